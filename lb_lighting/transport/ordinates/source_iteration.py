# SPDX-License-Identifier: GPL-3.0-or-later
"""Source iteration with discrete ordinates, for media that scatter forwards.

The lattice gives the fluence and the net flux. In a forward-scattering medium, the light scattered
away from a lamp's direction also depends on how much of that direction remains after a few
scatterings. So rays along many directions cross the box of the medium and collect the light that
is scattered into them: in the first iteration the lattice's light, in each later one the light of
the iteration before. The result is stored as moments and lobes, see `ScatteringMoments`.
docs/theory/physics.md has the measured gain.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import ceil, floor
from time import perf_counter

import numpy as np

from ...arrays import Floats, Integers
from .. import device as devices
from ..backend import backend_of
from ..bands import distinct
from ..box import Box
from ..device import Device
from ..field import Field, ScatteringMoments
from ..lights.base import Light
from ..lights.distant import Sun
from ..lights.emission import Emission
from ..lights.sampling import rank_1, shift_of
from ..medium import Medium, merged
from ..monitor import Monitor
from ..resample import between
from ..uncollided.sweep import Beam, Turn
from .moments import (
    BY_DEGREE,
    BandMoments,
    beside_beams,
    lobes_of,
    of_lobe,
    of_lobes,
    way_of,
)
from .quadrature import directions_for, harmonics, phase_function, third

ITERATIONS = 4  # more do not help: the error of the truncated moments remains
MIN_ANISOTROPY = 0.65  # mean cosine of the phase function above which iterations are worthwhile
# Mean optical depth of the voxels that hold matter: the largest for which iterations are
# worthwhile, as light varies within thicker voxels; and the largest that merging may lead to, of
# media with more than _MOST voxels along an edge, as scattered light is smooth.
THICKEST, _MERGED = 3.0, 2.0
_MOST = 48
_LARGEST = 160  # voxels along an edge, beyond which they are always merged: 1 GB
_LOBE = 3  # the mean cosine of lobes is g to this power, as of light at its third scattering
_BEAMS_AT_ONCE = 16


def is_worthwhile(medium: Medium, lights: Sequence[Light]) -> bool:
    """Whether source iteration improves pictures of a medium in some lights.

    Light that opaque voxels reflect is not iterated.
    """
    if medium.occlusion is not None or np.max(medium.g) < MIN_ANISOTROPY:
        return False
    has_beams = any(light.is_beam for light in lights)
    return bool(has_beams and _mean_depth(medium) <= THICKEST)


def iterate(
    medium: Medium,
    lights: Sequence[Light],
    field: Field,
    device: Device | str | None = None,
    iterations: int = ITERATIONS,
    progress: Callable[[float], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> ScatteringMoments:
    """The `ScatteringMoments` after some iterations from a `Field` of the physical model.

    medium, lights, device, cancel  those of `solve`
    iterations  each starts from the light of the one before
    progress    called with the completed fraction, 0 to 1
    Raises DeviceError or Cancelled.
    """
    monitor = Monitor(progress and (lambda _stage, fraction: progress(fraction)), cancel)
    lights, pieces = list(lights), _pieces(medium)
    if pieces == 1:
        return _iterated(medium, lights, field, device, iterations, monitor)
    coarse_field = _merged(field, medium, pieces)
    coarse = _iterated(medium.merged(pieces), lights, coarse_field, device, iterations, monitor)
    moments, lobes = (
        between(grid, pieces, medium.shape) for grid in (coarse.moments, coarse.lobes)
    )
    return ScatteringMoments(moments, lobes, coarse.g, iterations)


def _pieces(medium: Medium) -> int:
    """The number of voxels that are merged along each edge."""
    edge = max(medium.shape)
    pieces: int = min(ceil(edge / _MOST), floor(_MERGED / max(_mean_depth(medium), 1e-9)))
    return max(pieces, ceil(edge / _LARGEST))


def _mean_depth(medium: Medium) -> float:
    """The mean optical depth of the voxels that hold matter."""
    depth = medium.depth(np.max(medium.sigma_t))
    return float(depth.sum() / max(1, int(np.count_nonzero(depth))))


def _merged(field: Field, medium: Medium, pieces: int) -> Field:
    """A `Field` with the mean light of merged voxels of a medium."""
    filled = merged(np.ones(medium.shape, np.float32), pieces)
    names = ("fluence", "flux", "direct", "direct_flux", "by_light", "forward")
    return replace(field, **{name: merged(getattr(field, name), pieces) / filled for name in names})


def _iterated(
    medium: Medium,
    lights: Sequence[Light],
    field: Field,
    device: Device | str | None,
    iterations: int,
    monitor: Monitor,
) -> ScatteringMoments:
    """`iterate` in a medium's own voxels."""
    beams, box = _Beams(medium, lights), Box.around([medium.density])
    result: ScatteringMoments = ScatteringMoments.dark(
        medium.bands, len(beams.numbers), medium.shape, iterations
    )
    bands = _bands(medium, lights)
    for number, (band, multiples) in enumerate(bands):
        ordinates = _Ordinates(medium, box, band, beams, device)
        # Scaled to about 1, so that light of any strength fits float32.
        scale = (field.fluence[band] + field.direct[band]).max() or np.float32(1)
        light, uncollided = ordinates.first(field, scale), ordinates.uncollided(field, scale)
        for iteration in range(iterations):
            steps = len(bands) * iterations
            part = monitor.part((number * iterations + iteration) / steps, 1 / steps)
            light = ordinates.iterate(light, uncollided, part)
        light.moments[1:] *= ordinates.limiter(light)
        for other, factor in multiples.items():
            box.of(result.moments[other])[...] = factor * scale * light.moments
            box.of(result.lobes[:, other])[...] = factor * scale * light.lobes
            result.g[other] = light.g
    return result


