# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of lamps on an OpenCL device: kernels/uncollided/march.cl."""

import numpy as np
import pyopencl as cl
from numpy.typing import DTypeLike

from ...arrays import Array, Floats, Integers
from ..device import (
    Device,
    program,
    queue,
    upload,
    zeros,
)
from .march import TALLIES
from .sweep import STOPPED, Voxels

UNIT = 2.0**30  # of a tally, in a weight of 1
_SUMS = STOPPED + 1  # as in kernels/uncollided/march.cl
_GROUP = 64  # work-items; a multiple of every device's vector width
_GROUPS_A_UNIT = 16  # so compute units that finish early get more work


class OpenclMarch:
    """Rays through voxels on a device, the twin of `NumpyMarch`."""

    def __init__(self, device: Device, voxels: Voxels) -> None:
        self.shape, self.queue = voxels.depth.shape, queue(device)
        self.items = self.queue.device.max_compute_units * _GROUPS_A_UNIT * _GROUP
        occluded = voxels.occlusion is not None
        built = program(
            device,
            ("uncollided/attenuation.cl", "uncollided/march.cl"),
            ("OCCLUDED",) if occluded else (),
        )
        self.kernel = cl.Kernel(built, "march")
        grids = (voxels.depth, voxels.occlusion, voxels.reflecting)
        self.grids = [upload(self.queue, np.zeros(1) if grid is None else grid) for grid in grids]
        self.tallies = zeros(self.queue, 8 * TALLIES * voxels.depth.size)
        self.reflected = zeros(self.queue, 8 * voxels.depth.size if occluded else 4)
        self.sums = zeros(self.queue, 8 * _SUMS * self.items)

    def march(
        self,
        places: Floats,
        directions: Floats,
        weights: Floats,
        starts: Integers,
        faces: Integers,
    ) -> None:
        """Send rays; the arguments are those of `NumpyMarch.march`."""
        rays = np.concatenate([places.T, directions.T, weights[None]]).astype(np.float32)
        # A ray along a border between voxels stays on the side where it starts.
        np.minimum(rays[:3], np.nextafter(np.float32(1), np.float32(0)), out=rays[:3])
        heads = np.stack([starts, faces]).astype(np.int32)
        rays_buffer, heads_buffer = upload(self.queue, rays), upload(self.queue, heads, np.int32)
        self.kernel(
            *(self.queue, (self.items,), (_GROUP,), *map(np.int32, self.shape), *self.grids),
            *(rays_buffer, heads_buffer, np.int32(len(weights))),
            *(self.tallies, self.reflected, self.sums),
        )
        self.queue.finish()

    def read(self) -> tuple[Floats, Floats | None, Floats]:
        """As of the twin, tallies float32."""
        sums = self._read(self.sums, np.int64).reshape(-1, _SUMS).sum(axis=0) / UNIT
        reflected = None
        if self.reflected.size > 4:
            reflected = self._weights(self.reflected, 1)[0]
        return self._weights(self.tallies, TALLIES), reflected, sums

    def _weights(self, tally: cl.Buffer, kinds: int) -> Floats:
        """(kinds, nx, ny, nz) float32 from the two words of each tally."""
        lower, upper = self._read(tally, np.uint32).reshape(2, *self.shape, kinds)
        weights = np.empty((kinds, *self.shape), np.float32)
        for kind in range(kinds):
            units = upper[..., kind].view(np.int32) * 2.0**32 + lower[..., kind]
            weights[kind] = units / UNIT
        return weights

    def _read(self, buffer: cl.Buffer, kind: DTypeLike) -> Array:
        values = np.empty(buffer.size // np.dtype(kind).itemsize, kind)
        cl.enqueue_copy(self.queue, values, buffer)
        return values
