# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattered light found in larger voxels than unscattered light.

What has scattered is smooth where what has not has shadows. In voxels of twice the edge the lattice
has an eighth of the voxels and about half of the steps; docs/measurements/speed-and-accuracy.md
has what it costs in error.
"""

from dataclasses import replace

import numpy as np

from .medium import merged


def coarse(light, pieces):
    """A light for a medium whose voxels are merged."""
    return light.with_shadow_density(lambda density: merged(density, pieces))


def put_together(unscattered, scattered, pieces):
    """The `Field` of a medium: unscattered light of its own voxels, scattered of merged ones."""
    shape = unscattered.domain.shape
    names = ("fluence", "flux", "variance", "forward")
    grids = {name: between(getattr(scattered, name), pieces, shape) for name in names}
    return replace(unscattered, report=scattered.report, **grids)


def between(grid, pieces, shape):
    """(..., *shape) of a grid in voxels `pieces` times as large: linear between their centres, and
    constant beyond the outermost ones. None as it is."""
    if grid is None:
        return None
    for axis, n in zip((-3, -2, -1), shape, strict=True):
        last = grid.shape[axis] - 1
        place = np.clip((np.arange(n) + 0.5) / pieces - 0.5, 0, last)
        below = np.floor(place).astype(int)
        share = (place - below).astype(np.float32).reshape(-1, *[1] * (-1 - axis))
        above = np.minimum(below + 1, last)
        grid = grid.take(below, axis) * (1 - share) + grid.take(above, axis) * share
    return grid
