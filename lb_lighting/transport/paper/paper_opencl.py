# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's lattice on an OpenCL device, by one of its three kernels (paper 1, section 3.1)."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from math import prod
from typing import Any

import numpy as np
import pyopencl as cl

from ...arrays import Array, Floats, Integers
from ...errors import DeviceError
from ..device import Device, context, program, queue
from ..lattice.d3q19 import DIRECTIONS
from ..medium import Medium
from .paper_numpy import senders, set_initial_light


class PaperLattice:
    """The lattice of one medium on a device: two states that take turns, float32.

    kernel         "naive" (directions fastest in memory, a table of targets), "final" (DEPTH
                   fastest, targets computed) or "coalesced" (the same, written by stripes)
    keep_absorbed  whether absorbed light is kept and emitted again
    """

    def __init__(self, medium: Medium, keep_absorbed: bool, device: Device, kernel: str) -> None:
        self.shape, self.naive = medium.shape, kernel == "naive"
        self.context, self.queue = context(device), queue(device)
        defines = [
            f"{name}={n}" for name, n in zip(("WIDTH", "HEIGHT", "DEPTH"), self.shape, strict=True)
        ]
        defines.append(f"FIRST={0 if keep_absorbed else 1}")
        if medium.occlusion is not None:
            defines.append("OCCLUSION")
        self.update = cl.Kernel(program(device, f"paper/{kernel}.cl", tuple(defines)), "update")
        self.group = self._work_group(kernel)

        self.omega = self._buffer(19 * 19 * 4)
        self.states = [self._buffer(4 * self._state_size()) for _ in range(2)]
        self.density = self._upload(medium.density)
        occlusion = [] if medium.occlusion is None else [self._upload(medium.occlusion)]
        targets = self._targets() if self.naive else DIRECTIONS.astype(np.int32)
        self.arguments = [self.omega, self.density, *occlusion, self._upload(targets)]

    @staticmethod
    def buffers(shape: Sequence[int], kernel: str, occluded: bool) -> dict[str, int]:
        """{name: bytes} of device memory for a lattice of this shape."""
        nodes = prod(shape)
        plan = {
            "light": 19 * 4 * nodes,
            "next light": 19 * 4 * nodes,
            "density": 4 * nodes,
            "collision matrix": 19 * 19 * 4,
        }
        if occluded:
            plan["occlusion"] = 4 * nodes
        if kernel == "naive":
            plan["targets"] = 19 * 4 * nodes
        return plan

    def start(self, inflow: Floats, omega: Floats) -> None:
        """Set the light that enters, (19,) by direction, and the collision matrix (19, 19)."""
        for state in self.states:  # steps never write to the boundary, so both states hold it
            with self._mapped(state, cl.map_flags.WRITE_INVALIDATE_REGION) as light:
                set_initial_light(light, inflow)
        cl.enqueue_copy(self.queue, self.omega, omega.astype(np.float32))

    def advance(self, steps: int) -> None:
        """Take a number of steps, and wait for them."""
        for _ in range(steps):
            self.update(self.queue, self.shape[::-1], self.group, *self.states, *self.arguments)
            self.states.reverse()
        self.queue.finish()

    def read(self, previous: bool = False) -> AbstractContextManager[Floats]:
        """The light, or that of one step before, (19, nx, ny, nz) float32, as a context.

        The array is the device's own memory where the host shares it; it is valid in the context.
        """
        return self._mapped(self.states[1 if previous else 0], cl.map_flags.READ)

    def _work_group(self, kernel: str) -> tuple[int, ...] | None:
        """The paper's stripe along DEPTH; None, the driver's choice, if it is too long."""
        if self.shape[2] <= self.queue.device.max_work_group_size:
            return (self.shape[2], 1, 1)
        if kernel == "coalesced":
            raise DeviceError(
                f"The coalesced kernel takes {self.queue.device.max_work_group_size} voxels along "
                f"z at most on this device, not {self.shape[2]}; use the final kernel."
            )
        return None

    def _state_size(self) -> int:
        return 19 * (prod(self.shape) + (1 if self.naive else 0))  # 1: the sink

    @contextmanager
    def _mapped(self, state: cl.Buffer, access: Any) -> Iterator[Floats]:
        """A state as an array of the host, by direction; mapping it spares CPUs a copy."""
        values, _ = cl.enqueue_map_buffer(
            self.queue, state, access, 0, (self._state_size(),), np.dtype(np.float32)
        )
        try:
            yield self._by_direction(values)
        finally:
            values.base.release(self.queue)

    def _by_direction(self, values: Floats) -> Floats:
        """The view (19, nx, ny, nz) of a state in the device's order."""
        nx, ny, nz = self.shape
        if self.naive:
            return np.moveaxis(values[:-19].reshape(nx, ny, nz, 19), 3, 0)
        return np.moveaxis(values.reshape(nx, ny, 19, nz), 2, 0)

    def _targets(self) -> Integers:
        """(nx, ny, nz, 19) uint32: the node that each flow reaches, or the sink."""
        sink = prod(self.shape)
        nodes = np.arange(sink, dtype=np.uint32).reshape(self.shape)
        targets = np.full((*self.shape, 19), sink, np.uint32)
        for m, c in enumerate(DIRECTIONS):
            targets[..., m][senders(self.shape, c)] = nodes[1:-1, 1:-1, 1:-1]
        return targets

    def _upload(self, values: Array) -> cl.Buffer:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=values)

    def _buffer(self, size: int) -> cl.Buffer:
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)
