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
    Tallies,
    Wanted,
    in_weights,
    kinds,
)

GROUP = 64  # work-items; a multiple of every vector's width
_GROUPS_A_UNIT = 16  # so that compute units that are done early find more


class OpenclPaths:
    """Paths through one `PathGrid` on a device; `NumpyPaths` does the same."""

    def __init__(self, grid: PathGrid, device: Device) -> None:
        self.grid, self.device = grid, device
        self.context, self.queue = context(device), queue(device)
        self.items = self.queue.device.max_compute_units * _GROUPS_A_UNIT * GROUP
        self.arguments = self._grid_arguments()

    def free_paths(
        self, rays: Floats, indices: Integers, per_depth: float, seed: int, most_steps: int
    ) -> tuple[Floats, int, int]:
        """((n,) fine cells to the first real collision, particles met, bounds that were violated).

        rays     (6, n) float32: origins in the domain, in fine cells, and unit directions
        indices  (n,) the numbers of the rays, which choose their random numbers
        inf where a ray leaves, NaN where it takes over `most_steps` steps. Of the particles, real
        and virtual ones, and of the violated bounds it is the number in all rays
        """
        count = rays.shape[1]
        if count == 0:
            return np.empty(0, np.float32), 0, 0
        numbers = indices.astype(np.uint32)  # named, as the kernel reads it after its call returns
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
        wanted: Wanted,
        opaque: Opaque | None,
    ) -> None:
        """Empty tallies of `shape` voxels from `lower` on, 1 / `per_cell` fine cells an edge.

        wanted  whether these are: (direct, flux, handed)
        opaque  (occlusion, its albedo), (nx, ny, nz) float32 each, or None
        """
        direct, flux, _ = wanted
        self.tally_shape, self.kinds = shape, kinds(*wanted)
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
        # Two words a tally; and OpenCL has no empty buffers.
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

        photons  (7, n) float32: as `rays` of free_paths, and weights from 0 to HEAVIEST
        copies   paths that begin as each photon does
        first    number of the first path, which chooses its random numbers
        optics   (albedo, mean cosine)
        spacing  fine cells between two points where a path is scored
        last     the collision at which a photon is handed over, or 0
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
        """Tell that batch number `batch`, from 1 on, is complete."""
        kernel(self.photons, "take_batch")(
            *(self.queue, (prod(self.tally_shape),), None, self.tallies[1], np.int32(batch)),
            *(self.before, self.deviation),
        )

    def read_tallies(self) -> Tallies:
        """The `Tallies` of all batches."""
        direct, scattered, handed = (
            self._weights(tally, kinds)
            for tally, kinds in zip(self.tallies, self.kinds, strict=True)
        )
        deviation = self.read(self.deviation, np.float32)
        sums = self.read(self.sums, np.int64).reshape(-1, SUMS).sum(axis=0)
        return Tallies(direct, scattered, handed, deviation, in_weights(sums))

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
        """GRID_PARAMETERS of kernels/photons/paths.cl but for the last, per_depth."""
        grid, fine = self.grid, self.grid.fine
        density = None if grid.procedural else self.upload(fine.values)
        medium: tuple[Any, ...] = (density,) if density else grid.noise.device_arguments
        # Ray marching takes the density itself for a bound; noise has none, and needs none.
        bound = density if grid.majorants is None else self.upload(grid.majorants.values)
        return (
            *medium,
            bound or self.output(4),
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
    """A kernel of a program, kept: to make one takes as long as to trace a thousand photons."""
    return cl.Kernel(program, name)
