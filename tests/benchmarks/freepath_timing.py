# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays per second and steps per ray of one free-path sampler on one grid."""

from dataclasses import dataclass
from functools import cache
from time import perf_counter

import numpy as np

from lb_lighting.transport import Medium, Sky
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.photons import paths_numpy
from lb_lighting.transport.photons.free_path import MOST_STEPS

SUPERVOXELS = ("supervoxel_constant", "supervoxel_linear")

RAYS = 2**18  # at most in a batch
FEWEST = 2**10
BATCH_SECONDS, POINT_SECONDS = 0.25, 1.0
PROFILED = 1024  # rays whose steps are counted; a quarter of them in noise, which is slow


@dataclass(frozen=True)
class Speed:
    """Rays per second, and the number of rays in a batch."""

    rays: float
    batch: int


@cache
def unit_rays():
    """(6, RAYS) float32: a sky's photons on a cube with edge 1."""
    cube = Medium(np.ones((1, 1, 1)), 1.0, 0, 1)
    origins, directions, _ = Sky(1.0).emit(RAYS, cube, np.random.default_rng(0), 0)
    return np.concatenate([origins, directions], axis=1).T.astype(np.float32)


def rays_through(grid, count):
    """(6, count) float32 of `unit_rays`, in fine cells: every so many of them."""
    rays = unit_rays()[:, :: RAYS // count].copy()
    rays[:3] *= np.float32(grid.fine.upper[0])
    return rays


class Point:
    """One sampler on one grid, which can be timed at any density."""

    def __init__(self, grid, found):
        self.grid, self.paths = grid, backend_of(found).paths(grid)
        self.most_items = self.paths.items
        self.units = self.paths.queue.device.max_compute_units
        self._seconds(1, np.inf, 0)  # builds the program

    def speed(self, per_depth):
        """The `Speed`, where an optical depth of 1 is `per_depth` fine cells times density."""
        count = FEWEST
        seconds = [self._seconds(count, per_depth, 0)]
        while seconds[0] < BATCH_SECONDS and count < RAYS:
            count *= 2
            seconds = [self._seconds(count, per_depth, 0)]
        while sum(seconds) < POINT_SECONDS:
            seconds.append(self._seconds(count, per_depth, len(seconds)))
        return Speed(count / float(np.median(seconds)), count)

    def steps(self, per_depth):
        """Cells and particles per ray, on average, counted by the NumPy twin: columns of a row."""
        rays = rays_through(self.grid, PROFILED // (4 if self.grid.procedural else 1))
        going = np.arange(rays.shape[1])
        walk = paths_numpy._Walk(self.grid, rays, per_depth, 0, going)
        walk.start_flights(going)
        events = np.zeros(4)
        while len(going):
            event = walk.advance(going)
            events += np.bincount(event, minlength=4)
            going = going[(event != paths_numpy.COLLIDED) & (event != paths_numpy.LEFT)]
        events /= rays.shape[1]
        return {
            "cells/ray": events[paths_numpy.CROSSED] + events[paths_numpy.LEFT],
            "particles/ray": events[paths_numpy.VIRTUAL] + events[paths_numpy.COLLIDED],
        }

    def stopped(self, per_depth):
        """The share of rays that collide."""
        count = RAYS // 16
        rays, indices = rays_through(self.grid, count), np.arange(count, dtype=np.uint32)
        distances, *_ = self.paths.free_paths(rays, indices, per_depth, 0, MOST_STEPS)
        return np.isfinite(distances).mean()

    def _seconds(self, count, per_depth, seed):
        # Each work-item gets several rays, so that the device does not wait for the longest path.
        group = 64 * self.units
        self.paths.items = min(self.most_items, max(1, count // (16 * group)) * group)
        rays, indices = rays_through(self.grid, count), np.arange(count, dtype=np.uint32)
        start = perf_counter()
        self.paths.free_paths(rays, indices, per_depth, seed, MOST_STEPS)
        return perf_counter() - start
