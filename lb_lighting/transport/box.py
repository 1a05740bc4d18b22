# SPDX-License-Identifier: GPL-3.0-or-later
"""The box of a domain that holds all its matter: the lattice reaches no further."""

from dataclasses import dataclass

import numpy as np

# Voxels around matter that still tell of it: in the next ones light meets what is opaque, or comes
# back where a medium ends; in those behind them lies what `boundary_reflection` takes the mean of.
_MARGIN = 2


@dataclass(frozen=True)
class Box:
    """The voxels from `lower` to before `upper` of a domain of `whole` voxels, each (3,) int."""

    lower: tuple
    upper: tuple
    whole: tuple

    @classmethod
    def around(cls, grids):
        """All that is above 0 in any of the grids (nx, ny, nz), and a margin; the domain where
        there is nothing."""
        whole = grids[0].shape
        ends = [_ends(grids, axis, n) for axis, n in enumerate(whole)]
        return cls.all(whole) if None in ends else cls(*zip(*ends, strict=True), whole)

    @classmethod
    def all(cls, shape):
        return cls((0, 0, 0), tuple(shape), tuple(shape))

    @property
    def shape(self):
        return tuple(b - a for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def is_whole(self):
        return self.shape == self.whole

    def of(self, grid):
        """The part of a grid (..., nx, ny, nz) in the box, a view; of anything else all."""
        if np.ndim(grid) < 3:
            return grid
        return grid[..., *map(slice, self.lower, self.upper)]


def matter(medium, lights):
    """The `Box` of all that light may collide with, and of all that shines."""
    shadows = [getattr(light, "shadow_density", None) for light in lights]
    emission = None if medium.emission is None else medium.emission.sum(axis=0)
    grids = (medium.density, medium.occlusion, emission, *shadows)
    return Box.around([grid for grid in grids if grid is not None])


def _ends(grids, axis, n):
    """(first, end) along an axis; None where there is nothing."""
    across = tuple(other for other in range(3) if other != axis)
    filled = np.flatnonzero(np.any([grid.any(axis=across) for grid in grids], axis=0))
    if not len(filled):
        return None
    return max(0, int(filled[0]) - _MARGIN), min(n, int(filled[-1]) + 1 + _MARGIN)
