# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths from a camera in NumPy float64: the twin of kernels/preview/preview.cl."""

import numpy as np

from ...arrays import Floats, Integers
from ..photons.path_grid import PathGrid
from ..photons.tallies import Opaque
from ..photons.walk import COLLIDED, CROSSED, LEFT, STOPPED, VIRTUAL, Walk


class NumpyEye:
    """Follows paths from a camera through one `PathGrid`; `OpenclEye` does the same.

    lights    (n, 8) float32, see preview/preview.cl
    emission  (voxels, 4) float32: what one fine cell emits in three bands, W/(m^2 sr); or None
    opaque    (occlusion (nx, ny, nz), its albedo (voxels, 4)), float32 each; or None
    """

    def __init__(
        self, grid: PathGrid, lights: Floats, emission: Floats | None, opaque: Opaque | None
    ) -> None:
        self.grid, self.lights, self.emission, self.opaque = grid, lights, emission, opaque

    def see(
        self,
        rays: Floats,
        numbers: Integers,
        per_depth: float,
        seed: int,
        most_steps: int,
        most_collisions: int,
        albedo: Floats,
        g: float,
    ) -> tuple[Floats, Floats, int]:
        """(seen (n, 4), left (n, 8), number of violated majorants).

        seen     light in three bands, W/(m^2 sr), and whether the path met something
        left     direction, whether the path was abandoned, and its weight in three bands if it
                 left after a collision
        rays     (6, n) float32, as those of `NumpyPaths.free_paths`
        numbers  (n,) of the rays, which select their random numbers
        albedo   (3,)
        """
        paths = _Paths(self, Walk(self.grid, rays, per_depth, seed, numbers), most_steps)
        going: Integers = np.arange(rays.shape[1])
        paths.score_at = paths.walk.random.next(going)
        paths.walk.start_flights(going)
        while len(going):
            going = paths.meet(going, albedo, most_collisions)
            for light in self.lights:
                going = paths.light_up(going, light, g)
            going = paths.turn(going, g)
        seen = np.column_stack([paths.light, paths.collisions > 0])
        return seen, paths.left, int(np.count_nonzero(paths.walk.violated))


class _Paths:
    """The state of the paths from the camera, with one row for each ray."""

    def __init__(self, eye: NumpyEye, walk: Walk, most_steps: int) -> None:
        self.eye, self.walk, self.most_steps = eye, walk, most_steps
        n = len(walk.t)
        self.score_at: Floats = np.zeros(n)
        self.light, self.weight = np.zeros((n, 3)), np.ones((n, 3))
        self.left = np.zeros((n, 8))
        self.steps, self.collisions, self.face = (np.zeros(n, int) for _ in range(3))

    def meet(self, rays: Integers, albedo: Floats, most_collisions: int) -> Integers:
        """Follow the flights of paths. Returns those that met something and may go on."""
        walk, event = self.walk, self._fly(rays)
        self._glow(rays)
        hit, stopped = rays[event == COLLIDED], rays[event == STOPPED]
        self.weight[hit] *= albedo
        self.face[hit] = -1
        walk.arrive(hit)
        if len(stopped) and self.eye.opaque is not None:
            self.weight[stopped] *= self.eye.opaque[1][walk.stopped_by[stopped], :3]
            self.face[stopped] = walk.stopped_axis[stopped]
            walk.land(stopped)
        self.left[rays, :3] = walk.d[rays]
        gone = rays[(event == LEFT) & (self.collisions[rays] > 0)]
        self.left[gone, 4:7] = self.weight[gone]
        met = np.sort(np.concatenate([hit, stopped]))
        self.collisions[met] += 1
        return met[self.collisions[met] <= most_collisions]

    def light_up(self, rays: Integers, light: Floats, g: float) -> Integers:
        """Follow a flight from each collision to a light. Returns the paths not abandoned."""
        walk = self.walk
        state = [values[rays].copy() for values in (walk.d, walk.cell, walk.voxel)]
        towards = light[:3] - walk.o[rays] if light[3] > 0 else np.tile(light[:3], (len(rays), 1))
        squared = np.maximum((towards**2).sum(axis=1), 1e-12)
        walk.d[rays] = towards / np.sqrt(squared)[:, None]
        share = self._share(state[0], walk.d[rays], self.face[rays], g)
        walk.start_flights(rays)
        if light[3] > 0:
            share /= squared
            walk.end[rays] = np.minimum(walk.end[rays], np.sqrt(squared))
        event = self._fly(rays)
        arrived = event == LEFT
        due = self.weight[rays] * share[:, None] * light[4:7]
        self.light[rays[arrived]] += due[arrived]
        for values, value in zip((walk.d, walk.cell, walk.voxel), state, strict=True):
            values[rays] = value
        return rays[(event == COLLIDED) | (event == STOPPED) | arrived]

    def turn(self, rays: Integers, g: float) -> Integers:
        """Scatter the paths, with Russian roulette for small weights. Returns those that go on."""
        walk = self.walk
        most = self.weight[rays].max(axis=1)
        light = rays[most < 0.1]
        dies = (walk.random.next(light) < 0.5) | (most[most < 0.1] == 0)
        self.weight[light] *= 2
        rays = np.setdiff1d(rays, light[dies], assume_unique=True)
        walk.turn(rays[self.face[rays] < 0], g)
        walk.turn_back(rays[self.face[rays] >= 0])
        walk.start_flights(rays)
        return rays

    def _share(self, before: Floats, after: Floats, face: Integers, g: float) -> Floats:
        """(n,) 1/sr: the phase function, or Lambert's cosine, between directions (n, 3)."""
        cosine = (before * after).sum(axis=1)
        base = np.maximum(1 + g * g - 2 * g * cosine, 1e-12)
        phase = (1 - g * g) / (4 * np.pi * base * np.sqrt(base))
        row = np.arange(len(face)), np.maximum(face, 0)
        out = np.where(before[row] >= 0, -after[row], after[row])
        lambert = np.maximum(out, 0) / np.pi
        return np.where(face < 0, phase, lambert)

    def _fly(self, rays: Integers) -> Integers:
        """(n,) events that end the flights; CROSSED where a path took too many steps."""
        walk, event = self.walk, np.full(len(rays), CROSSED)
        going: Integers = np.arange(len(rays))
        while len(going):
            event[going] = walk.advance(rays[going])
            self.steps[rays[going]] += 1
            lost = self.steps[rays[going]] >= self.most_steps
            self.left[rays[going[lost]], 3] = 1
            goes_on = (event[going] == CROSSED) | (event[going] == VIRTUAL)
            event[going[lost]] = CROSSED
            going = going[goes_on & ~lost]
        if self.eye.opaque is not None:
            stopped = walk.stop(rays, self.eye.opaque[0])[rays]
            event[stopped & (event != CROSSED)] = STOPPED
        return event

    def _glow(self, rays: Integers) -> None:
        """Score the emission at points a fine cell apart, up to the flights' present points."""
        walk = self.walk
        while self.eye.emission is not None:
            due = rays[self.score_at[rays] < walk.t[rays]]
            if not len(due):
                break
            points = walk.o[due] + self.score_at[due, None] * walk.d[due]
            shape = self.eye.grid.fine.shape
            cell = np.clip(points.astype(int), 0, np.subtract(shape, 1))
            shining = self.eye.emission[np.ravel_multi_index(cell.T, shape), :3]
            self.light[due] += self.weight[due] * shining
            self.score_at[due] += 1
        self.score_at[rays] -= walk.t[rays]
