# SPDX-License-Identifier: GPL-3.0-or-later
"""The medium that the user chose for all sources. Needs no Blender."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from ..arrays import Floats
from ..transport.medium import PRESETS, Optics
from .mixture import Share, is_exact, mixture, scaled

FROM_MATERIAL = "MATERIAL"
CUSTOM = "CUSTOM"


@dataclass
class MediumChoice:
    """The medium that the user chose, and the notes about what became of it.

    medium         FROM_MATERIAL, CUSTOM, or the name of one of PRESETS for all sources
    optical_depth  of a straight line as long as the domain at density 1, for presets in volumes
                   and solids, or 0 for the coefficients of CUSTOM unchanged. Foliage has the
                   optical depth of its leaves.
    grid           name of the density grid to read, or "" for the one that the material names
    custom         the `Optics` of CUSTOM, 1/m
    notes          sentences for the user; all sources add theirs
    """

    medium: str
    optical_depth: float
    grid: str
    custom: Optics | None = None
    notes: list[str] = field(default_factory=list)

    def optics(self, fallback: str | None = None) -> Optics:
        """The `Optics` of the chosen preset, or of the preset `fallback` with FROM_MATERIAL."""
        if self.medium == CUSTOM:
            assert self.custom is not None
            return self.custom
        name = fallback if self.medium == FROM_MATERIAL else self.medium
        assert name is not None
        return PRESETS[name]

    def scaled_optics(self, fallback: str, length: float) -> Optics:
        """`optics`, scaled to the `optical_depth` over a `length` in metres."""
        if self.optical_depth == 0:
            return self.optics(fallback)
        return scaled(self.optics(fallback), self.optical_depth / length)

    def mixture(self, shares: Sequence[Share], shines: bool = False) -> tuple[Floats, Optics]:
        """`mixture` of `shares`; adds a note if it is not exact."""
        density, optics = mixture(shares, shines)
        if not is_exact(shares):
            self.notes.append(
                "The materials differ in colour or in how they scatter; the light uses their "
                "average, weighted by density."
            )
        return density, optics
