# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes as arrays, and the faces of one material in world space. Needs no Blender.

Only the arrays that Blender keeps in memory are read, by `read_meshes`. Everything else, such as
the triangles' corners and the normals, is computed from them in the solver's process.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Booleans, Floats, Integers
from ..errors import SceneError
from .grids.resample import Box
from .triangles import area_of, closed_triangles, is_finite


@dataclass(frozen=True)
class Mesh:
    """A mesh as Blender keeps it in memory, and the triangles and normals computed from it.

    points   (n, 3) m, float32, in the space of its object
    vertex   (corners,) the point of each corner of each face, one face after another
    face     (m,) the face of each triangle
    faces    number of faces
    split    (m, 3) the corners of each triangle, or None if no face has more than four
    slots    (faces,) the material slot of each face, or None if all have the first
    """

    points: Floats
    vertex: Integers
    face: Integers
    faces: int
    split: Integers | None
    slots: Integers | None

    @cached_property
    def fault(self) -> str | None:
        """Why the mesh cannot be lit, and what to do about it, or None."""
        if np.any(self.vertex < 0) or np.any(self.vertex >= len(self.points)):
            return "corners without a vertex; rebuild its mesh"
        if not is_finite(self.points) and not is_finite(self.points[self.vertex]):
            return "vertices whose position is not a number; repair or delete them"
        return None

    @cached_property
    def corners(self) -> Integers:
        """(m, 3), the points of each triangle."""
        if self.split is not None:
            corners: Integers = self.vertex[self.split]
            return corners
        corners = self.vertex[self._start[self.face][:, None] + np.arange(3)]
        # Complete the second triangles of the quads.
        second = np.flatnonzero(np.diff(self.face, prepend=-1) == 0)
        a, b, c = corners[second].T
        d = self.vertex[self._start[self.face[second]] + 3]
        # Use the other diagonal if this one lies outside of the face, as Blender's
        # `is_quad_flip_v3_first_third_fast` does.
        diagonal = self.points[c] - self.points[a]
        sides = (np.cross(diagonal, self.points[v] - self.points[a]) for v in (b, d))
        is_outside = np.einsum("na,na->n", *sides) > 0
        corners[second - 1, 2] = np.where(is_outside, d, c)
        corners[second] = np.stack([np.where(is_outside, b, a), c, d], axis=-1)
        return corners

    @cached_property
    def slot(self) -> Integers:
        """(m,), the material slot of each triangle."""
        if self.slots is None:
            return np.zeros(len(self.face), np.int32)
        slot: Integers = self.slots[self.face]
        return slot

    @cached_property
    def used_slots(self) -> Sequence[int]:
        """The material slots that have faces."""
        if self.slots is None:
            return [0] if self.faces else []
        return [int(slot) for slot in np.flatnonzero(np.bincount(self.slots))]

    @cached_property
    def closed(self) -> Booleans:
        """(m,) bool: whether each triangle belongs to a surface with at most small holes."""
        return closed_triangles(self.points.astype(float), self.corners)

    @property
    def normals(self) -> Floats:
        """(n, 3) of the points: the mean over the faces around them, weighted by their angles.

        Like Blender's, but 0 for points without a face.
        """
        # Compute the edges that leave and reach each corner.
        start, face = self._start, np.repeat(np.arange(self.faces), self._size)
        following = np.arange(1, len(self.vertex) + 1)
        following[start + self._size - 1] = start
        corner = self.points[self.vertex]
        ahead = corner[following] - corner
        of_face = np.add.reduceat(np.cross(corner - corner[start][face], ahead), start)
        forward = _unit(ahead)
        back = np.empty_like(forward)
        back[following] = -forward
        # Sum the normals of the faces, weighted by the angles at the corners.
        angle = np.arccos(np.clip(np.einsum("na,na->n", forward, back), -1, 1))
        weighted = angle[:, None] * _unit(of_face)[face]
        points = len(self.points)
        return _unit(np.stack([np.bincount(self.vertex, w, points) for w in weighted.T], axis=-1))

    @cached_property
    def _size(self) -> Integers:
        """(faces,), the number of corners of each face."""
        return np.bincount(self.face, minlength=self.faces) + 2

    @cached_property
    def _start(self) -> Integers:
        """(faces,), the first corner of each face."""
        return np.cumsum(self._size) - self._size


@dataclass(frozen=True)
class Faces:
    """The triangles of one material slot of a mesh, at all its places in the world.

    matrices  (k, 4, 4), the mesh's space to world space, for each instance of the mesh
    name      of the object
    """

    mesh: Mesh
    slot: int
    matrices: Floats
    name: str

    @cached_property
    def triangles(self) -> Floats:
        """(n, 3, 3) m, float64: triangle, corner, coordinate.

        Raises SceneError for vertices that are not finite.
        """
        corners = self.mesh.corners[self._in_slot]
        return _placed(self.mesh.points[corners].astype(float), self.matrices, self.name)

    @cached_property
    def closed(self) -> Booleans:
        """(n,) bool, see `closed_triangles`."""
        return np.tile(self.mesh.closed[self._in_slot], len(self.matrices))

    @property
    def area(self) -> float:
        """m^2, of one side."""
        return area_of(self.triangles)

    @property
    def dimensions(self) -> int:
        """The number of axes along which the largest instance is not scaled to zero."""
        axes = self.matrices[:, :3, :3]
        size = np.linalg.norm(axes, axis=(1, 2))
        if np.any(np.abs(np.linalg.det(axes)) > 1e-6 * size**3):  # fast for many instances
            return 3
        return int(np.linalg.matrix_rank(axes.astype(np.float32)).max())

    def refuse_broken(self, dimensions: int = 2) -> None:
        """Raise SceneError for a broken mesh or transform, or for fewer `dimensions` than this."""
        if self.mesh.fault:
            raise SceneError(f"'{self.name}' has {self.mesh.fault}.")
        if not is_finite(self.matrices):
            raise SceneError(
                f"'{self.name}' has a transform that is not a number; clear its location, "
                "rotation and scale, and those of its instances."
            )
        if self.dimensions < dimensions:
            along = "" if dimensions == 2 else " along an axis"
            raise SceneError(f"'{self.name}' is scaled to nothing{along}; give it a size.")

    @property
    def _in_slot(self) -> Booleans:
        is_in_slot: Booleans = self.mesh.slot == self.slot
        return is_in_slot


def world_bounds(parts: Sequence[Faces]) -> Box:
    """(lower, upper), each (3,) m, of all triangles; SceneError if there are none."""
    corners = [faces.triangles.reshape(-1, 3) for faces in parts]
    if not sum(map(len, corners)):
        raise SceneError("The selection has no faces; select a mesh that has some.")
    lower: list[Floats] = [c.min(axis=0) for c in corners if len(c)]
    upper: list[Floats] = [c.max(axis=0) for c in corners if len(c)]
    return np.min(lower, axis=0), np.max(upper, axis=0)


def _placed(triangles: Floats, matrices: Floats, name: str) -> Floats:
    """(k n, 3, 3): `triangles` (n, 3, 3), placed by each of the `matrices` (k, 4, 4)."""
    rotated = triangles.reshape(-1, 3) @ matrices[:, :3, :3].swapaxes(1, 2)
    placed = (rotated + matrices[:, None, :3, 3]).reshape(-1, 3, 3)
    if not np.all(np.isfinite(placed)):
        raise SceneError(
            f"'{name}' has vertices whose position is not a number; repair or delete them."
        )
    return placed


def _unit(vectors: Floats) -> Floats:
    """Vectors (n, 3), scaled to a length of 1; 0 stays 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
