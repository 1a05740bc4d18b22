# SPDX-License-Identifier: GPL-3.0-or-later
"""Beams of parallel light on an OpenCL device: kernels/uncollided/sweep.cl."""

from math import prod

import numpy as np
import pyopencl as cl

from ..device import (
    program,
    queue,
    upload,
    zeros,
)
from ..monitor import UNHEARD
from .sweep import STOPPED, Tallies

_CANCEL_EVERY = 16  # layers


class _Layers:
    """Sends beams of a turned domain layer by layer, by kernels that are built with some names.

    emitting  whether rays start empty
    """

    def __init__(self, turn, emitting, names, device):
        self.turn, self.emitting, self.queue = turn, emitting, queue(device)
        built = program(device, ("uncollided/attenuation.cl", "uncollided/sweep.cl"), tuple(names))
        self.kernels = {name: cl.Kernel(built, name) for name in ("tally", "pass")}

    def _bordered(self, grids):
        """Turned grids of the box, each or None, as the kernels have matter."""
        turn = self.turn
        layers, plane = turn.box_shape[0], turn.shape[1:]
        matter = np.zeros((len(grids), layers + 2, *(n + 2 for n in plane)), np.float32)
        inside = tuple(slice(a + 1, b + 1) for a, b in zip(turn.lower, turn.upper, strict=True))
        for values, grid in zip(matter, grids, strict=True):
            if grid is not None:
                values[1:-1, *inside[1:]] = grid
        return upload(self.queue, matter), np.uint64(matter[0].size)

    def _send(self, beams, matter, tallied, monitor):
        """What is left of the rays of beams, and beside, as of the twin's; matter as `_bordered`
        has it, tallied are the kernel's buffers."""
        turn, beside, count = self.turn, max(b.beside for b in beams), len(beams[0].points)
        shape = (len(beams), count, turn.shape[1] + beside, turn.shape[2] + beside)
        rays = np.zeros(shape, np.float32) if self.emitting else np.ones(shape, np.float32)
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        buffer = cl.Buffer(self.queue.context, flags, hostbuf=rays)
        for number, layer in enumerate(self._layers(beams, matter, beside, count)):
            if monitor.cancel is not None and number % _CANCEL_EVERY == 0:
                self.queue.finish()  # else all layers would be asked for before the first is done
                monitor.check()
            arguments, within = layer
            kernels, columns = self.kernels, turn.shape[:0:-1]
            tallies, *others = tallied
            rest = (buffer, tallies, np.uint64(prod(turn.shape)), *others)
            kernels["tally"](self.queue, columns, None, *arguments, *rest)
            if within:
                items = (turn.box_shape[2] + 1, turn.box_shape[1] + 1, len(beams) * count)
                kernels["pass"](self.queue, items, None, *arguments, buffer)
        cl.enqueue_copy(self.queue, rays, buffer)
        return rays, beside

    def _layers(self, beams, matter, beside, count):
        """(arguments of both kernels, whether it is in the box) of each layer, as light comes."""
        turn, backward = self.turn, bool(beams[0].backward[0])
        (_, nu, nv), (begin, bu, bv), (layers, mu, mv) = turn.shape, turn.lower, turn.box_shape
        sizes = cl.cltypes.make_int8(nu, nv, bu, bv, mu, mv, beside, count)
        facts = [
            (b.share, b.du, b.dv, b.dw, *b.backward[1:], self._unmet(b), backward) for b in beams
        ]
        facts = upload(self.queue, np.array(facts, np.float32))
        ways = np.stack([beam.ways() for beam in beams], axis=1).astype(np.float32)
        numbers = range(turn.shape[0])
        windows = np.array([[beam.shaded(n) for beam in beams] for n in numbers], np.int32)
        for number in numbers:
            at = turn.shape[0] - 1 - number if backward else number
            here, following = (
                min(max(n - begin + 1, 0), layers + 1) for n in (at, at - 1 if backward else at + 1)
            )
            facts_of = (at, here, layers, int(number == 0), following - here, 0, 0, 0)
            layer = cl.cltypes.make_int8(*facts_of)
            held, bordered = matter
            named = (sizes, layer, np.int32(len(beams)), bordered, held)
            crossing = (
                upload(self.queue, ways[number]),
                upload(self.queue, windows[number], np.int32),
            )
            yield (*named, facts, *crossing), 0 < here <= layers

    def _unmet(self, beam):
        return 0.0 if self.emitting else beam.unmet()

    def _read(self, buffer, shape):
        values = np.empty(buffer.size // 4, np.float32)
        cl.enqueue_copy(self.queue, values, buffer)
        return values.reshape(shape)


class OpenclSweep(_Layers):
    """Beams through voxels on a device; `NumpySweep` does the same."""

    def __init__(self, turn, voxels, directed, device):
        self.directed, self.occluded = directed, voxels.occlusion is not None
        emitting = voxels.glow is not None
        names = {"DIRECTED": directed, "OCCLUDED": self.occluded, "EMITTING": emitting}
        super().__init__(turn, emitting, [name for name, on in names.items() if on], device)
        # Only the first kinds that there are.
        self.matter = self._bordered(voxels.grids[: 4 if self.occluded else 2 if emitting else 1])
        self.tallies = zeros(self.queue, 4 * (4 if directed else 1) * prod(turn.shape))
        self.inside = zeros(self.queue, 4 * (4 if self.occluded else 3) * prod(turn.box_shape))
        sums = (STOPPED + 1) * prod(turn.shape[1:]) if self.occluded else 1
        self.sums = zeros(self.queue, 4 * sums)

    def run(self, beams, monitor=UNHEARD):
        """As the twin's, float32."""
        return self._send(beams, self.matter, (self.tallies, self.inside, self.sums), monitor)

    def read(self):
        """As the twin's, float32."""
        turn = self.turn
        tallies = self._read(self.tallies, (-1, *turn.shape))
        inside = self._read(self.inside, (-1, *turn.box_shape))
        sums = np.zeros(STOPPED + 1)
        if self.occluded:
            sums = self._read(self.sums, (STOPPED + 1, -1)).sum(axis=1, dtype=float)
        toward = tallies[1:] if self.directed else None
        reflected = inside[3] if self.occluded else None
        return Tallies(tallies[0], toward, inside[:3], reflected, sums)


class OpenclGlow(_Layers):
    """Beams that gather a light of their own on a device; `NumpyGlow` does the same."""

    def __init__(self, turn, depth, device):
        super().__init__(turn, True, ("EMITTING", "APART"), device)
        self.depth = depth

    def run(self, beams, glows, monitor=UNHEARD):
        """As the twin's, float32."""
        matter = self._bordered([self.depth, *glows])
        tallies = zeros(self.queue, 4 * len(beams) * prod(self.turn.shape))
        nothing = zeros(self.queue, 4)
        self._send(beams, matter, (tallies, nothing, nothing), monitor)
        return self._read(tallies, (len(beams), *self.turn.shape))
