# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a medium that scatters forwards sends light: gathered once more along many directions.

The lattice tells how much light there is, and its net flux. What such a medium sends aside of a
lamp's way hangs on more than that: on what is left of the lamp's direction after a few scatterings.
So rays of many directions cross the box of the medium and gather what is scattered into them; at
first of the lattice's light, then of what was gathered before: source iteration, as of discrete
ordinates. What comes of it is kept as moments and lobes, see `Scattered`; docs/theory/physics.md
says what that was measured to be worth.
"""

from dataclasses import dataclass, replace
from math import ceil, floor
from time import perf_counter

import numpy as np

from .. import device as devices
from ..backend import backend_of
from ..bands import distinct
from ..box import Box
from ..field import Scattered
from ..lights.distant import Sun
from ..lights.emission import Emission
from ..lights.sampling import rank_1, shift_of
from ..medium import merged
from ..monitor import Monitor
from ..resample import between
from ..uncollided.sweep import Beam, Turn
from .quadrature import (
    DEGREES,
    directions_for,
    harmonics,
    phase_function,
    third,
)

TIMES = 4  # that light is gathered: more gain nothing, as moments are not all there is
FORWARDS = 0.65  # mean cosine from which on it is worth it
# Mean optical depth of voxels, where there is matter: up to which it is, as light changes within
# thicker ones; and up to which those with more than _MOST along an edge are merged, as what has
# scattered is smooth.
THICKEST, _MERGED = 3.0, 2.0
_MOST = 48
_LARGEST = 160  # voxels along an edge, beyond which they are merged in any case: 1 GB
_LOBE = 3  # the mean cosine of lobes is this power of g, as of light that scatters a third time
_BEAMS_AT_ONCE = 16
_DEGREES = DEGREES.reshape(-1, 1, 1, 1)


def is_worthwhile(medium, lights):
    """Whether the pictures of a medium in some lights gain by gathering.

    Nothing is gathered of what opaque voxels reflect.
    """
    if medium.occlusion is not None or np.max(medium.g) < FORWARDS:
        return False
    beams = any(light.is_beam for light in lights)
    return bool(beams and _mean_depth(medium) <= THICKEST)


def gather(medium, lights, field, device=None, times=TIMES, progress=None, cancel=None):
    """The `Scattered` of the `Field` that a medium and its lights have by the physical model.

    medium, lights, device, cancel  those of `solve`
    times     that light is gathered, each of what was gathered before
    progress  called with the share that is done
    Raises DeviceError or Cancelled.
    """
    monitor = Monitor(progress and (lambda _stage, share: progress(share)), cancel)
    lights, pieces = list(lights), _pieces(medium)
    if pieces > 1:
        large, of_large = medium.merged(pieces), _merged(field, medium, pieces)
        found = _gathered(large, lights, of_large, device, times, monitor)
        moments, lobes = (
            between(grid, pieces, medium.shape) for grid in (found.moments, found.lobes)
        )
        return Scattered(moments, lobes, found.g, times)
    return _gathered(medium, lights, field, device, times, monitor)


def _pieces(medium):
    """How many voxels are merged along each edge."""
    edge = max(medium.shape)
    wished = min(ceil(edge / _MOST), floor(_MERGED / max(_mean_depth(medium), 1e-9)))
    return max(wished, ceil(edge / _LARGEST))


def _mean_depth(medium):
    """The mean optical depth of voxels where there is matter."""
    depth = medium.depth(np.max(medium.sigma_t))
    return depth.sum() / max(1, np.count_nonzero(depth))


def _merged(field, medium, pieces):
    """A `Field` of what light there is in merged voxels of a medium."""
    there = merged(np.ones(medium.shape, np.float32), pieces)
    names = ("fluence", "flux", "direct", "direct_flux", "by_light", "forward")
    return replace(field, **{name: merged(getattr(field, name), pieces) / there for name in names})


def _gathered(medium, lights, field, device, times, monitor):
    """`gather` in a medium's own voxels."""
    ways, box = _Ways(medium, lights), Box.around([medium.density])
    found = Scattered.dark(medium.bands, len(ways.numbers), medium.shape, times)
    runs = _runs(medium, lights)
    for number, (band, multiples) in enumerate(runs):
        gatherer = _Gatherer(medium, box, band, ways, device)
        # In float32 light may be as dim or bright as the user likes only where it is near 1.
        scale = (field.fluence[band] + field.direct[band]).max() or np.float32(1)
        light, unscattered = (part(field, scale) for part in (gatherer.first, gatherer.unscattered))
        for time in range(times):
            passes = len(runs) * times
            of_pass = monitor.part((number * times + time) / passes, 1 / passes)
            light = gatherer.next(light, unscattered, of_pass)
        light.moments[1:] *= gatherer.bound(light)
        for other, factor in multiples.items():
            box.of(found.moments[other])[...] = factor * scale * light.moments
            box.of(found.lobes[:, other])[...] = factor * scale * light.lobes
            found.g[other] = light.g
    return found


def _runs(medium, lights):
    """[(band to gather, {band: its multiple})]"""
    shining = lights if medium.emission is None else [*lights, Emission(medium)]
    return distinct(medium, shining)


