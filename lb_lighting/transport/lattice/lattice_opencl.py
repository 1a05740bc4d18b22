# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice on an OpenCL device, in float32: kernels/lattice."""

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
import pyopencl as cl

from ...arrays import Floats, Integers
from ..device import (
    Device,
    context,
    program,
    queue,
    upload,
    zeros,
)
from .boundary import REFLECTED, reflection
from .lattice_numpy import DIAGONAL_BLOCKING, Source
from .layout import (
    GROUP,
    MEAN_LENGTH,
    OPPOSITE,
    SECOND_MOMENT,
    WEIGHTS,
    Cells,
)
from .multigrid import shapes

_SOURCES = ("lattice/layout.cl", "lattice/lattice.cl", "lattice/multigrid.cl")

_SLAB = 8  # planes of a coarser lattice that are restricted or prolongated at a time
_CONSTANTS = (
    f"GROUP={GROUP}",
    *(
        f"{name}={value:.9e}f"
        for name, value in (
            ("W_AXIS", WEIGHTS[0]),
            ("W_DIAGONAL", WEIGHTS[-1]),
            ("MEAN_LENGTH", MEAN_LENGTH),
            ("SECOND_MOMENT", SECOND_MOMENT),
            ("REFLECTED", REFLECTED),
            ("DIAGONAL_BLOCKING", DIAGONAL_BLOCKING),
        )
    ),
)


