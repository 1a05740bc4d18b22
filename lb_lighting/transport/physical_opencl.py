# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice on an OpenCL device, in float32; physical_numpy.py is the twin."""

import numpy as np
import pyopencl as cl

from .borders import REFLECTED, mirrors
from .cells import GROUP, MEAN_LENGTH, SECOND_MOMENT, WEIGHTS, Cells
from .device import context, program, queue
from .physical_numpy import CROWDED

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
            ("CROWDED", CROWDED),
        )
    ),
)


class OpenCLLattice:
    """The lattice of one band on a device, with the arguments of `physical_numpy.NumpyLattice`."""

    def __init__(self, depth, albedo, g, occlusion, occlusion_albedo, device):
        self.shape, self.cells = depth.shape, Cells(depth.shape)
        self.context, self.queue = context(device), queue(device)
        self.program = program(device, ("cells.cl", "lattice_physical.cl"), _CONSTANTS)
        self.kernels = {kernel.function_name: kernel for kernel in self.program.all_kernels()}
        self.light = self._buffer(_state_size(self.cells))
        self.source = self._buffer(4 * self.cells.count)
        self.swapped = np.int32(0)

        cells = self.cells
        outside, within = mirrors(np.asarray(depth, float), albedo, g, occlusion, cells)
        depths = np.where(cells.is_inside(), cells.flat(depth), -1 - outside / REFLECTED)
        self.depths = self._upload(depths)
        factors = (1 - albedo * g, 1 - albedo * g * g, 1 - albedo)  # in float64: may be tiny
        grid = (cells.plane, cells.row, _stride(cells), cells.first)
        self.grid = [np.uint64(n) for n in grid]
        self.medium = [self.depths, *map(np.float32, factors)]
        self.mirrors = self._mirrors(within)
        self.occluders = None
        if occlusion is not None:
            self.occluders = _Occluders(self, occlusion, occlusion_albedo)

    def _mirrors(self, within):
        """(cells, arguments of the kernel `mirror`)."""
        faces = np.concatenate([np.full(len(at), face) for face, (at, _) in within.items()])
        at, shares = (np.concatenate(values) for values in zip(*within.values(), strict=True))
        if not len(at):
            return 0, ()
        arrays = (at.astype(np.int32), faces.astype(np.int32), shares.astype(np.float32))
        return len(at), [self._upload(array, array.dtype) for array in arrays]

    @staticmethod
    def buffers(shape, occluded):
        """{what: bytes} of device memory for a lattice of this shape, but for its flat faces."""
        cells, voxels = Cells(shape), 4 * int(np.prod(shape))
        plan = {"light": 4 * _state_size(cells), "optical depth": 4 * cells.count}
        plan |= {"source": 16 * cells.count, "fluence": voxels, "flux": 3 * voxels}
        if occluded:
            plan |= {"occluders": 6 * 4 * cells.count}
        return plan

    def start(self, source):
        """Dark, with a `Source`."""
        # The guards too: what lies there is read.
        cl.enqueue_fill_buffer(self.queue, self.light, np.float32(0), 0, self.light.size)
        self.swapped = np.int32(0)
        given = np.concatenate([source.power[None], source.drift]).astype(np.float32)
        cl.enqueue_copy(self.queue, self.source, self.cells.flat(given))
        if self.occluders is not None:
            self.occluders.start(source.reflected)

    def advance(self, steps):
        """Take so many steps, and wait for them."""
        cells = np.uint64(self.cells.count)
        for _ in range(steps):
            kernel = self.kernels["step_there" if self.swapped else "step_here"]
            arguments = (*self.grid, *self.medium, self.source, cells, self.light)
            kernel(self.queue, (self.cells.count,), (GROUP,), *arguments)
            self.swapped = np.int32(not self.swapped)
            count, mirrors_of = self.mirrors
            if count:
                arguments = (*self.grid, self.light, self.swapped, *mirrors_of)
                self.kernels["mirror"](self.queue, (count,), None, *arguments)
            if self.occluders is not None:
                self.occluders.meet()
        self.queue.finish()

    def fluence(self, every=1):
        """(nx, ny, nz) W/m^2, float32; of every n-th layer along x."""
        nx, ny, nz = self.shape
        return self._read("read_fluence", (-(-nx // every), ny, nz), every)

    def flux(self):
        """(3, nx, ny, nz) W/m^2, float32."""
        return self._read("read_flux", (3, *self.shape))

    def lost(self):
        """(left (6,), stopped), as of the twin."""
        nx, ny, nz = self.shape
        left = np.empty((6, nz), np.float32)
        buffer = self._buffer(left.size)
        arguments = (*self.grid, self.light, self.swapped, self.depths)
        arguments += (np.uint64(self.cells.first), np.int32(nx), np.int32(ny), buffer)
        self.kernels["read_left"](self.queue, (nz,), None, *arguments)
        cl.enqueue_copy(self.queue, left, buffer)
        stopped = 0.0 if self.occluders is None else self.occluders.stopped()
        return left.sum(axis=1, dtype=float), stopped

    def _read(self, kernel, shape, every=1):
        values = np.empty(shape, np.float32)
        buffer = self._buffer(values.size)
        arguments = (*self.grid, self.light, self.swapped, *self.medium, self.source)
        arguments += (np.uint64(self.cells.count), np.uint64(self.cells.first))
        items = shape[-3:][::-1]
        self.kernels[kernel](self.queue, items, None, *arguments, np.uint64(every), buffer)
        cl.enqueue_copy(self.queue, values, buffer)
        return values

    def _upload(self, values, kind=np.float32):
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, kind))

    def _buffer(self, floats):
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, 4 * floats)


