# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects to light, and the lights that reach them by ray visibility and light linking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...arrays import Array, Floats, Vector
from ..materials import has_volume
from ..remarks import Remarks
from ..sources import Source
from ..surface_sources import SurfaceSource

if TYPE_CHECKING:
    import bpy

NO_RAYS = "Left out, because Ray Visibility hides them from the selected objects: {}."
NOT_LINKED = "Left out, because Light Linking excludes the selected objects: {}."
SOME_RAYS = (
    "One bake lights volumes and surfaces alike; to follow the Ray Visibility of {}, bake volumes "
    "and surfaces separately."
)
SOME_LINKED = (
    "One bake lights all of its objects; to follow the Light Linking of {}, bake the objects that "
    "it excludes separately."
)
SHADED = (
    "All selected objects cast shadows in the light of {}, although Shadow Linking or Cast Shadow "
    "says otherwise."
)


@dataclass(frozen=True)
class Receivers:
    """The objects to light.

    objects       (n,) original objects
    volumes       (n,) bool: whether the object is lit as a volume; otherwise its surface is lit
    lower, upper  (3,) m, the box to light
    """

    objects: tuple[bpy.types.Object, ...]
    volumes: tuple[bool, ...]
    lower: Floats
    upper: Floats

    @classmethod
    def of(
        cls,
        objects: Sequence[bpy.types.Object],
        sources: Sequence[Source],
        depsgraph: bpy.types.Depsgraph,
        box: tuple[Vector, Vector] | None = None,
    ) -> Receivers:
        """The `objects` that the `sources` were made of, one each.

        box  (lower, upper) m, the part to light, or None for all of them
        """
        volumes = [
            source.is_volume or (source.is_body and _has_volume(ob))
            for ob, source in zip(objects, sources, strict=True)
        ]
        if box is None:
            pairs = zip(objects, sources, strict=True)
            boxes = np.concatenate([_outline(ob, source, depsgraph) for ob, source in pairs])
            box = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        return cls(tuple(objects), tuple(volumes), *np.array(box, float))

    @property
    def center(self) -> Floats:
        """(3,) m, the centre of the box."""
        return (self.lower + self.upper) / 2

    @property
    def size(self) -> float:
        """m, the longest edge of the box."""
        return float(np.max(self.upper - self.lower))

    @property
    def has_volumes(self) -> bool:
        return any(self.volumes)

    @property
    def has_surfaces(self) -> bool:
        return not all(self.volumes)

    def take_object(self, ob: bpy.types.Object, remarks: Remarks) -> bool:
        """`take` for the evaluated object of a lamp or an emissive mesh."""
        # The collections of an evaluated object hold evaluated objects.
        original: Any = ob.original
        linking = original.light_linking
        return self.take(ob.name, ob.visible_diffuse, ob.visible_volume_scatter, linking, remarks)

    def take(
        self,
        name: str,
        surfaces: bool,
        volumes: bool,
        linking: bpy.types.ObjectLightLinking | None,
        remarks: Remarks,
    ) -> bool:
        """Whether a light reaches any of the objects; adds a remark unless it reaches all.

        name               of the light
        surfaces, volumes  whether its rays are visible to them
        linking            of its original object, or None for a world
        """
        visible = [volumes if is_volume else surfaces for is_volume in self.volumes]
        if not any(visible):
            remarks.add(NO_RAYS, name)
            return False
        linked = [True] * len(visible)
        if linking and linking.receiver_collection:
            linked = members(linking.receiver_collection, self.objects)
        if not any(v and k for v, k in zip(visible, linked, strict=True)):
            remarks.add(NOT_LINKED, name)
            return False
        if not all(visible):
            remarks.add(SOME_RAYS, name)
        if not all(linked):
            remarks.add(SOME_LINKED, name)
        blockers = linking and linking.blocker_collection
        if blockers and not all(members(blockers, self.objects)):
            remarks.add(SHADED, name)
        return True


def members(collection: bpy.types.Collection, objects: Sequence[bpy.types.Object]) -> list[bool]:
    """[bool]: whether a Light Linking collection contains each of `objects`.

    As in Blender, it contains the included objects, or all objects if none is included, without
    the excluded ones.
    """
    states: dict[bpy.types.Object, str] = {}
    for child, entry in zip(collection.children, collection.collection_children, strict=True):
        states |= dict.fromkeys(child.all_objects, entry.light_linking.link_state)
    for ob, link in zip(collection.objects, collection.collection_objects, strict=True):
        states[ob] = link.light_linking.link_state
    others = "EXCLUDE" if "INCLUDE" in states.values() else "INCLUDE"
    return [states.get(ob, others) == "INCLUDE" for ob in objects]


def _has_volume(ob: bpy.types.Object) -> bool:
    return any(has_volume(slot.material) for slot in ob.material_slots)


def placed_boxes(lower: Array, upper: Array, matrices: Array | Sequence[Any]) -> Floats:
    """(k, 2, 3): lower and upper corners of the bounding boxes of transformed boxes.

    lower, upper  (3,) or (k, 3), the boxes
    matrices      (k, 4, 4), their transforms
    """
    matrices = np.asarray(matrices, float).reshape(-1, 4, 4)
    middle, half = np.add(lower, upper) / 2, np.subtract(upper, lower) / 2
    axes = matrices[:, :3, :3]
    center = np.einsum("kij,kj->ki", axes, np.broadcast_to(middle, (len(axes), 3)))
    center += matrices[:, :3, 3]
    extent = np.einsum("kij,kj->ki", np.abs(axes), np.broadcast_to(half, (len(axes), 3)))
    return np.stack([center - extent, center + extent], axis=1)


def _outline(ob: bpy.types.Object, source: Source, depsgraph: bpy.types.Depsgraph) -> Floats:
    """(k, 2, 3) m: bounding boxes of a source, quick to compute and at times too large."""
    if isinstance(source, SurfaceSource) and source.faces:
        return np.concatenate([_box_of(part.mesh.points, part.matrices) for part in source.faces])
    evaluated = ob.evaluated_get(depsgraph)
    return _box_of(np.array(evaluated.bound_box), [evaluated.matrix_world])


def _box_of(points: Floats, matrices: Array | Sequence[Any]) -> Floats:
    return placed_boxes(points.min(axis=0), points.max(axis=0), matrices)
