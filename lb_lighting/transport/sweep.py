# SPDX-License-Identifier: GPL-3.0-or-later
"""Parallel light through voxels, layer by layer: the unscattered light of a sun.

Rays start at the same places above each column of voxels, layers lie across the axis that they
follow most, and all rays of one number cross the voxels of a layer alike. So a voxel can look up
the rays that cross it, and nothing is added to it from elsewhere. What is tallied of each is what
`direct.NumpyMarch` tallies of a ray on its own, and `kernels/sweep.cl` does the same.
"""

from math import ceil

import numpy as np

from ..errors import Cancelled
from .crop import Box
from .fade import fade

NONE, U, V, U_THEN_V, V_THEN_U = range(5)
# To the next voxel along u and v, one behind the other.
_TURNS = ((), ((1, 0),), ((0, 1),), ((1, 0), (0, 1)), ((0, 1), (1, 0)))


class Beam:
    """Parallel rays through a domain.

    direction  (3,) of any length
    shape      voxels (nx, ny, nz)
    within     (2, count), where rays are above each column of voxels, from 0 to 1
    box        a `Box` that holds all matter; None for the whole domain
    """

    def __init__(self, direction, shape, within, box=None):
        direction = np.divide(direction, np.linalg.norm(direction))
        self.along = int(np.argmax(np.abs(direction)))
        self.order = [self.along, *(axis for axis in range(3) if axis != self.along)]
        self.backward = [direction[axis] < 0 for axis in self.order]
        self.dw, self.du, self.dv = np.abs(direction[self.order])
        self.nw, self.nu, self.nv = np.array(shape)[self.order]
        self.slopes = np.array((self.du, self.dv)) / self.dw
        self.points = within.T
        self.box = self._turned_box(box or Box.all(shape))
        self.beside = int(np.ceil(self.nw * self.slopes.max())) + 2

    def turned(self, grid):
        """(nw, nu, nv) of a grid (nx, ny, nz), as light comes to it."""
        return np.flip(grid.transpose(self.order), self._flipped())

    def back(self, grid):
        """The other way round."""
        return np.flip(grid, self._flipped()).transpose(np.argsort(self.order))

    def _turned_box(self, box):
        """[(first, end)] along w, u and v, as light comes to it."""
        ends = zip(self.order, self.backward, strict=True)
        return [
            (box.whole[n] - box.upper[n], box.whole[n] - box.lower[n])
            if backward
            else (box.lower[n], box.upper[n])
            for n, backward in ends
        ]

    def inside(self, grid):
        """(..., of the box) of a grid (..., nw, nu, nv), a view."""
        return grid[..., *(slice(*ends) for ends in self.box)]

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

    def unmet(self):
        """The score of a voxel that rays cross before anything has met them."""
        return np.float32(len(self.points) / self.dw)

    def _flipped(self):
        return [n for n, backward in enumerate(self.backward) if backward]

    def rays(self):
        """(count, nu + beside, nv + beside): 1 for each ray, by number and column; columns begin
        `beside` before the domain, for rays that enter through its sides."""
        return np.ones((len(self.points), self.nu + self.beside, self.nv + self.beside))

    def ways(self):
        """(nw, count, 8): the ways of rays through each layer, as kernels/sweep.cl has them."""
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

    def leaving(self, rays):
        """((6,) sums of what is left of rays by the face that they leave through, -x, +x, -y, +y,
        -z, +z; how many rays cross the domain)."""
        cells = [np.arange(n + self.beside) - self.beside for n in (self.nu, self.nv)]
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
        for axis, backward, out in zip(
            self.order, self.backward, (by_w, by_u, ~by_w & ~by_u), strict=True
        ):
            left[2 * axis + (not backward)] += remaining[out].sum(dtype=float)
        return left, int(crosses.sum())


class NumpySweep:
    """A `Beam` through voxels in float64, the twin of kernels/sweep.cl."""

    def __init__(self, beam, depth):
        self.beam, self.depth = beam, beam.turned(np.asarray(depth, float))

    def run(self, cancel=None):
        """(score (nw, nu, nv); its place along u, v and w, (3, of the box); what is left)."""
        beam, rays = self.beam, self.beam.rays()
        tallies = np.zeros((4, beam.nw, beam.nu + 2, beam.nv + 2))  # a border around each layer
        for layer, ways in enumerate(beam.ways()):
            if cancel is not None and cancel():
                raise Cancelled("Cancelled; nothing was changed.")
            depth = np.pad(self.depth[layer], 1)
            for number, way in enumerate(ways):
                self._cross(rays[number], way, depth, tallies[:, layer])
        tallies = tallies[:, :, 1:-1, 1:-1]
        return tallies[0], beam.inside(tallies[1:]), rays

    def _cross(self, rays, way, depth, tallies):
        """Take the rays of a number through a layer."""
        beam, columns = self.beam, way[:2].astype(int)
        begin = beam.beside - 1 - columns
        there = tuple(slice(a, a + n + 1) for a, n in zip(begin, (beam.nu, beam.nv), strict=True))
        place, voxel = np.append(way[2:4], 0.0), np.zeros(2, int)
        step = np.array((beam.du, beam.dv, beam.dw))
        for length, turn in zip(way[4:7], (*_TURNS[int(way[7])], None), strict=False):
            at = tuple(slice(a, a + n + 1) for a, n in zip(voxel, (beam.nu, beam.nv), strict=True))
            rays[there] *= self._score(
                rays[there], depth[at], length, place, step, tallies[(slice(None), *at)]
            )
            if turn is None:
                return
            place = place + length * step
            place[:2][np.array(turn) > 0] = 0
            voxel += turn

    def _score(self, weights, depth, length, place, step, tallies):
        """Tally the way in the voxels; the share of light behind it."""
        through, mean, _, on = fade(depth * length)
        score = weights * np.where(depth > 1, 1 - through, length * mean)
        tallies[0] += score
        for axis in range(3):
            tallies[1 + axis] += score * (place[axis] - 0.5 + length * on * step[axis])
        return through
