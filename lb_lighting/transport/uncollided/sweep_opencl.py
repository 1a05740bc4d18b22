# SPDX-License-Identifier: GPL-3.0-or-later
"""Parallel beams on an OpenCL device: kernels/uncollided/sweep.cl."""

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
import pyopencl as cl

from ...arrays import Floats
from ..device import (
    Device,
    program,
    queue,
    upload,
    zeros,
)
from ..monitor import NO_MONITOR, Monitor
from .sweep import STOPPED, Beam, Tallies, Turn, Voxels

_CANCEL_EVERY = 16  # layers

type Matter = tuple[cl.Buffer, np.uint64]
"""A buffer of bordered grids, one after the other, and the number of values in each."""


class _Layers:
    """Sends beams layer by layer through a turned domain, with kernels built with `macros`.

    emitting  whether rays start with a weight of 0
    """

    def __init__(self, turn: Turn, emitting: bool, macros: Sequence[str], device: Device) -> None:
        self.turn, self.emitting, self.queue = turn, emitting, queue(device)
        built = program(device, ("uncollided/attenuation.cl", "uncollided/sweep.cl"), tuple(macros))
        self.kernels = {name: cl.Kernel(built, name) for name in ("tally", "pass")}

    def _bordered(self, grids: Sequence[Floats | None]) -> Matter:
        """Turned grids of the box in the kernels' format of matter; zeros for None."""
        turn = self.turn
        layers, plane = turn.box_shape[0], turn.shape[1:]
        matter = np.zeros((len(grids), layers + 2, *(n + 2 for n in plane)), np.float32)
        inside = tuple(slice(a + 1, b + 1) for a, b in zip(turn.lower, turn.upper, strict=True))
        for values, grid in zip(matter, grids, strict=True):
            if grid is not None:
                values[1:-1, *inside[1:]] = grid
        return upload(self.queue, matter), np.uint64(matter[0].size)

    def _send(
        self, beams: Sequence[Beam], matter: Matter, tallied: Sequence[cl.Buffer], monitor: Monitor
    ) -> tuple[Floats, int]:
        """Send beams. Returns the same as `NumpySweep.run`.

        matter   as of `_bordered`
        tallied  the kernel's buffers: tallies, inside, sums
        """
        turn, beside, count = self.turn, max(b.beside for b in beams), len(beams[0].points)
        shape = (len(beams), count, turn.shape[1] + beside, turn.shape[2] + beside)
        rays = np.zeros(shape, np.float32) if self.emitting else np.ones(shape, np.float32)
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        buffer = cl.Buffer(self.queue.context, flags, hostbuf=rays)
        tallies, inside, sums = tallied
        for number, (arguments, is_in_box) in enumerate(self._layers(beams, matter, beside, count)):
            if monitor.cancel is not None and number % _CANCEL_EVERY == 0:
                self.queue.finish()  # otherwise all layers are enqueued before the first is done
                monitor.check()
            buffers = (buffer, tallies, np.uint64(prod(turn.shape)), inside, sums)
            self.kernels["tally"](self.queue, turn.shape[:0:-1], None, *arguments, *buffers)
            if is_in_box:
                items = (turn.box_shape[2] + 1, turn.box_shape[1] + 1, len(beams) * count)
                self.kernels["pass"](self.queue, items, None, *arguments, buffer)
        cl.enqueue_copy(self.queue, rays, buffer)
        return rays, beside

    def _layers(
        self, beams: Sequence[Beam], matter: Matter, beside: int, count: int
    ) -> Iterator[tuple[tuple[Any, ...], bool]]:
        """For each layer, in the order in which light reaches them: the arguments that both
        kernels share, and whether the layer is in the box."""
        turn, backward = self.turn, bool(beams[0].backward[0])
        (_, nu, nv), (begin, bu, bv), (layers, mu, mv) = turn.shape, turn.lower, turn.box_shape
        sizes = _int8(nu, nv, bu, bv, mu, mv, beside, count)
        constants = [
            (b.share, b.du, b.dv, b.dw, *b.backward[1:], self._unattenuated(b), backward)
            for b in beams
        ]
        of_beams = upload(self.queue, np.array(constants, np.float32))
        ways = np.stack([beam.ways() for beam in beams], axis=1).astype(np.float32)
        numbers = range(turn.shape[0])
        windows = np.array([[beam.shaded(n) for beam in beams] for n in numbers], np.int32)
        buffer, bordered = matter
        for number in numbers:
            at = turn.shape[0] - 1 - number if backward else number
            here, following = (
                min(max(n - begin + 1, 0), layers + 1) for n in (at, at - 1 if backward else at + 1)
            )
            layer = _int8(at, here, layers, int(number == 0), following - here, 0, 0, 0)
            arguments = (
                *(sizes, layer, np.int32(len(beams)), bordered, buffer, of_beams),
                upload(self.queue, ways[number]),
                upload(self.queue, windows[number], np.int32),
            )
            yield arguments, 0 < here <= layers

    def _unattenuated(self, beam: Beam) -> float:
        return 0.0 if self.emitting else beam.unattenuated()

    def _read(self, buffer: cl.Buffer, shape: tuple[int, ...]) -> Floats:
        values = np.empty(buffer.size // 4, np.float32)
        cl.enqueue_copy(self.queue, values, buffer)
        return values.reshape(shape)


def _int8(*values: int) -> Any:
    return cl.cltypes.make_int8(*values)  # type: ignore[attr-defined]  # defined on import


class OpenclSweep(_Layers):
    """Beams through voxels on a device, the twin of `NumpySweep`."""

    def __init__(self, turn: Turn, voxels: Voxels, directed: bool, device: Device) -> None:
        self.directed, self.occluded = directed, voxels.occlusion is not None
        emitting = voxels.glow is not None
        macros = {"DIRECTED": directed, "OCCLUDED": self.occluded, "EMITTING": emitting}
        super().__init__(turn, emitting, [name for name, on in macros.items() if on], device)
        # The kernels read only the first kinds of matter if the others are absent.
        self.matter = self._bordered(voxels.grids[: 4 if self.occluded else 2 if emitting else 1])
        self.tallies = zeros(self.queue, 4 * (4 if directed else 1) * prod(turn.shape))
        self.inside = zeros(self.queue, 4 * (4 if self.occluded else 3) * prod(turn.box_shape))
        sums = (STOPPED + 1) * prod(turn.shape[1:]) if self.occluded else 1
        self.sums = zeros(self.queue, 4 * sums)

    def run(self, beams: Sequence[Beam], monitor: Monitor = NO_MONITOR) -> tuple[Floats, int]:
        """As of the twin, float32."""
        return self._send(beams, self.matter, (self.tallies, self.inside, self.sums), monitor)

    def read(self) -> Tallies:
        """As of the twin, float32."""
        turn = self.turn
        tallies = self._read(self.tallies, (-1, *turn.shape))
        inside = self._read(self.inside, (-1, *turn.box_shape))
        sums: Floats = np.zeros(STOPPED + 1)
        if self.occluded:
            sums = self._read(self.sums, (STOPPED + 1, -1)).sum(axis=1, dtype=float)
        toward = tallies[1:] if self.directed else None
        reflected = inside[3] if self.occluded else None
        return Tallies(tallies[0], toward, inside[:3], reflected, sums)


class OpenclGlow(_Layers):
    """Beams, each with its emission, on a device, the twin of `NumpyGlow`."""

    def __init__(self, turn: Turn, depth: Floats, device: Device) -> None:
        super().__init__(turn, True, ("EMITTING", "APART"), device)
        self.depth = depth

    def run(
        self, beams: Sequence[Beam], glows: Sequence[Floats], monitor: Monitor = NO_MONITOR
    ) -> Floats:
        """As of the twin, float32."""
        matter = self._bordered([self.depth, *glows])
        tallies = zeros(self.queue, 4 * len(beams) * prod(self.turn.shape))
        unused = zeros(self.queue, 4)
        self._send(beams, matter, (tallies, unused, unused), monitor)
        return self._read(tallies, (len(beams), *self.turn.shape))
