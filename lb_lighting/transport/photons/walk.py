# SPDX-License-Identifier: GPL-3.0-or-later
"""How paths step through a `PathGrid`, in NumPy float64: the twin of kernels/photons/paths.cl and
scatter.cl. All paths take a step together."""

from collections.abc import Sequence

import numpy as np

from ...arrays import Booleans, Floats, Integers
from .path_grid import PathGrid
from .random import RandomStreams

CROSSED, VIRTUAL, COLLIDED, LEFT, STOPPED = range(5)  # how a step ends

_SLOWEST = 1e-18
_TOLERATED = 1.0001


class Walk:
    """The state of many paths, one row for each ray: the kernels' structs Path and Place."""

    def __init__(
        self, grid: PathGrid, rays: Floats, per_depth: float, seed: int, indices: Integers
    ) -> None:
        self.grid, self.per_depth = grid, per_depth
        self.cells = np.array(grid.cells)
        self.upper = np.array(grid.fine.upper)
        self.o, self.d = (np.ascontiguousarray(v.T, float) for v in (rays[:3], rays[3:]))
        n = len(self.o)
        self.t, self.end, self.depth, self.limit = (np.zeros(n) for _ in range(4))
        self.i, self.crossings = np.zeros((n, 3)), np.zeros((n, 3))
        self.cell = np.clip(self.o.astype(int) // grid.size, 0, self.cells - 1)
        self.violated = np.zeros(n, bool)
        # The positions of flights among opaque voxels: the kernel's struct Place.
        self.voxel = np.clip(self.o.astype(int), 0, np.subtract(grid.fine.shape, 1))
        self.stopped_axis, self.stopped_by = np.zeros((2, n), int)
        self.random = RandomStreams(seed, indices)

    def points(self, rays: Integers) -> Floats:
        return self.o[rays] + self.t[rays, None] * self.d[rays]

    def start_flights(self, rays: Integers) -> None:
        """Start flights from `o`, in the paths' super-voxels, along `d`."""
        d = self.d[rays]
        forward = d >= 0
        self.i[rays] = 1 / np.where(forward, np.maximum(d, _SLOWEST), np.minimum(d, -_SLOWEST))
        self.t[rays] = 0
        self.end[rays] = self._exits(rays).min(axis=1)
        self._draw_depth(rays)
        self.crossings[rays] = self._crossings(rays)
        self.limit[rays] = self._constant_majorant(rays)

    def advance(self, rays: Integers) -> Integers:
        """Advance each of `rays` by a step. Returns the events that end the steps."""
        next_ = self.end[rays]
        if self.grid.sampler != "woodcock":
            next_ = np.minimum(next_, self.crossings[rays].min(axis=1))
        length = np.maximum(next_ - self.t[rays], 0)
        if self.grid.polynomial:
            ahead = self._majorant_ahead(rays)
            depth = _integral(ahead, length)
        else:
            if self.grid.sampler == "ray_march" and self.grid.procedural:
                middle = self.t[rays] + length / 2
                points = self.o[rays] + middle[:, None] * self.d[rays]
                self.limit[rays] = self.grid.noise.density_at(points)
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

    def arrive(self, rays: Integers) -> None:
        """Move `o` to the present points of the flights."""
        self.o[rays] = np.clip(self.points(rays), self.grid.fine.lower, self.upper)

    def turn(self, rays: Integers, g: float) -> None:
        """Scatter `d` by the Henyey-Greenstein phase function."""
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

    def stop(self, rays: Integers, occlusion: Floats) -> Booleans:
        """Cut flights at the first voxel face that stops them. Returns whether there is one."""
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

    def land(self, rays: Integers) -> None:
        """Move `o` to the faces that stopped the flights, on the side that they came from."""
        self.arrive(rays)
        axis = self.stopped_axis[rays]
        self.o[rays, axis] = self.voxel[rays, axis] + (self.d[rays, axis] >= 0)
        self.cell[rays] = self.voxel[rays] // self.grid.size

    def turn_back(self, rays: Integers) -> None:
        """Reflect `d` from those faces, cosine-distributed about their normals (Lambert)."""
        squared = self.random.next(rays)
        around = 2 * np.pi * self.random.next(rays)
        aside = np.sqrt(1 - squared)
        axis = self.stopped_axis[rays]
        forward = self.d[rays, axis] >= 0
        self.d[rays, axis] = np.where(forward, -1, 1) * np.sqrt(squared)
        self.d[rays, (axis + 1) % 3] = aside * np.cos(around)
        self.d[rays, (axis + 2) % 3] = aside * np.sin(around)

    def face(self, rays: Integers) -> Integers:
        """The face through which each flight leaves: -x, +x, -y, +y, -z, +z."""
        axis = self._exits(rays).argmin(axis=1)
        return 2 * axis + (self.d[rays, axis] >= 0)

    def _draw_depth(self, rays: Integers) -> None:
        self.depth[rays] = -np.log(self.random.next(rays)) * self.per_depth

    def _exits(self, rays: Integers) -> Floats:
        """(n, 3) where the flights would leave the domain, by axis."""
        end = np.where(self.d[rays] >= 0, self.upper, self.grid.fine.lower)
        return (end - self.o[rays]) * self.i[rays]

    def _crossings(self, rays: Integers) -> Floats:
        """(n, 3) where the flights cross the next face of their super-voxel, by axis."""
        face = (self.cell[rays] + (self.d[rays] >= 0)) * self.grid.size
        return (face - self.o[rays]) * self.i[rays]

    def _constant_majorant(self, rays: Integers) -> Floats | float:
        grid = self.grid
        if grid.sampler == "woodcock":
            return grid.global_majorant
        if grid.polynomial or (grid.sampler == "ray_march" and grid.procedural):
            return 0.0  # not used
        values = grid.fine.values if grid.majorants is None else grid.majorants.values
        return values[tuple(self.cell[rays].T)]

    def _cross_faces(self, rays: Integers) -> Booleans:
        """Go on to the next super-voxel; whether there is one."""
        axis = self.crossings[rays].argmin(axis=1)
        forward = self.d[rays, axis] >= 0
        self.cell[rays, axis] += np.where(forward, 1, -1)
        self.crossings[rays] = self._crossings(rays)
        inside = ((self.cell[rays] >= 0) & (self.cell[rays] < self.cells)).all(axis=1)
        self.limit[rays[inside]] = self._constant_majorant(rays[inside])
        return inside

    def _fine_cells(self, points: Floats, rays: Integers) -> Integers:
        """The fine cells of points, always within their super-voxels."""
        first, last = np.zeros(3, int), np.array(self.grid.fine.shape)
        if self.grid.sampler != "woodcock":
            first = self.cell[rays] * self.grid.size
            last = np.minimum(first + self.grid.size, last)
        return np.clip(points.astype(int), first, last - 1)

    def _density(self, rays: Integers, majorant: Floats) -> Floats:
        points = self.points(rays)
        if self.grid.procedural:
            density = self.grid.noise.density_at(points)
        else:
            density = self._voxel_density(points, rays)
        self.violated[rays] |= density > majorant * _TOLERATED
        return density

    def _voxel_density(self, points: Floats, rays: Integers) -> Floats:
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

    def _coefficients(self, rays: Integers) -> Floats:
        """(8, n) coefficients of [1, x, y, z, xy, yz, zx, xyz] of the majorant."""
        cell = self.cell[rays]
        if self.grid.majorants is not None:
            return self.grid.majorants.values[tuple(cell.T)].T.astype(float)
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

    def _majorant_ahead(self, rays: Integers) -> tuple[Floats, ...]:
        """Four coefficients of the majorant along the flights: a cubic in the length from here."""
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


def _value(c: Sequence[Floats], s: Floats) -> Floats:
    return c[0] + s * (c[1] + s * (c[2] + s * c[3]))


def _integral(c: Sequence[Floats], s: Floats) -> Floats:
    return s * (c[0] + s * (c[1] / 2 + s * (c[2] / 3 + s * (c[3] / 4))))


def _solve(c: Sequence[Floats], depth: Floats, length: Floats) -> Floats:
    """Where the integral of non-negative cubics reaches `depth`, in [0, length].

    By bisection: slower than the kernel's Newton steps, but it cannot fail.
    """
    low, high = np.zeros_like(length), length.copy()
    for _ in range(60):
        middle = (low + high) / 2
        over = _integral(c, middle) > depth
        high[over] = middle[over]
        low[~over] = middle[~over]
    return high
