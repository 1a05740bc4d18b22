# SPDX-License-Identifier: GPL-3.0-or-later
"""Free paths and photons in NumPy float64: the twin of kernels/photons/free_path.cl and photons.cl.

All paths take a step together; those that have ended drop out.
"""

import numpy as np

from ...arrays import Array, Booleans, Floats, Integers
from .path_grid import PathGrid
from .tallies import (
    ABSORBED,
    COLLISIONS,
    DIRECTION,
    FLUX,
    HANDOVER,
    LEFT_THROUGH,
    LOST,
    LOST_PHOTONS,
    POSITION,
    POWER,
    SUMS,
    UNIT,
    VIOLATIONS,
    WEIGHT,
    Opaque,
    Selection,
    Tallies,
    in_weights,
    kinds,
)
from .walk import COLLIDED, LEFT, STOPPED, VIRTUAL, Walk

_AT_ONCE = 2**16  # rays: their state fits the cache


class NumpyPaths:
    """Paths through one `PathGrid`; `OpenclPaths` is its twin."""

    def __init__(self, grid: PathGrid) -> None:
        self.grid = grid

    def free_paths(
        self, rays: Floats, indices: Integers, per_depth: float, seed: int, most_steps: int
    ) -> tuple[Floats, int, int]:
        """(distances, collisions, violations) of free paths.

        distances   (n,) fine cells to the first real collision; inf where a ray leaves, NaN where
                    it needs more than `most_steps` steps
        collisions  the number of real and virtual collisions of all rays
        violations  how often the density exceeded its majorant

        rays     (6, n) float32: origins in the domain, in fine cells, and unit directions
        indices  (n,) the numbers of the rays, which select their random numbers
        """
        distances, particles, violations = np.full(rays.shape[1], np.nan), 0, 0
        for first in range(0, rays.shape[1], _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            walk = Walk(self.grid, rays[:, part], per_depth, seed, indices[part])
            walk.start_flights(np.arange(len(walk.t)))
            going = np.arange(len(walk.t))
            for _ in range(most_steps):
                if not len(going):
                    break
                event = walk.advance(going)
                particles += int(np.count_nonzero((event == VIRTUAL) | (event == COLLIDED)))
                hit, left = going[event == COLLIDED], going[event == LEFT]
                distances[first + hit], distances[first + left] = walk.t[hit], np.inf
                going = going[(event != COLLIDED) & (event != LEFT)]
            violations += int(np.count_nonzero(walk.violated))
        return distances, particles, violations

    def start_tallies(
        self,
        shape: tuple[int, ...],
        lower: float,
        per_cell: float,
        selection: Selection,
        opaque: Opaque | None,
    ) -> None:
        """Start tallies of `shape` voxels from `lower`, each 1 / `per_cell` fine cells wide, at 0.

        selection  which are tallied: (uncollided light, flux, collision source)
        opaque     (occlusion, its albedo), (nx, ny, nz) float32 each, or None
        """
        self.opaque = opaque
        voxels = int(np.prod(shape))
        self.tally_shape, self.tally_lower, self.per_cell = shape, lower, per_cell
        self.tallies = [np.zeros((voxels, n), np.uint64) for n in kinds(*selection)]
        self.before = np.zeros(voxels, np.uint64)
        self.deviation = np.zeros(voxels)
        self.sums = np.zeros(SUMS, np.int64)

    def trace_photons(
        self,
        photons: Floats,
        copies: int,
        first: int,
        per_depth: float,
        seed: int,
        most_steps: int,
        optics: tuple[float, float],
        spacing: float,
        last: int,
    ) -> None:
        """Trace photons into the tallies.

        photons  (7, n) float32: the `rays` of free_paths, and weights from 0 to HEAVIEST
        copies   paths that start from each photon
        first    number of the first path, which selects its random numbers
        optics   (albedo, mean cosine)
        spacing  fine cells between two points where a path is scored
        last     the collision at which a photon becomes part of the collision source; 0 for none
        """
        photons = np.repeat(photons, copies, axis=1)
        for begin in range(0, photons.shape[1], _AT_ONCE):
            part = photons[:, begin : begin + _AT_ONCE]
            numbers = first + begin + np.arange(part.shape[1])
            walk = Walk(self.grid, part[:6], per_depth, seed, numbers)
            self._trace(walk, part[6].astype(float), most_steps, *optics, spacing, last)

    def take_batch(self, batch: int) -> None:
        """Add the scores since the last batch to the variance; batches count from 1."""
        now = self.tallies[1][:, WEIGHT]
        weight = (now - self.before) / UNIT
        mean_before = self.before / (UNIT * max(batch - 1, 1))
        self.deviation += (weight - mean_before) * (weight - now / (UNIT * batch))
        self.before = now.copy()

    def read_tallies(self) -> Tallies:
        """The `Tallies` of all batches."""
        direct, scattered, source = (tally / UNIT for tally in self.tallies)
        return Tallies(direct, scattered, source, self.deviation, in_weights(self.sums))

    def _trace(
        self,
        walk: Walk,
        weight: Floats,
        most_steps: int,
        albedo: float,
        mean_cosine: float,
        spacing: float,
        last: int,
    ) -> None:
        going, least = np.arange(len(weight)), weight * 0.1
        collisions, turned = np.zeros(len(weight), int), np.zeros(len(weight), bool)
        score_at = walk.random.next(going) * spacing
        walk.start_flights(going)
        for step in range(1, most_steps + 1):
            if not len(going):
                break
            # Advance all paths to their next event, and score them up to it.
            event = walk.advance(going)
            if self.opaque is not None:
                ends = np.isin(event, (COLLIDED, LEFT)) | (step == most_steps)
                is_stopped = walk.stop(going[ends], self.opaque[0])
                event[is_stopped[going]] = STOPPED
            left = going[event == LEFT]
            # Paths that have not ended after the last step are lost.
            hit = going[(event == COLLIDED) & (step < most_steps)]
            stopped = going[(event == STOPPED) & (step < most_steps)]
            turning = np.concatenate([hit, stopped])
            self._score(walk, np.concatenate([turning, left]), weight, turned, score_at, spacing)

            # Absorb, end the photons that become a collision source, count those that leave.
            turned[turning] = True
            collisions[hit] += 1
            self._absorb(walk, hit, stopped, weight, albedo)
            collided = hit[collisions[hit] == last]
            if len(collided):
                self._hand_over(walk, collided, weight[collided])
            self._count_left(walk, left, weight)

            # End paths of little weight at random.
            light = np.setdiff1d(turning[weight[turning] < least[turning]], collided)
            dead = light[self._roulette(walk, light, weight)]
            ended = np.concatenate([collided, left, dead])
            self.sums[COLLISIONS] += collisions[ended].sum()

            # Scatter or reflect the others, and start their next flights.
            hit = np.setdiff1d(hit, ended, assume_unique=True)
            stopped = np.setdiff1d(stopped, ended, assume_unique=True)
            alive = np.concatenate([hit, stopped])
            score_at[alive] -= walk.t[alive]
            walk.arrive(hit)
            walk.turn(hit, mean_cosine)
            walk.land(stopped)
            walk.turn_back(stopped)
            walk.start_flights(alive)
            going = np.setdiff1d(going, ended, assume_unique=True)
        self._score(walk, going, weight, turned, score_at, spacing)
        self._count_lost(going, weight)
        self.sums[COLLISIONS] += collisions[going].sum()
        self.sums[VIOLATIONS] += np.count_nonzero(walk.violated)

    def _absorb(
        self, walk: Walk, hit: Integers, stopped: Integers, weight: Floats, albedo: float
    ) -> None:
        """Subtract from the weights what collisions and opaque voxels absorb."""
        turning = np.concatenate([hit, stopped])
        kept = weight[turning] * albedo
        if len(stopped) and self.opaque is not None:
            by = walk.stopped_by[stopped]
            kept[len(hit) :] = weight[stopped] * self.opaque[1].flat[by]
        self.sums[ABSORBED] += (_units(weight[turning]) - _units(kept)).sum()
        weight[turning] = kept

    def _count_left(self, walk: Walk, left: Integers, weight: Floats) -> None:
        """Count the weights that leave through each face."""
        through = walk.face(left)
        for n in range(6):
            self.sums[LEFT_THROUGH + n] += _units(weight[left[through == n]]).sum()

    def _count_lost(self, going: Integers, weight: Floats) -> None:
        """Count the paths that took too many steps, and their weights."""
        self.sums[LOST] += _units(weight[going]).sum()
        self.sums[LOST_PHOTONS] += len(going)

    def _roulette(self, walk: Walk, rays: Integers, weight: Floats) -> Booleans:
        """Which photons of little weight end. The others double theirs, which keeps the mean."""
        survives = walk.random.next(rays) < 0.5
        self.sums[ABSORBED] += (np.where(survives, -1, 1) * _units(weight[rays])).sum()
        weight[rays] *= 2
        return ~survives | (weight[rays] == 0)

    def _voxels(self, points: Floats) -> tuple[Integers, Floats]:
        """(voxel of the tallies, position in it from -1/2 to 1/2) of each point."""
        place = (points - self.tally_lower) * self.per_cell
        index = np.clip(place.astype(int), 0, np.subtract(self.tally_shape, 1))
        offset = np.clip(place - index, 0, 1) - 0.5
        return np.ravel_multi_index(index.T, self.tally_shape), offset

    def _score(
        self,
        walk: Walk,
        rays: Integers,
        weight: Floats,
        turned: Booleans,
        score_at: Floats,
        spacing: float,
    ) -> None:
        """Score flights at the points that are due, up to their present positions."""
        direct, scattered, _ = self.tallies
        while len(rays := rays[score_at[rays] < walk.t[rays]]):
            points = walk.o[rays] + score_at[rays, None] * walk.d[rays]
            voxel, _ = self._voxels(points)
            straight = ~turned[rays]
            if direct.shape[1]:
                _add(direct, voxel[straight], WEIGHT, weight[rays[straight]])
            others = rays[~straight]
            _add(scattered, voxel[~straight], WEIGHT, weight[others])
            if scattered.shape[1] > FLUX:
                _add_vector(scattered, voxel[~straight], FLUX, weight[others], walk.d[others])
            score_at[rays] += spacing

    def _hand_over(self, walk: Walk, rays: Integers, weight: Floats) -> None:
        """Score photons that become a collision source."""
        voxel, offset = self._voxels(walk.points(rays))
        source = self.tallies[2]
        _add(source, voxel, POWER, weight)
        _add_vector(source, voxel, POSITION, weight, offset)
        _add_vector(source, voxel, DIRECTION, weight, walk.d[rays])
        self.sums[HANDOVER] += _units(weight).sum()


def _units(weight: Floats) -> Integers:
    return np.rint(weight * UNIT).astype(np.int64)


def _add(tallies: Array, voxel: Integers, tally: int, weight: Floats) -> None:
    np.add.at(tallies[:, tally], voxel, _units(weight).astype(np.uint64))


def _add_vector(
    tallies: Array, voxel: Integers, tally: int, weight: Floats, vectors: Floats
) -> None:
    for axis in range(3):
        _add(tallies, voxel, tally + axis, weight * (0.5 * vectors[:, axis] + 0.5))
