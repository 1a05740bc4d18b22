# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of lamps, each followed on its own from voxel to voxel (Amanatides and Woo, "A fast voxel
traversal algorithm for ray tracing", 1987)."""

import numpy as np

from .attenuation import fade
from .sweep import STOPPED

# What a voxel's tallies count, as in kernels/uncollided/march.cl.
SCORE, POSITION, DIRECTION, TALLIES = 0, slice(1, 4), slice(4, 7), 7
_BORDER = 1e-6  # voxels from a face of the domain within which a ray comes from outside
_SLOWEST = 1e-18  # a direction's component closer to zero than this is taken for this


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


class NumpyMarch:
    """Rays through voxels in float64, the twin of kernels/uncollided/march.cl: see there."""

    def __init__(self, voxels):
        self.voxels, self.shape = voxels, voxels.depth.shape
        self.tallies = np.zeros((TALLIES, voxels.depth.size))
        self.reflected = None
        if voxels.occlusion is not None:
            self.reflected = np.zeros((1, voxels.depth.size))
        self.sums = np.zeros(STOPPED + 1)

    def read(self):
        """(tallies, reflected, sums), in weights: as in kernels/uncollided/march.cl, by kind and
        voxel.

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
        self._add(self.tallies, SCORE, at, total)
        for n in range(3):
            self._add(self.tallies, POSITION.start + n, at, position[:, n])
            self._add(self.tallies, DIRECTION.start + n, at, total * directions[:, n])
        return weights * through

    def _stop(self, weights, at, following):
        """What the next voxels stop, (n,), after what they reflect is tallied."""
        stopped = weights * self.voxels.occlusion.flat[following]
        back = weights * self.voxels.reflecting.flat[following]
        self._add(self.reflected, SCORE, at, back)
        self.sums[STOPPED] += (stopped - back).sum()
        return stopped

    def _add(self, tallies, kind, at, scores):
        tallies[kind] += np.bincount(at, scores, tallies.shape[1])
