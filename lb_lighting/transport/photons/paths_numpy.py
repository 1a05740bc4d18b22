# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths in NumPy float64: the twin of kernels/photons/paths.cl, photons/free_path.cl and
photons/photons.cl.

The tests hold the kernels to it, and it serves where there is no OpenCL. All rays take a step
together; those that are done drop out.
"""

import numpy as np

from .random import RandomStreams
from .tallies import (
    ABSORBED,
    COLLISIONS,
    DIRECTION,
    FLUX,
    HANDED,
    LEFT_THROUGH,
    LOST,
    LOST_PHOTONS,
    POSITION,
    POWER,
    SUMS,
    UNIT,
    VIOLATIONS,
    WEIGHT,
    in_weights,
    kinds,
)

CROSSED, VIRTUAL, COLLIDED, LEFT, STOPPED = range(5)

_SLOWEST = 1e-18
_TOLERATED = 1.0001
_AT_ONCE = 2**16  # rays: their state fits the cache


class NumpyPaths:
    """Paths through one `PathGrid`; `OpenclPaths` does the same."""

    def __init__(self, grid):
        self.grid = grid

    def free_paths(self, rays, indices, per_depth, seed, most_steps):
        """((n,) fine cells to the first real collision, particles met, bounds that were violated).

        rays     (6, n) float32: origins in the domain, in fine cells, and unit directions
        indices  (n,) the numbers of the rays, which choose their random numbers
        inf where a ray leaves, NaN where it takes over `most_steps` steps. Of the particles, real
        and virtual ones, and of the violated bounds it is the number in all rays
        """
        distances, particles, violations = np.full(rays.shape[1], np.nan), 0, 0
        for first in range(0, rays.shape[1], _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            walk = Walk(self.grid, rays[:, some], per_depth, seed, indices[some])
            walk.start_flights(np.arange(len(walk.t)))
            going = np.arange(len(walk.t))
            for _ in range(most_steps):
                if not len(going):
                    break
                event = walk.advance(going)
                particles += np.count_nonzero((event == VIRTUAL) | (event == COLLIDED))
                hit, left = going[event == COLLIDED], going[event == LEFT]
                distances[first + hit], distances[first + left] = walk.t[hit], np.inf
                going = going[(event != COLLIDED) & (event != LEFT)]
            violations += np.count_nonzero(walk.violated)
        return distances, particles, violations

    def start_tallies(self, shape, lower, per_cell, wanted, opaque):
        """Empty tallies of `shape` voxels from `lower` on, 1 / `per_cell` fine cells an edge.

        wanted  whether these are: (direct, flux, handed)
        opaque  (occlusion, its albedo), (nx, ny, nz) float32 each, or None
        """
        self.opaque = opaque
        voxels = int(np.prod(shape))
        self.tally_shape, self.tally_lower, self.per_cell = shape, lower, per_cell
        self.tallies = [np.zeros((voxels, n), np.uint64) for n in kinds(*wanted)]
        self.before = np.zeros(voxels, np.uint64)
        self.deviation = np.zeros(voxels)
        self.sums = np.zeros(SUMS, np.int64)

    def trace_photons(
        self, photons, copies, first, per_depth, seed, most_steps, optics, spacing, last
    ):
        """Trace photons into the tallies.

        photons  (7, n) float32: as `rays` of free_paths, and weights from 0 to HEAVIEST
        copies   paths that begin as each photon does
        first    number of the first path, which chooses its random numbers
        optics   (albedo, mean cosine)
        spacing  fine cells between two points where a path is scored
        last     the collision at which a photon is handed over, or 0
        """
        photons = np.repeat(photons, copies, axis=1)
        for begin in range(0, photons.shape[1], _AT_ONCE):
            some = photons[:, begin : begin + _AT_ONCE]
            numbers = first + begin + np.arange(some.shape[1])
            walk = Walk(self.grid, some[:6], per_depth, seed, numbers)
            self._trace(walk, some[6].astype(float), most_steps, *optics, spacing, last)

    def take_batch(self, batch):
        """Tell that batch number `batch`, from 1 on, is complete."""
        now = self.tallies[1][:, WEIGHT]
        weight = (now - self.before) / UNIT
        mean_before = self.before / (UNIT * max(batch - 1, 1))
        self.deviation += (weight - mean_before) * (weight - now / (UNIT * batch))
        self.before = now.copy()

    def read_tallies(self):
        """(direct, scattered, handed, deviation, sums) of all batches, as weights.

        The first three are (voxels, tallies). deviation (voxels,) adds up the squared deviations
        of the batches' scattered weight from its mean. sums is (SUMS,) float64.
        """
        tallies = (tally / UNIT for tally in self.tallies)
        return *tallies, self.deviation, in_weights(self.sums)

    def _trace(self, walk, weight, most_steps, albedo, mean_cosine, spacing, last):
        going = np.arange(len(weight))
        least = weight * 0.1
        collisions = np.zeros(len(weight), int)
        turned = np.zeros(len(weight), bool)
        score_at = walk.random.next(going) * spacing
        walk.start_flights(going)
        for step in range(1, most_steps + 1):
            if not len(going):
                break
            event = walk.advance(going)
            if self.opaque is not None:
                ends = np.isin(event, (COLLIDED, LEFT)) | (step == most_steps)
                stopped = walk.stop(going[ends], self.opaque[0])
                event[stopped[going]] = STOPPED
            left = going[event == LEFT]
            hit, stopped = (  # of the last step, these are lost
                going[(event == kind) & (step < most_steps)] for kind in (COLLIDED, STOPPED)
            )
            turning = np.concatenate([hit, stopped])
            self._score(walk, np.concatenate([turning, left]), weight, turned, score_at, spacing)

            turned[turning] = True
            collisions[hit] += 1
            kept = weight[turning] * albedo
            if len(stopped):
                by = walk.stopped_by[stopped]
                kept[len(hit) :] = weight[stopped] * self.opaque[1].flat[by]
            self.sums[ABSORBED] += (_units(weight[turning]) - _units(kept)).sum()
            weight[turning] = kept
            given = hit[collisions[hit] == last]
            if len(given):
                self._hand_over(walk, given, weight[given])

            through = walk.face(left)
            for n in range(6):
                self.sums[LEFT_THROUGH + n] += _units(weight[left[through == n]]).sum()

            light = np.setdiff1d(turning[weight[turning] < least[turning]], given)
            dead = light[self._roulette(walk, light, weight)]
            ended = np.concatenate([given, left, dead])
            self.sums[COLLISIONS] += collisions[ended].sum()
            hit, stopped = (np.setdiff1d(rays, ended, True) for rays in (hit, stopped))
            alive = np.concatenate([hit, stopped])
            score_at[alive] -= walk.t[alive]
            walk.arrive(hit)
            walk.turn(hit, mean_cosine)
            walk.land(stopped)
            walk.turn_back(stopped)
            walk.start_flights(alive)
            going = np.setdiff1d(going, ended, assume_unique=True)
        self._score(walk, going, weight, turned, score_at, spacing)
        self.sums[LOST] += _units(weight[going]).sum()
        self.sums[LOST_PHOTONS] += len(going)
        self.sums[COLLISIONS] += collisions[going].sum()
        self.sums[VIOLATIONS] += np.count_nonzero(walk.violated)

    def _roulette(self, walk, rays, weight):
        """Which of the light photons die; the others gain what these lose, on average."""
        survives = walk.random.next(rays) < 0.5
        self.sums[ABSORBED] += (np.where(survives, -1, 1) * _units(weight[rays])).sum()
        weight[rays] *= 2
        return ~survives | (weight[rays] == 0)

    def _voxels(self, points):
        """(voxel of the tallies, place in it from -1/2 to 1/2) of each point."""
        place = (points - self.tally_lower) * self.per_cell
        index = np.clip(place.astype(int), 0, np.subtract(self.tally_shape, 1))
        offset = np.clip(place - index, 0, 1) - 0.5
        return np.ravel_multi_index(index.T, self.tally_shape), offset

    def _score(self, walk, rays, weight, turned, score_at, spacing):
        """Score flights, up to where they have come, at the points that are due."""
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

    def _hand_over(self, walk, rays, weight):
        voxel, offset = self._voxels(walk.points(rays))
        handed = self.tallies[2]
        _add(handed, voxel, POWER, weight)
        _add_vector(handed, voxel, POSITION, weight, offset)
        _add_vector(handed, voxel, DIRECTION, weight, walk.d[rays])
        self.sums[HANDED] += _units(weight).sum()


def _units(weight):
    return np.rint(weight * UNIT).astype(np.int64)


def _add(tallies, voxel, tally, weight):
    np.add.at(tallies[:, tally], voxel, _units(weight).astype(np.uint64))


def _add_vector(tallies, voxel, tally, weight, vectors):
    for axis in range(3):
        _add(tallies, voxel, tally + axis, weight * (0.5 * vectors[:, axis] + 0.5))


class Walk:
    """The state of many paths: the kernels' structs Path and Place, with one row for each ray."""

    def __init__(self, grid, rays, per_depth, seed, indices):
        self.grid, self.per_depth = grid, per_depth
        self.cells = np.array(grid.cells)
        self.upper = np.array(grid.fine.upper)
        self.o, self.d = (np.ascontiguousarray(v.T, float) for v in (rays[:3], rays[3:]))
        n = len(self.o)
        self.t, self.end, self.depth, self.limit = (np.zeros(n) for _ in range(4))
        self.i, self.crossings = np.zeros((n, 3)), np.zeros((n, 3))
        self.cell = np.clip(self.o.astype(int) // grid.size, 0, self.cells - 1)
        self.violated = np.zeros(n, bool)
        # Where the flights are among opaque voxels: the kernel's struct Place.
        self.voxel = np.clip(self.o.astype(int), 0, np.subtract(grid.fine.shape, 1))
        self.stopped_axis, self.stopped_by = np.zeros((2, n), int)
        self.random = RandomStreams(seed, indices)

    def points(self, rays):
        return self.o[rays] + self.t[rays, None] * self.d[rays]

    def start_flights(self, rays):
        """New flights from `o`, in the paths' super-voxels, along `d`."""
        d = self.d[rays]
        forward = d >= 0
        self.i[rays] = 1 / np.where(forward, np.maximum(d, _SLOWEST), np.minimum(d, -_SLOWEST))
        self.t[rays] = 0
        self.end[rays] = self._exits(rays).min(axis=1)
        self._draw_depth(rays)
        self.crossings[rays] = self._crossings(rays)
        self.limit[rays] = self._constant_bound(rays)

    def advance(self, rays):
        """The events with which a step of each of `rays` ends."""
        next_ = self.end[rays]
        if self.grid.sampler != "woodcock":
            next_ = np.minimum(next_, self.crossings[rays].min(axis=1))
        length = np.maximum(next_ - self.t[rays], 0)
        if self.grid.polynomial:
            ahead = self._bound_ahead(rays)
            depth = _integral(ahead, length)
        else:
            if self.grid.sampler == "ray_march" and self.grid.procedural:
                middle = self.t[rays] + length / 2
                points = self.o[rays] + middle[:, None] * self.d[rays]
                self.limit[rays] = self.grid.medium.density_at(points)
            depth = self.limit[rays] * length

        event = np.full(len(rays), CROSSED)
        meets = self.depth[rays] < depth
        met = rays[meets]
        if self.grid.polynomial:
            step = _solve([c[meets] for c in ahead], self.depth[met], length[meets])
            limit = _value([c[meets] for c in ahead], step)
        else:
            limit = self.limit[met]
            step = self.depth[met] / limit
        self.t[met] = np.minimum(self.t[met] + step, next_[meets])
        event[meets] = COLLIDED
        if self.grid.sampler != "ray_march":
            threshold = self.random.next(met) * limit
            virtual = ~(self._density(met, limit) > threshold)
            self._draw_depth(met[virtual])
            event[meets] = np.where(virtual, VIRTUAL, COLLIDED)

        passing = ~meets
        on = rays[passing]
        self.depth[on] -= depth[passing]
        self.t[on] = next_[passing]
        event[passing & (next_ >= self.end[rays])] = LEFT
        crossing = event == CROSSED
        event[crossing] = np.where(self._cross_faces(rays[crossing]), CROSSED, LEFT)
        return event

    def arrive(self, rays):
        """Go to where the flights have come."""
        self.o[rays] = np.clip(self.points(rays), self.grid.fine.lower, self.upper)

    def turn(self, rays, g):
        """Turn `d` by a Henyey-Greenstein angle."""
        even = 2 * self.random.next(rays) - 1
        ratio = (1 - g * g) / (1 + g * even)
        small = abs(g) < 1e-3
        c = even + 1.5 * g * (1 - even**2) if small else (1 + g * g - ratio**2) / (2 * g)
        c = np.clip(c, -1, 1)
        s = np.sqrt(1 - c * c)
        around = 2 * np.pi * self.random.next(rays)
        u, v = s * np.cos(around), s * np.sin(around)
        dx, dy, dz = self.d[rays].T
        sign = np.copysign(1, dz)
        a = -1 / (sign + dz)
        b = dx * dy * a
        turned = np.stack(
            [
                u * (1 + sign * dx * dx * a) + v * b + c * dx,
                u * sign * b + v * (sign + dy * dy * a) + c * dy,
                -u * sign * dx - v * dy + c * dz,
            ],
            axis=1,
        )
        self.d[rays] = turned / np.linalg.norm(turned, axis=1, keepdims=True)

    def stop(self, rays, occlusion):
        """Cut flights at the first face of a voxel that stops them; whether one does."""
        stopped = np.zeros(len(self.t), bool)
        while len(rays):
            forward = self.d[rays] >= 0
            crossings = (self.voxel[rays] + forward - self.o[rays]) * self.i[rays]
            axis, next_ = crossings.argmin(axis=1), crossings.min(axis=1)
            voxel = self.voxel[rays] + np.where(forward, 1, -1) * (axis[:, None] == range(3))
            inside = ((voxel >= 0) & (voxel < occlusion.shape)).all(axis=1)
            enters = inside & (next_ < self.t[rays])
            rays, axis, next_, voxel = (v[enters] for v in (rays, axis, next_, voxel))

            share = occlusion[tuple(voxel.T)]
            stops = share == 1
            partly = (share > 0) & (share < 1)
            stops[partly] = self.random.next(rays[partly]) < share[partly]
            met = rays[stops]
            stopped[met] = True
            self.t[met] = np.maximum(next_[stops], 0)
            self.stopped_axis[met] = axis[stops]
            self.stopped_by[met] = np.ravel_multi_index(voxel[stops].T, occlusion.shape)
            rays = rays[~stops]
            self.voxel[rays] = voxel[~stops]
        return stopped

    def land(self, rays):
        """Go to the faces at which the flights were stopped, on the side that they came from."""
        self.arrive(rays)
        axis = self.stopped_axis[rays]
        self.o[rays, axis] = self.voxel[rays, axis] + (self.d[rays, axis] >= 0)
        self.cell[rays] = self.voxel[rays] // self.grid.size

    def turn_back(self, rays):
        """Turn `d` back from those faces, by the cosine about their normals (Lambert)."""
        squared = self.random.next(rays)
        around = 2 * np.pi * self.random.next(rays)
        aside = np.sqrt(1 - squared)
        axis = self.stopped_axis[rays]
        forward = self.d[rays, axis] >= 0
        self.d[rays, axis] = np.where(forward, -1, 1) * np.sqrt(squared)
        self.d[rays, (axis + 1) % 3] = aside * np.cos(around)
        self.d[rays, (axis + 2) % 3] = aside * np.sin(around)

    def face(self, rays):
        """The face through which each flight leaves: -x, +x, -y, +y, -z, +z."""
        axis = self._exits(rays).argmin(axis=1)
        return 2 * axis + (self.d[rays, axis] >= 0)

    def _draw_depth(self, rays):
        self.depth[rays] = -np.log(self.random.next(rays)) * self.per_depth

    def _exits(self, rays):
        """(n, 3) where the flights would leave the domain, by axis."""
        end = np.where(self.d[rays] >= 0, self.upper, self.grid.fine.lower)
        return (end - self.o[rays]) * self.i[rays]

    def _crossings(self, rays):
        """(n, 3) where the flights cross the next face of their super-voxel, by axis."""
        face = (self.cell[rays] + (self.d[rays] >= 0)) * self.grid.size
        return (face - self.o[rays]) * self.i[rays]

    def _constant_bound(self, rays):
        grid = self.grid
        if grid.sampler == "woodcock":
            return grid.majorant
        if grid.polynomial or (grid.sampler == "ray_march" and grid.procedural):
            return 0.0  # not used
        values = grid.fine.values if grid.bound is None else grid.bound.values
        return values[tuple(self.cell[rays].T)]

    def _cross_faces(self, rays):
        """Go on to the next super-voxel; whether there is one."""
        axis = self.crossings[rays].argmin(axis=1)
        forward = self.d[rays, axis] >= 0
        self.cell[rays, axis] += np.where(forward, 1, -1)
        self.crossings[rays] = self._crossings(rays)
        inside = ((self.cell[rays] >= 0) & (self.cell[rays] < self.cells)).all(axis=1)
        self.limit[rays[inside]] = self._constant_bound(rays[inside])
        return inside

    def _fine_cells(self, points, rays):
        """The fine cells of points; never one outside their super-voxel."""
        first, last = np.zeros(3, int), np.array(self.grid.fine.shape)
        if self.grid.sampler != "woodcock":
            first = self.cell[rays] * self.grid.size
            last = np.minimum(first + self.grid.size, last)
        return np.clip(points.astype(int), first, last - 1)

    def _density(self, rays, bound):
        points = self.points(rays)
        if self.grid.procedural:
            density = self.grid.medium.density_at(points)
        else:
            density = self._voxel_density(points, rays)
        self.violated[rays] |= density > bound * _TOLERATED
        return density

    def _voxel_density(self, points, rays):
        cell = self._fine_cells(points, rays)
        values = self.grid.fine.values
        if self.grid.linear:
            density = np.zeros(len(rays))
            share = np.clip(points - cell, 0, 1)
            for corner in np.ndindex(2, 2, 2):
                weight = np.where(corner, share, 1 - share).prod(axis=1)
                density += weight * values[tuple((cell + corner).T)]
        else:
            density = values[tuple(cell.T)]
        return density

    def _coefficients(self, rays):
        """(8, n) coefficients of [1, x, y, z, xy, yz, zx, xyz] of the bound."""
        cell = self.cell[rays]
        if self.grid.bound is not None:
            return self.grid.bound.values[tuple(cell.T)].T.astype(float)
        n = {c: self.grid.fine.values[tuple((cell + c).T)].astype(float) for c in _CORNERS}
        return np.stack(
            [
                n[0, 0, 0],
                n[1, 0, 0] - n[0, 0, 0],
                n[0, 1, 0] - n[0, 0, 0],
                n[0, 0, 1] - n[0, 0, 0],
                n[1, 1, 0] - n[1, 0, 0] - n[0, 1, 0] + n[0, 0, 0],
                n[0, 1, 1] - n[0, 1, 0] - n[0, 0, 1] + n[0, 0, 0],
                n[1, 0, 1] - n[1, 0, 0] - n[0, 0, 1] + n[0, 0, 0],
                n[1, 1, 1] - n[1, 1, 0] - n[1, 0, 1] - n[0, 1, 1]
                + n[1, 0, 0] + n[0, 1, 0] + n[0, 0, 1] - n[0, 0, 0],
            ]
        )  # fmt: skip

    def _bound_ahead(self, rays):
        """The bound along the flights, a cubic in the length from here: its four coefficients."""
        a = self._coefficients(rays)
        x, y, z = (self.points(rays) / self.grid.size - self.cell[rays]).T
        vx, vy, vz = (self.d[rays] / self.grid.size).T
        return (
            a[0] + x * (a[1] + a[4] * y) + y * (a[2] + a[5] * z) + z * (a[3] + a[6] * x)
            + a[7] * x * y * z,
            vx * (a[1] + a[4] * y + a[6] * z + a[7] * y * z)
            + vy * (a[2] + a[4] * x + a[5] * z + a[7] * x * z)
            + vz * (a[3] + a[5] * y + a[6] * x + a[7] * x * y),
            a[4] * vx * vy + a[5] * vy * vz + a[6] * vz * vx
            + a[7] * (x * vy * vz + y * vz * vx + z * vx * vy),
            a[7] * vx * vy * vz,
        )  # fmt: skip


_CORNERS = list(np.ndindex(2, 2, 2))


def _value(c, s):
    return c[0] + s * (c[1] + s * (c[2] + s * c[3]))


def _integral(c, s):
    return s * (c[0] + s * (c[1] / 2 + s * (c[2] / 3 + s * (c[3] / 4))))


def _solve(c, depth, length):
    """Where the integral of cubics that are nowhere negative reaches `depth`, in [0, length].

    Bisection: slower than the kernel's Newton steps, and nothing can go wrong with it.
    """
    low, high = np.zeros_like(length), length.copy()
    for _ in range(60):
        middle = (low + high) / 2
        over = _integral(c, middle) > depth
        high[over] = middle[over]
        low[~over] = middle[~over]
    return high