class _Occluders:
    """The opaque voxels of a lattice, and what they do to its light after each step."""

    def __init__(self, lattice, occlusion, albedo):
        self.lattice, cells = lattice, lattice.cells
        opaque = cells.flat(np.asarray(occlusion, np.float32))
        near = sum(np.roll(opaque > 0, step) for step in (0, *cells.steps)) > 0
        self.at = np.flatnonzero(near & cells.is_inside()).astype(np.int32)
        albedo = cells.flat(np.broadcast_to(albedo, cells.shape).astype(np.float32))
        grids = [lattice._upload(values) for values in (opaque, albedo)]
        self.arguments = [lattice.depths, *grids, lattice._upload(self.at, np.int32)]
        self.reflected = lattice._buffer(cells.count)
        self.densities = lattice._upload(np.zeros(cells.count))
        self.absorbed = lattice._upload(np.zeros(max(1, len(self.at))))

    def start(self, reflected):
        """reflected is that of a `Source`."""
        none = np.zeros(self.lattice.shape)
        values = self.lattice.cells.flat(none if reflected is None else reflected)
        cl.enqueue_copy(self.lattice.queue, self.reflected, values.astype(np.float32))

    def meet(self):
        """What the light of the last step meets on its way."""
        if not len(self.at):
            return
        lattice, items = self.lattice, (len(self.at),)
        arguments = (*lattice.grid, lattice.light, lattice.swapped, *self.arguments)
        for name, rest in (
            ("reflect", (self.reflected, self.densities)),
            ("meet", (self.densities, self.absorbed)),
        ):
            lattice.kernels[name](lattice.queue, items, None, *arguments, *rest)

    def stopped(self):
        """W/m^2, the sum of what was absorbed of the last step."""
        values = np.empty(self.absorbed.size // 4, np.float32)
        cl.enqueue_copy(self.lattice.queue, values, self.absorbed)
        return float(values.sum(dtype=float))


def _stride(cells):
    """Floats from one direction's light to the next one's: between them there is room for what
    cells at either end take from beyond it.

    Never a multiple of 1024: caches would hold only few of the 18 at a time.
    """
    floats = cells.count + -(-cells.first // 16) * 16
    return floats + 16 if floats % 1024 == 0 else floats


def _state_size(cells):
    return 18 * _stride(cells) + cells.first
