# SPDX-License-Identifier: GPL-3.0-or-later
"""Unscattered light, exactly: rays of a light, sent through the voxels.

Density is constant in a voxel, so a ray of power p that has the optical depth t in one leaves
p (1 - exp(-t)) there (Beer and Lambert), at 1/t - 1/(exp(t) - 1) of its way on average; nothing is
drawn at random but where a light starts. What is left to chance is where rays are: see `rays` and
`suns` of each light.
"""

from dataclasses import dataclass
from math import prod

import numpy as np

from .. import device as devices
from ..backend import backend_of
from ..box import Box
from ..lights.emission import Emission
from ..lights.sampling import rank_1, shift_of
from ..memory import DOUBLE, FLOAT, Footprint
from ..monitor import UNHEARD
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
    Turn,
    Voxels,
)

_AT_ONCE = 2**18  # rays, at least, that a device is given where there are more
_BEAMS_AT_ONCE = 8  # whose rays are in memory
# Rays of a light that cannot say itself how many it needs: at most; and by per_edge^2 and faces of
# voxels on half the border.
_MOST, _FOR_ALL = 2**22, 4


@dataclass
class Moments:
    """Light of one band that met something, by voxel.

    power      (nx, ny, nz) W
    position   (3, nx, ny, nz) W m, power times the place from the voxel's centre
    direction  (3, nx, ny, nz) W, power times the mean of its unit directions
    """

    power: np.ndarray
    position: np.ndarray
    direction: np.ndarray


@dataclass
class Cast:
    """Where the unscattered light of one light and band goes; arrays are float32.

    direct     (nx, ny, nz) W/m^2, its fluence
    toward     its net flux, (3, nx, ny, nz) W/m^2; or where all of it goes one way, that unit
               vector, (3,)
    shade      a `Box`: elsewhere light has met nothing
    collided   `Moments` of its first collisions, before any albedo; with the directions before;
               of voxels in the box that was asked for, like the next
    reflected  (nx, ny, nz) W, what opaque matter reflects, by the voxel that it goes back into;
               None without opaque voxels
    left       (6,) W, through the faces -x, +x, -y, +y, -z, +z
    stopped    W, what opaque matter absorbs
    entered    W, all of it: what collided, was reflected, left or was stopped
    """

    direct: np.ndarray
    toward: np.ndarray
    shade: Box
    collided: Moments
    reflected: np.ndarray | None
    left: np.ndarray
    stopped: float
    entered: float

    @property
    def flux(self):
        """(3, nx, ny, nz) W/m^2, its net flux."""
        return self.toward if self.toward.ndim > 1 else self._along(self.direct)

    @property
    def sent_back(self):
        """W, what opaque matter reflects."""
        return 0.0 if self.reflected is None else float(self.reflected.sum(dtype=float))

    def times(self, factor, reflecting):
        """The same of light that is stronger by a factor, where opaque matter reflects more, too.

        reflecting  factor on the share that it does
        """
        toward, collided, reflected = self.toward, self.collided, self.reflected
        found = Cast(
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
        found.stopped += factor * self.sent_back - found.sent_back  # what is met is the same
        return found

    def over(self, other):
        """(direct, flux) in the shade, by which it is more than another of the same light."""
        shade = self.shade.of
        direct = shade(self.direct) - shade(other.direct)
        if self.toward.ndim > 1:
            return direct, shade(self.toward) - shade(other.toward)
        return direct, self._along(direct)

    def _along(self, direct):
        """The flux of light that all goes one way."""
        return self.toward.astype(np.float32).reshape(3, 1, 1, 1) * direct


@dataclass
class _Scores:
    """What rays scored, in weights.

    score      (nx, ny, nz)
    position   (3, of the box)
    direction  (3, nx, ny, nz), or (3,) the unit vector where all rays have one
    reflected  (of the box), or None without opaque voxels
    sums       (7,), what left through the faces -x, +x, -y, +y, -z, +z, and what was stopped
    shade      a `Box`: elsewhere light has met nothing
    """

    score: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    reflected: np.ndarray | None
    sums: np.ndarray
    shade: Box

    @classmethod
    def dark(cls, shape, box, directions, occluded):
        """Of beams of some directions (n, 3) that are still to be sent."""
        one = len(directions) == 1
        direction = directions[0] if one else np.zeros((3, *shape), np.float32)
        reflected = np.zeros(box.shape, np.float32) if occluded else None
        grids = np.zeros(shape, np.float32), np.zeros((3, *box.shape), np.float32)
        return cls(*grids, direction, reflected, np.zeros(STOPPED + 1), Box.all(shape))

    def add(self, turn, tallies):
        """Add turned `Tallies`."""
        if tallies.toward is None:  # of a single beam: there is nothing yet
            self.score = turn.back(tallies.score)
        else:
            self.score += turn.back(tallies.score)
        if tallies.reflected is not None:
            self.reflected += turn.back(tallies.reflected)
        for number, axis in enumerate(turn.order):
            self.position[axis] += turn.back(tallies.position[number])
            if tallies.toward is not None:
                self.direction[axis] += turn.back(tallies.toward[number])
        self.sums[:STOPPED] += turn.by_face(tallies.sums[:STOPPED])
        self.sums[STOPPED] += tallies.sums[STOPPED]

    def let_out(self, beam, rays, beside):
        """Add what is left of a beam's rays; how many rays cross the domain."""
        left, count = beam.leaving(rays, beside)
        self.sums[:STOPPED] += beam.share * beam.turn.by_face(left)
        return count


def cast(medium, light, band, sigma_t, device=None, per_edge=10, monitor=UNHEARD, box=None):
    """Send the unscattered light of one light and band through a medium.

    medium    a `Medium`
    light     one of `lights.py`, or anything with their `spectrum` and `emit`
    sigma_t   extinction at density 1 to reckon with, 1/m
    device    None for the best, a `Device`, or part of the label of one of `device.devices()`
    per_edge  rays along a voxel's edge: see `rays` of each light
    monitor   a `Monitor`, whose `check` ends the cast where the user cancels
    box       a `Box` that holds all matter, and all that shines; None for the whole domain
    Returns a `Cast`, on a device always the same. Raises LightError or DeviceError.
    """
    device, box = devices.choose(device), box or Box.all(medium.shape)
    if hasattr(light, "suns"):
        return _swept(medium, box, light, band, sigma_t, device, per_edge, monitor)
    return _marched(medium, box, light, band, sigma_t, device, per_edge, monitor)


def footprint(shape, occluded=True):
    """The `Footprint` of a cast into `shape` voxels."""
    voxels = prod(shape)
    buffers = {"unscattered light": DOUBLE * TALLIES * voxels, "voxels": FLOAT * voxels}
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


def _marched(medium, box, light, band, sigma_t, device, per_edge, monitor):
    """The `Cast` of what shines from a place: ray by ray."""
    everywhere = Box.all(medium.shape)
    march = backend_of(device).march(_voxels(medium, everywhere, band, sigma_t))
    strongest, pieces = _rays(light, medium, band, per_edge)
    entered = 0.0
    for origins, directions, power in _gathered(pieces) if strongest > 0 else ():
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
    found = _cast(medium, box, sigma_t, strongest, scores, entered)
    softness = light.softness(medium.domain) if hasattr(light, "softness") else None
    return found if softness is None else _softened(found, box, softness.astype(np.float32))


def _swept(medium, box, light, band, sigma_t, device, per_edge, monitor):
    """The `Cast` of what shines as suns do: of each of these, by layers."""
    directions, strengths, of_each = light.suns(medium, band, per_edge)
    lattice, strongest = rank_1(of_each**2), float(strengths.max(initial=0))
    # A column of voxels is as wide as the cosine of the angle that it is seen at.
    shares = strengths / (strongest or 1.0) * np.abs(directions).max(axis=1)
    # W of a ray of weight 1; for one that gathers light the weight is that of a voxel's edge.
    unit = strongest * medium.voxel_size**2 / lattice.shape[1]
    glow, entered = None, 0.0
    if isinstance(light, Emission):
        emission = light.spectrum[band]
        brightest = max(float(emission.max()), np.finfo(np.float32).tiny)
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
            Beam(directions[n], shares[n], turn, (lattice + shift_of(n)) % 1)
            for n in np.flatnonzero((longest == axis) & (shares > 0))
        ]
        for some in _from_one_side(beams):
            rays, beside = sweep.run(some, monitor)
            for beam, left in zip(some, rays, strict=True):
                count = scores.let_out(beam, left, beside)
                entered += 0.0 if glow is not None else unit * beam.share * count
        scores.add(turn, sweep.read())
        if len(directions) == 1:
            scores.shade = beams[0].shade()
    return _cast(medium, box, sigma_t, unit, scores, entered)


