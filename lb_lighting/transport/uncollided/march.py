# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of lamps, each followed from voxel to voxel (Amanatides and Woo, "A fast voxel traversal
algorithm for ray tracing", 1987)."""

import numpy as np

from ...arrays import Booleans, Floats, Integers
from ..medium import Domain
from .attenuation import attenuate
from .sweep import STOPPED, Voxels

# The kinds of a voxel's tallies, as in kernels/uncollided/march.cl.
SCORE, POSITION, DIRECTION, TALLIES = 0, slice(1, 4), slice(4, 7), 7
_BORDER = 1e-6  # voxels from a face of the domain: closer rays count as from outside
_SLOWEST = 1e-18  # components of a direction closer to zero than this are replaced by this

type Starts = tuple[Floats, Booleans, Integers, Integers]
"""See `enter`."""


def enter(domain: Domain, origins: Floats, directions: Floats) -> Starts:
    """The starts of rays in the domain's voxels.

    origins     (n, 3) m, world space
    directions  (n, 3)
    Returns, for the m rays that cross the domain: their places (m, 3) in the first voxels, along
    each axis from 0 where a ray of this direction enters a voxel to 1 where it leaves it; which
    (n,) of the rays they are; their first voxels (m,); and the faces (m,) of the domain, -x, +x,
    -y, +y, -z, +z, through which they enter, or -1 for rays that start inside.
    """
    shape = np.array(domain.shape)
    points = (origins - domain.origin) / domain.voxel_size
    forward = directions >= 0
    with np.errstate(divide="ignore", invalid="ignore"):
        begin = (np.where(forward, 0, shape) - points) / directions
        end = (np.where(forward, shape, 0) - points) / directions
    level = directions == 0  # such a ray is either always between two faces or never
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


class NumpyMarch:
    """Rays through voxels in float64, the twin of kernels/uncollided/march.cl.

    voxels  `Voxels` of the domain, without a glow
    """

    def __init__(self, voxels: Voxels) -> None:
        self.voxels, self.shape = voxels, voxels.depth.shape
        self.tallies = np.zeros((TALLIES, voxels.depth.size))
        self.reflected = None
        if voxels.occlusion is not None:
            self.reflected = np.zeros((1, voxels.depth.size))
        self.sums = np.zeros(STOPPED + 1)

    def read(self) -> tuple[Floats, Floats | None, Floats]:
        """(TALLIES, nx, ny, nz) tallies, (nx, ny, nz) reflected light, and sums (7,), in weights:
        as in kernels/uncollided/march.cl.

        The reflected light is None without opaque voxels.
        """
        reflected = None if self.reflected is None else self.reflected.reshape(self.shape)
        return self.tallies.reshape(-1, *self.shape), reflected, self.sums

    def march(
        self,
        places: Floats,
        directions: Floats,
        weights: Floats,
        starts: Integers,
        faces: Integers,
    ) -> None:
        """Send rays.

        places, starts, faces  (n, 3), (n,) and (n,), as of `enter`
        directions             (n, 3) unit vectors
        weights                (n,) from 0 to 1
        """
        weights = weights - self._stop_at_border(weights, starts, faces)
        voxels = np.stack(np.unravel_index(starts, self.shape), axis=1)
        ahead: Integers = np.where(directions < 0, voxels, np.array(self.shape) - 1 - voxels)
        rays = (places, directions, weights, starts, ahead)
        while len(rays[0]):
            rays = self._cross(*rays)

    def _stop_at_border(self, weights: Floats, starts: Integers, faces: Integers) -> Floats | float:
        """The light from outside that the first voxels stop. The reflected part leaves."""
        occlusion, reflecting = self.voxels.occlusion, self.voxels.reflecting
        if occlusion is None or reflecting is None:
            return 0.0
        stopped = np.where(faces >= 0, weights * occlusion.flat[starts], 0)
        back = np.where(faces >= 0, weights * reflecting.flat[starts], 0)
        self.sums[:STOPPED] += np.bincount(np.maximum(faces, 0), back, STOPPED)
        self.sums[STOPPED] += (stopped - back).sum()
        return stopped

    def _cross(
        self,
        places: Floats,
        directions: Floats,
        weights: Floats,
        at: Integers,
        ahead: Integers,
    ) -> tuple[Floats, Floats, Floats, Integers, Integers]:
        """Take each ray through a voxel. Returns the same of the rays still in the domain.

        at     (n,), the voxel
        ahead  (n, 3), the number of voxels ahead along each axis
        """
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
        face = 2 * axis + (sign > 0)
        self.sums[:STOPPED] += np.bincount(face[leaving], weights[leaving], STOPPED)

        inside = ~leaving
        strides = np.array((self.shape[1] * self.shape[2], self.shape[2], 1))
        following = at + sign * strides[axis]
        if self.reflected is not None:
            stopped = self._stop(weights[inside], at[inside], following[inside])
            weights = weights.copy()
            weights[inside] -= stopped
        places[rays, axis] = 0
        return (
            places[inside],
            directions[inside],
            weights[inside],
            following[inside],
            ahead[inside],
        )

    def _score(
        self, places: Floats, directions: Floats, weights: Floats, at: Integers, way: Floats
    ) -> Floats:
        """Tally paths of lengths `way` through the rays' voxels. Returns the weights after them."""
        edge = self.voxels.depth.flat[at]
        depth = edge * way
        transmittance, mean, _, place = attenuate(depth)
        total = weights * np.where(edge > 1, 1 - transmittance, way * mean)
        along = total * way * place
        sign = np.where(directions < 0, -1, 1)
        position = sign * (total[:, None] * (places - 0.5)) + along[:, None] * directions
        self._add(self.tallies, SCORE, at, total)
        for n in range(3):
            self._add(self.tallies, POSITION.start + n, at, position[:, n])
            self._add(self.tallies, DIRECTION.start + n, at, total * directions[:, n])
        return weights * transmittance

    def _stop(self, weights: Floats, at: Integers, following: Integers) -> Floats | float:
        """The light, (n,), that the next voxels stop. The reflected part is tallied."""
        occlusion, reflecting = self.voxels.occlusion, self.voxels.reflecting
        if self.reflected is None or occlusion is None or reflecting is None:
            return 0.0
        stopped = weights * occlusion.flat[following]
        back = weights * reflecting.flat[following]
        self._add(self.reflected, SCORE, at, back)
        self.sums[STOPPED] += (stopped - back).sum()
        return stopped

    def _add(self, tallies: Floats, kind: int, at: Integers, scores: Floats) -> None:
        tallies[kind] += np.bincount(at, scores, tallies.shape[1])
