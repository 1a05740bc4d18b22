# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads evaluated meshes: their arrays, and all the faces that objects bring into the scene.

It reads the arrays that Blender keeps in memory, which takes milliseconds for millions of faces.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array, Floats, Integers
from .meshes import Faces, Mesh
from .triangles import FARTHEST

if TYPE_CHECKING:
    import bpy


@dataclass(frozen=True)
class Part:
    """Triangles of one material that an object brings into the scene.

    object     the original object that has the mesh or instances it
    instanced  whether it instances the mesh
    """

    faces: Faces
    material: bpy.types.Material | None
    object: bpy.types.Object
    instanced: bool


def world_parts(depsgraph: bpy.types.Depsgraph, objects: Iterable[bpy.types.Object]) -> list[Part]:
    """[Part]: all the evaluated faces that the original `objects` bring into the scene.

    These are the faces of their meshes (or of curves, texts and metaballs) after modifiers, and of
    everything that they instance: by geometry nodes, particles, collections, vertices and faces.
    """
    chosen = set(objects)
    meshes: dict[Any, Mesh] = {}
    matrices: dict[Any, list[Any]] = defaultdict(list)
    instances: Any = depsgraph.object_instances
    for instance in instances:
        ob: Any = instance.object
        owner: Any = instance.parent if instance.is_instance else ob
        source = owner.original
        if source not in chosen or not instance.show_self or ob.type != "MESH":
            continue
        materials = _materials(ob)
        key = source, ob.data.as_pointer(), materials, instance.is_instance
        if key not in meshes:
            meshes[key] = read_mesh(ob.data, len(materials))
        matrices[key].append([tuple(row) for row in instance.matrix_world])
    return [
        Part(
            Faces(mesh, slot, np.array(matrices[key]), source.name),
            materials[slot],
            source,
            is_instance,
        )
        for key, mesh in meshes.items()
        for source, _pointer, materials, is_instance in [key]
        for slot in mesh.used_slots
    ]


def vertices(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[Mesh, Floats]:
    """(the `Mesh` of the mesh object `ob` after modifiers, its space to world space (4, 4)).

    If modifiers change the number of vertices, it is the original mesh.
    """
    evaluated = ob.evaluated_get(depsgraph)
    original: Any = ob.data
    data: Any = evaluated.data
    mesh = read_mesh(data if len(data.vertices) == len(original.vertices) else original)
    is_nowhere = ~np.all(np.abs(mesh.points) < FARTHEST, axis=1)  # no face has them, see Mesh.fault
    mesh.points[is_nowhere] = 0
    return mesh, np.array(evaluated.matrix_world)


def read_mesh(mesh: bpy.types.Mesh, slots: int = 1) -> Mesh:
    """The `Mesh` of a Blender mesh with this number of material slots."""
    mesh.calc_loop_triangles()
    face = _read(mesh.loop_triangle_polygons, "value", np.int32)
    has_only_quads = np.bincount(face, minlength=1).max() <= 2
    points, vertex, material = _arrays(mesh)
    return Mesh(
        points.reshape(-1, 3),
        vertex,
        face,
        len(mesh.polygons),
        None if has_only_quads else _read(mesh.loop_triangles, "loops", np.int32, 3).reshape(-1, 3),
        # Blender draws faces whose slot does not exist with the nearest slot.
        None if material is None else np.clip(material, 0, slots - 1),
    )


def _materials(ob: Any) -> tuple[bpy.types.Material | None, ...]:
    """The original materials of an evaluated object by slot; a bare mesh has one empty slot."""
    # Curves, texts and metaballs appear as temporary mesh objects without slots.
    slots = [slot.material for slot in ob.material_slots] or ob.data.materials
    return tuple(m and m.original for m in slots) or (None,)


def _arrays(mesh: bpy.types.Mesh) -> tuple[Floats, Integers, Integers | None]:
    """(points, the point of each corner, the slot of each face or None), flat."""
    attributes = mesh.attributes
    # Edit Mode hides all attributes, and a mesh without faces has no corners.
    if not {"position", ".corner_vert"}.issubset(attributes.keys()):
        return (
            _read(mesh.vertices, "co", np.float32, 3),
            _read(mesh.loops, "vertex_index", np.int32),
            _read(mesh.polygons, "material_index", np.int32),
        )
    position: Any = attributes["position"]
    corner: Any = attributes[".corner_vert"]
    slots: Any = attributes.get("material_index")
    has_slots = slots and (slots.domain, slots.data_type) == ("FACE", "INT")
    return (
        _read(position.data, "vector", np.float32, 3),
        _read(corner.data, "value", np.int32),
        _read(slots.data, "value", np.int32) if has_slots else None,
    )


def _read(collection: Any, name: str, dtype: type, width: int = 1) -> Array:
    """The property `name` of all elements of a Blender collection, flat."""
    values: Array = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values