def seconds(medium, lights, device=None, times=TIMES):
    """About how long `gather` takes, s: some of its rays are sent to see."""
    medium = medium.merged(_pieces(medium))
    gatherer = _Gatherer(medium, Box.around([medium.density]), 0, _Ways(medium, lights), device)
    dark = _Light.dark(len(gatherer.ways.numbers), gatherer.depth.shape)
    turn, some = next(gatherer.groups())
    for _ in range(2):  # the first makes programs ready
        start = perf_counter()
        gatherer.radiance(turn, some, dark, [])
        spent = perf_counter() - start
    passes = len(_runs(medium, lights)) * times
    return passes * spent * len(gatherer.towards) / len(some)


def of_lobes(fluence, flux, g):
    """(9, nx, ny, nz) W/m^2: moments of what light is scattered to that has a lobe about its flux.

    fluence (nx, ny, nz) W/m^2, flux (3, nx, ny, nz) W/m^2, g of the medium
    """
    flux = np.asarray(flux, float)  # its square may be more than float32 has
    strength = np.linalg.norm(flux, axis=0)
    way = np.divide(flux, strength, out=np.zeros(flux.shape), where=strength > 0)
    cosine = np.divide(strength, fluence, out=np.zeros(strength.shape), where=fluence > 0)
    return _of_lobe(fluence, way, g * np.minimum(cosine, 1))


def _of_lobe(light, way, cosine):
    """The moments of light (nx, ny, nz) of a lobe about unit vectors (3, ...)."""
    return light * harmonics(way) * np.asarray(cosine) ** _DEGREES


# --- One band ------------------------------------------------------------------------------------


class _Ways:
    """Which lights are beams, and where they go in the voxels of a medium."""

    def __init__(self, medium, lights):
        self.numbers = [n for n, light in enumerate(lights) if light.is_beam]
        self.beams = [lights[n] for n in self.numbers]
        self.suns = [way_of(beam)[:, 0, 0, 0] for beam in self.beams if isinstance(beam, Sun)]
        self.domain = medium.domain

    def within(self, box):
        """[(3, 1, 1, 1) or (3, of the box)]: unit vectors, by beam."""
        ways = (way_of(beam, self.domain).astype(np.float32) for beam in self.beams)
        return [way if way.size == 3 else box.of(way) for way in ways]


def way_of(beam, domain=None):
    """(3, 1, 1, 1) or (3, nx, ny, nz): unit vectors along which a beam goes in each voxel."""
    if isinstance(beam, Sun):
        way = np.reshape(beam.direction, (3, 1, 1, 1))
    else:
        way = np.moveaxis(domain.centers() - beam.position, -1, 0)
    length = np.linalg.norm(way, axis=0)
    return np.divide(way, length, out=np.zeros(way.shape), where=length > 0)


@dataclass
class _Light:
    """What light is scattered to: of a band what `Scattered` has of all, in the voxels of a box."""

    moments: np.ndarray
    lobes: np.ndarray
    g: float

    @classmethod
    def dark(cls, beams, shape):
        return cls(np.zeros((9, *shape), np.float32), np.zeros((beams, *shape), np.float32), 0.0)

    def into(self, directions, cosines):
        """(n, of the box) W/(m^2 sr) into n directions; cosines are by beam those of their angles
        to it, (n, 1, 1, 1) or (n, of the box)."""
        basis = harmonics(directions.T).T.astype(np.float32)
        found = np.tensordot(basis, self.moments, axes=1)
        for light, cosine in zip(self.lobes, cosines, strict=True):
            found += light * phase_function(cosine, np.float32(self.g))
        return found


