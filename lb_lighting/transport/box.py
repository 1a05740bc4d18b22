# SPDX-License-Identifier: GPL-3.0-or-later
"""The box of a domain that holds all its matter: the lattice covers nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from .lights.base import Light
from .medium import Medium

# Layers of empty voxels around matter in the box: in the first one light meets opaque voxels
# or is reflected where a medium ends; `boundary_reflection` averages over the second.
_MARGIN = 2


@dataclass(frozen=True)
class Box:
    """The voxels from `lower` up to, but without, `upper`, in a domain of `whole` voxels; each
    (3,) int."""

    lower: tuple[int, ...]
    upper: tuple[int, ...]
    whole: tuple[int, ...]

    @classmethod
    def around(cls, grids: Sequence[Array]) -> "Box":
        """The box of all voxels where one of the grids (nx, ny, nz) is above 0, with a margin; the
        whole domain if there are none."""
        whole = grids[0].shape
        ends = [_ends(grids, axis, n) for axis, n in enumerate(whole)]
        filled = [end for end in ends if end is not None]
        if len(filled) < len(ends):
            return cls.all(whole)
        lower, upper = zip(*filled, strict=True)
        return cls(lower, upper, whole)

    @classmethod
    def all(cls, shape: Sequence[int]) -> "Box":
        """The whole domain of a shape."""
        return cls((0, 0, 0), tuple(shape), tuple(shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """(nx, ny, nz) voxels of the box."""
        return tuple(b - a for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole domain."""
        return self.shape == self.whole

    def of(self, grid: Any) -> Any:
        """The part of a grid (..., nx, ny, nz) in the box, a view; other values unchanged."""
        if np.ndim(grid) < 3:
            return grid
        return grid[..., *map(slice, self.lower, self.upper)]


def matter(medium: Medium, lights: Sequence[Light]) -> Box:
    """The `Box` of everything that light may collide with and of all emission."""
    shadows = [light.shadow_density for light in lights]
    emission = None if medium.emission is None else medium.emission.sum(axis=0)
    grids = (medium.density, medium.occlusion, emission, *shadows)
    return Box.around([grid for grid in grids if grid is not None])


def _ends(grids: Sequence[Array], axis: int, n: int) -> tuple[int, int] | None:
    """(first, end) along an axis; None if all grids are 0."""
    across = tuple(other for other in range(3) if other != axis)
    filled = np.flatnonzero(np.any([grid.any(axis=across) for grid in grids], axis=0))
    if not len(filled):
        return None
    return max(0, int(filled[0]) - _MARGIN), min(n, int(filled[-1]) + 1 + _MARGIN)
