# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that photons scored, summed over all tracings into a `Field`."""

from typing import Any

import numpy as np

from ...arrays import Floats
from ..field import Field, Handed, PhotonReport
from ..medium import Domain, Medium
from . import tallies
from .free_path import refuse_violations
from .perlin import PerlinMedium
from .schedule import Run
from .tallies import Tallies, Wanted


class Estimates:
    """Sums of the light that the runs of a trace scored."""

    def __init__(
        self, medium: Medium | PerlinMedium, shape: tuple[int, ...], wanted: Wanted, batches: int
    ) -> None:
        _, flux, handed = wanted
        edge = medium.voxel_size * medium.shape[0] / shape[0]
        self.domain = Domain(medium.origin, edge, shape)
        self.batches = batches
        bands = medium.bands
        self.fluence, self.direct, self.variance = (
            np.zeros((bands, *shape), np.float32) for _ in range(3)
        )
        self.flux = np.zeros((bands, 3, *shape), np.float32) if flux else None
        self.handed = Handed.empty(bands, shape) if handed else None
        self.energy = np.zeros((bands, tallies.LOST_PHOTONS))  # W
        self.collisions = np.zeros(bands, int)
        self.photons = self.lost = 0

    def add(self, run: Run, scored: Tallies, at_border: Floats, spacing: float) -> None:
        """Add what a run scored.

        at_border  (SUMS,) of what opaque voxels at the domain's faces stopped before it was traced
        spacing    m between two scores of a path
        """
        sums = scored.sums + at_border
        refuse_violations(int(sums[tallies.VIOLATIONS]))
        self.photons += run.photons * run.copies * self.batches
        self.lost += int(sums[tallies.LOST_PHOTONS])
        edge, shape = self.domain.voxel_size, self.domain.shape
        direct, scattered, handed = (v.T.reshape(-1, *shape) for v in scored[:3])
        # The variance of the mean of the batches; a single batch has none.
        correction = self.batches / (self.batches - 1) if self.batches > 1 else np.inf
        for band, factor in run.multiples.items():
            power = factor * run.power / self.batches
            self.energy[band] += power * sums[: tallies.LOST_PHOTONS]
            self.collisions[band] += int(sums[tallies.COLLISIONS])
            scale = np.float32(power * spacing / edge**3)  # path length in 1 m^3
            self.direct[band] += scale * direct.sum(axis=0)  # 0 where it is not tallied
            self.fluence[band] += scale * scattered[tallies.WEIGHT]
            with np.errstate(invalid="ignore"):  # infinity times 0, of a single batch
                self.variance[band] += scale**2 * correction * scored.deviation.reshape(shape)
            if self.flux is not None:
                self.flux[band] += scale * _signed(scattered, tallies.FLUX, tallies.WEIGHT)
            if self.handed is not None:
                self._add_handed(self.handed, band, power, handed)

    def _add_handed(self, source: Handed, band: int, power: float, tally: Floats) -> None:
        source.power[band] += power * tally[tallies.POWER]
        place = _signed(tally, tallies.POSITION, tallies.POWER)
        source.position[band] += power * self.domain.voxel_size * place
        source.direction[band] += power * _signed(tally, tallies.DIRECTION, tallies.POWER)

    def facts(self) -> dict[str, Any]:
        """The fields of a `PhotonReport` that come of the tallies."""
        energy = {
            "absorbed": self.energy[:, tallies.ABSORBED],
            "left": self.energy[:, tallies.LEFT_THROUGH : tallies.LEFT_THROUGH + 6],
            "handed": self.energy[:, tallies.HANDED],
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
            self.domain, self.fluence, self.direct, self.flux, report, self.variance, self.handed
        )


def _signed(tally: Floats, first: int, weight: int) -> Floats:
    """(3, ...) of three tallies that hold weight times (1 + q) / 2: weight times q."""
    return 2 * tally[first : first + 3] - tally[weight]
