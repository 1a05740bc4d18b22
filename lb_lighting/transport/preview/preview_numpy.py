# SPDX-License-Identifier: GPL-3.0-or-later
"""What rays from a camera see, in NumPy float64: the twin of kernels/preview/preview.cl."""

import numpy as np

from ..photons.paths_numpy import (
    COLLIDED,
    CROSSED,
    LEFT,
    STOPPED,
    VIRTUAL,
    Walk,
)


class NumpyEye:
    """Sees through one `PathGrid`; the arguments are those of `OpenclEye`."""

    def __init__(self, grid, lights, emission, opaque):
        self.grid, self.lights, self.emission, self.opaque = grid, lights, emission, opaque

    def see(self, rays, numbers, per_depth, seed, most_steps, most_collisions, albedo, g):
        """As `OpenclEye.see`."""
        paths = _Paths(self, Walk(self.grid, rays, per_depth, seed, numbers), most_steps)
        going = np.arange(rays.shape[1])
        paths.score_at = paths.walk.random.next(going)
        paths.walk.start_flights(going)
        while len(going):
            going = paths.meet(going, albedo, most_collisions)
            for light in self.lights:
                going = paths.light_up(going, light, g)
            going = paths.turn(going, g)
        seen = np.column_stack([paths.light, paths.collisions > 0])
        return seen, paths.left, np.count_nonzero(paths.walk.violated)


class _Paths:
    """The state of the paths from the camera, with one row for each ray."""

    def __init__(self, eye, walk, most_steps):
        self.eye, self.walk, self.most_steps = eye, walk, most_steps
        n = len(walk.t)
        self.light, self.weight = np.zeros((n, 3)), np.ones((n, 3))
        self.left = np.zeros((n, 8))
        self.steps, self.collisions, self.face = (np.zeros(n, int) for _ in range(3))

    def meet(self, rays, albedo, most_collisions):
        """Follow the paths' own flights; those that met something, and may go on."""
        walk, event = self.walk, self._fly(rays)
        self._glow(rays)
        hit, stopped = rays[event == COLLIDED], rays[event == STOPPED]
        self.weight[hit] *= albedo
        self.face[hit] = -1
        walk.arrive(hit)
        if len(stopped):
            self.weight[stopped] *= self.eye.opaque[1][walk.stopped_by[stopped], :3]
            self.face[stopped] = walk.stopped_axis[stopped]
            walk.land(stopped)
        self.left[rays, :3] = walk.d[rays]
        gone = rays[(event == LEFT) & (self.collisions[rays] > 0)]
        self.left[gone, 4:7] = self.weight[gone]
        met = np.sort(np.concatenate([hit, stopped]))
        self.collisions[met] += 1
        return met[self.collisions[met] <= most_collisions]

    def light_up(self, rays, light, g):
        """Follow a flight from each path's collision to a light, and back; those not lost."""
        walk = self.walk
        before = [values[rays].copy() for values in (walk.d, walk.cell, walk.voxel)]
        towards = light[:3] - walk.o[rays] if light[3] > 0 else np.tile(light[:3], (len(rays), 1))
        squared = np.maximum((towards**2).sum(axis=1), 1e-12)
        walk.d[rays] = towards / np.sqrt(squared)[:, None]
        share = self._share(before[0], walk.d[rays], self.face[rays], g)
        walk.start_flights(rays)
        if light[3] > 0:
            share /= squared
            walk.end[rays] = np.minimum(walk.end[rays], np.sqrt(squared))
        event = self._fly(rays)
        arrived = event == LEFT
        due = self.weight[rays] * share[:, None] * light[4:7]
        self.light[rays[arrived]] += due[arrived]
        for values, value in zip((walk.d, walk.cell, walk.voxel), before, strict=True):
            values[rays] = value
        return rays[(event == COLLIDED) | (event == STOPPED) | arrived]

    def turn(self, rays, g):
        """Let the paths go on, those that are light by Russian roulette; those that do."""
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

    def _share(self, before, after, face, g):
        """(n,) 1/sr: what scatters from the directions `after` back along `before`, (n, 3) each."""
        cosine = (before * after).sum(axis=1)
        base = np.maximum(1 + g * g - 2 * g * cosine, 1e-12)
        phase = (1 - g * g) / (4 * np.pi * base * np.sqrt(base))
        row = np.arange(len(face)), np.maximum(face, 0)
        out = np.where(before[row] >= 0, -after[row], after[row])
        lambert = np.maximum(out, 0) / np.pi
        return np.where(face < 0, phase, lambert)

    def _fly(self, rays):
        """The events with which flights end; CROSSED where a path took too many steps."""
        walk, event, going = self.walk, np.full(len(rays), CROSSED), np.arange(len(rays))
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

    def _glow(self, rays):
        """Score flights, up to where they have come, at points a fine cell apart."""
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
