# SPDX-License-Identifier: GPL-3.0-or-later
"""Uncollided light: rays of each light, sent through the voxels.

Density is constant in a voxel, so a ray of power p whose path in a voxel has the optical depth t
deposits p (1 - exp(-t)) there (Beer-Lambert law), at the mean place 1/t - 1/(exp(t) - 1) along the
path. Attenuation is exact; the only error is the finite number of rays. The lights place the rays:
see their `rays` and `suns`.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Self

import numpy as np

from ...arrays import Array, Floats
from .. import device as devices
from ..backend import backend_of
from ..box import Box
from ..device import Device
from ..lights.base import DistantLight, Light, Photons
from ..lights.emission import Emission
from ..lights.sampling import rank_1, shift_of
from ..medium import Medium
from ..memory import DOUBLE, FLOAT, Footprint
from ..monitor import NO_MONITOR, Monitor
from .march import (
    DIRECTION,
    POSITION,
    SCORE,
    TALLIES,
    enter,
)
from .sweep import (
    STOPPED,
    Beam,
    Tallies,
    Turn,
    Voxels,
)

_AT_ONCE = 2**18  # rays, at least, that a device gets at once, except for the last ones
_BEAMS_AT_ONCE = 8  # beams whose rays are in memory at a time


@dataclass
class Moments:
    """Moments of the collisions of one band, by voxel.

    power      (nx, ny, nz) W
    position   (3, nx, ny, nz) W m, power times the place relative to the voxel's centre
    direction  (3, nx, ny, nz) W, power times the mean of the unit directions
    """

    power: Floats
    position: Floats
    direction: Floats


@dataclass
class Cast:
    """The uncollided light of one light and band, and its first collisions; arrays are float32.

    direct     (nx, ny, nz) W/m^2, the uncollided fluence
    toward     (3, nx, ny, nz) W/m^2, the net flux; or (3,), the unit vector along which all of the
               light travels
    shade      a `Box`: outside it light is unattenuated
    collided   `Moments` of the first collisions, before the albedo and with the directions before
               the collision, in the box that `cast` was given
    reflected  (nx, ny, nz) W, the light that opaque matter reflects, by the voxel that it goes back
               into, in that box, too; None without opaque voxels
    left       (6,) W, through the faces -x, +x, -y, +y, -z, +z
    stopped    W, absorbed by opaque matter
    entered    W, the sum: collided, reflected, left and stopped
    """

    direct: Floats
    toward: Floats
    shade: Box
    collided: Moments
    reflected: Floats | None
    left: Floats
    stopped: float
    entered: float

    @property
    def flux(self) -> Floats:
        """(3, nx, ny, nz) W/m^2, the net flux."""
        return self.toward if self.toward.ndim > 1 else self._along(self.direct)

    @property
    def sent_back(self) -> float:
        """W, reflected by opaque matter."""
        return 0.0 if self.reflected is None else float(self.reflected.sum(dtype=float))

    def times(self, factor: float, reflecting: float) -> "Cast":
        """The cast of light scaled by a factor, with the share that opaque matter reflects scaled
        by the factor `reflecting`."""
        toward, collided, reflected = self.toward, self.collided, self.reflected
        scaled = Cast(
            _product(factor, self.direct),
            _product(factor, toward) if toward.ndim > 1 else toward,
            self.shade,
            Moments(
                _product(factor, collided.power),
                _product(factor, collided.position),
                _product(factor, collided.direction),
            ),
            None if reflected is None else _product(factor * reflecting, reflected),
            factor * self.left,
            factor * self.stopped,
            factor * self.entered,
        )
        # Opaque matter stops the same light: it absorbs what it does not reflect.
        scaled.stopped += factor * self.sent_back - scaled.sent_back
        return scaled

    def over(self, other: "Cast") -> tuple[Floats, Floats]:
        """The fluence and the flux, in the shade, less those of another cast of this light."""
        shade = self.shade.of
        direct = shade(self.direct) - shade(other.direct)
        if self.toward.ndim > 1:
            return direct, shade(self.toward) - shade(other.toward)
        return direct, self._along(direct)

    def _along(self, direct: Floats) -> Floats:
        """The flux of light that travels along `toward`."""
        return self.toward.astype(np.float32).reshape(3, 1, 1, 1) * direct


@dataclass
class _Scores:
    """Scores of rays, in weights.

    score      (nx, ny, nz)
    position   (3, of the box)
    direction  (3, nx, ny, nz), or (3,) the unit vector of all rays
    reflected  (of the box), or None without opaque voxels
    sums       (7,), the light that left through the faces -x, +x, -y, +y, -z, +z, and the light
               that opaque matter absorbed
    shade      a `Box`: outside it light is unattenuated
    """

    score: Floats
    position: Floats
    direction: Floats
    reflected: Floats | None
    sums: Floats
    shade: Box

    @classmethod
    def dark(cls, shape: tuple[int, ...], box: Box, directions: Floats, occluded: bool) -> Self:
        """Scores of 0, for beams with the directions (n, 3)."""
        one = len(directions) == 1
        direction = directions[0] if one else np.zeros((3, *shape), np.float32)
        reflected = np.zeros(box.shape, np.float32) if occluded else None
        score, position = np.zeros(shape, np.float32), np.zeros((3, *box.shape), np.float32)
        sums = np.zeros(STOPPED + 1)
        return cls(score, position, direction, reflected, sums, Box.all(shape))

    def add(self, turn: Turn, tallies: Tallies) -> None:
        """Add turned `Tallies`."""
        if tallies.toward is None:  # of a single beam: all scores are still 0
            self.score = turn.back(tallies.score)
        else:
            self.score += turn.back(tallies.score)
        if self.reflected is not None and tallies.reflected is not None:
            self.reflected += turn.back(tallies.reflected)
        for number, axis in enumerate(turn.order):
            self.position[axis] += turn.back(tallies.position[number])
            if tallies.toward is not None:
                self.direction[axis] += turn.back(tallies.toward[number])
        self.sums[:STOPPED] += turn.by_face(tallies.sums[:STOPPED])
        self.sums[STOPPED] += tallies.sums[STOPPED]

    def add_leaving(self, beam: Beam, rays: Floats, beside: int) -> int:
        """Add the rays of a beam that leave the domain. Returns the number of rays that cross it.

        rays, beside  as of `NumpySweep.run`, of this beam
        """
        left, count = beam.leaving(rays, beside)
        self.sums[:STOPPED] += beam.share * beam.turn.by_face(left)
        return count


def cast(
    medium: Medium,
    light: Light,
    band: int,
    sigma_t: float,
    device: Device | str | None = None,
    per_edge: int = 10,
    monitor: Monitor = NO_MONITOR,
    box: Box | None = None,
) -> Cast:
    """Send the uncollided light of one light and band through a medium.

    sigma_t   extinction coefficient at density 1, 1/m
    device    None for the best, a `Device`, or part of the label of one of `device.devices()`
    per_edge  rays along a voxel's edge; see `rays` and `suns` of each light
    monitor   its `check` raises Cancelled if the user cancels
    box       a `Box` that holds all matter and all emission; None for the whole domain
    Returns a `Cast`, reproducible on each device. Raises LightError, DeviceError or Cancelled.
    """
    chosen: Device = devices.choose(device)
    box = box or Box.all(medium.shape)
    if isinstance(light, DistantLight):
        return _swept(medium, box, light, band, sigma_t, chosen, per_edge, monitor)
    return _marched(medium, box, light, band, sigma_t, chosen, per_edge, monitor)


def footprint(shape: Sequence[int], occluded: bool = True) -> Footprint:
    """The memory of a cast into `shape` voxels."""
    voxels = prod(shape)
    buffers = {"uncollided light": DOUBLE * TALLIES * voxels, "voxels": FLOAT * voxels}
    if occluded:
        buffers |= {"reflected light": DOUBLE * voxels, "opaque voxels": DOUBLE * voxels}
    kinds = TALLIES + (1 if occluded else 0)
    arrays = {
        "scores": FLOAT * (kinds + 3) * voxels,
        "depth": FLOAT * voxels,
        "work": DOUBLE * (TALLIES + 3) * voxels,
        "rays": 40 * DOUBLE * 2 * _AT_ONCE,
    }
    return Footprint(buffers, arrays)


def _marched(
    medium: Medium,
    box: Box,
    light: Light,
    band: int,
    sigma_t: float,
    device: Device,
    per_edge: int,
    monitor: Monitor,
) -> Cast:
    """The `Cast` of a light's rays, followed one by one."""
    everywhere = Box.all(medium.shape)
    march = backend_of(device).march(_voxels(medium, everywhere, band, sigma_t))
    strongest, pieces = light.rays(medium, band, per_edge)
    entered = 0.0
    for origins, directions, power in _joined(pieces) if strongest > 0 else ():
        monitor.check()
        places, hit, starts, faces = enter(medium.domain, origins, directions)
        power = power[hit]
        if not power.size:
            continue
        entered += float(power.sum())
        march.march(places, directions[hit], power / strongest, starts, faces)
    tallies, reflected, sums = march.read()
    reflected = None if reflected is None else box.of(reflected)
    position = box.of(tallies[POSITION])
    scores = _Scores(tallies[SCORE], position, tallies[DIRECTION], reflected, sums, everywhere)
    result = _cast(medium, box, sigma_t, strongest, scores, entered)
    softness = light.softness(medium.domain)
    return result if softness is None else _softened(result, box, softness.astype(np.float32))


