# SPDX-License-Identifier: GPL-3.0-or-later
"""Unscattered light, exactly: rays of a light, marched through the voxels.

Density is constant in a voxel, so a ray of power p that has the optical depth t in one leaves
p (1 - exp(-t)) there (Beer and Lambert), at 1/t - 1/(exp(t) - 1) of its way on average; nothing is
drawn at random but where a light starts. What is left to chance is where rays are: see `rays` of
each light.
"""

from dataclasses import dataclass
from math import prod

import numpy as np

from ..errors import Cancelled
from . import device as devices
from .crop import Box
from .fade import fade
from .lights import Emission, rank_1, shift_of
from .sweep import STOPPED, Beam, NumpySweep, Turn

# What a voxel's tallies and the sums of all rays count, as in kernels/direct.cl.
_SCORE, _POSITION, _DIRECTION, _TALLIES = 0, slice(1, 4), slice(4, 7), 7

_AT_ONCE = 2**18  # rays, at least, that a device is given where there are more
_BEAMS_AT_ONCE = 8  # whose rays are in memory
# Rays of a light that cannot say itself how many it needs: at most; and by per_edge^2 and faces of
# voxels on half the border.
_MOST, _FOR_ALL = 2**22, 4
_BORDER = 1e-6  # voxels from a face of the domain within which a ray comes from outside
_SLOWEST = 1e-18  # a direction's component closer to zero than this is taken for this


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
        if self.toward.ndim > 1:
            return self.toward
        return self.toward.astype(np.float32).reshape(3, 1, 1, 1) * self.direct

    def over(self, other):
        """(direct, flux) in the shade, by which it is more than another of the same light."""
        shade = self.shade.of
        direct = shade(self.direct) - shade(other.direct)
        if self.toward.ndim > 1:
            return direct, shade(self.toward) - shade(other.toward)
        return direct, self.toward.astype(np.float32).reshape(3, 1, 1, 1) * direct


@dataclass(frozen=True)
class Voxels:
    """What rays meet: each (nx, ny, nz), or None.

    depth       optical depth of a voxel's edge
    glow        emission, from 0 to 1
    occlusion   share of arriving light that is stopped
    reflecting  share of arriving light that is reflected
    """

    depth: np.ndarray
    glow: np.ndarray | None
    occlusion: np.ndarray | None
    reflecting: np.ndarray | None

    @property
    def grids(self):
        return self.depth, self.glow, self.occlusion, self.reflecting

    def of(self, part):
        """The same of what a function makes of each grid."""
        return Voxels(*(None if grid is None else part(grid) for grid in self.grids))


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


def cast(medium, light, band, sigma_t, device=None, per_edge=10, cancel=None, box=None):
    """Send the unscattered light of one light and band through a medium.

    medium    a `Medium`
    light     one of `lights.py`, or anything with their `spectrum` and `emit`
    sigma_t   extinction at density 1 to reckon with, 1/m
    device    None for the best, a `Device`, or part of the label of one of `device.devices()`
    per_edge  rays along a voxel's edge: see `rays` of each light
    cancel    called without arguments; the cast ends with `Cancelled` where it returns true
    box       a `Box` that holds all matter, and all that shines; None for the whole domain
    Returns a `Cast`, on a device always the same. Raises LightError or DeviceError.
    """
    device, box = devices.choose(device), box or Box.all(medium.shape)
    if hasattr(light, "suns"):
        return _swept(medium, box, light, band, sigma_t, device, per_edge, cancel)
    march = _march(device, _voxels(medium, Box.all(medium.shape), band, sigma_t))
    strongest, pieces = _rays(light, medium, band, per_edge)
    entered = 0.0
    for origins, directions, power in _gathered(pieces) if strongest > 0 else ():
        if cancel is not None and cancel():
            raise Cancelled("Cancelled; nothing was changed.")
        places, hit, starts, faces = enter(medium.domain, origins, directions)
        power = power[hit]
        if not power.size:
            continue
        entered += float(power.sum())
        march.march(places, directions[hit], power / strongest, starts, faces)
    tallies, reflected, sums = march.read()
    reflected = None if reflected is None else box.of(reflected)
    position = box.of(tallies[_POSITION])
    everywhere = Box.all(medium.shape)
    scores = _Scores(tallies[_SCORE], position, tallies[_DIRECTION], reflected, sums, everywhere)
    found = _cast(medium, box, sigma_t, strongest, scores, entered)
    softness = light.softness(medium.domain) if hasattr(light, "softness") else None
    return found if softness is None else _softened(found, box, softness.astype(np.float32))


