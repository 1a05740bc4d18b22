# SPDX-License-Identifier: GPL-3.0-or-later
"""The `Field` that a trace estimates from the photons' scores."""

from typing import Any

import numpy as np

from ...arrays import Floats
from ..field import CollisionSource, Field, PhotonReport
from ..medium import Domain, Medium
from . import tallies
from .free_path import refuse_violations
from .perlin import PerlinMedium
from .schedule import Run
from .tallies import Selection, Tallies


class Estimates:
    """The sums of the scores of all runs of a trace."""

    def __init__(
        self,
        medium: Medium | PerlinMedium,
        shape: tuple[int, ...],
        selection: Selection,
        batches: int,
    ) -> None:
        _, flux, source = selection
        edge = medium.voxel_size * medium.shape[0] / shape[0]
        self.domain = Domain(medium.origin, edge, shape)
        self.batches = batches
        bands = medium.bands
        self.fluence, self.direct, self.variance = (
            np.zeros((bands, *shape), np.float32) for _ in range(3)
        )
        self.flux = np.zeros((bands, 3, *shape), np.float32) if flux else None
        self.source = CollisionSource.empty(bands, shape) if source else None
        self.energy = np.zeros((bands, tallies.LOST_PHOTONS))  # W
        self.collisions = np.zeros(bands, int)
        self.photons = self.lost = 0

    def add(self, run: Run, scored: Tallies, at_border: Floats, spacing: float) -> None:
        """Add the scores of a run.

        at_border  (SUMS,) of the light that opaque voxels at the domain's faces stop before
                   tracing
        spacing    m between two scores of a path
        """
        sums = scored.sums + at_border
        refuse_violations(int(sums[tallies.VIOLATIONS]))
        self.photons += run.photons * run.copies * self.batches
        self.lost += int(sums[tallies.LOST_PHOTONS])
        edge, shape = self.domain.voxel_size, self.domain.shape
        direct, scattered, collided = (v.T.reshape(-1, *shape) for v in scored[:3])
        # The variance of the mean of the batches; that of a single batch is infinite.
        correction = self.batches / (self.batches - 1) if self.batches > 1 else np.inf
        for band, factor in run.multiples.items():
            power = factor * run.power / self.batches
            self.energy[band] += power * sums[: tallies.LOST_PHOTONS]
            self.collisions[band] += int(sums[tallies.COLLISIONS])
            scale = np.float32(power * spacing / edge**3)  # path length in 1 m^3
            self.direct[band] += scale * direct.sum(axis=0)  # 0 where it is not tallied
            self.fluence[band] += scale * scattered[tallies.WEIGHT]
            with np.errstate(invalid="ignore"):  # infinity times 0 for a single batch
                self.variance[band] += scale**2 * correction * scored.deviation.reshape(shape)
            if self.flux is not None:
                self.flux[band] += scale * _signed(scattered, tallies.FLUX, tallies.WEIGHT)
            if self.source is not None:
                self._add_source(self.source, band, power, collided)

    def _add_source(self, source: CollisionSource, band: int, power: float, tally: Floats) -> None:
        source.power[band] += power * tally[tallies.POWER]
        place = _signed(tally, tallies.POSITION, tallies.POWER)
        source.position[band] += power * self.domain.voxel_size * place
        source.direction[band] += power * _signed(tally, tallies.DIRECTION, tallies.POWER)

    def facts(self) -> dict[str, Any]:
        """The attributes of a `PhotonReport` that come from the tallies."""
        energy = {
            "absorbed": self.energy[:, tallies.ABSORBED],
            "left": self.energy[:, tallies.LEFT_THROUGH : tallies.LEFT_THROUGH + 6],
            "handover": self.energy[:, tallies.HANDOVER],
            "lost": self.energy[:, tallies.LOST],
        }
        return {
            "photons": self.photons,
            "lost": self.lost,
            "collisions": self.collisions,
            "energy": {"entered": self.energy.sum(axis=1), **energy},
        }

    def field(self, report: PhotonReport) -> Field:
        """The `Field` of all runs."""
        if self.batches == 1:
            self.variance[:] = np.inf
        return Field(
            self.domain, self.fluence, self.direct, self.flux, report, self.variance, self.source
        )


def _signed(tally: Floats, first: int, weight: int) -> Floats:
    """(3, ...) weight times q, from three tallies of weight times (1 + q) / 2."""
    return 2 * tally[first : first + 3] - tally[weight]