def _swept(
    medium: Medium,
    box: Box,
    light: DistantLight,
    band: int,
    sigma_t: float,
    device: Device,
    per_edge: int,
    monitor: Monitor,
) -> Cast:
    """The `Cast` of a light's parallel beams, layer by layer."""
    directions, strengths, per_edge_of_each = light.suns(medium, band, per_edge)
    lattice, strongest = rank_1(per_edge_of_each**2), float(strengths.max(initial=0))
    # A beam sees the cross-section of a column of voxels foreshortened by its cosine.
    shares = strengths / (strongest or 1.0) * np.abs(directions).max(axis=1)
    # W of a ray of weight 1. For emission, a ray gains a weight of 1 along the edge of the
    # brightest voxel.
    unit = strongest * medium.voxel_size**2 / lattice.shape[1]
    glow, entered = None, 0.0
    if isinstance(light, Emission):
        emission = light.spectrum[band]
        brightest: Any = max(float(emission.max()), np.finfo(np.float32).tiny)
        glow = box.of(emission) / brightest
        unit *= brightest * medium.voxel_size
        entered = float(emission.sum(dtype=float)) * medium.voxel_size**3
    voxels = _voxels(medium, box, band, sigma_t, glow)
    scores = _Scores.dark(medium.shape, box, directions, voxels.occlusion is not None)
    longest = np.abs(directions).argmax(axis=1)
    for axis in np.unique(longest[shares > 0]):
        turn = Turn(axis, medium.shape, box)
        directed = len(directions) > 1
        sweep = backend_of(device).sweep(turn, voxels.of(turn.turned), directed)
        beams = [
            Beam(directions[n], shares[n], turn, np.add(lattice, shift_of(int(n))) % 1)
            for n in np.flatnonzero((longest == axis) & (shares > 0))
        ]
        for group in _from_one_side(beams):
            rays, beside = sweep.run(group, monitor)
            for beam, leaving in zip(group, rays, strict=True):
                count = scores.add_leaving(beam, leaving, beside)
                entered += 0.0 if glow is not None else unit * beam.share * count
        scores.add(turn, sweep.read())
        if len(directions) == 1:
            scores.shade = beams[0].shade()
    return _cast(medium, box, sigma_t, unit, scores, entered)


