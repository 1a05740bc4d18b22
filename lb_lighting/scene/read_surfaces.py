# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads surfaces as sources: foliage, solids and occluders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import SceneError
from ..transport.medium import Optics
from .materials import has_surface
from .medium_choice import FROM_MATERIAL
from .meshes import Faces
from .mixture import scaled
from .read_meshes import Part
from .reader import Reader
from .surface_sources import FoliageSource, OccluderSource, SolidSource

if TYPE_CHECKING:
    import bpy


def read_foliage(ob: bpy.types.Object, parts: Sequence[Part], reader: Reader) -> FoliageSource:
    """The foliage of the original object `ob` with these `parts`; raises SceneError."""
    place = reader.place(ob)
    faces = _faces_of(parts)
    lights_instances = _has_instances(parts) and not _has_duplicates(ob)
    if not lights_instances:
        _note_instances(ob, parts, reader)
    return FoliageSource(
        name=ob.name,
        uid=ob.session_uid,
        place=place,
        choice=reader.choice,
        faces=faces,
        lights_instances=lights_instances,
        leaves=[_leaf(part, reader) for part in parts],
        instanced=[_name_of(part.material) for part in parts if part.instanced],
    )


def read_solid(ob: bpy.types.Object, parts: Sequence[Part], reader: Reader) -> SolidSource:
    """The solid of the original object `ob` with these `parts`; raises SceneError."""
    materials = [part.material for part in parts]
    shows_light = any(map(has_surface, materials))
    place = reader.place(ob)
    faces = _faces_of(parts, dimensions=3)
    if shows_light:
        _note_instances(ob, parts, reader)
    optics = reader.volume_optics(ob, materials, SolidSource.preset)
    if optics and optics.needs_grid:
        raise SceneError(
            f"The density of '{ob.name}' follows the attribute '{optics.density_attribute}', "
            "which a mesh does not have inside, so Cycles does not render it; give its material "
            "a plain density."
        )
    return SolidSource(
        name=ob.name,
        uid=ob.session_uid,
        place=place,
        choice=reader.choice,
        faces=faces,
        lights_instances=False,
        shows_light=shows_light,
        material=optics,
        glows=reader.glows(ob, materials, optics),
    )


def read_occluder(ob: bpy.types.Object, parts: Sequence[Part], reader: Reader) -> OccluderSource:
    """The occluder of the original object `ob` with these `parts`; raises SceneError."""
    place = reader.place(ob)
    faces = _faces_of(parts)
    _note_instances(ob, parts, reader)
    return OccluderSource(
        name=ob.name,
        uid=ob.session_uid,
        place=place,
        choice=reader.choice,
        faces=faces,
        lights_instances=False,
        colors=reader.occluder_colors(ob, parts),
    )


def _name_of(material: bpy.types.Material | None) -> str | None:
    return material.name if material else None


def _faces_of(parts: Sequence[Part], dimensions: int = 2) -> list[Faces]:
    """The `Faces` of `parts`; SceneError if any are broken, or scaled to fewer `dimensions`."""
    for part in parts:
        part.faces.refuse_broken(dimensions)
    return [part.faces for part in parts]


def _has_instances(parts: Sequence[Part]) -> bool:
    return any(part.instanced for part in parts)


def _has_duplicates(ob: bpy.types.Object) -> bool:
    """Whether `ob` makes instances that its modifiers do not see: by instancing or particles."""
    return ob.instance_type != "NONE" or bool(len(ob.particle_systems))


def _note_instances(ob: bpy.types.Object, parts: Sequence[Part], reader: Reader) -> None:
    """Note that the instances of a mesh object cannot show the light."""
    if ob.type == "MESH" and _has_instances(parts):
        reader.notes.append(
            f"The instances of '{ob.name}' shade and colour the light, but show none of it "
            "themselves; make them real to light them."
        )


def _leaf(part: Part, reader: Reader) -> tuple[float, Optics]:
    """(share of the faces that is not transparent, `Optics` at an extinction of 1 1/m)."""
    if reader.choice.medium != FROM_MATERIAL:
        return 1.0, scaled(reader.choice.optics(), 1.0)
    leaf = reader.leaf(part)
    return leaf.coverage, leaf.optics
