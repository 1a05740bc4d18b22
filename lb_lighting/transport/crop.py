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

    def spread(self, values):
        """A grid of the domain, 0 outside of the box, of one of the box."""
        if self.is_whole:
            return values
        grid = np.zeros(self.whole, values.dtype)
        self.of(grid)[...] = values
        return grid


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
        targets = [(fluence, scale * length)]
        targets += [(part, scale * n) for part, n in zip(flux, c, strict=True) if n]
        axes = np.flatnonzero(c)
        faces = 2 * axes + (c[axes] > 0)
        left[faces] += _fly(_Way(box, c), leaving, targets)
    return left


class _Way:
    """A domain as light finds it that flies along a direction: all steps lead upwards.

    axis    along which it goes from plane to plane
    across  the other axis along which it moves, among a plane's two; None if there is none
    begin, end, planes  the box's first plane and that behind it, and how many there are
    inside  the box, in a plane
    """

    def __init__(self, box, c):
        self.box, self.c = box, c
        self.axis, *others = np.flatnonzero(c)
        self.across = others[0] - 1 if others else None
        ends = [
            (n - b, n - a) if step < 0 else (a, b)
            for a, b, n, step in zip(box.lower, box.upper, box.whole, c, strict=True)
        ]
        self.planes = box.whole[self.axis]
        self.begin, self.end = ends.pop(self.axis)
        moves = np.delete(c, self.axis) != 0
        self.inside = tuple(
            slice(*span) if moving else slice(None)
            for span, moving in zip(ends, moves, strict=True)
        )

    def turned(self, grid):
        """A view of a grid of the domain: what may be reached, by planes."""
        reached = tuple(
            slice(None) if step else slice(a, b)
            for a, b, step in zip(self.box.lower, self.box.upper, self.c, strict=True)
        )
        return self.flipped(grid[reached])

    def flipped(self, grid):
        return np.moveaxis(np.flip(grid, np.flatnonzero(self.c < 0)), self.axis, 0)


def _fly(way, leaving, targets):
    """Add light, times a factor, to each of the targets (grid, factor) where it comes by outside
    of the box; what leaves the domain through the end of the first axis, and of the second."""
    light, left = way.flipped(leaving), np.zeros(1 if way.across is None else 2)
    targets = [(way.turned(grid), factor) for grid, factor in targets]
    flow = np.zeros(targets[0][0].shape[1:], leaving.dtype)
    for plane in range(way.begin, way.planes):
        if plane < way.end:
            flow[way.inside] = 0
        for grid, factor in targets:
            grid[plane] += factor * flow
        if plane < way.end:
            flow[way.inside] = light[plane - way.begin]
        if way.across is not None and plane < way.planes - 1:
            flow, out = _moved(flow, way.across)
            left[1] += out
    left[0] = flow.sum(dtype=float)
    return left


def _moved(flow, axis):
    """(light in a plane that has moved on by a voxel along an axis, the sum of what it lost)."""
    first, last, rest, ahead = (
        (slice(None),) * axis + (part,)
        for part in (slice(1), slice(-1, None), slice(-1), slice(1, None))
    )
    moved = np.empty_like(flow)
    moved[first], moved[ahead] = 0, flow[rest]
    return moved, flow[last].sum(dtype=float)
