# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a solver: light in every voxel, and a report of the solve."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from ..arrays import Floats
from .medium import Domain


@dataclass
class Report:
    """A report of a solve.

    model     which model solved it
    device    the device that ran, as shown to the user
    steps     lattice steps taken
    corrections  number of corrections by coarser lattices
    residual  estimated relative error (L2) of the lattice's light where it stopped, the largest
              of the bands; in the paper's model the relative change in the last step
    seconds   {stage: seconds}
    bytes     memory that the solver allocated, bytes
    runs      number of bands that were solved; the other bands are multiples of these. Of a trace,
              the number of its pairs of a light and a band
    converged whether the residual reached the tolerance within the allowed steps
    energy    {where: W, (bands,) or (bands, 6)}: "entered" is the sum of "absorbed", "left"
              through the faces -x, +x, -y, +y, -z, +z, and what the kind of report adds to these;
              empty where a model does not count it
    """

    model: str
    device: str
    steps: int = 0
    corrections: int = 0
    residual: float = 0.0
    seconds: dict[str, float] = field(default_factory=dict)
    bytes: int = 0
    runs: int = 0
    converged: bool = True
    energy: dict[str, Any] = field(default_factory=dict)


@dataclass
class PhotonReport(Report):
    """A report of tracing photons.

    photons     number of traced photons
    lost        number of photons that were given up after too many steps
    collisions  (bands,) number of real collisions of all photons
    energy      as of a `Report`; "handover" and "lost" are two more terms of the sum
    """

    photons: int = 0
    lost: int = 0
    collisions: Floats | None = None


class Clock:
    """Adds up seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - start


@dataclass
class CollisionSource:
    """The collision source of a trace: moments of the collisions at which photons stop, by voxel.

    power      (bands, nx, ny, nz) W, of the photons after that collision
    position   (bands, 3, nx, ny, nz) W m, power times the position relative to the voxel's centre
    direction  (bands, 3, nx, ny, nz) W, power times the unit direction before the collision
    """

    power: Floats
    position: Floats
    direction: Floats

    @classmethod
    def empty(cls, bands: int, shape: Sequence[int]) -> "CollisionSource":
        return cls(
            np.zeros((bands, *shape), np.float32),
            np.zeros((bands, 3, *shape), np.float32),
            np.zeros((bands, 3, *shape), np.float32),
        )


@dataclass
class ScatteringMoments:
    """The in-scattered radiance of light that has scattered, over sigma_s; arrays are float32.

    moments     (bands, 9, nx, ny, nz) W/m^2, its integrals times `quadrature.harmonics`, without
                the lobes
    lobes       (beams, bands, nx, ny, nz) W/m^2, the light in a Henyey-Greenstein lobe about each
                beam's direction; together the lobes have the third moments along these directions
    g           (bands,) the mean cosine of the lobes
    iterations  of the source iteration
    """

    moments: Floats
    lobes: Floats
    g: Floats
    iterations: int

    @classmethod
    def dark(
        cls, bands: int, beams: int, shape: Sequence[int], iterations: int
    ) -> "ScatteringMoments":
        return cls(
            np.zeros((bands, 9, *shape), np.float32),
            np.zeros((beams, bands, *shape), np.float32),
            np.zeros(bands),
            iterations,
        )


@dataclass
class Field:
    """Light in a domain.

    domain    where the voxels are
    fluence   (bands, nx, ny, nz) W/m^2, scattered light; in the paper's model all light
    direct    (bands, nx, ny, nz) W/m^2, uncollided light; in the paper's model zero
    flux      (bands, 3, nx, ny, nz) W/m^2, net flux of what `fluence` counts; None where a trace
              was asked for none
    variance  (bands, nx, ny, nz) of the fluence, (W/m^2)^2, where the solver is random, else None
    report    a `Report`, of traced photons a `PhotonReport`
    collision_source  a `CollisionSource` where photons ended at a handover, else None
    by_light  (lights, bands, nx, ny, nz) W/m^2, the uncollided light of each light, in the order
              of the lights, without the medium's emission; None where lights are not separated
    direct_flux  (bands, 3, nx, ny, nz) W/m^2, net flux of what `direct` counts, or None
    forward   (lights, bands, nx, ny, nz) W/m^2, the part of `fluence` that has scattered by
              small angles only and still travels close to each light's direction; None where
              lights are not separated
    scattered  the `ScatteringMoments` of source iteration, or None
    """

    domain: Domain
    fluence: Floats
    direct: Floats
    flux: Floats | None
    report: Report
    variance: Floats | None = None
    collision_source: CollisionSource | None = None
    by_light: Floats | None = None
    direct_flux: Floats | None = None
    forward: Floats | None = None
    scattered: ScatteringMoments | None = None

    def with_uncollided(self) -> "Field":
        """The same field with uncollided light added to `fluence` and `flux`, as in the paper's
        model."""
        if self.direct_flux is None:
            return self
        assert self.flux is not None
        fluence, flux = self.fluence + self.direct, self.flux + self.direct_flux
        return replace(self, fluence=fluence, flux=flux)

    def mean_radiance(self) -> Floats:
        """(bands, nx, ny, nz) W/(m^2 sr): all light, averaged over directions."""
        return (self.fluence + self.direct) / np.float32(4 * np.pi)
