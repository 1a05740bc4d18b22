# SPDX-License-Identifier: GPL-3.0-or-later
"""Solves in larger or smaller voxels than the medium's.

Scattered light is smooth where uncollided light has shadows. In voxels of twice the edge the
lattice has an eighth of the voxels and needs about half of the steps;
docs/measurements/speed-and-accuracy.md has the error. Voxels that are too thick for the lattice are
divided (`lattice.subdivision`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Floats
from .field import Field
from .lights.base import Light
from .medium import Medium, merged, repeated


@dataclass(frozen=True)
class Resampling:
    """The voxels of a solve: `merge` of the medium's along an edge make one, or one is divided
    into `divide` along its edges."""

    merge: int = 1
    divide: int = 1

    def medium(self, medium: Medium) -> Medium:
        """A medium in these voxels."""
        if self.merge > 1:
            return medium.merged(self.merge)
        return medium.divided(self.divide) if self.divide > 1 else medium

    def lights(self, lights: Sequence[Light]) -> list[Light]:
        """Lights for a medium in these voxels."""
        return [light.with_shadow_density(self._grid) for light in lights]

    def _grid(self, grid: Floats) -> Any:
        if self.merge > 1:
            return merged(grid, self.merge)
        return repeated(grid, self.divide) if self.divide > 1 else grid

    def restored(self, field: Field) -> Field:
        """The field of a divided medium, in the voxels before the division."""
        pieces, domain = self.divide, field.domain
        if pieces == 1:
            return field
        coarse = replace(
            domain,
            voxel_size=domain.voxel_size * pieces,
            shape=tuple(n // pieces for n in domain.shape),
        )
        names = ("fluence", "direct", "flux", "direct_flux", "by_light", "forward")
        grids = {name: _mean(getattr(field, name), pieces) for name in names}
        variance = None if field.variance is None else _mean(field.variance, pieces) / pieces**3
        return replace(field, domain=coarse, variance=variance, collision_source=None, **grids)


def combine(uncollided: Field, scattered: Field, merge: int) -> Field:
    """The `Field` of uncollided light in the medium's voxels and scattered light in merged ones."""
    shape = uncollided.domain.shape
    names = ("fluence", "flux", "variance", "forward")
    grids = {name: between(getattr(scattered, name), merge, shape) for name in names}
    return replace(uncollided, report=scattered.report, **grids)


def between(grid: Any, merge: int, shape: Sequence[int]) -> Any:
    """(..., *shape) of a grid in voxels `merge` times as large: linear between their centres, and
    constant beyond the outermost ones; None stays None."""
    if grid is None:
        return None
    for axis, n in zip((-3, -2, -1), shape, strict=True):
        last = grid.shape[axis] - 1
        place = np.clip((np.arange(n) + 0.5) / merge - 0.5, 0, last)
        below = np.floor(place).astype(int)
        share = (place - below).astype(np.float32).reshape(-1, *[1] * (-1 - axis))
        above = np.minimum(below + 1, last)
        grid = grid.take(below, axis) * (1 - share) + grid.take(above, axis) * share
    return grid


def _mean(values: Any, pieces: int) -> Any:
    """The mean of the pieces of each voxel, of a grid (..., nx, ny, nz); None stays None."""
    if values is None:
        return None
    *outer, nx, ny, nz = values.shape
    split = (nx // pieces, pieces, ny // pieces, pieces, nz // pieces, pieces)
    return values.reshape(*outer, *split).mean(axis=(-5, -3, -1))
