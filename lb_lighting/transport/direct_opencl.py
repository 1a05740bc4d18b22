# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of unscattered light on an OpenCL device: kernels/direct.cl."""

import numpy as np
import pyopencl as cl

from ..errors import Cancelled
from .device import context, program, queue

UNIT = 2.0**30  # of a tally, in a weight of 1
_SUMS = 8  # as in kernels/direct.cl
_GROUP = 64  # work-items; a multiple of every vector's width
_GROUPS_A_UNIT = 16  # so that compute units that are done early find more


class OpenclSweep:
    """A `Beam` through voxels on a device; `NumpySweep` does the same."""

    def __init__(self, device, beam, depth):
        self.beam, self.context, self.queue = beam, context(device), queue(device)
        built = program(device, ("fade.cl", "sweep.cl"), ())
        self.tally, self.pass_on = (cl.Kernel(built, name) for name in ("tally", "pass"))
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        self.depth, self.ways = (
            cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, np.float32))
            for values in (beam.turned(depth), beam.ways())
        )

    def run(self, cancel=None):
        """As the twin's, float32."""
        beam, flags = self.beam, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        rays = beam.rays().astype(np.float32)
        rays_buffer = cl.Buffer(self.context, flags, hostbuf=rays)
        score = np.empty((beam.nw, beam.nu, beam.nv), np.float32)
        tallies = cl.Buffer(self.context, cl.mem_flags.READ_WRITE, 4 * score.nbytes)
        cl.enqueue_fill_buffer(self.queue, tallies, beam.unmet(), 0, score.nbytes)
        (begin, end), *sides = beam.box
        for layer in range(begin, int(beam.nw)):
            if cancel is not None and layer % 16 == 0 and cancel():
                raise Cancelled("Cancelled; nothing was changed.")
            self._tally(layer, rays_buffer, tallies, np.uint64(score.size))
            if layer < end:
                self._pass(layer, rays_buffer, sides)
        cl.enqueue_copy(self.queue, score, tallies)
        cl.enqueue_copy(self.queue, rays, rays_buffer)
        return score, self._places(tallies), rays

    def _tally(self, layer, rays, tallies, size):
        (u, u_end), (v, v_end) = self.beam.shaded(layer)
        if u < u_end and v < v_end:
            step = [np.float32(part) for part in (self.beam.du, self.beam.dv, self.beam.dw)]
            self.tally(
                *(self.queue, (v_end - v, u_end - u), None, *self._layer(layer), rays),
                *(*step, tallies, size),
                global_offset=(v, u),
            )

    def _pass(self, layer, rays, sides):
        """Over the rays that start in the box's columns, or in the row before."""
        (u, u_end), (v, v_end) = sides
        items = (v_end - v + 1, u_end - u + 1, len(self.beam.points))
        arguments = (*self._layer(layer), rays)
        self.pass_on(self.queue, items, None, *arguments, global_offset=(v, u, 0))

    def _layer(self, layer):
        """What both kernels are told of a layer."""
        beam = self.beam
        count, voxels = len(beam.points), beam.nu * beam.nv
        sizes = [np.int32(n) for n in (beam.nu, beam.nv, beam.beside, count)]
        first = [np.uint64(layer * offset) for offset in (voxels, 8 * count, voxels)]
        return (*sizes, *first, self.depth, self.ways)

    def _places(self, tallies):
        """(3, of the box) of the tallies: they lie behind the score."""
        beam = self.beam
        begins, ends = zip(*beam.box, strict=True)
        places = np.empty((3, *np.subtract(ends, begins)), np.float32)
        row, plane = 4 * int(beam.nv), 4 * int(beam.nv * beam.nu)
        for number, place in enumerate(places, 1):
            cl.enqueue_copy(
                *(self.queue, place, tallies),
                buffer_origin=(4 * begins[2], begins[1], number * int(beam.nw) + begins[0]),
                host_origin=(0, 0, 0),
                region=(place[0, 0].nbytes, *place.shape[1::-1]),
                buffer_pitches=(row, plane),
                host_pitches=(place[0, 0].nbytes, place[0].nbytes),
            )
        return places


class OpenclMarch:
    """Rays through voxels on a device; `NumpyMarch` does the same."""

    def __init__(self, device, voxels, directed):
        self.shape, self.device = voxels.depth.shape, device
        self.context, self.queue = context(device), queue(device)
        self.items = self.queue.device.max_compute_units * _GROUPS_A_UNIT * _GROUP
        self.kinds = 7 if directed else 4
        occluded, emitting = voxels.occlusion is not None, voxels.glow is not None
        defines = {"DIRECTED": directed, "OCCLUDED": occluded, "EMITTING": emitting}
        built = program(
            device, ("fade.cl", "direct.cl"), tuple(name for name, on in defines.items() if on)
        )
        self.kernel = cl.Kernel(built, "march")
        grids = (voxels.depth, voxels.occlusion, voxels.reflecting, voxels.glow)
        self.grids = [self._upload(np.zeros(1) if grid is None else grid) for grid in grids]
        self.tallies = self._zeros(8 * self.kinds * voxels.depth.size)
        self.reflected = self._zeros(8 * voxels.depth.size if occluded else 4)
        self.sums = self._zeros(8 * _SUMS * self.items)

    def march(self, places, directions, weights, starts, faces):
        """Send rays; the arguments are those of `NumpyMarch.march`."""
        rays = np.concatenate([places.T, directions.T, weights[None]]).astype(np.float32)
        # A ray along a border stays on the side where it starts.
        np.minimum(rays[:3], np.nextafter(np.float32(1), np.float32(0)), out=rays[:3])
        heads = np.stack([starts, faces]).astype(np.int32)
        rays_buffer, heads_buffer = self._upload(rays), self._upload(heads, np.int32)
        self.kernel(
            *(self.queue, (self.items,), (_GROUP,), *map(np.int32, self.shape), *self.grids),
            *(rays_buffer, heads_buffer, np.int32(len(weights))),
            *(self.tallies, self.reflected, self.sums),
        )
        self.queue.finish()

    def read(self):
        """(tallies, reflected, sums) as those of `NumpyMarch`."""
        sums = self._read(self.sums, np.int64).reshape(-1, _SUMS).sum(axis=0) / UNIT
        reflected = None
        if self.reflected.size > 4:
            reflected = self._weights(self.reflected, 1)[0]
        return self._weights(self.tallies, self.kinds), reflected, sums

    def _weights(self, tally, kinds):
        """(kinds, nx, ny, nz) float32 of the two words of each tally."""
        lower, upper = self._read(tally, np.uint32).reshape(2, *self.shape, kinds)
        weights = np.empty((kinds, *self.shape), np.float32)
        for kind in range(kinds):
            whole = upper[..., kind].view(np.int32) * 2.0**32 + lower[..., kind]
            weights[kind] = whole / UNIT
        return weights

    def _read(self, buffer, kind):
        values = np.empty(buffer.size // np.dtype(kind).itemsize, kind)
        cl.enqueue_copy(self.queue, values, buffer)
        return values

    def _upload(self, values, kind=np.float32):
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, kind))

    def _zeros(self, size):
        buffer = cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)
        cl.enqueue_fill_buffer(self.queue, buffer, np.uint32(0), 0, size)
        return buffer
