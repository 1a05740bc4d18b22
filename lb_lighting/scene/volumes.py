# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume grids, from files, sequences and geometry nodes."""

import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import openvdb

from ..cache_key import content_of_blocks, content_of_file
from ..errors import EmptyError, SceneError
from .grids.sparse import SparseCells


@dataclass(frozen=True)
class Grid:
    """A grid by its name in a .vdb file, read when it is needed, or one that no file has.

    path  of the file, or ""
    made  the openvdb grid that is in no file, or None
    """

    name: str
    path: str = ""
    made: object = None

    @cached_property
    def vdb(self):
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
    def cache_key(self):
        """What the grid holds, wherever it lies."""
        if self.made is None:
            return self.name, content_of_file(self.path)
        return self.name, _index_to_object(self.made), content_of_blocks(_blocks(self.made))


def grid_names(ob, depsgraph):
    """Names of the grids that the original object `ob` shows at the current frame."""
    _geometry, grids = _loaded(ob, depsgraph)
    return [grid.name for grid in grids]


def find_grid(ob, depsgraph, name="density"):
    """The `Grid` called `name` of the original object `ob` at the current frame.

    Raises EmptyError for a file that cannot be read, or a name that does not exist: another frame
    may have them.
    """
    geometry, grids = _loaded(ob, depsgraph)
    names = [grid.name for grid in grids]
    if name not in names:
        known = list(filter(None, names))
        if known:
            advice = f"choose one of: {', '.join(known)}"
        else:
            advice = "its grids have no names; name the grid in the program that wrote the file"
        raise EmptyError(f"'{ob.name}' has no grid '{name}'; {advice}.")
    if grids.frame_filepath and not ob.modifiers:
        return Grid(name, grids.frame_filepath)
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder, "evaluated.vdb"))
        geometry.volume.grids.save(filepath=path)
        return Grid(name, made=openvdb.read(path, name))


def has_volume(ob, depsgraph):
    """Whether the original object `ob` shows a volume, its own or one that its nodes make."""
    return _volume_geometry(ob, depsgraph) is not None


def volume_materials(ob, depsgraph):
    """[original material or None] of the slots that the volume of `ob` has, maybe by its nodes.

    [] for a volume that nodes make and give none.
    """
    if ob.type == "VOLUME":
        slots = [slot.material for slot in ob.evaluated_get(depsgraph).material_slots]
        return [material and material.original for material in slots]
    geometry = _volume_geometry(ob, depsgraph)  # it owns its volume and has to outlive it
    return [material and material.original for material in geometry.volume.materials]


def is_in_object_space(ob, depsgraph):
    """Whether a material's coefficients are per unit of the object's own space, not per m."""
    geometry = _volume_geometry(ob, depsgraph)
    return geometry.volume.render.space == "OBJECT"


def world_matrix(ob, depsgraph):
    """(4, 4): the evaluated object's space to world space; SceneError where that is flat."""
    matrix = np.array(ob.evaluated_get(depsgraph).matrix_world, np.float32)
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise SceneError(f"'{ob.name}' is scaled to nothing along an axis; give it a size.")
    return matrix.astype(float)


def world_bounds(grid, matrix_world):
    """(lower, upper), each (3,) m: the box around the active voxels of `grid` in world space.

    matrix_world  (4, 4), of the object that shows the grid
    """
    return cells_of(grid, matrix_world).bounds


def resample(grid, matrix_world, domain):
    """`grid` averaged over the voxels of `domain`: (nx, ny, nz) float32, 0 outside of the grid.

    A vector grid gives (3, nx, ny, nz).
    matrix_world  (4, 4), of the object that shows the grid
    """
    return cells_of(grid, matrix_world).on(domain)


def cells_of(grid, matrix_world):
    """The `SparseCells` of an openvdb grid in the world; SceneError for one that is empty.

    matrix_world  (4, 4), of the object that shows the grid
    """
    lower, upper = _active_box(grid)
    matrix = np.asarray(matrix_world) @ _index_to_object(grid)
    return SparseCells(grid, matrix, lower, upper + 1)


def _volume_geometry(ob, depsgraph):
    """The evaluated geometry of `ob` if there is a volume in it, or None."""
    try:
        geometry = ob.evaluated_get(depsgraph).evaluated_geometry()
    except TypeError:  # empties, lamps and the like
        return None
    return geometry if geometry.volume is not None else None


def _loaded(ob, depsgraph):
    """(geometry, grids); the geometry owns the grids and has to outlive them."""
    geometry = _volume_geometry(ob, depsgraph)
    if geometry is None:
        raise SceneError(f"'{ob.name}' has no volume; choose a Volume object or one that makes it.")
    grids = geometry.volume.grids
    # The error of an earlier frame stays with the grids of this one.
    if not grids.load() and not len(grids):
        raise EmptyError(
            f"The volume file '{geometry.volume.filepath}' of '{ob.name}' cannot be read "
            f"({grids.error_message}); correct its path."
        )
    if not len(grids):
        if geometry.volume.is_sequence and not grids.frame_filepath:
            raise EmptyError(
                f"'{ob.name}' shows no file of its sequence at this frame; correct its start, its "
                "number of frames or its mode."
            )
        raise EmptyError(f"The volume of '{ob.name}' has no grids; choose a file that has some.")
    return geometry, grids


def _active_box(grid):
    """The first and the last active voxel, (3,) int each."""
    if not grid.activeVoxelCount():
        raise EmptyError(f"The grid '{grid.name}' is empty; choose one with active voxels.")
    return tuple(map(np.array, grid.evalActiveVoxelBoundingBox()))


def _blocks(grid):
    """Yields the active box of `grid`, then (first voxel, values) of each block with any values."""
    if grid.activeVoxelCount():
        cells = cells_of(grid, np.eye(4))
        yield cells.lower, cells.upper
        yield from cells.blocks(cells.lower, cells.upper)


def _index_to_object(grid):
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
