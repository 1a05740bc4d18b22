# SPDX-License-Identifier: GPL-3.0-or-later
"""What is lit, and which lights Blender lets reach it: ray visibility, and light linking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...arrays import Array, Floats, Vector
from ..materials import has_volume
from ..remarks import Remarks
from ..sources import Source
from ..surface_sources import FoliageSource, OccluderSource, SolidSource

if TYPE_CHECKING:
    import bpy

NO_RAYS = "Left out, because Ray Visibility keeps the light from what is selected: {}."
NOT_LINKED = "Left out, because Light Linking keeps the light from what is selected: {}."
SOME_RAYS = (
    "Light reaches volumes and surfaces alike in one bake; to follow the Ray Visibility of {}, "
    "bake volumes and surfaces apart."
)
SOME_LINKED = (
    "Light reaches all that is baked together; to follow the Light Linking of {}, bake apart what "
    "it keeps in the dark."
)
SHADED = (
    "All that is selected shades the light of {}, although Shadow Linking, or Cast Shadow, says "
    "otherwise."
)


@dataclass(frozen=True)
class Receivers:
    """The objects that are lit.

    objects  (n,) original bpy.types.Object
    volumes  (n,) bool: does light scatter in it as in a volume, or on its surface?
    lower, upper  (3,) m, the box that is lit
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
        """Those that `sources` were made of.

        box  (lower, upper) m, what is lit of them, or None for all
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
        """(3,) m, of the box."""
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
        """`take` the light of the evaluated object of a lamp or a shining mesh."""
        # Evaluated objects have collections of evaluated objects.
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
        """Whether a light shines on any of them; remarks say where it should not shine on all.

        name      of the light
        surfaces, volumes  whether its rays are visible to these
        linking   `bpy.types.ObjectLightLinking` of its original object, or None for a world
        """
        seen = [volumes if is_volume else surfaces for is_volume in self.volumes]
        if not any(seen):
            remarks.add(NO_RAYS, name)
            return False
        linked = [True] * len(seen)
        if linking and linking.receiver_collection:
            linked = members(linking.receiver_collection, self.objects)
        if not any(s and k for s, k in zip(seen, linked, strict=True)):
            remarks.add(NOT_LINKED, name)
            return False
        if not all(seen):
            remarks.add(SOME_RAYS, name)
        if not all(linked):
            remarks.add(SOME_LINKED, name)
        blockers = linking and linking.blocker_collection
        if blockers and not all(members(blockers, self.objects)):
            remarks.add(SHADED, name)
        return True


def members(collection: bpy.types.Collection, objects: Sequence[bpy.types.Object]) -> list[bool]:
    """[bool]: is each of `objects` in the set that a collection of Light Linking stands for?

    As in Blender: what is included, or all where nothing is; less what is excluded.
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
    """(k, 2, 3): the lower and upper corners of the boxes about the box from `lower` to `upper`,
    (3,) or (k, 3), under each of the matrices (k, 4, 4)."""
    matrices = np.asarray(matrices, float).reshape(-1, 4, 4)
    middle, half = np.add(lower, upper) / 2, np.subtract(upper, lower) / 2
    turn = matrices[:, :3, :3]
    center = np.einsum("kij,kj->ki", turn, np.broadcast_to(middle, (len(turn), 3)))
    center += matrices[:, :3, 3]
    reach = np.einsum("kij,kj->ki", np.abs(turn), np.broadcast_to(half, (len(turn), 3)))
    return np.stack([center - reach, center + reach], axis=1)


def _outline(ob: bpy.types.Object, source: Source, depsgraph: bpy.types.Depsgraph) -> Floats:
    """(k, 2, 3) m: boxes about a source, found in no time; they may be somewhat too large."""
    if isinstance(source, (FoliageSource, SolidSource, OccluderSource)) and source.faces:
        return np.concatenate([_box_of(part.mesh.points, part.matrices) for part in source.faces])
    evaluated = ob.evaluated_get(depsgraph)
    return _box_of(np.array(evaluated.bound_box), [evaluated.matrix_world])


def _box_of(points: Floats, matrices: Array | Sequence[Any]) -> Floats:
    return placed_boxes(points.min(axis=0), points.max(axis=0), matrices)
