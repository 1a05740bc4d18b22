# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths on an OpenCL device: kernels/photons/paths.cl with photons/free_path.cl or
photons/photons.cl."""

from collections.abc import Iterable
from functools import cache
from math import prod
from typing import Any

import numpy as np
import pyopencl as cl

from ...arrays import Array, Floats, Integers
from ..device import Device, context, program, queue
from .path_grid import PathGrid
from .tallies import (
    SUMS,
    UNIT,
    Opaque,
    Selection,
    Tallies,
    in_weights,
    kinds,
)

GROUP = 64  # work-items; a multiple of every vector's width
_GROUPS_A_UNIT = 16  # compute units that finish early take more


class OpenclPaths:
    """Paths through one `PathGrid` on a device. `NumpyPaths` is its twin."""

    def __init__(self, grid: PathGrid, device: Device) -> None:
        self.grid, self.device = grid, device
        self.context, self.queue = context(device), queue(device)
        self.items = self.queue.device.max_compute_units * _GROUPS_A_UNIT * GROUP
        self.arguments = self._grid_arguments()

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
        count = rays.shape[1]
        if count == 0:
            return np.empty(0, np.float32), 0, 0
        numbers = indices.astype(
            np.uint32
        )  # kept alive: the call returns before the kernel reads it
        distances = np.empty(count, np.float32)
        result = self.output(distances.nbytes)
        met, flaws = (self.output(4 * self.items) for _ in range(2))
        kernel(self.program("photons/free_path.cl"), "free_paths")(
            *(self.queue, (self.items,), (GROUP,), *self.arguments, np.float32(per_depth)),
            *(self.upload(rays), self.upload(numbers), np.int32(count)),
            *(np.uint32(seed), np.int32(most_steps), result, met, flaws),
        )
        cl.enqueue_copy(self.queue, distances, result)
        particles, violations = (int(self.read(b, np.int32).sum()) for b in (met, flaws))
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
        direct, flux, _ = selection
        self.tally_shape, self.kinds = shape, kinds(*selection)
        self.tally_arguments: tuple[Any, ...] = (
            *map(np.int32, shape),
            np.float32(lower),
            np.float32(per_cell),
        )
        defines = {"KEEP_DIRECT": direct, "KEEP_FLUX": flux, "OCCLUSION": opaque is not None}
        self.photons = self.program(
            *("photons/scatter.cl", "photons/photons.cl"),
            defined=tuple(name for name, on in defines.items() if on),
        )
        self.opaque: list[Any] = (
            [self.output(4)] * 2 if opaque is None else [*map(self.upload, opaque)]
        )
        # A tally has two words, and OpenCL has no empty buffers.
        self.tallies = [self._zeros(max(8 * prod(shape) * n, 8)) for n in self.kinds]
        self.before = self._zeros(8 * prod(shape))
        self.deviation = self._zeros(4 * prod(shape))
        self.sums = self._zeros(8 * SUMS * self.items)

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
        if photons.shape[1] == 0:
            return
        kernel(self.photons, "trace_photons")(
            *(self.queue, (self.items,), (GROUP,), *self.arguments, np.float32(per_depth)),
            *(self.upload(photons), np.int32(photons.shape[1]), np.int32(copies)),
            *(np.uint32(seed), np.uint32(first), np.int32(most_steps)),
            *map(np.float32, (*optics, spacing)),
            *(np.int32(last), *self.opaque, *self.tally_arguments, *self.tallies, self.sums),
        )
        self.queue.finish()

    def take_batch(self, batch: int) -> None:
        """Add the scores since the last batch to the variance; batches count from 1."""
        kernel(self.photons, "take_batch")(
            *(self.queue, (prod(self.tally_shape),), None, self.tallies[1], np.int32(batch)),
            *(self.before, self.deviation),
        )

    def read_tallies(self) -> Tallies:
        """The `Tallies` of all batches."""
        direct, scattered, source = (
            self._weights(tally, kinds)
            for tally, kinds in zip(self.tallies, self.kinds, strict=True)
        )
        deviation = self.read(self.deviation, np.float32)
        sums = self.read(self.sums, np.int64).reshape(-1, SUMS).sum(axis=0)
        return Tallies(direct, scattered, source, deviation, in_weights(sums))

    def _weights(self, tally: cl.Buffer, kinds: int) -> Floats:
        """(voxels, kinds) float32 of the two words of each tally."""
        voxels = prod(self.tally_shape)
        if not kinds:
            return np.empty((voxels, 0), np.float32)
        lower, upper = self.read(tally, np.uint32).reshape(2, voxels, kinds)
        weights = upper * np.float32(2**32 / UNIT)
        weights += lower * np.float32(1 / UNIT)
        return weights

    def read(self, buffer: cl.Buffer, kind: type[np.generic]) -> Array:
        values = np.empty(buffer.size // np.dtype(kind).itemsize, kind)
        cl.enqueue_copy(self.queue, values, buffer)
        return values

    def program(self, *kernels: str, defined: Iterable[str] = ()) -> cl.Program:
        """The program of files in kernels/ for this grid."""
        grid = self.grid
        noise = ["photons/perlin.cl"] if grid.procedural else []
        defines = {
            "RAY_MARCH": grid.sampler == "ray_march",
            "WOODCOCK": grid.sampler == "woodcock",
            "POLYNOMIAL": grid.polynomial,
            "LINEAR": grid.linear,
            "PERLIN_MEDIUM": grid.procedural,
        }
        return program(
            self.device,
            ("photons/random.cl", *noise, "photons/paths.cl", *kernels),
            (*(name for name, on in defines.items() if on), *defined),
        )

    def _grid_arguments(self) -> tuple[Any, ...]:
        """All but the last (per_depth) of GRID_PARAMETERS in kernels/photons/paths.cl."""
        grid, fine = self.grid, self.grid.fine
        density = None if grid.procedural else self.upload(fine.values)
        medium: tuple[Any, ...] = (density,) if density else grid.noise.device_arguments
        # Ray marching uses the density as its majorant; noise has no grid, and needs none.
        majorants = density if grid.majorants is None else self.upload(grid.majorants.values)
        return (
            *medium,
            majorants or self.output(4),
            *map(np.int32, (*fine.shape, *grid.cells, grid.size)),
            *map(np.float32, (fine.lower, *fine.upper, grid.global_majorant)),
        )

    def upload(self, values: Array) -> cl.Buffer:
        """A buffer of `values`; the array itself where the device shares the memory."""
        flags = cl.mem_flags
        keep = flags.USE_HOST_PTR if self.device.shares_memory else flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags.READ_ONLY | keep, hostbuf=values)

    def output(self, size: int) -> cl.Buffer:
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)

    def _zeros(self, size: int) -> cl.Buffer:
        buffer = self.output(size)
        self._clear(buffer)
        return buffer

    def _clear(self, buffer: cl.Buffer) -> None:
        cl.enqueue_fill_buffer(self.queue, buffer, np.uint32(0), 0, buffer.size)


@cache
def kernel(program: cl.Program, name: str) -> cl.Kernel:
    """A kernel of a program, cached: creating one takes as long as tracing a thousand photons."""
    return cl.Kernel(program, name)
