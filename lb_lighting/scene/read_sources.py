# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads volumes and smoke domains as sources. Only Blender's arrays are read, which is quick."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from . import read_volumes, smoke
from .materials import VolumeOptics, first_volume, has_volume
from .medium_choice import FROM_MATERIAL
from .reader import Reader
from .sources import Emission, GridSource, SmokeSource, VolumeSource

if TYPE_CHECKING:
    import bpy


def read_volume(ob: bpy.types.Object, reader: Reader) -> VolumeSource:
    """The source of the volume that the original object `ob` shows; raises SceneError."""
    names = read_volumes.grid_names(ob, reader.depsgraph)
    materials = _volume_materials(ob, reader)
    place = reader.place(ob)
    material = _Material.read(ob, reader, materials, names)
    return VolumeSource(
        name=ob.name,
        uid=ob.session_uid,
        place=place,
        choice=reader.choice,
        material=material.optics,
        glows=material.glows,
        grid_name=material.grid_name,
        grid=read_volumes.find_grid(ob, reader.depsgraph, material.grid_name),
        matrix=read_volumes.world_matrix(ob, reader.depsgraph),
        is_in_object_space=read_volumes.is_in_object_space(ob, reader.depsgraph),
        fire={
            name: read_volumes.find_grid(ob, reader.depsgraph, name)
            for name in material.glowing_grids.intersection(names)
        },
    )


def read_smoke(ob: bpy.types.Object, reader: Reader) -> SmokeSource:
    """The source of the original object `ob`, the domain of a gas; raises SceneError."""
    names = smoke.grid_names(ob, reader.depsgraph)
    materials = smoke.materials(ob, reader.depsgraph)
    place = reader.place(ob)
    material = _Material.read(ob, reader, materials, names)
    source = SmokeSource(
        name=ob.name,
        uid=ob.session_uid,
        place=place,
        choice=reader.choice,
        material=material.optics,
        glows=material.glows,
        grid_name=material.grid_name,
        bounds=smoke.world_bounds(ob, reader.depsgraph),
        cells=smoke.read_grid(ob, reader.depsgraph, material.grid_name),
        hue=None if material.optics else smoke.hue(ob, reader.depsgraph),
        fire={
            name: smoke.read_grid(ob, reader.depsgraph, name)
            for name in material.glowing_grids.intersection(names)
        },
    )
    if smoke.burns(ob, reader.depsgraph) and not source.glows:
        reader.notes.append(
            f"The fire of '{ob.name}' emits no light; give its material a Blackbody Intensity."
        )
    return source


@dataclass(frozen=True)
class _Material:
    """The material of a `GridSource`.

    optics     None for a preset
    grid_name  of the density grid
    """

    optics: VolumeOptics | None
    glows: Sequence[Emission]
    grid_name: str

    @classmethod
    def read(
        cls,
        ob: bpy.types.Object,
        reader: Reader,
        materials: Sequence[bpy.types.Material | None],
        names: Collection[str],
    ) -> _Material:
        """names  of the grids that `ob` has"""
        first = first_volume(materials)
        optics = reader.volume_optics(ob, [first], GridSource.preset)
        glows = reader.glows(ob, [first], optics)
        grid_name = reader.choice.grid or _grid_name(optics, glows, names)
        material = cls(optics, glows, grid_name)
        # Cycles does not render a material that reads no grid.
        is_even = optics is not None and optics.density_attribute is None
        is_visible = glows or (optics is not None and not optics.is_clear)
        if is_even and is_visible and not reader.choice.grid and not material.glowing_grids:
            reader.notes.append(
                f"The material of '{ob.name}' reads no grid, so Cycles does not render it; "
                f"it was lit as if it filled the grid '{grid_name}' evenly."
            )
        return material

    @property
    def glowing_grids(self) -> set[str]:
        """The names of the grids that the emission depends on."""
        return {name for glow in self.glows for name in glow.grids}


def _grid_name(
    optics: VolumeOptics | None, glows: Sequence[Emission], names: Collection[str]
) -> str:
    """The grid that shows where the material is, one of `names` if possible."""
    if optics and optics.density_attribute:
        return optics.density_attribute
    glowing = [name for glow in glows for name in glow.grids]
    candidates = ["density", *glowing]
    if optics and optics.is_clear:
        candidates = glowing or ["density"]
    return next((name for name in candidates if name in names), candidates[0])


def _volume_materials(ob: bpy.types.Object, reader: Reader) -> Sequence[bpy.types.Material | None]:
    """The materials of a volume's slots; those of the object if its nodes set none."""
    materials = read_volumes.volume_materials(ob, reader.depsgraph)
    if materials or ob.type == "VOLUME":
        return materials
    slots = [slot.material for slot in ob.material_slots]
    of_object = [material for material in slots if material and has_volume(material)]
    if of_object and reader.choice.medium == FROM_MATERIAL:
        reader.notes.append(
            f"The nodes of '{ob.name}' give their volume no material, and Cycles renders it "
            f"with a plain one; it was lit with '{of_object[0].name}', which the object has. Add "
            "Set Material to the nodes to render that."
        )
    return of_object
