# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume grids of OpenVDB, in files or in memory, and in the world. Needs no Blender."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import openvdb

from ..arrays import Floats, Integers
from ..cache_key import content_of_blocks, content_of_file
from ..errors import EmptyError, SceneError
from ..transport.medium import Domain
from .grids.resample import Box
from .grids.sparse import SparseCells


@dataclass(frozen=True)
class Grid:
    """A grid by its name in a .vdb file, read when it is needed, or a grid that is in no file.

    path  of the file, or ""
    made  the openvdb grid that is in no file, or None
    """

    name: str
    path: str = ""
    made: Any = None

    @cached_property
    def vdb(self) -> Any:
        """The openvdb grid; SceneError for a file or a kind of grid that cannot be read."""
        if self.made is not None:
            return self.made
        try:
            return openvdb.read(self.path, self.name)
        except (KeyError, OSError, RuntimeError, TypeError, ValueError) as error:
            raise SceneError(
                f"The grid '{self.name}' of {self.path} cannot be read; save it again as a grid of "
                "numbers, or choose another."
            ) from error

    @property
    def cache_key(self) -> tuple[object, ...]:
        """What the grid contains, wherever its file lies."""
        if self.made is None:
            return self.name, content_of_file(self.path)
        return self.name, _index_to_object(self.made), content_of_blocks(_blocks(self.made))


def world_bounds(grid: Any, matrix_world: Floats) -> Box:
    """(lower, upper), each (3,) m: the box around the active voxels of `grid` in world space.

    matrix_world  (4, 4), of the object that shows the grid
    """
    return cells_of(grid, matrix_world).bounds


def resample(grid: Any, matrix_world: Floats, domain: Domain) -> Floats:
    """`grid` averaged over the voxels of `domain`: (nx, ny, nz) float32, 0 outside of the grid.

    A vector grid gives (3, nx, ny, nz).
    matrix_world  (4, 4), of the object that shows the grid
    """
    return cells_of(grid, matrix_world).on(domain)


def cells_of(grid: Any, matrix_world: Floats) -> SparseCells:
    """The `SparseCells` of an openvdb grid in the world; SceneError for an empty grid.

    matrix_world  (4, 4), of the object that shows the grid
    """
    lower, upper = _active_box(grid)
    matrix = np.asarray(matrix_world) @ _index_to_object(grid)
    return SparseCells(grid, matrix, lower, upper + 1)


def _active_box(grid: Any) -> tuple[Integers, Integers]:
    """The first and the last active voxel, (3,) int each."""
    if not grid.activeVoxelCount():
        raise EmptyError(f"The grid '{grid.name}' is empty; choose one with active voxels.")
    lower, upper = map(np.array, grid.evalActiveVoxelBoundingBox())
    return lower, upper


def _blocks(grid: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the active box of `grid`, then (first voxel, values) of each block with values."""
    if grid.activeVoxelCount():
        cells = cells_of(grid, np.eye(4))
        yield cells.lower, cells.upper
        yield from cells.blocks(cells.lower, cells.upper)


def _index_to_object(grid: Any) -> Floats:
    """(4, 4): the grid's own transform."""
    if not grid.transform.isLinear:
        raise SceneError(f"The grid '{grid.name}' is a frustum; save it with a linear transform.")
    origin, *axes = (
        np.array(grid.transform.indexToWorld(p)) for p in ((0, 0, 0), *np.eye(3, dtype=int))
    )
    matrix = np.eye(4)
    matrix[:3, 3] = origin
    matrix[:3, :3] = np.transpose(axes - origin)
    return matrix