def _bands(medium: Medium, lights: Sequence[Light]) -> list[tuple[int, dict[int, float]]]:
    """[(band to iterate, {band: its multiple})]"""
    sources = lights if medium.emission is None else [*lights, Emission(medium)]
    bands: list[tuple[int, dict[int, float]]] = distinct(medium, sources)
    return bands


def seconds(
    medium: Medium,
    lights: Sequence[Light],
    device: Device | str | None = None,
    iterations: int = ITERATIONS,
) -> float:
    """An estimate of the time that `iterate` takes, s, from a trial of some of its rays."""
    medium = medium.merged(_pieces(medium))
    beams, box = _Beams(medium, lights), Box.around([medium.density])
    ordinates = _Ordinates(medium, box, 0, beams, device)
    dark = BandMoments.dark(len(beams.numbers), ordinates.depth.shape)
    turn, group = next(ordinates.groups())
    for _ in range(2):  # the first also builds programs
        start = perf_counter()
        ordinates.radiance(turn, group, dark, [])
        duration = perf_counter() - start
    steps = len(_bands(medium, lights)) * iterations
    return steps * duration * len(ordinates.directions) / len(group)


class _Beams:
    """The lights that are beams, and their directions in the voxels of a medium."""

    def __init__(self, medium: Medium, lights: Sequence[Light]) -> None:
        self.numbers = [n for n, light in enumerate(lights) if light.is_beam]
        self.lights = [lights[n] for n in self.numbers]
        self.domain = medium.domain
        suns = [light for light in self.lights if isinstance(light, Sun)]
        self.suns = [way_of(sun, self.domain)[:, 0, 0, 0] for sun in suns]

    def within(self, box: Box) -> list[Floats]:
        """[(3, 1, 1, 1) or (3, of the box)]: unit vectors, by beam."""
        ways = (way_of(beam, self.domain).astype(np.float32) for beam in self.lights)
        return [way if way.size == 3 else box.of(way) for way in ways]