def plan(shape, occluded=True):
    """({what: bytes} on the device, bytes on the host) of a cast into `shape` voxels."""
    voxels = prod(shape)
    buffers = {"unscattered light": 8 * _TALLIES * voxels, "voxels": 4 * voxels}
    if occluded:
        buffers |= {"reflected light": 8 * voxels, "opaque voxels": 8 * voxels}
    kinds = _TALLIES + (1 if occluded else 0)
    work = 8 * (_TALLIES + 3) * voxels
    rays = 40 * 8 * 2 * _AT_ONCE
    return buffers, (4 * (kinds + 3) + 4) * voxels + work + rays


def _swept(medium, box, light, band, sigma_t, device, per_edge, cancel):
    """The `Cast` of what shines as suns do: of each of these, by layers."""
    directions, strengths, of_each = light.suns(medium, band, per_edge)
    lattice, strongest = rank_1(of_each**2), float(strengths.max(initial=0))
    # A column of voxels is as wide as the cosine of the angle that it is seen at.
    shares = strengths / (strongest or 1.0) * np.abs(directions).max(axis=1)
    # W of a ray of weight 1; for one that gathers light the weight is that of a voxel's edge.
    unit = strongest * medium.voxel_size**2 / lattice.shape[1]
    emission, entered = None, 0.0
    if isinstance(light, Emission):
        emission = light.spectrum[band]
        unit *= float(emission.max()) * medium.voxel_size
        entered = float(emission.sum(dtype=float)) * medium.voxel_size**3
    voxels = _voxels(medium, box, band, sigma_t, emission)
    scores = _Scores.dark(medium.shape, box, directions, voxels.occlusion is not None)
    longest = np.abs(directions).argmax(axis=1)
    for axis in np.unique(longest[shares > 0]):
        turn = Turn(axis, medium.shape, box)
        sweep = _sweep(device, turn, voxels.of(turn.turned), directed=len(directions) > 1)
        beams = [
            Beam(directions[n], shares[n], turn, (lattice + shift_of(n)) % 1)
            for n in np.flatnonzero((longest == axis) & (shares > 0))
        ]
        for some in _from_one_side(beams):
            rays, beside = sweep.run(some, cancel)
            for beam, left in zip(some, rays, strict=True):
                count = scores.let_out(beam, left, beside)
                entered += 0.0 if emission is not None else unit * beam.share * count
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


def _sweep(device, turn, voxels, directed):
    if device.kind == "NumPy":
        return NumpySweep(turn, voxels, directed)
    from .sweep_opencl import OpenclSweep  # only now: it needs pyopencl

    return OpenclSweep(turn, voxels, directed, device)


def _voxels(medium, box, band, sigma_t, emission=None):
    """The `Voxels` of a box."""
    glow = occlusion = reflecting = None
    if emission is not None:
        glow = box.of(emission) / max(float(emission.max()), np.finfo(np.float32).tiny)
    if medium.occlusion is not None:
        occlusion = box.of(medium.occlusion)
        reflecting = occlusion * box.of(medium.occlusion_albedo[band])
    return Voxels(medium.depth(sigma_t, box), glow, occlusion, reflecting)


def _march(device, voxels):
    if device.kind == "NumPy":
        return NumpyMarch(voxels)
    from .direct_opencl import OpenclMarch  # only now: it needs pyopencl

    return OpenclMarch(device, voxels)


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


def enter(domain, origins, directions):
    """Where rays ((n, 3) m, world space, and (n, 3)) begin their way through the domain's voxels.

    Returns ((m, 3) the places in their first voxels, from 0 where a ray that goes this way enters
    to 1 where it leaves; which (n,) rays these are; (m,) the voxels; (m,) the faces of the domain
    -x, +x, -y, +y, -z, +z that they come through, or -1 where they begin inside).
    """
    shape = np.array(domain.shape)
    points = (origins - domain.origin) / domain.voxel_size
    forward = directions >= 0
    with np.errstate(divide="ignore", invalid="ignore"):
        begin = (np.where(forward, 0, shape) - points) / directions
        end = (np.where(forward, shape, 0) - points) / directions
    level = directions == 0  # such a ray is between two faces for ever, or never
    begin[level] = -np.inf
    end[level] = np.where((points >= 0) & (points <= shape), np.inf, -np.inf)[level]
    axis = begin.argmax(axis=1)
    rays = np.arange(len(axis))
    begin = begin[rays, axis]
    outside = begin >= -_BORDER
    hit = np.maximum(begin, 0) < end.min(axis=1)

    points += np.maximum(begin, 0)[:, None] * directions
    side = ~forward[rays, axis]
    points[rays[outside], axis[outside]] = (side * shape[axis])[outside]
    cells = np.clip(np.floor(points), 0, shape - 1)
    places = np.clip(points - cells, 0, 1)
    places = np.where(forward, places, 1 - places)
    cells = cells.astype(np.int64)
    starts = (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]
    faces = np.where(outside, 2 * axis + side, -1)
    return places[hit], hit, starts[hit], faces[hit]