def _from_one_side(beams: Sequence[Beam]) -> Iterator[list[Beam]]:
    """Groups of beams to send at once: all from one side, and few enough for memory."""
    for backward in (False, True):
        side = [beam for beam in beams if beam.backward[0] == backward]
        for first in range(0, len(side), _BEAMS_AT_ONCE):
            yield side[first : first + _BEAMS_AT_ONCE]


def _voxels(
    medium: Medium, box: Box, band: int, sigma_t: float, glow: Floats | None = None
) -> Voxels:
    """The `Voxels` of a box, with the emission `glow` of its voxels."""
    occlusion = reflecting = None
    if medium.occlusion is not None:
        occlusion = box.of(medium.occlusion)
        reflecting = occlusion * box.of(medium.occlusion_albedo[band])
    return Voxels(medium.depth(sigma_t, box), glow, occlusion, reflecting)


def _joined(pieces: Iterable[Photons]) -> Iterator[list[Floats]]:
    """The same rays, joined into larger pieces."""
    waiting: list[Photons] = []
    count = 0
    for piece in pieces:
        waiting.append(piece)
        count += len(piece[2])
        if count >= _AT_ONCE:
            yield [np.concatenate(parts) for parts in zip(*waiting, strict=True)]
            waiting, count = [], 0
    if waiting:
        yield [np.concatenate(parts) for parts in zip(*waiting, strict=True)]


def _cast(
    medium: Medium, box: Box, sigma_t: float, unit: float, scores: _Scores, entered: float
) -> Cast:
    """The `Cast` of `_Scores`; unit is the power of a ray of weight 1, W."""
    h, depth, score = medium.voxel_size, medium.depth(sigma_t, box), box.of(scores.score)
    direct, colliding = _product(unit / h**2, scores.score), unit * np.minimum(1, depth)
    box.of(direct)[...] /= np.maximum(1, depth)
    toward = scores.direction
    if toward.ndim == 1:
        along = _product(toward.reshape(3, 1, 1, 1), colliding * score)
    else:
        along = _product(colliding, box.of(toward))
        toward = _product(unit / h**2, toward)
        box.of(toward)[...] /= np.maximum(1, depth)
    place = _product(colliding * h, scores.position)
    collided = Moments(_product(colliding, score), place, along)
    reflected, sums = scores.reflected, scores.sums
    if reflected is not None:
        reflected = (unit * reflected.astype(float)).astype(np.float32)
    left, stopped = unit * sums[:STOPPED], float(unit * sums[STOPPED])
    return Cast(direct, toward, scores.shade, collided, reflected, left, stopped, entered)


def _softened(cast: Cast, box: Box, softness: Floats) -> Cast:
    """The `Cast` of a point light, scaled in each voxel by a lamp's softness (nx, ny, nz). The
    power removed counts as not emitted."""
    cast.direct *= softness
    cast.toward *= softness
    collided, softness = cast.collided, box.of(softness)
    cast.entered -= float(np.sum(collided.power * (1 - softness), dtype=float))
    for moments in (collided.power, collided.position, collided.direction):
        moments *= softness
    return cast


def _product(factor: float | Array, values: Array) -> Floats:
    """The product in float32, computed in float64 so that neither factor needs to fit float32."""
    out = np.empty(np.broadcast_shapes(np.shape(factor), values.shape), np.float32)
    return np.multiply(factor, values, out=out, dtype=float, casting="same_kind")
