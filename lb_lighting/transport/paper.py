# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's lattice on an OpenCL device, by one of its three kernels (paper 1, section 3.1)."""

from math import prod

import numpy as np
import pyopencl as cl

from ..errors import DeviceError
from .device import context, program, queue, require_memory
from .lattice import DIRECTIONS
from .reference import initial_light

KERNELS = ("naive", "final", "coalesced")


class PaperLattice:
    """The lattice of one medium on a device: two states in turn, float32.

    kernel         "naive" (directions fastest in memory, a table of targets), "final" (DEPTH
                   fastest, targets computed) or "coalesced" (the same, written by stripes)
    keep_absorbed  whether absorbed light stays, and is emitted again, or is dropped
    """

    def __init__(self, medium, keep_absorbed, device, kernel):
        self.shape, self.naive = medium.shape, kernel == "naive"
        self.bytes = require_memory(
            device, self.shape, lambda shape: self.buffers(shape, kernel, medium.occlusion)
        )
        self.context, self.queue = context(device), queue(device)
        defines = [
            f"{name}={n}" for name, n in zip(("WIDTH", "HEIGHT", "DEPTH"), self.shape, strict=True)
        ]
        defines.append(f"FIRST={0 if keep_absorbed else 1}")
        if medium.occlusion is not None:
            defines.append("OCCLUSION")
        self.update = cl.Kernel(program(device, f"lattice_{kernel}.cl", tuple(defines)), "update")
        self.group = self._work_group(kernel)

        self.omega = self._buffer(19 * 19 * 4)
        self.states = [self._buffer(4 * self._state_size()) for _ in range(2)]
        self.density = self._upload(medium.density)
        occlusion = [] if medium.occlusion is None else [self._upload(medium.occlusion)]
        targets = self._targets() if self.naive else DIRECTIONS
        self.arguments = [self.omega, self.density, *occlusion, self._upload(targets, np.int32)]

    @staticmethod
    def buffers(shape, kernel, occlusion):
        """{what: bytes} of device memory for a lattice of this shape."""
        nodes = prod(shape)
        plan = {
            "light": 19 * 4 * nodes,
            "next light": 19 * 4 * nodes,
            "density": 4 * nodes,
            "collision matrix": 19 * 19 * 4,
        }
        if occlusion is not None:
            plan["occlusion"] = 4 * nodes
        if kernel == "naive":
            plan["targets"] = 19 * 4 * nodes
        return plan

    def start(self, inflow, omega):
        """Set the light that enters, (19,) by direction, and the collision matrix (19, 19)."""
        light = self._to_device(initial_light(self.shape, inflow).astype(np.float32))
        for state in self.states:  # the boundary is never written, so both hold it
            cl.enqueue_copy(self.queue, state, light)
        cl.enqueue_copy(self.queue, self.omega, omega.astype(np.float32))

    def advance(self, steps):
        """Take so many steps, and wait for them."""
        for _ in range(steps):
            self.update(self.queue, self.shape[::-1], self.group, *self.states, *self.arguments)
            self.states.reverse()
        self.queue.finish()

    def read(self):
        """(light, light one step before), each (19, nx, ny, nz) float32."""
        return tuple(self._to_host(state) for state in self.states)

    def _work_group(self, kernel):
        """The paper's: a stripe along DEPTH; left to the driver where one is too long for it."""
        if self.shape[2] <= self.queue.device.max_work_group_size:
            return (self.shape[2], 1, 1)
        if kernel == "coalesced":
            raise DeviceError(
                f"The coalesced kernel takes {self.queue.device.max_work_group_size} voxels along "
                f"z at most on this device, not {self.shape[2]}; use the final kernel."
            )
        return None

    def _state_size(self):
        return 19 * int(np.prod(self.shape)) + (1 if self.naive else 0)  # 1: the sink

    def _to_device(self, light):
        if self.naive:
            return np.append(np.moveaxis(light, 0, 3).ravel(), np.float32(0))
        return np.ascontiguousarray(np.moveaxis(light, 0, 2))

    def _to_host(self, state):
        nx, ny, nz = self.shape
        light = np.empty(self._state_size(), np.float32)
        cl.enqueue_copy(self.queue, light, state)
        if self.naive:
            return np.moveaxis(light[:-1].reshape(nx, ny, nz, 19), 3, 0)
        return np.moveaxis(light.reshape(nx, ny, 19, nz), 2, 0)

    def _targets(self):
        """(nx, ny, nz, 19), where each flow goes in the naive layout; the sink if nowhere."""
        nodes = np.stack(np.indices(self.shape), axis=-1)[..., None, :]
        out = nodes + DIRECTIONS
        inside = np.all((out > 0) & (out < np.subtract(self.shape, 1)), axis=-1)
        index = np.ravel_multi_index(np.moveaxis(out, -1, 0), self.shape, mode="clip")
        return np.where(inside, index * 19 + np.arange(19), 19 * int(np.prod(self.shape)))

    def _upload(self, values, dtype=np.float32):
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, dtype))

    def _buffer(self, size):
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)
