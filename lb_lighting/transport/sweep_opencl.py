# SPDX-License-Identifier: GPL-3.0-or-later
"""Beams of parallel light on an OpenCL device: kernels/sweep.cl."""

from math import prod

import numpy as np
import pyopencl as cl

from ..errors import Cancelled
from .device import program, queue, upload, zeros
from .sweep import STOPPED, Tallies

_CANCEL_EVERY = 16  # layers


class OpenclSweep:
    """Beams through voxels on a device; `NumpySweep` does the same."""

    def __init__(self, turn, voxels, directed, device):
        self.turn, self.directed = turn, directed
        self.queue = queue(device)
        self.occluded, self.emitting = voxels.occlusion is not None, voxels.glow is not None
        defines = {"DIRECTED": directed, "OCCLUDED": self.occluded, "EMITTING": self.emitting}
        built = program(
            device, ("fade.cl", "sweep.cl"), tuple(name for name, on in defines.items() if on)
        )
        self.kernels = {name: cl.Kernel(built, name) for name in ("tally", "pass")}
        matter = self._matter(voxels)
        self.matter, self.bordered = upload(self.queue, matter), np.uint64(matter[0].size)
        self.tallies = zeros(self.queue, 4 * (4 if directed else 1) * prod(turn.shape))
        self.inside = zeros(self.queue, 4 * (4 if self.occluded else 3) * prod(turn.box_shape))
        sums = (STOPPED + 1) * prod(turn.shape[1:]) if self.occluded else 1
        self.sums = zeros(self.queue, 4 * sums)

    def _matter(self, voxels):
        """As the kernels have it: only the first kinds that there are."""
        turn, kinds = self.turn, 4 if self.occluded else 2 if self.emitting else 1
        layers, plane = turn.box_shape[0], turn.shape[1:]
        matter = np.zeros((kinds, layers + 2, *(n + 2 for n in plane)), np.float32)
        inside = tuple(slice(a + 1, b + 1) for a, b in zip(turn.lower, turn.upper, strict=True))
        for values, grid in zip(matter, voxels.grids, strict=False):
            if grid is not None:
                values[1:-1, *inside[1:]] = grid
        return matter

    def run(self, beams, cancel=None):
        """As the twin's, float32."""
        turn, beside, count = self.turn, max(b.beside for b in beams), len(beams[0].points)
        shape = (len(beams), count, turn.shape[1] + beside, turn.shape[2] + beside)
        rays = np.zeros(shape, np.float32) if self.emitting else np.ones(shape, np.float32)
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        buffer = cl.Buffer(self.queue.context, flags, hostbuf=rays)
        for number, layer in enumerate(self._layers(beams, beside, count)):
            if cancel is not None and number % _CANCEL_EVERY == 0:
                self.queue.finish()  # else all layers would be asked for before the first is done
                if cancel():
                    raise Cancelled("Cancelled; nothing was changed.")
            arguments, within = layer
            kernels, columns = self.kernels, turn.shape[:0:-1]
            rest = (buffer, self.tallies, np.uint64(prod(turn.shape)), self.inside, self.sums)
            kernels["tally"](self.queue, columns, None, *arguments, *rest)
            if within:
                items = (turn.box_shape[2] + 1, turn.box_shape[1] + 1, len(beams) * count)
                kernels["pass"](self.queue, items, None, *arguments, buffer)
        cl.enqueue_copy(self.queue, rays, buffer)
        return rays, beside

    def _layers(self, beams, beside, count):
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
            named = (sizes, layer, np.int32(len(beams)), self.bordered)
            crossing = (
                upload(self.queue, ways[number]),
                upload(self.queue, windows[number], np.int32),
            )
            yield (*named, self.matter, facts, *crossing), 0 < here <= layers

    def _unmet(self, beam):
        return 0.0 if self.emitting else beam.unmet()

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

    def _read(self, buffer, shape):
        values = np.empty(buffer.size // 4, np.float32)
        cl.enqueue_copy(self.queue, values, buffer)
        return values.reshape(shape)
