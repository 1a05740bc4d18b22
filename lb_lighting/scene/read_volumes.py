# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the grids and materials of Volume objects, and of volumes that geometry nodes make."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import openvdb

from ..arrays import Floats
from ..errors import EmptyError, SceneError
from .volumes import Grid

if TYPE_CHECKING:
    import bpy


def grid_names(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[str]:
    """Names of the grids that the original object `ob` shows at the current frame."""
    _geometry, grids = _loaded(ob, depsgraph)
    return [grid.name for grid in grids]


def find_grid(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, name: str = "density") -> Grid:
    """The `Grid` called `name` of the original object `ob` at the current frame.

    Raises EmptyError for a file that cannot be read, or a name that does not exist: other frames
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


def has_volume(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether the original object `ob` shows a volume, its own or one that its nodes make."""
    return _volume_geometry(ob, depsgraph) is not None


def volume_materials(
    ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> list[bpy.types.Material | None]:
    """[original material or None] of the slots of the volume that the original object `ob` shows.

    [] for a volume that nodes make without a material.
    """
    if ob.type == "VOLUME":
        slots: Any = ob.evaluated_get(depsgraph).material_slots
        return [slot.material and slot.material.original for slot in slots]
    geometry = _volume_geometry(ob, depsgraph)  # it owns its volume and has to outlive it
    return [material and material.original for material in geometry.volume.materials]


def is_in_object_space(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether a material's coefficients are per unit of the object's space, not per metre."""
    geometry = _volume_geometry(ob, depsgraph)
    return bool(geometry.volume.render.space == "OBJECT")


def world_matrix(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Floats:
    """(4, 4): the evaluated object's space to world space; SceneError if it is flat."""
    matrix = np.array(ob.evaluated_get(depsgraph).matrix_world, np.float32)
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise SceneError(f"'{ob.name}' is scaled to nothing along an axis; give it a size.")
    return matrix.astype(float)


def _volume_geometry(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Any:
    """The evaluated geometry of `ob` if it contains a volume, or None."""
    try:
        geometry: Any = ob.evaluated_get(depsgraph).evaluated_geometry()
    except TypeError:  # empties, lamps and the like
        return None
    return geometry if geometry.volume is not None else None


def _loaded(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[Any, Any]:
    """(geometry, grids); the geometry owns the grids and has to outlive them."""
    geometry = _volume_geometry(ob, depsgraph)
    if geometry is None:
        raise SceneError(f"'{ob.name}' has no volume; choose a Volume object or one that makes it.")
    grids = geometry.volume.grids
    # Blender keeps the error of an earlier frame for this frame's grids.
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
