# SPDX-License-Identifier: GPL-3.0-or-later
"""The directions and weights of the physical lattice, and the layout of its cells in memory.

All cells lie in one row, z fastest, so that the neighbour along a direction is always the same
number of cells away. A layer of cells around the voxels stands for the vacuum outside: light that
leaves the domain arrives there.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from ...arrays import Array, Booleans, Floats, Integers
from .d3q19 import DIRECTIONS

MOVING = DIRECTIONS[1:]
"""(18, 3) int, c_m in voxels a step: six along the axes, then twelve diagonals."""

LENGTHS = np.linalg.norm(MOVING, axis=1)
"""(18,) voxels, l_m."""


def _weights() -> Floats:
    weights = np.where(LENGTHS == 1, 0.2 / 6, 0.8 / (12 * np.sqrt(2)))
    return weights / weights.sum()


WEIGHTS = _weights()
"""(18,), w_m, the shares of isotropic light. In free flight, light crosses a voxel over the length
l_m; w_m l_m has the moments of the sphere up to the fourth order."""

MEAN_LENGTH = float(WEIGHTS @ LENGTHS)
SECOND_MOMENT = float(WEIGHTS @ MOVING[:, 0] ** 2)

OPPOSITE = np.array([np.flatnonzero((-c == MOVING).all(axis=1))[0] for c in MOVING])
"""(18,) int, the opposite directions."""

THROUGH = [np.flatnonzero(MOVING[:, axis] == side) for axis, side in product(range(3), (-1, 1))]
"""For each of the faces -x, +x, -y, +y, -z, +z, the five directions that lead out of it."""


def parts(c: Integers) -> Integers:
    """(1 or 2, 3) int: the steps along axes that add up to c."""
    return np.diag(c)[c != 0]


GROUP = 256
"""Cells of a work-group; the number of cells is a multiple of it."""


class Cells:
    """The cells of a domain of `shape` voxels."""

    def __init__(self, shape: Sequence[int]) -> None:
        self.shape = nx, ny, nz = tuple(shape)
        self.row, self.plane = nz + 2, (ny + 2) * (nz + 2)
        self.first = self.plane + self.row + 1  # cell of the first voxel
        self.count = -(-((nx + 2) * self.plane) // GROUP) * GROUP
        self.steps = MOVING @ (self.plane, self.row, 1)  # to each neighbour

    def is_inside(self) -> Booleans:
        """(count,): whether a cell is a voxel of the domain."""
        return self.flat(np.ones(self.shape, bool), False)

    def flat(self, values: Array, outside: Any = 0) -> Array:
        """(..., count) of values (..., nx, ny, nz), with `outside` in all other cells."""
        cells = np.full((*values.shape[:-3], self.count), outside, values.dtype)
        self.inside(cells)[...] = values
        return cells

    def inside(self, cells: Array) -> Array:
        """(..., nx, ny, nz), a view of the cells (..., count) in the domain."""
        wide = [n + 2 for n in self.shape]
        used = cells[..., : wide[0] * self.plane].reshape(*cells.shape[:-1], *wide)
        return used[..., 1:-1, 1:-1, 1:-1]
