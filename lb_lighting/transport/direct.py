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
from .fade import fade, own_place
from .lights import Emission, Sky, Sun, rank_1, shift_of
from .sweep import Beam, NumpySweep

# What a voxel's tallies and the sums of all rays count, as in kernels/direct.cl.
_SCORE, _POSITION, _DIRECTION, _TALLIES = 0, slice(1, 4), slice(4, 7), 7
_STOPPED, _EMITTED = 6, 7

_AT_ONCE = 2**18  # rays, at least, that a device is given where there are more
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
    flux       (3, nx, ny, nz) W/m^2, its net flux
    collided   `Moments` of its first collisions, before any albedo; with the directions before;
               of voxels in the box that was asked for, like the next
    reflected  (nx, ny, nz) W, what opaque matter reflects, by the voxel that it goes back into;
               None without opaque voxels
    left       (6,) W, through the faces -x, +x, -y, +y, -z, +z
    stopped    W, what opaque matter absorbs
    entered    W, all of it: what collided, was reflected, left or was stopped
    """

    direct: np.ndarray
    flux: np.ndarray
    collided: Moments
    reflected: np.ndarray | None
    left: np.ndarray
    stopped: float
    entered: float


@dataclass(frozen=True)
class _Voxels:
    """What rays meet: each (nx, ny, nz), or None.

    depth       optical depth of a voxel's edge
    occlusion   share of arriving light that is stopped
    reflecting  share of arriving light that is reflected
    glow        emission, from 0 to 1
    """

    depth: np.ndarray
    occlusion: np.ndarray | None
    reflecting: np.ndarray | None
    glow: np.ndarray | None


@dataclass(frozen=True)
class _Scores:
    """What rays scored, in weights.

    score      (nx, ny, nz)
    position   (3, of the box)
    direction  (3, nx, ny, nz), or (3,) the unit vector where all rays have one
    reflected  (nx, ny, nz), or None without opaque voxels
    sums       as in kernels/direct.cl
    """

    score: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    reflected: np.ndarray | None
    sums: np.ndarray


def cast(medium, light, band, sigma_t, device=None, per_edge=10, cancel=None, box=None):
    """Send the unscattered light of one light and band through a medium.

    medium    a `Medium`
    light     one of `lights.py`, or anything with their `spectrum` and `emit`
    sigma_t   extinction at density 1 to reckon with, 1/m
    device    None for the best, a `Device`, or part of the label of one of `device.devices()`
    per_edge  rays along a voxel's edge: see `rays` of each light
    cancel    called without arguments; the cast ends with `Cancelled` where it returns true
    box       a `Box` that holds all matter; None for the whole domain
    Returns a `Cast`, on a device always the same. Raises LightError or DeviceError.
    """
    device, box = devices.choose(device), box or Box.all(medium.shape)
    if isinstance(light, (Sun, Sky)) and medium.occlusion is None:
        return _swept(medium, box, light, band, sigma_t, device, per_edge, cancel)
    emission = light.spectrum[band] if isinstance(light, Emission) else None
    voxels = _voxels(medium, band, sigma_t, emission)
    march = _march(device, voxels, directed=not isinstance(light, Sun))
    strongest, pieces = _rays(light, medium, band, per_edge)
    # W of a ray of weight 1, the largest that there is. Rays that gather light have at most that
    # of all the voxels that they can cross.
    brightest = 1.0 if emission is None else float(emission.max()) * medium.voxel_size
    unit = strongest * brightest * (1 if emission is None else sum(medium.shape))
    entered = 0.0
    for origins, directions, power in _gathered(pieces) if unit > 0 else ():
        if cancel is not None and cancel():
            raise Cancelled("Cancelled; nothing was changed.")
        places, hit, starts, faces = enter(medium.domain, origins, directions)
        power = power[hit]
        if not power.size:
            continue
        entered += float(power.sum())
        march.march(places, directions[hit], power * (brightest / unit), starts, faces)
    tallies, reflected, sums = march.read()
    toward = _toward(light) if isinstance(light, Sun) else tallies[_DIRECTION]
    scores = _Scores(tallies[_SCORE], box.of(tallies[_POSITION]), toward, reflected, sums)
    if emission is not None and unit > 0:
        # What rays gathered is a little off the whole, which is known.
        entered = float(emission.sum(dtype=float)) * medium.voxel_size**3
        unit = entered / sums[_EMITTED]
    found = _cast(medium, box, sigma_t, unit, scores, entered)
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
    """The `Cast` of a sun or a sky where nothing is opaque: of each of its suns, by layers."""
    directions, irradiances, of_each = light.suns(medium, band, per_edge)
    lattice, depth = rank_1(of_each**2), box.spread(medium.depth(sigma_t, box))
    strongest = float(irradiances.max(initial=0)) * medium.voxel_size**2 / lattice.shape[1]
    alone = len(directions) == 1
    score = np.zeros(medium.shape, np.float32)
    position = np.zeros((3, *box.shape), np.float32)
    toward = directions[0] if alone else np.zeros((3, *medium.shape), np.float32)
    left, entered = np.zeros(_EMITTED + 1), 0.0
    for number, direction in enumerate(directions if strongest > 0 else ()):
        beam = Beam(direction, medium.shape, (lattice + shift_of(number)) % 1, box)
        share = np.float32(irradiances[number] / irradiances.max() * beam.dw)
        found, places, rays = _sweep(device, beam, depth).run(cancel)
        through, count = beam.leaving(rays)
        left[:_STOPPED] += share * through
        entered += strongest * float(share) * count  # which may be too small for float32
        found *= share
        score += beam.back(found)
        u, v, w = (beam.back(place) * share for place in places)
        for place, axis, backward in zip((w, u, v), beam.order, beam.backward, strict=True):
            position[axis] += -place if backward else place
        if not alone:
            for part, component in zip(toward, direction, strict=True):
                part += np.float32(component) * beam.back(found)
    return _cast(
        medium, box, sigma_t, strongest, _Scores(score, position, toward, None, left), entered
    )


def _sweep(device, beam, depth):
    if device.kind == "NumPy":
        return NumpySweep(beam, depth)
    from .direct_opencl import OpenclSweep  # only now: it needs pyopencl

    return OpenclSweep(device, beam, depth)


def _voxels(medium, band, sigma_t, emission):
    occlusion = reflecting = glow = None
    if medium.occlusion is not None:
        occlusion = medium.occlusion
        reflecting = occlusion * medium.occlusion_albedo[band]
    if emission is not None:
        glow = emission / max(float(emission.max()), np.finfo(np.float32).tiny)
    return _Voxels(medium.depth(sigma_t), occlusion, reflecting, glow)


def _march(device, voxels, directed):
    if device.kind == "NumPy":
        return NumpyMarch(voxels, directed)
    from .direct_opencl import OpenclMarch  # only now: it needs pyopencl

    return OpenclMarch(device, voxels, directed)


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
    if scores.direction.ndim == 1:
        toward = scores.direction.reshape(3, 1, 1, 1)
        flowing, along = _product(toward, direct), _product(toward, colliding * score)
    else:
        flowing = _product(unit / h**2, scores.direction)
        box.of(flowing)[...] /= np.maximum(1, depth)
        along = _product(colliding, box.of(scores.direction))
    place = _product(colliding * h, scores.position)
    collided = Moments(_product(colliding, score), place, along)
    reflected, sums = scores.reflected, scores.sums
    if reflected is not None:
        reflected = (unit * box.of(reflected).astype(float)).astype(np.float32)
    left, stopped = unit * sums[:_STOPPED], float(unit * sums[_STOPPED])
    return Cast(direct, flowing, collided, reflected, left, stopped, entered)


def _softened(cast, box, softness):
    """Of a `Cast` of a point the share, (nx, ny, nz), that a lamp sends; the rest never was."""
    cast.direct *= softness
    cast.flux *= softness
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
    """Rays through voxels in float64, the twin of kernels/direct.cl: see there.

    directed  whether the rays have different directions, which must be tallied then
    """

    def __init__(self, voxels, directed):
        self.voxels, self.directed = voxels, directed
        self.shape = voxels.depth.shape
        self.tallies = np.zeros((_TALLIES if directed else _TALLIES - 3, voxels.depth.size))
        self.reflected = None
        if voxels.occlusion is not None:
            self.reflected = np.zeros((1, voxels.depth.size))
        self.sums = np.zeros(_EMITTED + 1)

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
        weights                (n,) from 0 to 1; with a glow, what a ray gathers in a voxel's edge
        """
        gathered = np.zeros_like(weights)
        if self.voxels.glow is not None:
            weights, gathered = gathered, weights
        weights = weights - self._stop_at_border(weights, starts, faces)
        ahead = np.stack(np.unravel_index(starts, self.shape), axis=1)
        ahead = np.where(directions < 0, ahead, np.array(self.shape) - 1 - ahead)
        rays = (places, directions, weights, gathered, starts, ahead)
        while len(rays[0]):
            rays = self._cross(*rays)

    def _stop_at_border(self, weights, starts, faces):
        """What of light from outside the first voxels stop; what they reflect leaves again."""
        if self.reflected is None:
            return 0.0
        stopped = np.where(faces >= 0, weights * self.voxels.occlusion.flat[starts], 0)
        back = np.where(faces >= 0, weights * self.voxels.reflecting.flat[starts], 0)
        self.sums[:_STOPPED] += np.bincount(np.maximum(faces, 0), back, _STOPPED)
        self.sums[_STOPPED] += (stopped - back).sum()
        return stopped

    def _cross(self, places, directions, weights, gathered, at, ahead):
        """Take rays through a voxel each; those that are still in the domain."""
        speed = np.maximum(np.abs(directions), _SLOWEST)
        ways = (1 - places) / speed
        axis = ways.argmin(axis=1)
        rays = np.arange(len(axis))
        way = ways[rays, axis]
        weights = self._score(places, directions, weights, gathered, at, way)

        places = np.minimum(places + way[:, None] * speed, 1)
        places[rays, axis] = 1
        ahead = ahead.copy()
        ahead[rays, axis] -= 1
        sign = np.where(directions < 0, -1, 1)[rays, axis]
        leaving = ahead[rays, axis] < 0
        through = 2 * axis + (sign > 0)
        self.sums[:_STOPPED] += np.bincount(through[leaving], weights[leaving], _STOPPED)

        on = ~leaving
        strides = np.array((self.shape[1] * self.shape[2], self.shape[2], 1))
        following = at + sign * strides[axis]
        if self.reflected is not None:
            stopped = self._stop(weights[on], at[on], following[on])
            weights = weights.copy()
            weights[on] -= stopped
        places[rays, axis] = 0
        return tuple(v[on] for v in (places, directions, weights, gathered, following, ahead))

    def _score(self, places, directions, weights, gathered, at, way):
        """Tally the rays' ways through their voxels; their weights after it."""
        edge = self.voxels.depth.flat[at]
        depth = edge * way
        through, mean, lost, place = fade(depth)
        total = weights * np.where(edge > 1, 1 - through, way * mean)
        along = total * way * place
        weights = weights * through
        if self.voxels.glow is not None:
            fresh = gathered * self.voxels.glow.flat[at] * way
            own = fresh * np.where(edge > 1, 1 - mean, way * lost)
            total = total + own
            along = along + own * way * own_place(depth, mean, place)
            weights = weights + fresh * mean
            self.sums[_EMITTED] += fresh.sum()
        sign = np.where(directions < 0, -1, 1)
        position = sign * (total[:, None] * (places - 0.5)) + along[:, None] * directions
        self._add(self.tallies, _SCORE, at, total)
        for n in range(3):
            self._add(self.tallies, _POSITION.start + n, at, position[:, n])
            if self.directed:
                self._add(self.tallies, _DIRECTION.start + n, at, total * directions[:, n])
        return weights

    def _stop(self, weights, at, following):
        """What the next voxels stop, (n,), after what they reflect is tallied."""
        stopped = weights * self.voxels.occlusion.flat[following]
        back = weights * self.voxels.reflecting.flat[following]
        self._add(self.reflected, _SCORE, at, back)
        self.sums[_STOPPED] += (stopped - back).sum()
        return stopped

    def _add(self, tallies, kind, at, scores):
        tallies[kind] += np.bincount(at, scores, tallies.shape[1])