class _Gatherer:
    """The box of a medium in one band, and the directions that light is gathered along in it."""

    def __init__(self, medium, box, band, ways, device):
        self.device, self.box, self.band, self.ways = devices.choose(device), box, band, ways
        self.g = float(medium.g[band])
        self.depth = medium.depth(medium.sigma_t[band], box).astype(np.float32)
        self.scattering = medium.depth(medium.sigma_s[band], box).astype(np.float32)
        self.towards, self.weights = directions_for(ways.suns, self.g)
        self.along = ways.within(box)
        self.lattice = rank_1(1)

    def first(self, field, scale):
        """The `_Light` of a `Field`, over a scale: what goes on forwards of each beam, and a lobe
        of the rest."""
        forward = self._beams(field.forward, scale)
        # What was scattered ahead once has the mean cosine g, and counts as 1 in the lattice.
        ahead = ((1 + self.g) / 2 * way * own for way, own in zip(self.along, forward, strict=True))
        fluence = self.box.of(field.fluence[self.band]) / scale - forward.sum(axis=0)
        flux = self.box.of(field.flux[self.band]) / scale - sum(ahead)
        rest = of_lobes(np.maximum(fluence, 0), flux, self.g)
        return _Light(rest.astype(np.float32), forward, max(self.g, 0.0) ** 2)

    def unscattered(self, field, scale):
        """The `_Light` of beams, and of all other light that has not scattered, over a scale."""
        beside = beside_beams(field, self.band, self.ways.numbers, self.along, self.box)
        rest = of_lobes(*(light / scale for light in beside), self.g)
        return _Light(rest.astype(np.float32), self._beams(field.by_light, scale), self.g)

    def _beams(self, grids, scale):
        return self.box.of(grids[self.ways.numbers, self.band]) / scale

    def next(self, light, unscattered, monitor):
        """The `_Light` that is gathered of one, and of unscattered light."""
        moments = np.zeros((9, *self.depth.shape), np.float32)
        thirds = np.zeros((len(self.along), *self.depth.shape), np.float32)
        done = 0
        for turn, some in self.groups():
            monitor.check()
            radiance = self.radiance(turn, some, light, [unscattered])
            weights = self.weights[some].astype(np.float32)
            basis = (weights * harmonics(self.towards[some].T)).astype(np.float32)
            moments += np.tensordot(basis, radiance, axes=1)
            for own, cosine in zip(thirds, self._cosines(some), strict=True):
                weighted = weights.reshape(-1, 1, 1, 1) * third(cosine)
                own += np.sum(weighted * radiance, axis=0)
            done += len(some)
            monitor.report("ordinates", done / len(self.towards))
        moments *= (self.g**_DEGREES).astype(np.float32)
        if self.g < FORWARDS:  # there is hardly a third moment
            return _Light(moments, np.zeros_like(thirds), 0.0)
        g = self.g**_LOBE
        lobes = _apart((self.g / g) ** 3 * thirds, self.along)
        for own, way in zip(lobes, self.along, strict=True):
            moments -= _of_lobe(own, way, g).astype(np.float32)
        return _Light(moments, lobes, g)

    def bound(self, light):
        """(of the box): what a `_Light`'s uneven moments are to be multiplied by, from 0 to 1, for
        it to be nowhere less than nothing: a few moments of light from one side are."""
        least = np.ones(self.depth.shape, np.float32)
        for number, row in enumerate(harmonics(self.towards.T).T.astype(np.float32)):
            even = row[0] * light.moments[0]
            uneven = np.tensordot(row[1:], light.moments[1:], axes=1)
            for own, cosine in zip(light.lobes, self._cosines([number]), strict=True):
                even = even + own * phase_function(cosine[0], np.float32(light.g))
            share = np.divide(even, -uneven, out=np.ones_like(least), where=uneven < 0)
            np.minimum(least, np.maximum(share, 0), out=least)
        return least

    def groups(self):
        """(`Turn`, numbers) of the directions that are sent at once: from one side."""
        longest = np.abs(self.towards).argmax(axis=1)
        for axis in range(3):
            turn = Turn(axis, self.depth.shape, Box.all(self.depth.shape))
            for backward in (False, True):
                of_side = (longest == axis) & ((self.towards[:, axis] < 0) == backward)
                numbers = np.flatnonzero(of_side)
                for first in range(0, len(numbers), _BEAMS_AT_ONCE):
                    yield turn, numbers[first : first + _BEAMS_AT_ONCE]

    def radiance(self, turn, some, light, more):
        """(n, of the box) W/(m^2 sr), mean in each voxel, of n directions: of light that is
        scattered to them from a `_Light`, and from more."""
        cosines = self._cosines(some)
        shining = sum(each.into(self.towards[some], cosines) for each in [light, *more])
        np.maximum(shining, 0, out=shining)  # moments alone may be less than nothing
        shining *= self.scattering
        beams = [Beam(self.towards[n], 1.0, turn, (self.lattice + shift_of(n)) % 1) for n in some]
        glow = backend_of(self.device).glow(turn, turn.turned(self.depth))
        score = glow.run(beams, [turn.turned(own) for own in shining])
        width = np.array([beam.dw for beam in beams], np.float32) / self.lattice.shape[1]
        found = np.array([turn.back(own) for own in score], np.float32)
        return found * width.reshape(-1, 1, 1, 1) / np.maximum(1, self.depth)

    def _cosines(self, some):
        return [
            np.tensordot(self.towards[some].astype(np.float32), way, axes=1) for way in self.along
        ]


def beside_beams(field, band, numbers, ways, box):
    """(fluence (of the box), flux (3, of the box)) W/m^2: unscattered light but that of beams."""
    fluence, flux = box.of(field.direct[band]), box.of(field.direct_flux[band])
    for number, way in zip(numbers, ways, strict=True):
        own = box.of(field.by_light[number, band])
        fluence, flux = fluence - own, flux - way * own
    # Rounding leaves less than nothing where beams are all there is.
    return np.maximum(fluence, 0), flux


def _apart(thirds, ways):
    """The lobes (beams, ...) whose third moments along each of the ways add up to those given."""
    count = len(ways)
    if count <= 1:
        return thirds
    near = np.broadcast_arrays(*(third(np.sum(a * b, axis=0)) for a in ways for b in ways))
    near = np.stack(near, axis=-1).reshape(*near[0].shape, count, count)
    # Beams that go about the same way share a lobe.
    inverse = np.linalg.pinv(near.astype(float), rtol=0.03)
    return np.einsum("...ij,j...->i...", inverse, thirds).astype(np.float32)
