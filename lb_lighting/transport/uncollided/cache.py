# SPDX-License-Identifier: GPL-3.0-or-later
"""The rays of a light, which bands share where they meet the same."""

from functools import cached_property

import numpy as np

from ..lights.base import by_band, multiple, same
from ..lights.distant import FEW_VOXELS, Sky
from ..lights.emission import Emission
from . import casting

# Rays along a voxel's edge, fewer where voxels are not few and share what single ones are off;
# those of a sky, and of a medium that shines, go in many directions.
_USUAL, _AMONG_MANY, _OF_SKY = 6, 3, 4


def parts(lights):
    """[(number of its light, light)]: skies divided in what is even and what is not."""
    return [(number, part) for number, light in enumerate(lights) for part in light.parts()]


class Rays:
    """Sends the rays of a light; bands of which they meet the same share them.

    So they are sent once through leaves, which stop all colours alike, and through smoke that only
    differs in how much of each it scatters.

    number          of rays along a voxel's edge, over the usual number
    device, monitor  as of `direct.cast`
    """

    def __init__(self, medium, box, light, number, device, monitor):
        self.medium, self.box, self.light = medium, box, light
        self.how = number, device, monitor
        self.sent = {}  # {whether without the forward peak: (sigma_t, band, `direct.Cast`)}

    def cast(self, band, sigma_t, shadowed=True, peaked=True):
        """The `direct.Cast` of a band.

        sigma_t   extinction at density 1 to reckon with, 1/m
        shadowed  whether the light's own shadow density counts, the same in all calls
        peaked    whether the forward peak counts as scattered
        """
        if peaked in self.sent:
            known, base, cast = self.sent[peaked]
            if same(known, sigma_t) and None not in (factors := self._factors(band, base)):
                return cast if factors == (1, 1) else cast.times(*factors)
        found = self._send(band, sigma_t, shadowed)
        self.sent[peaked] = sigma_t, band, found
        return found

    def _send(self, band, sigma_t, shadowed):
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
    def missing(self):
        """The `Rays` of what the medium would radiate if it gave back all that it absorbs of a
        uniform sky."""
        radiance = by_band(self.light.radiance, self.medium.bands)
        absorbed = 4 * np.pi * radiance * self.medium.sigma_a
        emission = absorbed[:, None, None, None] * self.medium.density
        emitting = Emission(self.medium.altered(emission=emission))
        return Rays(self.medium, self.box, emitting, *self.how)

    def _factors(self, band, base):
        """How many times more light of a band there is, and is reflected by what is opaque; None
        where that is no number."""
        light, medium = multiple([self.light], self.medium, band, base), self.medium
        if medium.occlusion is None:
            return light, 1.0
        own, other = (medium.occlusion_albedo[b] for b in (band, base))
        if np.array_equal(own, other):
            return light, 1.0
        total = float(np.sum(other, dtype=float))
        ratio = float(np.sum(own, dtype=float)) / total if total else 1.0
        # What is reflected out of the domain at once is not counted apart from what else leaves.
        can = same(own, ratio * other) and not _on_border(medium.occlusion)
        return light, ratio if can else None


def _on_border(grid):
    """Whether a grid (nx, ny, nz) has anything in its outermost voxels."""
    return any(grid.take((0, -1), axis).any() for axis in range(3))
