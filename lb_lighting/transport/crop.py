# SPDX-License-Identifier: GPL-3.0-or-later
"""The box of a domain that holds all its matter, and light that has left it.

Outside of the box light only streams on, and what has left it along a direction of the lattice
never comes back. So the lattice need not reach further, and its light is carried on once, at last.
"""

from dataclasses import dataclass

import numpy as np

from .cells import LENGTHS, MOVING

# Voxels around matter that still tell of it: in the next ones light meets what is opaque, or comes
# back where a medium ends; in those behind them lies what `borders.mirrors` takes the mean of.
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


def _ends(grids, axis, n):
    """(first, end) along an axis; None where there is nothing."""
    across = tuple(other for other in range(3) if other != axis)
    filled = np.flatnonzero(np.any([grid.any(axis=across) for grid in grids], axis=0))
    if not len(filled):
        return None
    return max(0, int(filled[0]) - _MARGIN), min(n, int(filled[-1]) + 1 + _MARGIN)


def stream_on(lattice, box, scale, fluence, flux):
    """Carry the light that leaves the lattice of a box on through the domain.

    It is added, scale times, to fluence (nx, ny, nz) and flux (3, nx, ny, nz), which are the
    domain's. Returns (6,): what leaves that through the faces -x, +x, -y, +y, -z, +z, as
    `NumpyLattice.lost` counts it.
    """
    left = np.zeros(6)
    for leaving, c, length in zip(lattice.leaving(), MOVING, LENGTHS, strict=True):
        light = np.multiply(leaving, scale, dtype=fluence.dtype)
        for start, sheet in _sheets(light, c, np.array(box.lower)):
            _fly(sheet, start, c, length, fluence, flux, left)
    return left / scale


def _sheets(light, c, lower):
    """[((3,) voxel of its first corner, light)] that has just left a box along c, by the faces
    that it left through; each diagonal's by the first of its two."""
    rest = [slice(None)] * 3
    for axis in np.flatnonzero(c):
        last, others = (slice(-1, None), slice(-1)) if c[axis] > 0 else (slice(1), slice(1, None))
        at = tuple(last if n == axis else part for n, part in enumerate(rest))
        first = [part.indices(n)[0] for part, n in zip(at, light.shape, strict=True)]
        yield lower + first + c, light[at]
        rest[axis] = others


def _fly(sheet, start, c, length, fluence, flux, left):
    """Add to all voxels that a sheet of light crosses, and in the end to what has left."""
    while sheet.size:
        for axis in np.flatnonzero(c):
            sheet, out, start = _split(sheet, start, axis, c[axis], fluence.shape[axis])
            left[2 * axis + (c[axis] > 0)] += out.sum(dtype=float)
        at = tuple(slice(a, a + n) for a, n in zip(start, sheet.shape, strict=True))
        fluence[at] += length * sheet
        for part, component in zip(flux, c, strict=True):
            if component:
                part[at] += component * sheet
        start = start + c


def _split(sheet, start, axis, forward, end):
    """(what of a sheet is in the domain, what is beyond its end along an axis, its new start)."""
    inside = end - start[axis] if forward > 0 else max(0, -start[axis])
    lower, upper = np.split(sheet, [min(max(inside, 0), sheet.shape[axis])], axis)
    if forward > 0:
        return lower, upper, start
    start = start.copy()
    start[axis] = max(start[axis], 0)
    return upper, lower, start
