# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of one band while it is solved, and the field that the bands are assembled in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Floats
from .field import Field, Report
from .medium import Medium
from .uncollided import casting


def dark_field(medium: Medium, lights: int, device: str) -> Field:
    """A `Field` of zeros for a number of lights, solved on the device of this label."""
    shape, bands = medium.shape, medium.bands
    energy = {
        "entered": np.zeros(bands),
        "absorbed": np.zeros(bands),
        "left": np.zeros((bands, 6)),
    }
    return Field(
        medium.domain,
        fluence=np.zeros((bands, *shape), np.float32),
        direct=np.zeros((bands, *shape), np.float32),
        flux=np.zeros((bands, 3, *shape), np.float32),
        report=Report("physical", device, energy=energy),
        by_light=np.zeros((lights, bands, *shape), np.float32),
        forward=np.zeros((lights, bands, *shape), np.float32),
        direct_flux=np.zeros((bands, 3, *shape), np.float32),
    )


@dataclass
class BandLight:
    """The light of one band from some of the lights.

    fluence, flux, direct_flux  as of `Field`, without the axis of bands
    by_light, forward           as of `Field`, one grid for each of the lights
    energy                      {where: W, or (6,) W}, as of `Report`
    residual, steps, corrections  of the lattice, as of `Report`
    """

    fluence: Floats
    flux: Floats
    direct_flux: Floats
    by_light: list[Floats]
    forward: list[Floats]
    energy: dict[str, Any]
    residual: float = 0.0
    steps: int = 0
    corrections: int = 0

    @classmethod
    def dark(cls, field: Field, band: int, lights: Sequence[int], in_place: bool) -> "BandLight":
        """The light of a band before anything is added.

        lights    numbers of the lights
        in_place  whether the totals of all lights are the field's own grids
        """
        assert field.flux is not None
        assert field.direct_flux is not None
        assert field.by_light is not None
        assert field.forward is not None
        grids = [field.fluence[band], field.flux[band], field.direct_flux[band]]
        if not in_place:
            grids = [np.zeros(grid.shape, np.float32) for grid in grids]
        by_light, forward = (
            [_grid_of_light(grids_by_light, number, band) for number in lights]
            for grids_by_light in (field.by_light, field.forward)
        )
        energy = {"entered": 0.0, "absorbed": 0.0, "left": np.zeros(6)}
        return cls(grids[0], grids[1], grids[2], by_light, forward, energy)

    def add_uncollided(self, number: int, cast: casting.Cast) -> None:
        """Add the uncollided light of one of the lights, by its place in the lists."""
        self.by_light[number] += cast.direct
        for flux, toward in zip(self.direct_flux, cast.toward, strict=True):
            flux += toward if np.ndim(toward) else float(toward) * cast.direct

    def add_forward_peak(self, number: int, cast: casting.Cast, uncollided: casting.Cast) -> None:
        """Add the forward peak: the light of a cast that counts it as uncollided, less that of a
        cast that does not."""
        shade = cast.shade.of
        direct, flux = cast.over(uncollided)
        shade(self.fluence)[...] += direct
        shade(self.flux)[...] += flux
        shade(self.forward[number])[...] += direct

    def add_to(self, field: Field, lights: Sequence[int], band: int, factor: float) -> None:
        """Add this light times a factor to a band of a field; lights are the lights' numbers.

        Light in the field's own grids is there already.
        """

        def add(total: Floats, values: Floats) -> None:
            if not np.may_share_memory(total, values):
                total += values if factor == 1 else factor * values

        assert field.flux is not None
        assert field.direct_flux is not None
        assert field.by_light is not None
        assert field.forward is not None
        for number, direct, forward in zip(lights, self.by_light, self.forward, strict=True):
            add(field.direct[band], direct)
            if number < len(field.by_light):
                add(field.by_light[number, band], direct)
                add(field.forward[number, band], forward)
        add(field.direct_flux[band], self.direct_flux)
        add(field.fluence[band], self.fluence)
        add(field.flux[band], self.flux)
        report = field.report
        for where, power in self.energy.items():
            report.energy.setdefault(where, np.zeros(len(field.fluence)))[band] += factor * power
        report.steps = max(report.steps, self.steps)
        report.corrections = max(report.corrections, self.corrections)
        report.residual = max(report.residual, self.residual)


def _grid_of_light(grids: Floats, number: int, band: int) -> Floats:
    """The field's grid of a light; a new one for the medium's emission, which comes last."""
    if number < len(grids):
        grid: Floats = grids[number, band]
        return grid
    return np.zeros(grids.shape[2:], np.float32)
