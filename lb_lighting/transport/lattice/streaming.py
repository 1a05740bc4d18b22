# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that has left the box of all matter, streamed through the rest of the domain.

Outside the box, light never collides, and light that has left it along a direction of the lattice
never returns. So it is streamed once, after the solve.
"""

from typing import Any

import numpy as np

from ...arrays import Floats, Integers
from ..backend import Lattice
from ..box import Box
from .layout import LENGTHS, MOVING


def stream_on(lattice: Lattice, box: Box, scale: float, fluence: Floats, flux: Floats) -> Floats:
    """Stream the light that leaves the lattice of a box through the domain.

    Adds `scale` times the light to fluence (nx, ny, nz) and flux (3, nx, ny, nz) of the domain.
    Returns (6,): the light that leaves the domain through the faces -x, +x, -y, +y, -z, +z, as of
    `NumpyLattice.lost`.
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
    """Light that leaves a box along a direction, in grids flipped so that it is positive.

    The axes along which it moves come first. It leaves through the last plane of the first axis
    and, along a diagonal, also through the last row of the second. These rows, in order, are
    the light that crosses any later plane, shifted by one row per plane.

    light  (rows, ...) of a diagonal, else (...)
    """

    def __init__(self, leaving: Floats, box: Box, c: Integers, axes: Integers) -> None:
        self.c, self.axes, self.diagonal = c, axes, len(axes) > 1
        ends = [
            (n - b, n - a, n) if step < 0 else (a, b, n)
            for a, b, n, step in zip(box.lower, box.upper, box.whole, c, strict=True)
        ]
        # The first plane of the box, the one behind its last, and the number of the domain's.
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
        flipped = np.flip(grid, tuple(np.flatnonzero(self.c < 0)))
        return np.moveaxis(flipped, self.axes, range(len(self.axes)))

    def add_to(self, grid: Floats, factor: float) -> None:
        """Add the light, times a factor, to a grid (nx, ny, nz) along its path."""
        grid, light = self._turned(grid[self.beside]), self.light * factor
        if not self.diagonal:
            grid[self.end :] += light
            return
        for plane in range(self.begin + 1, self.planes):
            row = self._first_row(plane)
            # Beside the box, only light that has left it in earlier planes.
            first = max(self.row_end - row, 0) if plane < self.end else 0
            last = min(len(light), self.rows - row)
            if first < last:
                grid[plane, row + first : row + last] += light[first:last]

    def left(self) -> Any:
        """The light that leaves the domain, by axis."""
        light = self.light.reshape(len(self.light), -1).sum(axis=1, dtype=float)
        if not self.diagonal:
            return light.sum()
        # Rows that reach the last plane leave through it, also in the corner.
        rows = max(self.rows - self._first_row(self.planes - 1), 0)
        return light[:rows].sum(), light[rows:].sum()

    def _first_row(self, plane: int) -> int:
        """The row of a plane that the first row of the light has reached."""
        return self.row + plane - self.end + 1
