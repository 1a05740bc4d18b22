# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice on an OpenCL device, in float32; physical_numpy.py is the twin."""

from math import prod

import numpy as np
import pyopencl as cl

from .device import context, program, queue
from .physical_numpy import CROWDED, MEAN_LENGTH, REFLECTED, SECOND_MOMENT, WEIGHTS, open_faces

_GROUP = 64  # voxels that a work-group takes
_CONSTANTS = tuple(
    f"{name}={value:.9e}f"
    for name, value in (
        ("W_AXIS", WEIGHTS[0]),
        ("W_DIAGONAL", WEIGHTS[-1]),
        ("MEAN_LENGTH", MEAN_LENGTH),
        ("SECOND_MOMENT", SECOND_MOMENT),
        ("REFLECTED", REFLECTED),
        ("CROWDED", CROWDED),
    )
)


class OpenCLLattice:
    """The lattice of one band on a device, with the arguments of `physical_numpy.NumpyLattice`."""

    def __init__(self, depth, albedo, g, occlusion, occlusion_albedo, device):
        self.shape, self.voxels = depth.shape, prod(depth.shape)
        self.context, self.queue = context(device), queue(device)
        occluded = ("OCCLUSION",) if occlusion is not None else ()
        built = program(device, "lattice_physical.cl", _CONSTANTS + occluded)
        names = ("update", "read_fluence", "read_flux", "read_lost")
        self.kernels = {name: cl.Kernel(built, name) for name in names}
        self.range = (-(-self.voxels // _GROUP) * _GROUP,)

        floats = _state_size(self.shape)
        self.states = [self._buffer(floats) for _ in range(2)]
        self.power, self.drift = self._buffer(self.voxels), self._buffer(3 * self.voxels)
        self.depth = self._upload(depth)
        self.faces = self._upload(open_faces(depth, albedo, g, occlusion), np.uint8)
        self.reflected = self.occlusion = self.occlusion_albedo = None
        if occlusion is not None:
            self.reflected = self._buffer(self.voxels)
            self.occlusion = self._upload(occlusion)
            self.occlusion_albedo = self._upload(np.broadcast_to(occlusion_albedo, self.shape))
        factors = (1 - albedo * g, 1 - albedo * g * g, 1 - albedo)  # in float64: may be tiny
        self.medium = [self.occlusion, self.occlusion_albedo, *map(np.float32, factors)]
        sizes = np.uint32(_stride(self.shape)), np.uint32(_guard(self.shape))
        self.grid = [*map(np.int32, self.shape), *sizes]

    @staticmethod
    def buffers(shape, occluded):
        """{what: bytes} of device memory for a lattice of this shape."""
        state, voxels = 4 * _state_size(shape), 4 * prod(shape)
        plan = {"light": state, "next light": state, "optical depth": voxels}
        plan["open faces"] = voxels // 4
        plan |= {"power": voxels, "drift": 3 * voxels, "fluence": voxels, "flux": 3 * voxels}
        if occluded:
            plan |= {"reflected": voxels, "occlusion": voxels, "occlusion's albedo": voxels}
        return plan

    def start(self, source):
        """Dark, with a `Source`."""
        for state in self.states:  # the guards too: what lies there is read, though not used
            cl.enqueue_fill_buffer(self.queue, state, np.float32(0), 0, 4 * _state_size(self.shape))
        given = [(self.power, source.power), (self.drift, source.drift)]
        if self.reflected is not None:
            none = np.zeros(self.shape, np.float32)
            given.append((self.reflected, none if source.reflected is None else source.reflected))
        for buffer, values in given:
            cl.enqueue_copy(self.queue, buffer, np.ascontiguousarray(values, np.float32))

    def advance(self, steps):
        """Take so many steps, and wait for them."""
        for _ in range(steps):
            self._run("update", self.states[1])
            self.states.reverse()
        self.queue.finish()

    def fluence(self):
        """(nx, ny, nz) W/m^2, float32."""
        return self._read("read_fluence", self.shape)

    def flux(self):
        """(3, nx, ny, nz) W/m^2, float32."""
        return self._read("read_flux", (3, *self.shape))

    def lost(self):
        """(left (6,), stopped), as of the twin."""
        sums = self._read("read_lost", (7, self.shape[2]), (self.shape[2],), None)
        sums = sums.sum(axis=1, dtype=float)
        return sums[:6], float(sums[6])

    def _read(self, kernel, shape, items=None, group=(_GROUP,)):
        values = np.empty(shape, np.float32)
        buffer = self._buffer(values.size)
        self._run(kernel, buffer, items, group)
        cl.enqueue_copy(self.queue, values, buffer)
        return values

    def _run(self, kernel, result, items=None, group=(_GROUP,)):
        buffers = (self.states[0], self.depth, self.faces, self.power, self.drift, self.reflected)
        arguments = (*self.grid, *buffers, *self.medium, result)
        self.kernels[kernel](self.queue, items or self.range, group, *arguments)

    def _upload(self, values, kind=np.float32):
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, kind))

    def _buffer(self, floats):
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, 4 * floats)


def _guard(shape):
    """Floats before and behind the light, as far as the voxel upstream can lie beyond it."""
    return shape[1] * shape[2] + shape[2] + 1


def _stride(shape):
    """Floats from one direction's light to the next one's.

    Never a multiple of 1024: caches would hold only few of the 18 at a time.
    """
    stride = -(-prod(shape) // 16) * 16
    return stride + 16 if stride % 1024 == 0 else stride


def _state_size(shape):
    return 18 * _stride(shape) + 2 * _guard(shape)