def _from_one_side(beams):
    """[[beam]]: so many as are sent at once."""
    for backward in (False, True):
        some = [beam for beam in beams if beam.backward[0] == backward]
        for first in range(0, len(some), _BEAMS_AT_ONCE):
            yield some[first : first + _BEAMS_AT_ONCE]


def _voxels(medium, box, band, sigma_t, glow=None):
    """The `Voxels` of a box; glow is theirs."""
    occlusion = reflecting = None
    if medium.occlusion is not None:
        occlusion = box.of(medium.occlusion)
        reflecting = occlusion * box.of(medium.occlusion_albedo[band])
    return Voxels(medium.depth(sigma_t, box), glow, occlusion, reflecting)


def _rays(light, medium, band, per_edge):
    """The rays of a light, as `rays` of `lights.py` returns them."""
    if hasattr(light, "rays"):
        return light.rays(medium, band, per_edge)
    nx, ny, nz = medium.shape
    count = min(_MOST, _FOR_ALL * per_edge**2 * (nx * ny + ny * nz + nz * nx))
    rays = light.emit(count, medium, np.random.default_rng(0), band)
    pieces = ([part[n : n + _AT_ONCE] for part in rays] for n in range(0, count, _AT_ONCE))
    return float(rays[2].max()), pieces


def _gathered(pieces):
    """The same rays in larger pieces."""
    waiting, count = [], 0
    for piece in pieces:
        waiting.append(piece)
        count += len(piece[2])
        if count >= _AT_ONCE:
            yield [np.concatenate(parts) for parts in zip(*waiting, strict=True)]
            waiting, count = [], 0
    if waiting:
        yield [np.concatenate(parts) for parts in zip(*waiting, strict=True)]


def _cast(medium, box, sigma_t, unit, scores, entered):
    """The `Cast` of `_Scores`."""
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


def _softened(cast, box, softness):
    """Of a `Cast` of a point the share, (nx, ny, nz), that a lamp sends; the rest never was."""
    cast.direct *= softness
    cast.toward *= softness
    collided, softness = cast.collided, box.of(softness)
    cast.entered -= float(np.sum(collided.power * (1 - softness), dtype=float))
    for moments in (collided.power, collided.position, collided.direction):
        moments *= softness
    return cast


def _product(factor, values):
    """float32, but in between float64: neither of the two need fit into the other."""
    out = np.empty(np.broadcast_shapes(np.shape(factor), values.shape), np.float32)
    return np.multiply(factor, values, out=out, dtype=float, casting="same_kind")
