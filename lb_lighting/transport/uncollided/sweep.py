# SPDX-License-Identifier: GPL-3.0-or-later
"""Parallel beams through voxels, layer by layer: uncollided light of suns, skies and emission.

Rays start at the same places above each column of voxels, and layers lie across the axis closest
to the direction of the rays. All rays with the same number then cross the voxels of a layer in the
same way, so each voxel looks up the rays that cross it, and no two threads write to the same voxel.
The tallies of a ray are those of `march.NumpyMarch`; kernels/uncollided/sweep.cl is the twin.

Grids are transposed ("turned") to the axes w, u and v; w is the axis closest to the direction of
the rays.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from ...arrays import Floats, Integers, Vector
from ..box import Box
from ..monitor import NO_MONITOR, Monitor
from .attenuation import attenuate, source_collision_place

type Ends = tuple[int, int]
"""The first index along an axis, and the one after the last."""

NONE, U, V, U_THEN_V, V_THEN_U = range(5)
# For each order of crossings: the steps to the next voxels along u and v.
_TURNS: list[list[tuple[int, int]]] = [[], [(1, 0)], [(0, 1)], [(1, 0), (0, 1)], [(0, 1), (1, 0)]]
STOPPED = 6  # index in sums, after the faces -w, +w, -u, +u, -v, +v


@dataclass(frozen=True)
class Voxels:
    """The matter that rays meet: grids (nx, ny, nz), or None.

    depth       optical depth of a voxel's edge
    glow        emission, from 0 to 1
    occlusion   share of the arriving light that opaque matter stops
    reflecting  share of the arriving light that it reflects
    """

    depth: Floats
    glow: Floats | None
    occlusion: Floats | None
    reflecting: Floats | None

    @property
    def grids(self) -> tuple[Floats, Floats | None, Floats | None, Floats | None]:
        """All four."""
        return self.depth, self.glow, self.occlusion, self.reflecting

    def of(self, part: Callable[[Floats], Floats]) -> "Voxels":
        """`Voxels` with a function applied to each grid."""
        others = (None if grid is None else part(grid) for grid in self.grids[1:])
        return Voxels(part(self.depth), *others)


class Turn:
    """The axes w, u and v for light whose direction is closest to a given axis.

    axis   w: 0, 1 or 2
    shape  (nx, ny, nz) of the domain; the attribute is (nw, nu, nv)
    box    a `Box` that holds all matter and all emission
    """

    def __init__(self, axis: int, shape: tuple[int, ...], box: Box) -> None:
        self.axis = axis
        self.order = [axis, *(other for other in range(3) if other != axis)]
        self.shape: tuple[int, ...] = tuple(shape[n] for n in self.order)
        self.lower, self.upper = (
            tuple(ends[n] for n in self.order) for ends in (box.lower, box.upper)
        )
        self.inside = tuple(map(slice, self.lower, self.upper))

    def turned(self, grid: Floats) -> Floats:
        """(nw, nu, nv) of a grid (nx, ny, nz), a view."""
        return grid.transpose(self.order)

    def back(self, grid: Floats) -> Floats:
        """(nx, ny, nz) of a grid (nw, nu, nv), a view."""
        return grid.transpose(np.argsort(self.order))

    def by_face(self, sums: Floats) -> Floats:
        """(6,) by the faces -x, +x, -y, +y, -z, +z, of sums by -w, +w, -u, +u, -v, +v."""
        return np.reshape(sums, (3, 2))[np.argsort(self.order)].ravel()

    @property
    def box_shape(self) -> tuple[int, ...]:
        """(3,) voxels of the box along w, u and v."""
        return tuple(np.subtract(self.upper, self.lower).tolist())


class Beam:
    """Parallel rays through a turned domain.

    direction  (3,) unit vector, along x, y and z
    share      weight of its rays over that of the strongest beam's, from 0 to 1
    turn       a `Turn` for the longest component of the direction
    within     (2, count), places of the rays above each column of voxels, from 0 to 1
    """

    def __init__(self, direction: Vector, share: float, turn: Turn, within: Floats) -> None:
        self.turn, self.share, self.points = turn, share, within.T
        self.direction = np.asarray(direction)[turn.order]
        self.dw, self.du, self.dv = np.abs(self.direction)
        self.nw, self.nu, self.nv = turn.shape
        self.backward = self.direction < 0
        self.slopes = np.array((self.du, self.dv)) / self.dw
        # The `Ends` of the box along w, u and v, in the order in which light reaches the voxels.
        self.box: list[Ends] = [
            (n - end, n - begin) if backward else (begin, end)
            for n, begin, end, backward in zip(
                turn.shape, turn.lower, turn.upper, self.backward, strict=True
            )
        ]
        self.beside = ceil(self.nw * self.slopes.max()) + 2

    def flipped(self, grid: Floats) -> Floats:
        """A view of a turned grid in the order in which light reaches the voxels."""
        return np.flip(grid, tuple(np.flatnonzero(self.backward)))

    def shaded(self, layer: int) -> list[Ends]:
        """The columns of a layer, along u and v, that rays may reach after they have crossed the
        box; in all others, light is unattenuated."""
        (begin, end), *sides = self.box
        if layer < begin:
            return [(0, 0)] * 2
        within, behind = layer + 1 - begin, max(0, layer - end)
        return [
            (min(int(n), first + int(behind * slope)), min(int(n), last + ceil(within * slope)))
            for (first, last), slope, n in zip(sides, self.slopes, (self.nu, self.nv), strict=True)
        ]

    def shade(self) -> Box:
        """The `Box` of the columns of `shaded` in all layers."""
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

    def unattenuated(self) -> float:
        """The score of a voxel that unattenuated rays cross."""
        return float(len(self.points) / self.dw)

    def ways(self) -> Floats:
        """(nw, count, 8): the paths of the rays through each layer, in the format of `ways` in
        kernels/uncollided/sweep.cl."""
        place = self.points + np.arange(self.nw)[:, None, None] * self.slopes
        columns = np.floor(place)
        place = place - columns
        with np.errstate(divide="ignore"):
            crossing = np.minimum((1 - place) / self.slopes, 1)  # share of the layer
        first, last = crossing.min(axis=-1), crossing.max(axis=-1)
        u_first = crossing[..., 0] <= crossing[..., 1]
        order = np.where(last < 1, np.where(u_first, U_THEN_V, V_THEN_U), np.where(u_first, U, V))
        order = np.where(first < 1, order, NONE)
        lengths = np.stack([first, last - first, 1 - last], axis=-1) / self.dw
        return np.concatenate([columns, place, lengths, order[..., None]], axis=-1)

    def leaving(self, rays: Floats, beside: int) -> tuple[Floats, int]:
        """(6,), the weights with which rays leave, summed by the faces -w, +w, -u, +u, -v, +v; and
        the number of rays that cross the domain.

        rays, beside  as of `NumpySweep.run`
        """
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
    """Scores of rays, in weights, by turned voxel of the domain or of the box.

    score      (nw, nu, nv)
    toward     (3, nw, nu, nv), score times the direction along w, u and v; None if not tallied
    position   (3, of the box), score times the place relative to the voxel's centre
    reflected  (of the box), the light that opaque voxels reflect into each voxel; None without them
    sums       (7,), the light that opaque voxels reflect out of the domain by face, and at STOPPED
               the light that they absorb
    """

    score: Floats
    toward: Floats | None
    position: Floats
    reflected: Floats | None
    sums: Floats


class NumpySweep:
    """Beams through voxels in float64, the twin of kernels/uncollided/sweep.cl.

    voxels    `Voxels` of the box of a `Turn`, turned
    directed  whether the beams have different directions, which are then tallied
    """

    def __init__(self, turn: Turn, voxels: Voxels, directed: bool) -> None:
        self.turn, self.voxels = turn, voxels
        self.score = np.zeros(turn.shape)
        self.toward = np.zeros((3, *turn.shape)) if directed else None
        self.position = np.zeros((3, *turn.box_shape))
        self.reflected = None if voxels.occlusion is None else np.zeros(turn.box_shape)
        self.sums = np.zeros(STOPPED + 1)

    def read(self) -> Tallies:
        """The `Tallies` of all beams."""
        return Tallies(self.score, self.toward, self.position, self.reflected, self.sums)

    def run(self, beams: Sequence[Beam], monitor: Monitor = NO_MONITOR) -> tuple[Floats, int]:
        """Send beams that come from the same side.

        Returns (beams, count, nu + beside, nv + beside), the weights with which rays leave, by
        number and column; and beside, the number of columns before the domain, in which the rays
        start that enter through its sides.
        """
        beside = max(beam.beside for beam in beams)
        rays = [self._sent(beam, beside, monitor) for beam in beams]
        return np.array(rays), beside

    def _sent(self, beam: Beam, beside: int, monitor: Monitor) -> Floats:
        """Send a beam. Returns its rays, as of `run`."""
        shape = (len(beam.points), beam.nu + beside, beam.nv + beside)
        rays = np.zeros(shape) if self.voxels.glow is not None else np.ones(shape)
        crossing = _Crossing(beam, self.voxels, self.turn)
        for layer, ways in enumerate(beam.ways()):
            monitor.check()
            for number, way in enumerate(ways):
                crossing.cross(rays[number], layer, way, beside)
        self._add(beam, crossing)
        return rays

    def _add(self, beam: Beam, crossing: "_Crossing") -> None:
        """Add the tallies of a beam."""
        share, inside = beam.share, self.turn.inside
        score, *position, reflected = (beam.flipped(g[:, 1:-1, 1:-1]) for g in crossing.tallies)
        self.score += share * score
        for n, backward in enumerate(beam.backward):
            sign = -share if backward else share
            self.position[n] += sign * position[n][inside]
            if self.toward is not None:
                self.toward[n] += share * beam.direction[n] * score
        if self.reflected is not None:
            self.reflected += share * reflected[inside]
        entry_faces = 2 * np.arange(3) + beam.backward
        self.sums[entry_faces] += share * crossing.back
        self.sums[STOPPED] += share * crossing.stopped


class NumpyGlow:
    """Beams that each gain light from an emission of their own, in float64; the twin of
    kernels/uncollided/sweep.cl.

    turn   a `Turn`
    depth  optical depth of a voxel's edge, of its box, turned
    """

    def __init__(self, turn: Turn, depth: Floats) -> None:
        self.turn, self.depth = turn, depth

    def run(
        self, beams: Sequence[Beam], glows: Sequence[Floats], monitor: Monitor = NO_MONITOR
    ) -> Floats:
        """Send beams that come from the same side.

        glows  for each beam the emission in the box, turned, in radiance per voxel edge
        Returns (beams, nw, nu, nv), turned: the scores of the rays, for a share of 1.
        """
        scores = np.zeros((len(beams), *self.turn.shape))
        for score, beam, glow in zip(scores, beams, glows, strict=True):
            sweep = NumpySweep(self.turn, Voxels(self.depth, glow, None, None), directed=False)
            sweep.run([beam], monitor)
            score[...] = sweep.score
        return scores


class _Crossing:
    """A beam on its way through the domain; grids are flipped, with a border around each layer.

    tallies  score; score times the place relative to the voxel's centre along w, u and v; reflected
             light
    back     (3,), the light that opaque voxels reflect out of the domain, by the sides of entry
    stopped  the light that opaque voxels absorb
    """

    def __init__(self, beam: Beam, voxels: Voxels, turn: Turn) -> None:
        self.beam, self.back, self.stopped = beam, np.zeros(3), 0.0
        self.tallies = np.zeros((5, beam.nw, beam.nu + 2, beam.nv + 2))
        bordered = voxels.of(lambda grid: self._bordered(grid, turn))
        self.depth, self.glow, self.occlusion, self.reflecting = bordered.grids

    def _bordered(self, grid: Floats, turn: Turn) -> Floats:
        """A grid of the box in the domain, with an empty border and an empty layer behind."""
        domain = np.zeros((self.beam.nw + 1, self.beam.nu + 2, self.beam.nv + 2))
        self.beam.flipped(domain[:-1, 1:-1, 1:-1])[turn.inside] = grid
        return domain

    def cross(self, rays: Floats, layer: int, way: Floats, beside: int) -> None:
        """Take the rays of one number, (nu + beside, nv + beside), through a layer."""
        beam, columns = self.beam, way[:2].astype(int)
        begin = beside - 1 - columns
        window = tuple(slice(a, a + n + 1) for a, n in zip(begin, (beam.nu, beam.nv), strict=True))
        place, voxel = np.append(way[2:4], 0.0), np.zeros(2, int)
        step = np.array((beam.du, beam.dv, beam.dw))
        entry = 0 if layer == 0 else None  # the axis along which rays enter the domain
        for length, turn in zip(way[4:7], (*_TURNS[int(way[7])], None), strict=False):
            at = (layer, *self._columns(voxel))
            following = layer + 1, *at[1:]
            if turn is not None:
                following = layer, *self._columns(np.add(voxel, turn))
            weights = self._enter(rays[window], at, entry)
            rays[window] = self._score(weights, at, length, place, step)
            if self.reflecting is not None:
                self.tallies[(4, *at)] += rays[window] * self.reflecting[following]
            if turn is None:
                return
            place = place + length * step
            place[:2][np.array(turn) > 0] = 0
            voxel += turn
            entry = 1 + int(np.argmax(turn))

    def _columns(self, voxel: Integers) -> tuple[slice, slice]:
        u, v = voxel
        return slice(u, u + self.beam.nu + 1), slice(v, v + self.beam.nv + 1)

    def _enter(self, weights: Floats, at: tuple[int, slice, slice], entry: int | None) -> Floats:
        """The weights of rays that pass the opaque matter of the voxels that they enter; entry is
        the axis along which they enter the domain, or None."""
        if self.occlusion is None or self.reflecting is None:
            return weights
        occlusion, back = self.occlusion[at], weights * self.reflecting[at]
        self.stopped += float((weights * occlusion - back).sum())
        if entry == 0:
            self.back[0] += back.sum()
        elif entry is not None:  # through a side: into the first row after the border
            first: list[slice | int] = [slice(None)] * 2
            first[entry - 1] = 1 - (at[1], at[2])[entry - 1].start
            self.back[entry] += back[tuple(first)].sum()
        weights = weights * (1 - occlusion)
        return weights

    def _score(
        self,
        weights: Floats,
        at: tuple[int, slice, slice],
        length: float,
        place: Floats,
        step: Floats,
    ) -> Floats:
        """Tally the paths in voxels. Returns the weights behind them."""
        edge = self.depth[at]
        depth = edge * length
        transmittance, mean, source_score, collision_place = attenuate(depth)
        total = weights * np.where(edge > 1, 1 - transmittance, length * mean)
        along = total * length * collision_place
        weights = weights * transmittance
        if self.glow is not None:
            emitted = self.glow[at] * length
            score = emitted * np.where(edge > 1, 1 - mean, length * source_score)
            total = total + score
            along = along + score * length * source_collision_place(depth, mean, collision_place)
            weights = weights + emitted * mean
        self.tallies[(0, *at)] += total
        for kind, axis in ((1, 2), (2, 0), (3, 1)):  # along w, u, v
            self.tallies[(kind, *at)] += total * (place[axis] - 0.5) + along * step[axis]
        return weights
