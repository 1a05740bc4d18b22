# SPDX-License-Identifier: GPL-3.0-or-later
"""Casts of a light, shared by the bands in which its rays meet the same medium."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ...arrays import Floats
from ..box import Box
from ..device import Device
from ..lights.base import Light, by_band, multiple, same
from ..lights.distant import FEW_VOXELS, Sky
from ..lights.emission import Emission
from ..medium import Medium
from ..monitor import Monitor
from . import casting

# The usual number of rays along a voxel's edge: in small domains; in large ones, where a single
# voxel's error matters less; and for skies and emission, which have many directions.
_USUAL, _AMONG_MANY, _OF_SKY = 6, 3, 4


def parts(lights: Sequence[Light]) -> list[tuple[int, Light]]:
    """[(number of its light, part)]: all lights, with skies split into an even and an uneven
    part."""
    return [(number, part) for number, light in enumerate(lights) for part in light.parts()]


class Rays:
    """Casts of one light, shared by bands with the same extinction.

    Leaves, for example, stop all colours alike, and the bands of some smoke differ only in albedo:
    rays are sent through these only once.

    number           rays along a voxel's edge over the usual number
    device, monitor  as of `casting.cast`
    """

    def __init__(
        self,
        medium: Medium,
        box: Box,
        light: Light,
        number: float,
        device: Device,
        monitor: Monitor,
    ) -> None:
        self.medium, self.box, self.light = medium, box, light
        self.how = number, device, monitor
        # {whether the forward peak counts as scattered: (sigma_t, band, `casting.Cast`)}
        self.sent: dict[bool, tuple[float, int, casting.Cast]] = {}

    def cast(
        self, band: int, sigma_t: float, shadowed: bool = True, peaked: bool = True
    ) -> casting.Cast:
        """The `casting.Cast` of a band.

        sigma_t   extinction coefficient at density 1, 1/m
        shadowed  whether the light's shadow density replaces the medium's; the same in all calls
        peaked    whether the forward peak counts as scattered
        """
        if peaked in self.sent:
            known, base, cast = self.sent[peaked]
            factors = self._factors(band, base) if same(known, sigma_t) else None
            if factors is not None:
                return cast if factors == (1, 1) else cast.times(*factors)
        cast = self._send(band, sigma_t, shadowed)
        self.sent[peaked] = sigma_t, band, cast
        return cast

    def _send(self, band: int, sigma_t: float, shadowed: bool) -> casting.Cast:
        medium, light = self.medium, self.light
        number, device, monitor = self.how
        if light.shadow_density is not None and shadowed:
            medium = medium.altered(density=light.shadow_density)
        usual = _USUAL if max(medium.shape) <= FEW_VOXELS else _AMONG_MANY
        if isinstance(light, (Sky, Emission)):
            usual = _OF_SKY
        per_edge = max(1, round(usual * number))
        return casting.cast(medium, light, band, sigma_t, device, per_edge, monitor, self.box)

    @cached_property
    def missing(self) -> "Rays":
        """The `Rays` of the light that the medium would emit if it re-emitted all that it absorbs
        of a uniform sky."""
        radiance = by_band(self.light.spectrum, self.medium.bands)
        absorbed = 4 * np.pi * radiance * self.medium.sigma_a
        emission = absorbed[:, None, None, None] * self.medium.density
        emitting = Emission(self.medium.altered(emission=emission))
        return Rays(self.medium, self.box, emitting, *self.how)

    def _factors(self, band: int, base: int) -> tuple[float, float] | None:
        """The light of a band over that of another, and likewise the share that opaque matter
        reflects; None if the bands are not multiples of each other."""
        light, medium = multiple([self.light], self.medium, band, base), self.medium
        if light is None:
            return None
        if medium.occlusion is None:
            return light, 1.0
        albedo, other = (medium.occlusion_albedo[b] for b in (band, base))
        if np.array_equal(albedo, other):
            return light, 1.0
        total = float(np.sum(other, dtype=float))
        ratio = float(np.sum(albedo, dtype=float)) / total if total else 1.0
        # Light that the border reflects out of the domain is not tallied separately from other
        # light that leaves.
        is_multiple = same(albedo, ratio * other) and not _on_border(medium.occlusion)
        return (light, ratio) if is_multiple else None


def _on_border(grid: Floats) -> bool:
    """Whether a grid (nx, ny, nz) is above 0 in any of its outermost voxels."""
    return any(grid.take((0, -1), axis).any() for axis in range(3))
