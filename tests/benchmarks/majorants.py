# SPDX-License-Identifier: GPL-3.0-or-later
"""Tightness of majorants in super-voxels, mean(majorant) / mean(density), and seconds to build.

The media are two heads with a constant density in each voxel. The two majorants of the samplers are
compared with two simpler ones: a trilinear function between the maxima around each corner, and the
least-squares fit plus an offset that lifts it above the density everywhere.
"""

from time import perf_counter

import numpy as np

from lb_lighting.transport import device
from lb_lighting.transport.photons.linear_majorants import linear_majorants
from lb_lighting.transport.photons.majorants import constant_majorants
from tests.benchmarks.table import publish
from tests.setup import heads

SIZES = (4, 8, 16, 32)
BUILT_OF = (512, 512, 512)  # voxels of the volume that is timed


def whole(density, size):
    """The part of the density that consists of whole super-voxels, for the simple majorants."""
    return density[tuple(slice(n // size * size) for n in density.shape)]


def corner_maxima(density, size):
    """Mean of the trilinear function through the maxima of the super-voxels at each corner."""
    corners = np.pad(constant_majorants(density, size).values, 1, mode="edge")
    for axis in range(3):
        n = corners.shape[axis]
        corners = np.maximum(corners.take(range(n - 1), axis), corners.take(range(1, n), axis))
    for axis in range(3):
        n = corners.shape[axis]
        corners = (corners.take(range(n - 1), axis) + corners.take(range(1, n), axis)) / 2
    return corners.mean(dtype=float)


def least_squares(density, size):
    """Mean of the least-squares fit plus its largest error, by super-voxel."""
    node = np.arange(size + 1) / size
    x, y, z = (t.ravel() for t in np.meshgrid(node, node, node, indexing="ij"))
    terms = np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, x * y * z], axis=1)
    fit, middle = np.linalg.pinv(terms), np.array([8, 4, 4, 4, 2, 2, 2, 1]) / 8
    total = cells = 0
    for first in range(0, len(density), size):
        nodes = node_values(density[first : first + size], size)
        coefficients = nodes @ fit.T
        lift = (nodes - coefficients @ terms.T).max(axis=1)
        total += (coefficients @ middle + lift).sum()
        cells += len(nodes)
    return total / cells


def node_values(layer, size):
    """(cells, nodes): the largest voxel around each node of each super-voxel of a layer."""
    cells = layer.reshape(size, -1, size, layer.shape[2] // size, size).transpose(1, 3, 0, 2, 4)
    nodes = np.pad(cells, [(0, 0), (0, 0), (1, 1), (1, 1), (1, 1)], mode="edge")
    for axis in (2, 3, 4):
        nodes = np.maximum(nodes.take(range(size + 1), axis), nodes.take(range(1, size + 2), axis))
    return nodes.reshape(-1, (size + 1) ** 3)


def seconds(make, *arguments):
    start = perf_counter()
    make(*arguments)
    return perf_counter() - start


def row(name, head, size, found):
    density = whole(head, size)
    mean = density.mean(dtype=float)
    return {
        "head": name,
        "size": size,
        "constant": constant_majorants(density, size).mean / mean,
        "corner maxima": corner_maxima(density, size) / mean,
        "least squares + offset": least_squares(density, size) / mean,
        "linear": linear_majorants(density, size, device=found).mean / mean,
        "linear, between centres": linear_majorants(density, size, "linear", found).mean / mean,
    }


def main():
    found = device.choose()
    head = heads.ch2better()
    volumes = {"ch2better": head, "cranium": heads.cranium()}
    rows = [row(name, volume, size, found) for name, volume in volumes.items() for size in SIZES]
    large = heads.resampled(head, BUILT_OF)
    for line in rows[: len(SIZES)]:
        for kind, build in (("constant", constant_majorants), ("linear", linear_majorants)):
            line[f"512^3 {kind}, s"] = seconds(build, large, line["size"])
    publish("majorants", found.label, rows)


if __name__ == "__main__":
    main()
