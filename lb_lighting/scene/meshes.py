# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes as the scene shows them: their triangles by material, and the points that show light."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from .voxelize import Faces, Shape


@dataclass(frozen=True)
class Part:
    """Triangles of one material that an object brings into the scene.

    faces      where they are
    material   bpy.types.Material or None
    object     the original bpy.types.Object that they come from, or that instances them
    instanced  whether it instances them
    """

    faces: Faces
    material: object
    object: object
    instanced: bool


def world_parts(depsgraph, objects):
    """[Part]: all evaluated mesh surface that the original `objects` contribute to the scene.

    That is their own mesh (or that of a curve, text or metaball) with modifiers, and everything
    that they instance: geometry nodes, particles, collections, vertices and faces.
    """
    chosen = set(objects)
    shapes = {}
    matrices = defaultdict(list)
    for instance in depsgraph.object_instances:
        source = (instance.parent if instance.is_instance else instance.object).original
        ob = instance.object
        if source not in chosen or not instance.show_self or ob.type != "MESH":
            continue
        materials = _materials(ob)
        key = source, ob.data.as_pointer(), materials, instance.is_instance
        if key not in shapes:
            shapes[key] = _shape(ob.data, len(materials))
        matrices[key].append([tuple(row) for row in instance.matrix_world])
    return [
        Part(
            Faces(shape, int(slot), np.array(matrices[key]), source.name),
            materials[slot],
            source,
            instanced,
        )
        for key, shape in shapes.items()
        for source, _mesh, materials, instanced in [key]
        for slot in np.flatnonzero(np.bincount(shape.slot))
    ]


def vertices(ob, depsgraph):
    """(points (n, 3) m, normals (n, 3), to_world (4, 4)) of the mesh of `ob` after modifiers.

    Points and normals are in its own space. Modifiers that change the number of vertices leave no
    such place; then the vertices are taken where the original mesh has them.
    """
    evaluated = ob.evaluated_get(depsgraph)
    mesh = evaluated.data if len(evaluated.data.vertices) == len(ob.data.vertices) else ob.data
    points = _read(mesh.vertices, "co", np.float32, 3)
    normals = _read(mesh.vertex_normals, "vector", np.float32, 3)
    return points, normals, np.array(evaluated.matrix_world)


def _materials(ob):
    """The original materials of an evaluated object by slot; a bare mesh has one empty slot."""
    # Curves, texts and metaballs turn up as temporary mesh objects that have no slots.
    slots = [slot.material for slot in ob.material_slots] or ob.data.materials
    return tuple(m and m.original for m in slots) or (None,)


def _shape(mesh, slots):
    mesh.calc_loop_triangles()
    points = _read(mesh.vertices, "co", np.float32, 3)
    corners = _read(mesh.loop_triangles, "vertices", np.int32, 3)
    # Faces that name a slot which is not there are drawn with the last one.
    slot = np.minimum(_read(mesh.loop_triangles, "material_index", np.int32, 1)[:, 0], slots - 1)
    return Shape(points, corners, slot)


def _read(collection, attribute, dtype, width):
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(attribute, values)
    return values.reshape(-1, width)
