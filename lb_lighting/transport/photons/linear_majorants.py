# SPDX-License-Identifier: GPL-3.0-or-later
"""The linear majorants of super-voxels: linear programs that a backend solves.

The linear majorant of a super-voxel is the trilinear function with the least mean that is nowhere
below the density. Majorant minus density is trilinear in a fine cell, so its minimum is at a
corner, and it suffices that the majorant holds at the nodes. This is a linear program in its 8
values at the super-voxel's corners.
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

# Range of maximum densities outside which intermediate results would underflow or overflow.
_SMALLEST, _LARGEST = 1e-30, 1e30
_FINEST = 32  # cells along an edge of the largest linear program; beyond, blocks are merged
# Coefficients from corner values: that of a term is the alternating sum of the corners below it.
_COEFFICIENTS = np.array(
    [
        [(-1.0) ** (term - corner).sum() if np.all(corner <= term) else 0.0 for corner in CORNERS]
        for term in TERMS
    ]
)


def linear_majorants(
    density: Floats, size: int, interpolation: str = "constant", device: Device | str | None = None
) -> Majorants:
    """The `Majorants` with the least trilinear function in each super-voxel.

    Its mean is at most 0.1 % above the optimum (up to 32 fine cells along an edge; beyond that, it
    bounds the maxima of small blocks), and in no super-voxel above the constant majorant.
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
    """Fine cells along an edge of the smallest blocks that keep the program within _FINEST."""
    extent = min(size, longest)
    return next(n for n in range(1, size + 1) if size % n == 0 and extent <= n * _FINEST)


def _polynomials(corners: Floats, constant: Floats, problem: Problem, interpolation: str) -> Floats:
    """(mx, my, mz, 8) float32 coefficients from the corner values of each super-voxel's fine cells.

    Where the constant majorant (mx, my, mz) is as good or better, it is used instead.
    """
    values = np.empty(corners.shape, np.float32)
    x, y, z = (problem.size / problem.extents(axis) for axis in range(3))
    for layer, stretch in enumerate(x):  # one at a time, to stay in the cache
        usable = (constant[layer] > _SMALLEST) & (constant[layer] < _LARGEST)
        coefficients = np.where(usable[..., None], corners[layer], 0) @ _COEFFICIENTS.T
        slope = np.abs(coefficients[..., 1:]).sum(axis=-1)
        size = np.abs(coefficients[..., 0]) + slope
        # Where majorant and density are both constant, nothing is rounded.
        coefficients[..., 0] += MARGIN * size * ((slope > 0) | (interpolation == "linear"))
        mean = coefficients @ 0.5 ** TERMS.sum(axis=1)
        worse = ~(usable & (mean < constant[layer]))
        coefficients[worse] = 0
        coefficients[worse, 0] = constant[layer][worse]
        # Convert from coordinates along the extents to those along the whole super-voxel.
        stretches = stretch, y[:, None], z[None, :]
        for term, powers in enumerate(TERMS):
            for along, power in zip(stretches, powers, strict=True):
                if power:
                    coefficients[..., term] *= along
        values[layer] = coefficients
    return values
