# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads what is common to all sources: materials and emission, or a preset in their place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Floats, Vector
from ..errors import SceneError
from ..transport.medium import Optics
from .emission import BlackBody, Glow, volume_glows
from .materials import Leaf, VolumeOptics, leaf_optics, volume_optics, volume_shines
from .medium_choice import FROM_MATERIAL, MediumChoice
from .nodes.attributes import object_attributes
from .read_meshes import Part

if TYPE_CHECKING:
    import bpy


class Reader:
    """Reads sources at the current frame, by their materials or by the medium that the user chose.

    depsgraph  the evaluated scene
    choice     the `MediumChoice`, which crosses to the solver's process with the sources
    """

    def __init__(
        self,
        depsgraph: bpy.types.Depsgraph,
        medium: str,
        optical_depth: float,
        grid: str,
        custom: Optics | None = None,
    ) -> None:
        """medium, optical_depth, grid, custom  see `MediumChoice`"""
        self.depsgraph = depsgraph
        self.choice = MediumChoice(medium, optical_depth, grid, custom)
        layer = depsgraph.view_layer
        assert layer
        if layer.material_override:
            self.notes.append(
                f"The view layer '{layer.name}' overrides all materials with "
                f"'{layer.material_override.name}', which shows none of the light. The light was "
                "baked for the overridden materials; clear Material Override to see it."
            )

    @property
    def notes(self) -> list[str]:
        """Sentences for the user."""
        return self.choice.notes

    def place(self, ob: bpy.types.Object) -> Floats:
        """(4, 4), the space of the original object `ob` to world space."""
        place = np.array(ob.evaluated_get(self.depsgraph).matrix_world)
        if not np.isfinite(place).all():
            raise SceneError(
                f"'{ob.name}' has a location, rotation or scale that is not a number; clear it."
            )
        return place

    def volume_optics(
        self, ob: bpy.types.Object, materials: Sequence[bpy.types.Material | None], fallback: str
    ) -> VolumeOptics | None:
        """The first `VolumeOptics` of `materials`, or None if a preset replaces them.

        fallback  the preset for an object without a volume material
        """
        if self.choice.medium != FROM_MATERIAL:
            return None
        attributes = object_attributes(ob, self.depsgraph)
        every = [optics for m in materials if (optics := volume_optics(m, attributes))]
        if not every:
            self.notes.append(
                f"'{ob.name}' has no volume material; the preset '{fallback}' was used."
            )
            return None
        if any(optics != every[0] for optics in every):
            self.notes.append(f"'{ob.name}' has several volume materials; the first was used.")
        return every[0]

    def glows(
        self,
        ob: bpy.types.Object,
        materials: Sequence[bpy.types.Material | None],
        optics: VolumeOptics | None,
    ) -> list[Glow | BlackBody]:
        """The emission of the volumes of `materials`.

        Emission that cannot be read is left out, with a note. Raises SceneError if there would be
        nothing else to see, because the `optics` are clear.
        """
        try:
            attributes = object_attributes(ob, self.depsgraph)
            return [glow for m in materials for glow in volume_glows(m, attributes)]
        except SceneError as error:
            shines = any(map(volume_shines, materials))
            if shines and optics and optics.is_clear:
                raise
            if shines:
                self.notes.append(
                    f"'{ob.name}' emits light, but that light is not baked, and Replace "
                    f"hides it. {error}"
                )
            return []

    def occluder_colors(self, ob: bpy.types.Object, parts: Sequence[Part]) -> list[Vector]:
        """[(3,)], the reflectance of each of the parts of `ob`.

        It is 0, with a note, for materials that cannot be read: they still stop the light.
        """
        try:
            return [self.leaf(part).reflectance for part in parts]
        except SceneError as error:
            self.notes.append(f"'{ob.name}' reflects no light. {error}")
            return [np.zeros(3)] * len(parts)

    def leaf(self, part: Part) -> Leaf:
        """The `Leaf` of the faces of a `Part`."""
        # Each instance may have different attributes.
        attributes = None if part.instanced else object_attributes(part.object, self.depsgraph)
        return leaf_optics(part.material, attributes)
