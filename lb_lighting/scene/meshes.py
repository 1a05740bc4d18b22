# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes as the scene shows them: their triangles by material, and the points that show light.

Blender has some of their arrays as they lie in memory, which takes milliseconds for millions of
faces; those are read. What it would have to look up for each element is worked out from them, in
the solver's process.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .voxelize import (
    FARTHEST,
    Faces,
    closed_triangles,
    is_finite,
)


@dataclass(frozen=True)
class Mesh:
    """A mesh as Blender has it in memory, and its triangles and normals made of that.

    points   (n, 3) m, float32, in the space of its object
    vertex   (corners,) the point of each corner of each face; faces follow one another
    face     (m,) the face of each triangle that faces are drawn as
    faces    how many there are
    split    (m, 3) the corners of each triangle, or None where no face has more than four
    slots    (faces,) the material slot of each, or None where all have the first
    """

    points: np.ndarray
    vertex: np.ndarray
    face: np.ndarray
    faces: int
    split: np.ndarray | None
    slots: np.ndarray | None

    @cached_property
    def fault(self):
        """What the mesh has that keeps it from being lit, and what to do, or None."""
        if np.any(self.vertex < 0) or np.any(self.vertex >= len(self.points)):
            return "corners without a vertex; rebuild its mesh"
        if not is_finite(self.points) and not is_finite(self.points[self.vertex]):
            return "vertices that are not finite; repair or delete them"
        return None

    @cached_property
    def corners(self):
        """(m, 3), the points of each triangle."""
        if self.split is not None:
            return self.vertex[self.split]
        corners = self.vertex[self._start[self.face][:, None] + np.arange(3)]
        second = np.flatnonzero(np.diff(self.face, prepend=-1) == 0)
        a, b, c = corners[second].T
        d = self.vertex[self._start[self.face[second]] + 3]
        # Blender's `is_quad_flip_v3_first_third_fast`: a diagonal outside of the face is not taken.
        along = self.points[c] - self.points[a]
        sides = (np.cross(along, self.points[v] - self.points[a]) for v in (b, d))
        outside = np.einsum("na,na->n", *sides) > 0
        corners[second - 1, 2] = np.where(outside, d, c)
        corners[second] = np.stack([np.where(outside, b, a), c, d], axis=-1)
        return corners

    @cached_property
    def slot(self):
        """(m,), the material slot of each triangle."""
        return np.zeros(len(self.face), np.int32) if self.slots is None else self.slots[self.face]

    @cached_property
    def closed(self):
        """(m,) bool: is the triangle of a surface with small holes at most?"""
        return closed_triangles(self.points.astype(float), self.corners)

    @property
    def normals(self):
        """(n, 3) of the points: the mean over the faces around them, weighed by their angles there.

        As Blender's, but 0 for points that no face has.
        """
        start, own = self._start, np.repeat(np.arange(self.faces), self._size)
        following = np.arange(1, len(self.vertex) + 1)
        following[start + self._size - 1] = start
        corner = self.points[self.vertex]
        ahead = corner[following] - corner
        of_face = np.add.reduceat(np.cross(corner - corner[start][own], ahead), start)
        ahead = _unit(ahead)
        back = np.empty_like(ahead)
        back[following] = -ahead
        angle = np.arccos(np.clip(np.einsum("na,na->n", ahead, back), -1, 1))
        weighed = angle[:, None] * _unit(of_face)[own]
        points = len(self.points)
        return _unit(np.stack([np.bincount(self.vertex, w, points) for w in weighed.T], axis=-1))

    @cached_property
    def _size(self):
        """(faces,), how many corners each has."""
        return np.bincount(self.face, minlength=self.faces) + 2

    @cached_property
    def _start(self):
        """(faces,), the first corner of each."""
        return np.cumsum(self._size) - self._size


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
    meshes = {}
    matrices = defaultdict(list)
    for instance in depsgraph.object_instances:
        source = (instance.parent if instance.is_instance else instance.object).original
        ob = instance.object
        if source not in chosen or not instance.show_self or ob.type != "MESH":
            continue
        materials = _materials(ob)
        key = source, ob.data.as_pointer(), materials, instance.is_instance
        if key not in meshes:
            meshes[key] = read_mesh(ob.data, len(materials))
        matrices[key].append([tuple(row) for row in instance.matrix_world])
    return [
        Part(
            Faces(mesh, int(slot), np.array(matrices[key]), source.name),
            materials[slot],
            source,
            instanced,
        )
        for key, mesh in meshes.items()
        for source, _pointer, materials, instanced in [key]
        for slot in _used(mesh)
    ]


def vertices(ob, depsgraph):
    """(the `Mesh` of `ob` after modifiers, its space to world space (4, 4)).

    Modifiers that change the number of vertices leave these no place of their own; then it is the
    original mesh.
    """
    evaluated = ob.evaluated_get(depsgraph)
    mesh = evaluated.data if len(evaluated.data.vertices) == len(ob.data.vertices) else ob.data
    mesh = read_mesh(mesh)
    nowhere = ~np.all(np.abs(mesh.points) < FARTHEST, axis=1)  # and of no face, see Faces
    mesh.points[nowhere] = 0
    return mesh, np.array(evaluated.matrix_world)


def _materials(ob):
    """The original materials of an evaluated object by slot; a bare mesh has one empty slot."""
    # Curves, texts and metaballs turn up as temporary mesh objects that have no slots.
    slots = [slot.material for slot in ob.material_slots] or ob.data.materials
    return tuple(m and m.original for m in slots) or (None,)


def read_mesh(mesh, slots=1):
    """The `Mesh` that a bpy.types.Mesh is, with material slots below `slots`."""
    mesh.calc_loop_triangles()
    face = _read(mesh.loop_triangle_polygons, "value", np.int32)
    few = np.bincount(face, minlength=1).max() <= 2
    points, vertex, material = _arrays(mesh)
    return Mesh(
        points.reshape(-1, 3),
        vertex,
        face,
        len(mesh.polygons),
        None if few else _read(mesh.loop_triangles, "loops", np.int32, 3).reshape(-1, 3),
        # Faces that name a slot which is not there are drawn with the nearest one.
        None if material is None else np.clip(material, 0, slots - 1),
    )


def _arrays(mesh):
    """(points, the point of each corner, the slot of each face or None), flat."""
    attributes = mesh.attributes
    # Edit Mode hides them all, and a mesh without faces lacks one.
    if not {"position", ".corner_vert"}.issubset(attributes.keys()):
        return (
            _read(mesh.vertices, "co", np.float32, 3),
            _read(mesh.loops, "vertex_index", np.int32),
            _read(mesh.polygons, "material_index", np.int32),
        )
    slots = attributes.get("material_index")
    return (
        _read(attributes["position"].data, "vector", np.float32, 3),
        _read(attributes[".corner_vert"].data, "value", np.int32),
        _read(slots.data, "value", np.int32) if _is_of_faces(slots) else None,
    )


def _is_of_faces(attribute):
    """Whether an attribute, or None, is a whole number for each face."""
    return attribute and (attribute.domain, attribute.data_type) == ("FACE", "INT")


def _used(mesh):
    """The slots that faces of a `Mesh` have."""
    if mesh.slots is None:
        return [0] if mesh.faces else []
    return np.flatnonzero(np.bincount(mesh.slots))


def _read(collection, name, dtype, width=1):
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values


def _unit(vectors):
    """Vectors (n, 3) at a length of 1, or 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
