# SPDX-License-Identifier: GPL-3.0-or-later
"""The linear majorants of super-voxels: linear programs that a backend solves.

The linear majorant of a super-voxel is the trilinear function of the least mean that is nowhere
below the density. Majorant minus density is trilinear in a fine cell, so it is least at a corner,
and it is enough to demand the majorant at the nodes: a linear program in its 8 values at the
super-voxel's corners.
"""

import numpy as np

from ...arrays import Floats
from .. import device as devices
from ..backend import backend_of
from ..device import Device
from .majorants import (
    CORNERS,
    MARGIN,
    TERMS,
    Majorants,
    Problem,
    block_maxima,
    constant_majorants,
    fine_cells,
    mean_of,
    require_size,
)

# Maximum densities beyond which they would underflow or overflow on the way.
_SMALLEST, _LARGEST = 1e-30, 1e30
_FINEST = 32  # nodes an edge, less one, of the largest linear program; beyond, blocks are merged
# Coefficients from corner values: a term takes the alternating sum of the corners below it.
_COEFFICIENTS = np.array(
    [
        [(-1.0) ** (term - corner).sum() if np.all(corner <= term) else 0.0 for corner in CORNERS]
        for term in TERMS
    ]
)


def linear_majorants(
    density: Floats, size: int, interpolation: str = "constant", device: Device | str | None = None
) -> Majorants:
    """The `Majorants` by the least trilinear function in each super-voxel.

    It is at most 0.1 % above the least mean that is possible (up to 32 fine cells an edge; beyond,
    it bounds the maxima of small blocks), and in no super-voxel looser than the constant bound.
    device  as in `device.choose`; NumPy computes in float64, OpenCL in float32
    SettingsError for a size below 1.
    """
    grid = fine_cells(density, interpolation)
    require_size(size)
    merged = _merged(size, max(grid.shape))
    if merged == 1:
        problem = Problem(grid.values, grid.shape, size, interpolation == "constant")
    else:
        blocks = block_maxima(grid.values, grid.shape, merged)
        problem = Problem(blocks, blocks.shape, size // merged, True)
    values = np.empty((*problem.cells, 8), np.float32)
    constant = constant_majorants(density, size, interpolation).values
    backend = backend_of(devices.choose(device))
    for layers, slab in problem.slabs():
        corners = backend.least_corners(slab)
        values[layers] = _polynomials(corners, constant[layers], slab, interpolation)
    return Majorants(size, values, mean_of(values, TERMS, grid, size))


def _merged(size: int, longest: int) -> int:
    """Fine cells an edge of the blocks that a linear program of few enough nodes can tell apart."""
    extent = min(size, longest)
    return next(n for n in range(1, size + 1) if size % n == 0 and extent <= n * _FINEST)


def _polynomials(corners: Floats, constant: Floats, problem: Problem, interpolation: str) -> Floats:
    """(mx, my, mz, 8) float32 coefficients from the corner values of what each super-voxel has.

    Where that is no better than the constant bound (mx, my, mz), it becomes the constant bound.
    """
    values = np.empty(corners.shape, np.float32)
    x, y, z = (problem.size / problem.extents(axis) for axis in range(3))
    for layer, stretch in enumerate(x):  # one at a time, for the sake of the cache
        usable = (constant[layer] > _SMALLEST) & (constant[layer] < _LARGEST)
        coefficients = np.where(usable[..., None], corners[layer], 0) @ _COEFFICIENTS.T
        slope = np.abs(coefficients[..., 1:]).sum(axis=-1)
        size = np.abs(coefficients[..., 0]) + slope
        # Where bound and density are both constant, nothing is rounded.
        coefficients[..., 0] += MARGIN * size * ((slope > 0) | (interpolation == "linear"))
        mean = coefficients @ 0.5 ** TERMS.sum(axis=1)
        worse = ~(usable & (mean < constant[layer]))
        coefficients[worse] = 0
        coefficients[worse, 0] = constant[layer][worse]
        # From coordinates along what there is of the super-voxel to those along the whole.
        stretches = stretch, y[:, None], z[None, :]
        for term, powers in enumerate(TERMS):
            for along, power in zip(stretches, powers, strict=True):
                if power:
                    coefficients[..., term] *= along
        values[layer] = coefficients
    return values