class _Ordinates:
    """The discrete ordinates of one band: directions with weights, in the box of a medium."""

    def __init__(
        self,
        medium: Medium,
        box: Box,
        band: int,
        beams: _Beams,
        device: Device | str | None,
    ) -> None:
        self.device: Device = devices.choose(device)
        self.box, self.band, self.beams = box, band, beams
        self.g = float(medium.g[band])
        self.depth: Floats = medium.depth(medium.sigma_t[band], box).astype(np.float32)
        self.scattering: Floats = medium.depth(medium.sigma_s[band], box).astype(np.float32)
        self.directions, self.weights = directions_for(beams.suns, self.g)
        self.along = beams.within(box)
        self.lattice = rank_1(1)

    def first(self, field: Field, scale: float | np.floating) -> BandMoments:
        """The `BandMoments` of a `Field`: its forward-scattered light by beam, and a lobe of the
        remainder."""
        assert field.flux is not None
        forward = self._by_beam(field.forward, scale)
        # Light scattered once into the forward peak has the mean cosine g; the lattice takes 1.
        ahead = ((1 + self.g) / 2 * way * f for way, f in zip(self.along, forward, strict=True))
        fluence = self.box.of(field.fluence[self.band]) / scale - forward.sum(axis=0)
        flux = self.box.of(field.flux[self.band]) / scale - sum(ahead)
        moments = of_lobes(np.maximum(fluence, 0), flux, self.g)
        return BandMoments(moments.astype(np.float32), forward, max(self.g, 0.0) ** 2)

    def uncollided(self, field: Field, scale: float | np.floating) -> BandMoments:
        """The `BandMoments` of uncollided light: by beam, and a lobe of all other lights."""
        fluence, flux = beside_beams(field, self.band, self.beams.numbers, self.along, self.box)
        moments = of_lobes(fluence / scale, flux / scale, self.g)
        return BandMoments(moments.astype(np.float32), self._by_beam(field.by_light, scale), self.g)

    def _by_beam(self, grids: Floats | None, scale: float | np.floating) -> Floats:
        assert grids is not None
        light: Floats = self.box.of(grids[self.beams.numbers, self.band]) / scale
        return light

    def iterate(self, light: BandMoments, uncollided: BandMoments, monitor: Monitor) -> BandMoments:
        """The `BandMoments` of the light that has scattered, from those of the step before and of
        uncollided light."""
        moments = np.zeros((9, *self.depth.shape), np.float32)
        thirds = np.zeros((len(self.along), *self.depth.shape), np.float32)
        done = 0
        for turn, group in self.groups():
            monitor.check()
            radiance = self.radiance(turn, group, light, [uncollided])
            weights = self.weights[group].astype(np.float32)
            basis = (weights * harmonics(self.directions[group].T)).astype(np.float32)
            moments += np.tensordot(basis, radiance, axes=1)
            for moment, cosine in zip(thirds, self._cosines(group), strict=True):
                weighted = weights.reshape(-1, 1, 1, 1) * third(cosine)
                moment += np.sum(weighted * radiance, axis=0)
            done += len(group)
            monitor.report("ordinates", done / len(self.directions))
        moments *= (self.g**BY_DEGREE).astype(np.float32)
        if self.g < MIN_ANISOTROPY:  # the third moments are negligible
            return BandMoments(moments, np.zeros_like(thirds), 0.0)
        g = self.g**_LOBE
        lobes = lobes_of((self.g / g) ** 3 * thirds, self.along)
        for lobe, way in zip(lobes, self.along, strict=True):
            moments -= of_lobe(lobe, way, g).astype(np.float32)
        return BandMoments(moments, lobes, g)

    def limiter(self, light: BandMoments) -> Floats:
        """(of the box), 0 to 1: the factor on the moments of degree 1 and 2 that keeps radiance
        positive in all directions; a truncated series of one-sided light is negative in some."""
        factor = np.ones(self.depth.shape, np.float32)
        for number, row in enumerate(harmonics(self.directions.T).T.astype(np.float32)):
            even = row[0] * light.moments[0]
            uneven = np.tensordot(row[1:], light.moments[1:], axes=1)
            for lobe, cosine in zip(light.lobes, self._cosines([number]), strict=True):
                even = even + lobe * phase_function(cosine[0], np.float32(light.g))
            share = np.divide(even, -uneven, out=np.ones_like(factor), where=uneven < 0)
            np.minimum(factor, np.maximum(share, 0), out=factor)
        return factor

    def groups(self) -> Iterator[tuple[Turn, Integers]]:
        """(`Turn`, numbers) of the directions that are swept at once: from one side."""
        longest = np.abs(self.directions).argmax(axis=1)
        for axis in range(3):
            turn = Turn(axis, self.depth.shape, Box.all(self.depth.shape))
            for backward in (False, True):
                side = (longest == axis) & ((self.directions[:, axis] < 0) == backward)
                numbers = np.flatnonzero(side)
                for first in range(0, len(numbers), _BEAMS_AT_ONCE):
                    yield turn, numbers[first : first + _BEAMS_AT_ONCE]

    def radiance(
        self, turn: Turn, group: Integers, light: BandMoments, others: Sequence[BandMoments]
    ) -> Floats:
        """(n, of the box) W/(m^2 sr), the mean in each voxel along n directions of the light that
        is scattered from `BandMoments`."""
        cosines = self._cosines(group)
        source = light.into(self.directions[group], cosines)
        for other in others:
            source = source + other.into(self.directions[group], cosines)
        np.maximum(source, 0, out=source)  # truncated series may be negative
        source *= self.scattering
        beams = [
            Beam(self.directions[n], 1.0, turn, np.add(self.lattice, shift_of(int(n))) % 1)
            for n in group
        ]
        glow = backend_of(self.device).glow(turn, turn.turned(self.depth))
        scores = glow.run(beams, [turn.turned(emission) for emission in source])
        width = np.array([beam.dw for beam in beams], np.float32) / self.lattice.shape[1]
        radiance: Floats = np.array([turn.back(score) for score in scores], np.float32)
        radiance = radiance * width.reshape(-1, 1, 1, 1) / np.maximum(1, self.depth)
        return radiance

    def _cosines(self, group: Integers | list[int]) -> list[Floats]:
        """By beam, the cosines of the angles between directions and the beam."""
        directions = self.directions[group].astype(np.float32)
        return [np.tensordot(directions, way, axes=1) for way in self.along]