def _toward(sun):
    return np.divide(sun.direction, np.linalg.norm(sun.direction))


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


class NumpyMarch:
    """Rays through voxels in float64, the twin of kernels/direct.cl: see there."""

    def __init__(self, voxels):
        self.voxels, self.shape = voxels, voxels.depth.shape
        self.tallies = np.zeros((_TALLIES, voxels.depth.size))
        self.reflected = None
        if voxels.occlusion is not None:
            self.reflected = np.zeros((1, voxels.depth.size))
        self.sums = np.zeros(STOPPED + 1)

    def read(self):
        """(tallies, reflected, sums), in weights: as in kernels/direct.cl, by kind and voxel.

        reflected is None without opaque voxels.
        """
        reflected = None if self.reflected is None else self.reflected.reshape(self.shape)
        return self.tallies.reshape(-1, *self.shape), reflected, self.sums

    def march(self, places, directions, weights, starts, faces):
        """Send rays.

        places, starts, faces  (n, 3), (n,) and (n,) as `enter` returns them
        directions             (n, 3) unit vectors
        weights                (n,) from 0 to 1
        """
        weights = weights - self._stop_at_border(weights, starts, faces)
        ahead = np.stack(np.unravel_index(starts, self.shape), axis=1)
        ahead = np.where(directions < 0, ahead, np.array(self.shape) - 1 - ahead)
        rays = (places, directions, weights, starts, ahead)
        while len(rays[0]):
            rays = self._cross(*rays)

    def _stop_at_border(self, weights, starts, faces):
        """What of light from outside the first voxels stop; what they reflect leaves again."""
        if self.reflected is None:
            return 0.0
        stopped = np.where(faces >= 0, weights * self.voxels.occlusion.flat[starts], 0)
        back = np.where(faces >= 0, weights * self.voxels.reflecting.flat[starts], 0)
        self.sums[:STOPPED] += np.bincount(np.maximum(faces, 0), back, STOPPED)
        self.sums[STOPPED] += (stopped - back).sum()
        return stopped

    def _cross(self, places, directions, weights, at, ahead):
        """Take rays through a voxel each; those that are still in the domain."""
        speed = np.maximum(np.abs(directions), _SLOWEST)
        ways = (1 - places) / speed
        axis = ways.argmin(axis=1)
        rays = np.arange(len(axis))
        way = ways[rays, axis]
        weights = self._score(places, directions, weights, at, way)

        places = np.minimum(places + way[:, None] * speed, 1)
        places[rays, axis] = 1
        ahead = ahead.copy()
        ahead[rays, axis] -= 1
        sign = np.where(directions < 0, -1, 1)[rays, axis]
        leaving = ahead[rays, axis] < 0
        through = 2 * axis + (sign > 0)
        self.sums[:STOPPED] += np.bincount(through[leaving], weights[leaving], STOPPED)

        on = ~leaving
        strides = np.array((self.shape[1] * self.shape[2], self.shape[2], 1))
        following = at + sign * strides[axis]
        if self.reflected is not None:
            stopped = self._stop(weights[on], at[on], following[on])
            weights = weights.copy()
            weights[on] -= stopped
        places[rays, axis] = 0
        return tuple(v[on] for v in (places, directions, weights, following, ahead))

    def _score(self, places, directions, weights, at, way):
        """Tally the rays' ways through their voxels; their weights after it."""
        edge = self.voxels.depth.flat[at]
        depth = edge * way
        through, mean, _, place = fade(depth)
        total = weights * np.where(edge > 1, 1 - through, way * mean)
        along = total * way * place
        sign = np.where(directions < 0, -1, 1)
        position = sign * (total[:, None] * (places - 0.5)) + along[:, None] * directions
        self._add(self.tallies, _SCORE, at, total)
        for n in range(3):
            self._add(self.tallies, _POSITION.start + n, at, position[:, n])
            self._add(self.tallies, _DIRECTION.start + n, at, total * directions[:, n])
        return weights * through

    def _stop(self, weights, at, following):
        """What the next voxels stop, (n,), after what they reflect is tallied."""
        stopped = weights * self.voxels.occlusion.flat[following]
        back = weights * self.voxels.reflecting.flat[following]
        self._add(self.reflected, _SCORE, at, back)
        self.sums[STOPPED] += (stopped - back).sum()
        return stopped

    def _add(self, tallies, kind, at, scores):
        tallies[kind] += np.bincount(at, scores, tallies.shape[1])
