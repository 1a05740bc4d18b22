# SPDX-License-Identifier: GPL-3.0-or-later
"""Parallel light through voxels, layer by layer: the unscattered light of suns, skies and glow.

Rays start at the same places above each column of voxels, layers lie across the axis that they
follow most, and all rays of one number cross the voxels of a layer alike. So a voxel can look up
the rays that cross it, and nothing is added to it from elsewhere. What is tallied of each is what
`march.NumpyMarch` tallies of a ray on its own, and `kernels/uncollided/sweep.cl` does the same.

Grids are turned: axes w, u and v, of which w is the one that rays follow most.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np

from ..box import Box
from ..monitor import UNHEARD
from .attenuation import fade, own_place

NONE, U, V, U_THEN_V, V_THEN_U = range(5)
# To the next voxel along u and v, one behind the other.
_TURNS = ((), ((1, 0),), ((0, 1),), ((1, 0), (0, 1)), ((0, 1), (1, 0)))
STOPPED = 6  # behind what came back through the faces -w, +w, -u, +u, -v, +v


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


class Turn:
    """A domain of `shape` voxels, (nx, ny, nz), as light that follows an axis most finds it.

    box  a `Box` that holds all that light meets, and all that shines
    """

    def __init__(self, axis, shape, box):
        self.axis = axis
        self.order = [axis, *(other for other in range(3) if other != axis)]
        self.shape = tuple(shape[n] for n in self.order)
        self.lower, self.upper = (
            tuple(ends[n] for n in self.order) for ends in (box.lower, box.upper)
        )
        self.inside = tuple(map(slice, self.lower, self.upper))

    def turned(self, grid):
        """(nw, nu, nv) of a grid (nx, ny, nz), a view."""
        return grid.transpose(self.order)

    def back(self, grid):
        """The other way round."""
        return grid.transpose(np.argsort(self.order))

    def by_face(self, sums):
        """(6,) by the faces -x, +x, -y, +y, -z, +z, of those by -w, +w, -u, +u, -v, +v."""
        return np.reshape(sums, (3, 2))[np.argsort(self.order)].ravel()

    @property
    def box_shape(self):
        return tuple(np.subtract(self.upper, self.lower).tolist())


class Beam:
    """Parallel rays through a turned domain.

    direction  (3,) unit vector, along x, y and z
    share      of the weight of a ray, from 0 to 1
    turn       a `Turn` for its longest component
    within     (2, count), where rays are above each column of voxels, from 0 to 1
    """

    def __init__(self, direction, share, turn, within):
        self.turn, self.share, self.points = turn, share, within.T
        self.direction = np.asarray(direction)[turn.order]
        self.dw, self.du, self.dv = np.abs(self.direction)
        self.nw, self.nu, self.nv = turn.shape
        self.backward = self.direction < 0
        self.slopes = np.array((self.du, self.dv)) / self.dw
        # The box [(first, end)] along w, u and v, as light comes to it.
        self.box = [
            (n - end, n - begin) if backward else (begin, end)
            for n, begin, end, backward in zip(
                turn.shape, turn.lower, turn.upper, self.backward, strict=True
            )
        ]
        self.beside = ceil(self.nw * self.slopes.max()) + 2

    def flipped(self, grid):
        """A view of a turned grid, as light comes to it."""
        return np.flip(grid, np.flatnonzero(self.backward))

    def shaded(self, layer):
        """[(first, end)] of columns along u and v where rays that have been in the box may be in
        a layer; elsewhere nothing has met them."""
        (begin, end), *sides = self.box
        if layer < begin:
            return [(0, 0)] * 2
        within, behind = layer + 1 - begin, max(0, layer - end)
        return [
            (min(int(n), first + int(behind * slope)), min(int(n), last + ceil(within * slope)))
            for (first, last), slope, n in zip(sides, self.slopes, (self.nu, self.nv), strict=True)
        ]

    def shade(self):
        """The `Box` of all columns that `shaded` names, in any layer."""
        turn, (begin, _), *sides = self.turn, *self.box
        ends = [(begin, self.nw)]
        for (first, last), slope, n in zip(sides, self.slopes, (self.nu, self.nv), strict=True):
            ends.append((first, min(n, last + ceil((self.nw - begin) * slope))))
        for axis, backward in enumerate(self.backward):
            if backward:
                n, (first, last) = turn.shape[axis], ends[axis]
                ends[axis] = (n - last, n - first)
        lower, upper = zip(*(ends[n] for n in np.argsort(turn.order)), strict=True)
        return Box(lower, upper, tuple(turn.shape[n] for n in np.argsort(turn.order)))

    def unmet(self):
        """The score of a voxel that rays cross before anything has met them."""
        return np.float32(len(self.points) / self.dw)

    def ways(self):
        """(nw, count, 8): the ways of rays through each layer, as kernels/uncollided/sweep.cl has
        them."""
        place = self.points + np.arange(self.nw)[:, None, None] * self.slopes
        columns = np.floor(place)
        place = place - columns
        with np.errstate(divide="ignore"):
            crossing = np.minimum((1 - place) / self.slopes, 1)  # of the way through the layer
        first, last = crossing.min(axis=-1), crossing.max(axis=-1)
        u_first = crossing[..., 0] <= crossing[..., 1]
        order = np.where(last < 1, np.where(u_first, U_THEN_V, V_THEN_U), np.where(u_first, U, V))
        order = np.where(first < 1, order, NONE)
        lengths = np.stack([first, last - first, 1 - last], axis=-1) / self.dw
        return np.concatenate([columns, place, lengths, order[..., None]], axis=-1)

    def leaving(self, rays, beside):
        """((6,) sums of what is left of rays by the face that they leave through, -w, +w, -u, +u,
        -v, +v; how many rays cross the domain). The rays are those of `run`."""
        cells = [np.arange(n + beside) - beside for n in (self.nu, self.nv)]
        u, v = (
            cell[None] + point[:, None] for cell, point in zip(cells, self.points.T, strict=True)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            enters = [np.where(p < 0, -p / s, 0) for p, s in zip((u, v), self.slopes, strict=True)]
            leaves = [
                (n - p) / s if s else np.full_like(p, np.inf)
                for n, p, s in zip((self.nu, self.nv), (u, v), self.slopes, strict=True)
            ]
        leaves_u, leaves_v = leaves[0][:, :, None], leaves[1][:, None, :]
        last = np.minimum(np.minimum(leaves_u, leaves_v), self.nw)
        crosses = np.maximum(enters[0][:, :, None], enters[1][:, None, :]) < last
        left = np.zeros(6)
        remaining = np.where(crosses, rays, 0)
        by_w = last == self.nw
        by_u = ~by_w & (leaves_u <= leaves_v)
        outs = (by_w, by_u, ~by_w & ~by_u)
        for axis, (backward, out) in enumerate(zip(self.backward, outs, strict=True)):
            left[2 * axis + (not backward)] += remaining[out].sum(dtype=float)
        return left, int(crosses.sum())


@dataclass(frozen=True)
class Tallies:
    """What rays scored, in weights, by turned voxel; of the box is what only matter has.

    score      (nw, nu, nv)
    toward     (3, nw, nu, nv), score times the direction along w, u and v; None where not asked for
    position   (3, of the box), score times the place from the voxel's centre
    reflected  (of the box), what opaque voxels send back into each; None without these
    sums       (7,), what those reflect out of the domain by face, and at STOPPED what they keep
    """

    score: np.ndarray
    toward: np.ndarray | None
    position: np.ndarray
    reflected: np.ndarray | None
    sums: np.ndarray


class NumpySweep:
    """Beams through voxels in float64, the twin of kernels/uncollided/sweep.cl.

    voxels    `Voxels` of the box of a `Turn`, turned
    directed  whether the beams have different directions, which must be tallied then
    """

    def __init__(self, turn, voxels, directed):
        self.turn, self.voxels = turn, voxels
        self.score = np.zeros(turn.shape)
        self.toward = np.zeros((3, *turn.shape)) if directed else None
        self.position = np.zeros((3, *turn.box_shape))
        self.reflected = None if voxels.occlusion is None else np.zeros(turn.box_shape)
        self.sums = np.zeros(STOPPED + 1)

    def read(self):
        """The `Tallies` of all beams."""
        return Tallies(self.score, self.toward, self.position, self.reflected, self.sums)

    def run(self, beams, monitor=UNHEARD):
        """Send beams that come from the same side.

        Returns ((beams, count, nu + beside, nv + beside) the weights that their rays are left
        with, by number and column; beside: columns begin so many before the domain, for rays that
        enter through its sides).
        """
        beside = max(beam.beside for beam in beams)
        rays = [self._sent(beam, beside, monitor) for beam in beams]
        return np.array(rays), beside

    def _sent(self, beam, beside, monitor):
        """Send a beam; its rays as of `run`."""
        shape = (len(beam.points), beam.nu + beside, beam.nv + beside)
        rays = np.zeros(shape) if self.voxels.glow is not None else np.ones(shape)
        way_of = _Way(beam, self.voxels, self.turn)
        for layer, ways in enumerate(beam.ways()):
            monitor.check()
            for number, way in enumerate(ways):
                way_of.cross(rays[number], layer, way, beside)
        self._take(beam, way_of)
        return rays

    def _take(self, beam, way):
        share, inside = beam.share, self.turn.inside
        score, *position, reflected = (beam.flipped(g[:, 1:-1, 1:-1]) for g in way.tallies)
        self.score += share * score
        for n, backward in enumerate(beam.backward):
            sign = -share if backward else share
            self.position[n] += sign * position[n][inside]
            if self.toward is not None:
                self.toward[n] += share * beam.direction[n] * score
        if self.reflected is not None:
            self.reflected += share * reflected[inside]
        faces = 2 * np.arange(3) + beam.backward  # that rays come in through
        self.sums[faces] += share * way.back
        self.sums[STOPPED] += share * way.stopped


class NumpyGlow:
    """Beams that gather a light of their own, in float64, the twin of kernels/uncollided/sweep.cl.

    turn   a `Turn`
    depth  optical depth of a voxel's edge, of its box, turned
    """

    def __init__(self, turn, depth):
        self.turn, self.depth = turn, depth

    def run(self, beams, glows, monitor=UNHEARD):
        """Send beams that come from the same side through what shines: glows, one of the box for
        each, turned, in radiance a voxel's edge.

        Returns (beams, nw, nu, nv), turned: what their rays score, of a share of 1.
        """
        found = np.zeros((len(beams), *self.turn.shape))
        for score, beam, glow in zip(found, beams, glows, strict=True):
            sweep = NumpySweep(self.turn, Voxels(self.depth, glow, None, None), directed=False)
            sweep.run([beam], monitor)
            score[...] = sweep.score
        return found


class _Way:
    """A beam on its way, with all grids as it finds them and a border around each layer.

    tallies  score, score times the place from the voxel's centre along w, u and v, reflected light
    back     (3,) what opaque voxels reflect out of the domain, through the sides that rays enter by
    stopped  what those keep
    """

    def __init__(self, beam, voxels, turn):
        self.beam, self.back, self.stopped = beam, np.zeros(3), 0.0
        self.tallies = np.zeros((5, beam.nw, beam.nu + 2, beam.nv + 2))
        self.depth, self.glow, self.occlusion, self.reflecting = (
            None if grid is None else self._bordered(grid, turn) for grid in voxels.grids
        )

    def _bordered(self, grid, turn):
        whole = np.zeros((self.beam.nw + 1, self.beam.nu + 2, self.beam.nv + 2))  # nothing behind
        self.beam.flipped(whole[:-1, 1:-1, 1:-1])[turn.inside] = grid
        return whole

    def cross(self, rays, layer, way, beside):
        """Take the rays of a number, (nu + beside, nv + beside), through a layer."""
        beam, columns = self.beam, way[:2].astype(int)
        begin = beside - 1 - columns
        there = tuple(slice(a, a + n + 1) for a, n in zip(begin, (beam.nu, beam.nv), strict=True))
        place, voxel = np.append(way[2:4], 0.0), np.zeros(2, int)
        step = np.array((beam.du, beam.dv, beam.dw))
        entry = 0 if layer == 0 else None  # the axis that rays have come along, into the domain
        for length, turn in zip(way[4:7], (*_TURNS[int(way[7])], None), strict=False):
            at = (layer, *self._columns(voxel))
            following = (
                (layer + 1, *at[1:]) if turn is None else (layer, *self._columns(voxel + turn))
            )
            weights = self._enter(rays[there], at, entry)
            rays[there] = self._score(weights, at, length, place, step)
            if self.reflecting is not None:
                self.tallies[(4, *at)] += rays[there] * self.reflecting[following]
            if turn is None:
                return
            place = place + length * step
            place[:2][np.array(turn) > 0] = 0
            voxel += turn
            entry = 1 + int(np.argmax(turn))

    def _columns(self, voxel):
        ends = zip(voxel, (self.beam.nu, self.beam.nv), strict=True)
        return tuple(slice(a, a + n + 1) for a, n in ends)

    def _enter(self, weights, at, entry):
        """What is left of rays that come into voxels; entry is the axis that they come along."""
        if self.occlusion is None:
            return weights
        occlusion, back = self.occlusion[at], weights * self.reflecting[at]
        self.stopped += float((weights * occlusion - back).sum())
        if entry == 0:
            self.back[0] += back.sum()
        elif entry is not None:  # through a side: into the first row behind the border
            first = [slice(None)] * 2
            first[entry - 1] = 1 - at[entry].start
            self.back[entry] += back[tuple(first)].sum()
        return weights * (1 - occlusion)

    def _score(self, weights, at, length, place, step):
        """Tally the way in the voxels; the weights behind it."""
        edge = self.depth[at]
        depth = edge * length
        through, mean, lost, on = fade(depth)
        total = weights * np.where(edge > 1, 1 - through, length * mean)
        along = total * length * on
        weights = weights * through
        if self.glow is not None:
            fresh = self.glow[at] * length
            own = fresh * np.where(edge > 1, 1 - mean, length * lost)
            total = total + own
            along = along + own * length * own_place(depth, mean, on)
            weights = weights + fresh * mean
        self.tallies[(0, *at)] += total
        for kind, axis in ((1, 2), (2, 0), (3, 1)):  # along w, u, v
            self.tallies[(kind, *at)] += total * (place[axis] - 0.5) + along * step[axis]
        return weights
