# SPDX-License-Identifier: GPL-3.0-or-later
"""How sources are read: by their materials or by a preset, and what is told of that."""

from dataclasses import dataclass, field

import numpy as np

from ..errors import SceneError
from ..transport.medium import PRESETS, Optics
from .emission import volume_glows
from .materials import leaf_optics, volume_optics, volume_shines
from .mixture import is_exact, mixture, scaled
from .nodes.attributes import object_attributes

FROM_MATERIAL = "MATERIAL"
CUSTOM = "CUSTOM"


@dataclass
class Reader:
    """How sources are read: the choices of the user, and what to tell about them.

    medium         FROM_MATERIAL, CUSTOM, or the name of one of PRESETS for everything
    optical_depth  of a straight line as long as the domain through density 1, for presets in
                   volumes and solids; foliage has its own, from its leaves; 0 for the
                   coefficients of CUSTOM as they are
    grid           name of the grid to read, or "" for the one that the material names
    custom         the `Optics` of CUSTOM, 1/m
    """

    depsgraph: object
    medium: str
    optical_depth: float
    grid: str
    custom: Optics | None = None
    notes: list = field(default_factory=list)

    def __post_init__(self):
        layer = self.depsgraph and self.depsgraph.view_layer
        if layer and layer.material_override:
            self.notes.append(
                f"The view layer '{layer.name}' overrides all materials with "
                f"'{layer.material_override.name}', which shows none of the light. It was baked "
                "for the materials behind that; clear Material Override to see it."
            )

    def __getstate__(self):
        return vars(self) | {"depsgraph": None}  # it stays in Blender

    def volume_optics(self, ob, materials, fallback):
        """The first `VolumeOptics` of `materials`, or None where a preset stands in for them.

        fallback  name of that preset, where none is chosen
        """
        if self.medium != FROM_MATERIAL:
            return None
        attributes = object_attributes(ob, self.depsgraph)
        found = [optics for m in materials if (optics := volume_optics(m, attributes))]
        if not found:
            self.notes.append(
                f"'{ob.name}' has no volume material; the preset '{fallback}' stands in."
            )
            return None
        if any(optics != found[0] for optics in found):
            self.notes.append(f"'{ob.name}' has several volume materials; the first fills it all.")
        return found[0]

    def glows(self, ob, materials, optics):
        """[Glow | BlackBody] that the volumes of `materials` shine with.

        None for those that cannot be read, with a note, or SceneError where nothing else is to be
        seen of their `optics`.
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
                    f"'{ob.name}' shines by itself, which does not light it, and Replace leaves "
                    f"that out. {error}"
                )
            return []

    def mixture(self, shares, shines=False):
        """`mixture` of `shares`, with a note where it is not exact."""
        mixed = mixture(shares, shines)
        if not is_exact(shares):
            self.notes.append(
                "The materials differ in colour or in how they scatter; the light takes their "
                "mean, weighed by how dense each is."
            )
        return mixed

    def occluder_colors(self, ob, parts):
        """[(3,)], the share of light that each of the parts of `ob` throws back.

        0 for materials that cannot be read, with a note: they stop light all the same.
        """
        try:
            return [self.leaf(part).reflectance for part in parts]
        except SceneError as error:
            self.notes.append(f"'{ob.name}' throws no light back. {error}")
            return [np.zeros(3)] * len(parts)

    def leaf(self, part):
        """The `Leaf` that the faces of a `Part` are."""
        # Each instance may have attributes of its own.
        one = None if part.instanced else object_attributes(part.object, self.depsgraph)
        return leaf_optics(part.material, one)

    def chosen(self, fallback=None):
        """The `Optics` of the chosen preset, or of the one called `fallback`."""
        if self.medium == CUSTOM:
            return self.custom
        return PRESETS[fallback if self.medium == FROM_MATERIAL else self.medium]

    def preset(self, fallback, length):
        """The chosen preset (or `fallback`), scaled to `optical_depth` over `length` metres."""
        if self.optical_depth == 0:
            return self.chosen(fallback)
        return scaled(self.chosen(fallback), self.optical_depth / length)
