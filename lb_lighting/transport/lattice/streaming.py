# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that has left the box of all matter, streamed on through the rest of the domain.

Outside of the box light never collides, and what has left along a direction of the lattice never
comes back. So it is streamed once, at the end.
"""

from typing import Any

import numpy as np

from ...arrays import Floats, Integers
from ..backend import Lattice
from ..box import Box
from .layout import LENGTHS, MOVING


def stream_on(lattice: Lattice, box: Box, scale: float, fluence: Floats, flux: Floats) -> Floats:
    """Carry the light that leaves the lattice of a box on through the domain.

    It is added, scale times, to fluence (nx, ny, nz) and flux (3, nx, ny, nz), which are the
    domain's. Returns (6,): what leaves that through the faces -x, +x, -y, +y, -z, +z, as
    `NumpyLattice.lost` counts it.
    """
    left = np.zeros(6)
    for leaving, c, length in zip(lattice.leaving(), MOVING, LENGTHS, strict=True):
        axes = np.flatnonzero(c)
        light = _Leaving(leaving, box, c, axes)
        light.add_to(fluence, scale * length)
        for axis in axes:
            light.add_to(flux[axis], scale * c[axis])
        left[2 * axes + (c[axes] > 0)] += light.left()
    return left


class _Leaving:
    """Light that leaves a box along a direction, which leads upwards as seen here.

    Of grids the axes that it moves along come first. It leaves through the last plane of the first
    of these, and along a diagonal through the last row of the others, too: these rows, one behind
    the other, are the light that crosses any plane further on, one row further each time.

    light  (rows, ...), or without a diagonal (...)
    """

    def __init__(self, leaving: Floats, box: Box, c: Integers, axes: Integers) -> None:
        self.c, self.axes, self.diagonal = c, axes, len(axes) > 1
        ends = [
            (n - b, n - a, n) if step < 0 else (a, b, n)
            for a, b, n, step in zip(box.lower, box.upper, box.whole, c, strict=True)
        ]
        # Of the box the first, and the one behind it; of the domain how many.
        self.begin, self.end, self.planes = ends[axes[0]]
        self.row, self.row_end, self.rows = ends[axes[-1]]
        self.beside = tuple(
            slice(None) if step else slice(a, b)
            for a, b, step in zip(box.lower, box.upper, c, strict=True)
        )
        leaving = self._turned(leaving)
        self.light = leaving[-1]
        if self.diagonal:
            self.light = np.concatenate([self.light, leaving[-2::-1, -1]])

    def _turned(self, grid: Floats) -> Floats:
        flipped = np.flip(grid, tuple(map(int, np.flatnonzero(self.c < 0))))
        return np.moveaxis(flipped, self.axes, range(len(self.axes)))

    def add_to(self, grid: Floats, factor: float) -> None:
        """Add it, times a factor, to a grid (nx, ny, nz) along its way."""
        grid, light = self._turned(grid[self.beside]), self.light * factor
        if not self.diagonal:
            grid[self.end :] += light
            return
        for plane in range(self.begin + 1, self.planes):
            row = self._first_row(plane)
            # Beside the box: only what has left it in planes before.
            first = max(self.row_end - row, 0) if plane < self.end else 0
            last = min(len(light), self.rows - row)
            if first < last:
                grid[plane, row + first : row + last] += light[first:last]

    def left(self) -> Any:
        """What leaves the domain, by axis."""
        light = self.light.reshape(len(self.light), -1).sum(axis=1, dtype=float)
        if not self.diagonal:
            return light.sum()
        # Rows that are still there in the last plane leave through it, also in the corner.
        there = max(self.rows - self._first_row(self.planes - 1), 0)
        return light[:there].sum(), light[there:].sum()

    def _first_row(self, plane: int) -> int:
        """Where the first of the light's rows has come to in a plane."""
        return self.row + plane - self.end + 1