class OpenclLattice:
    """The lattice of one band on a device; it takes the calls of `lattice_numpy.NumpyLattice`."""

    def __init__(
        self,
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None,
        occlusion_albedo: Any,
        device: Device,
        edge: float | None = None,
    ) -> None:
        self.shape, self.cells = depth.shape, Cells(depth.shape)
        self.context, self.queue = context(device), queue(device)
        self.program = program(device, _SOURCES, _CONSTANTS)
        self.kernels = {kernel.function_name: kernel for kernel in self.program.all_kernels()}
        self.light = self._buffer(_state_size(self.cells))
        self.swapped = np.int32(0)
        self.kind: str | None = None

        cells = self.cells
        outside, within = reflection(np.asarray(depth, float), albedo, g, occlusion, cells, edge)
        depths = np.where(cells.is_inside(), cells.flat(depth), -1 - outside / REFLECTED)
        self.depths = upload(self.queue, depths)
        factors = (
            1 - albedo * g,
            1 - albedo * g * g,
            1 - albedo,
        )  # float64: they may be tiny
        grid = (cells.plane, cells.row, _stride(cells), cells.first)
        self.grid = [np.uint64(n) for n in grid]
        self.origin = np.uint64(cells.first)
        self.medium = [self.depths, *map(np.float32, factors)]
        self.reflection = self._reflection(within)
        self.occluders = None
        if occlusion is not None:
            self.occluders = _Occluders(self, occlusion, occlusion_albedo)

    def _reflection(
        self, within: dict[int, tuple[Integers, Floats]]
    ) -> tuple[int, Sequence[cl.Buffer]]:
        """(cells, arguments of the kernel `mirror`)."""
        faces = np.concatenate([np.full(len(at), face) for face, (at, _) in within.items()])
        at, shares = (np.concatenate(values) for values in zip(*within.values(), strict=True))
        if not len(at):
            return 0, ()
        arrays = (at.astype(np.int32), faces.astype(np.int32), shares.astype(np.float32))
        return len(at), [upload(self.queue, array, array.dtype) for array in arrays]

    @staticmethod
    def buffers(shape: Sequence[int], occluded: bool) -> dict[str, int]:
        """{name: bytes} of device memory for a lattice of this shape and all coarser ones, without
        the reflection of flat faces."""
        cells, voxels = Cells(shape), 4 * prod(shape)
        matter = 4 + 6 * 4 * occluded  # bytes of each cell
        plan = {"light": 4 * _state_size(cells), "medium": matter * cells.count}
        plan |= {"source": 16 * cells.count, "fluence": voxels, "flux": 3 * voxels}
        for coarser in shapes(shape):
            cells = Cells(coarser)
            plan["coarser lattices"] = plan.get("coarser lattices", 0) + (
                8 * _state_size(cells) + matter * cells.count + 4 * _parts_size(coarser)
            )
        return plan

    def start(self, source: Source) -> None:
        """As the twin's."""
        given = np.concatenate([source.power[None], source.drift]).astype(np.float32)
        self.source = [upload(self.queue, self.cells.flat(given)), np.uint64(self.cells.count)]
        self.kind = "step"
        self._start_dark(source.reflected)

    def start_as_coarser(self) -> None:
        """As the twin's."""
        if self.kind is None:
            self.kind, self.source = "step_coarser", [self._buffer(_state_size(self.cells))]
            self.parts = self._buffer(_parts_size(self.shape))
        self._darken(*self.source)
        self._start_dark(None)

    def _start_dark(self, reflected: Floats | None) -> None:
        if self.occluders is not None:
            self.occluders.start(reflected)
        self._darken(self.light)  # the guards, too: kernels read them
        self.swapped = np.int32(0)

    def _darken(self, buffer: cl.Buffer) -> None:
        cl.enqueue_fill_buffer(self.queue, buffer, np.float32(0), 0, buffer.size)

    def advance(self, steps: int) -> None:
        """Take a number of steps."""
        for _ in range(steps):
            kernel = self.kernels[f"{self.kind}_there" if self.swapped else f"{self.kind}_here"]
            arguments = (*self.grid, *self.medium, *self.source, self.light)
            kernel(self.queue, (self.cells.count,), (GROUP,), *arguments)
            self.swapped = np.int32(not self.swapped)
            count, reflecting = self.reflection
            if count:
                arguments = (*self.grid, self.light, self.swapped, *reflecting)
                self.kernels["mirror"](self.queue, (count,), None, *arguments)
            if self.occluders is not None:
                self.occluders.meet()

    def restrict(self, coarser: "OpenclLattice", factor: float) -> None:
        """As the twin's."""
        (_, ny, nz), (given, parts) = coarser.shape, (coarser.source[0], coarser.parts)
        across = (*self.grid, self.light, self.swapped, self.depths, self.origin, self.medium[1])
        down = (*coarser.grid, coarser.depths, coarser.origin, self.medium[1])
        depth = np.uint64(self.shape[2])
        for begin, planes in coarser._slabs():
            self._run("sum_across", (self.shape[2], ny, planes), *across, begin, parts)
            rest = (begin, depth, parts, np.float32(factor), given)
            self._run("restrict_light", (nz, ny, planes), *down, *rest)

    def prolongate(self, coarser: "OpenclLattice", factor: float) -> None:
        """As the twin's."""
        (nx, ny, nz), parts = coarser.shape, coarser.parts
        above = (*coarser.grid, coarser.light, coarser.swapped, coarser.origin)
        here = (*self.grid, self.light, self.swapped, self.depths, self.origin, self.medium[1])
        over = (coarser.depths, *coarser.grid[:2], coarser.origin, np.uint64(ny))
        depth = self.shape[2]
        for begin, planes in coarser._slabs():
            rest = (begin, np.uint64(nx), np.uint64(nz), parts)
            self._run("interpolate", (depth, ny, planes + 2), *above, *rest)
            rest = (begin, *over, np.uint64(planes + 2), parts, np.float32(factor))
            layers = min(2 * planes, self.shape[0] - 2 * int(begin))
            self._run("prolongate", (depth, self.shape[1], layers), *here, *rest)

    def _slabs(self) -> list[tuple[np.uint64, int]]:
        """[(first plane, planes)] that are restricted or prolongated at a time."""
        nx = self.shape[0]
        return [(np.uint64(x), min(_SLAB, nx - x)) for x in range(0, nx, _SLAB)]

    def _run(self, kernel: str, items: tuple[int, ...], *arguments: Any) -> None:
        self.kernels[kernel](self.queue, items, None, *arguments)

    def fluence(self, every: int = 1) -> Floats:
        """(nx, ny, nz) W/m^2, float32; of every n-th layer along x."""
        nx, ny, nz = self.shape
        return self._read("read_fluence", (-(-nx // every), ny, nz), every)

    def flux(self) -> Floats:
        """(3, nx, ny, nz) W/m^2, float32."""
        return self._read("read_flux", (3, *self.shape))

    def leaving(self) -> Iterator[Floats]:
        """As the twin's."""
        depths, light = np.empty((2, self.cells.count), np.float32)
        cl.enqueue_copy(self.queue, depths, self.depths)
        staying = np.where(depths < 0, REFLECTED * (-1 - depths), 0)
        for m, step in enumerate(self.cells.steps):
            lies = (OPPOSITE[m], 0) if self.swapped else (m, step)
            offset = self.cells.first + lies[0] * _stride(self.cells) + lies[1]
            cl.enqueue_copy(self.queue, light, self.light, src_offset=4 * int(offset))
            yield self.cells.inside((1 - np.roll(staying, -step)) * light)

    def lost(self) -> tuple[Floats, float]:
        """(left (6,), stopped), as of the twin."""
        nx, ny, nz = self.shape
        left = np.empty((6, nz), np.float32)
        buffer = self._buffer(left.size)
        arguments = (*self.grid, self.light, self.swapped, self.depths)
        arguments += (self.origin, np.int32(nx), np.int32(ny), buffer)
        self.kernels["read_left"](self.queue, (nz,), None, *arguments)
        cl.enqueue_copy(self.queue, left, buffer)
        stopped = 0.0 if self.occluders is None else self.occluders.stopped()
        return left.sum(axis=1, dtype=float), stopped

    def _read(self, kernel: str, shape: tuple[int, ...], every: int = 1) -> Floats:
        values = np.empty(shape, np.float32)
        buffer = self._buffer(values.size)
        arguments = (*self.grid, self.light, self.swapped, *self.medium, *self.source, self.origin)
        items = shape[-3:][::-1]
        self.kernels[kernel](self.queue, items, None, *arguments, np.uint64(every), buffer)
        cl.enqueue_copy(self.queue, values, buffer)
        return values

    def _buffer(self, floats: int) -> cl.Buffer:
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, 4 * floats)


class _Occluders:
    """The opaque voxels of a lattice, which stop and reflect its light after each step."""

    def __init__(self, lattice: OpenclLattice, occlusion: Floats, albedo: Any) -> None:
        self.lattice, cells = lattice, lattice.cells
        opaque = cells.flat(np.asarray(occlusion, np.float32))
        near = sum(np.roll(opaque > 0, step) for step in (0, *cells.steps)) > 0
        self.at = np.flatnonzero(near & cells.is_inside()).astype(np.int32)
        albedo = cells.flat(np.broadcast_to(albedo, cells.shape).astype(np.float32))
        grids = [upload(lattice.queue, values) for values in (opaque, albedo)]
        self.arguments = [lattice.depths, *grids, upload(lattice.queue, self.at, np.int32)]
        self.reflected = lattice._buffer(cells.count)
        self.densities = zeros(lattice.queue, 4 * cells.count)
        self.absorbed = zeros(lattice.queue, 4 * max(1, len(self.at)))

    def start(self, reflected: Floats | None) -> None:
        """Start with the reflected light of a `Source`."""
        if reflected is None:
            self.lattice._darken(self.reflected)
        else:
            values = self.lattice.cells.flat(reflected).astype(np.float32)
            cl.enqueue_copy(self.lattice.queue, self.reflected, values)

    def meet(self) -> None:
        """Stop and reflect the light of the last step."""
        if not len(self.at):
            return
        lattice, items = self.lattice, (len(self.at),)
        arguments = (*lattice.grid, lattice.light, lattice.swapped, *self.arguments)
        for name, rest in (
            ("reflect", (self.reflected, self.densities)),
            ("meet", (self.densities, self.absorbed)),
        ):
            lattice.kernels[name](lattice.queue, items, None, *arguments, *rest)

    def stopped(self) -> float:
        """W/m^2 that they absorbed in the last step, summed over voxels."""
        values = np.empty(self.absorbed.size // 4, np.float32)
        cl.enqueue_copy(self.lattice.queue, values, self.absorbed)
        return float(values.sum(dtype=float))


def _stride(cells: Cells) -> int:
    """Floats from one direction's light to the next. Between them are guards, which the cells at
    either end read.

    It is never a multiple of 1024, with which caches could hold only a few directions at a time.
    """
    floats = cells.count + -(-cells.first // 16) * 16
    return floats + 16 if floats % 1024 == 0 else floats


def _state_size(cells: Cells) -> int:
    return 18 * _stride(cells) + cells.first


def _parts_size(shape: tuple[int, ...]) -> int:
    """Floats of the buffer between a coarser lattice of this shape and the next finer one."""
    _, ny, nz = shape
    return ny * 2 * nz * max(21 * _SLAB, 18 * (_SLAB + 2))
