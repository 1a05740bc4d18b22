# SPDX-License-Identifier: GPL-3.0-or-later
"""The expected error and time of settings: those of a pilot, scaled to the voxels of the solve.

docs/measurements/speed-and-accuracy.md has the measurements that the scaling is fitted to.
"""

from dataclasses import dataclass, replace
from math import hypot, inf, sqrt

import numpy as np

from ..lights.distant import FEW_VOXELS
from ..medium import Medium
from ..solver import Settings
from .pilot import EVENER, Pilot, effort, work_of_rays

SAFE = 0.85  # share of the target that an expected error may use

_NOISE = (0.3, 0.5)  # least and most noise of photons, as shares of the target
# The share of the lattice's error that remains when photons precede it.
_LEFT = (0, 1, 2, 4), (1, 0.75, 0.6, 0.45)  # by handover
_FIXED = 0.04  # s that the smallest solve takes; half of it without a lattice
_FEWEST_PHOTONS = 10_000


@dataclass(frozen=True)
class Expectation:
    """The expected error and time of `Settings` in one medium.

    edge    voxels along the longest edge of the box of all matter
    target  relative error that the number of photons is chosen for
    """

    pilot: Pilot
    medium: Medium
    edge: int
    target: float

    def error(self, settings: Settings) -> tuple[Settings, float]:
        """(`Settings` with the photons that the target needs, their expected relative error)."""
        pilot = self.pilot
        sampling = pilot.sampling * settings.rays**-EVENER
        if self.edge > FEW_VOXELS >= pilot.edge:  # large domains use half the rays along an edge
            sampling *= 2**EVENER
        if settings.scattering == "single":
            return settings, hypot(max(pilot.share, pilot.mean), sampling)

        # Add up the errors of the lattice, of merged voxels, of rays and of stopping.
        large = self.edge / settings.merge
        merging = self._error_of_merging(settings, pilot.edge * (1 / large - 1 / self.edge))
        left = 0.0 if settings.handover == inf else float(np.interp(settings.handover, *_LEFT))
        lattice = left * pilot.error if left else 0.0
        error = hypot(lattice, merging, sampling, settings.tolerance if left else 0.0)
        if not settings.handover:
            return settings, error

        # Choose the number of photons by the noise that they may have.
        noise = pilot.noise * large / pilot.edge  # of a single photon
        if not noise:  # the pilot traced none
            return settings, inf
        allowed = sqrt(max((SAFE * self.target) ** 2 - error**2, 0.0))
        allowed = min(max(allowed, _NOISE[0] * self.target), _NOISE[1] * self.target)
        photons = settings.photons or max(_FEWEST_PHOTONS, round((noise / allowed) ** 2))
        return replace(settings, photons=photons), hypot(error, noise / sqrt(photons))

    def seconds(self, settings: Settings) -> float:
        """The expected time of a solve, s."""
        pilot = self.pilot
        scale = pilot.air * effort(settings.rays)
        once = pilot.once * scale * work_of_rays(self.edge) / work_of_rays(pilot.edge)
        if settings.scattering == "single":
            return once + _FIXED / 2
        seconds = _FIXED + (once if settings.merge > 1 else 0.0)
        if settings.handover:
            photons = settings.photons or 0
            seconds += photons * pilot.trace * self._path(settings.handover)
        if settings.handover == inf:
            # Media that scatter forward need two casts.
            casts = 2 if self.medium.g.max() > 0 else 1
            return float(seconds + casts * once / settings.merge**3)
        large, small = self._edges(settings)
        seconds += pilot.rays * scale * work_of_rays(large) / work_of_rays(small)
        if pilot.steps[0]:
            steps, steps_of_half = pilot.steps
            growth = min(max(np.log2(steps / steps_of_half), 0.0), 1.0) if steps_of_half else 1.0
            seconds += pilot.solve * self._growth(settings) ** (3 + growth)
        return float(seconds)

    def seconds_of_photon(self, handover: float) -> float:
        """The expected time of one photon, s."""
        return self.pilot.trace * self._path(handover)

    def seconds_of_step(self, settings: Settings) -> float:
        """The expected time of one lattice step, s; 0 if the pilot took none."""
        pilot = self.pilot
        if not pilot.steps[0] or not pilot.solve:
            return 0.0
        return float(pilot.solve / pilot.steps[0] * self._growth(settings) ** 3)

    def _error_of_merging(self, settings: Settings, growth: float) -> float:
        """The error of merged voxels, whose edges grow by `growth` voxels of the pilot."""
        if not growth:
            return 0.0
        merging = self.pilot.merging * growth
        if not settings.handover:
            return merging
        # The lattice also errs where photons make its source uneven. Measured: .35 of its error at
        # a growth of 1, .7 at 3.
        return hypot(merging, self.pilot.error * growth / (growth + 1.6))

    def _edges(self, settings: Settings) -> tuple[float, float]:
        """Voxels of the lattice and its rays along an edge, and those of the pilot."""
        pieces = self.pilot.pieces
        large = self.edge / settings.merge * pieces.get(settings.merge, 1)
        return large, self.pilot.edge * pieces.get(0, 1)

    def _growth(self, settings: Settings) -> float:
        large, small = self._edges(settings)
        return large / small

    def _path(self, handover: float) -> float:
        """Collisions of a photon up to its handover, relative to a photon of the pilot."""
        pilot, medium = self.pilot, self.medium
        transport = 1 / (1 - float((medium.albedo * medium.g).max()))
        collisions, of_pilot = (
            min(1 + depth * transport, pilot.collisions) for depth in (handover, pilot.traced)
        )
        return collisions / of_pilot if of_pilot else 1.0  # 1 where nothing collides
