# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths from a camera on an OpenCL device: kernels/preview/preview.cl."""

from typing import Any

import numpy as np

from ...arrays import Floats, Integers
from ..device import Device
from ..photons.path_grid import PathGrid
from ..photons.paths_opencl import GROUP, OpenclPaths, kernel
from ..photons.tallies import Opaque


class OpenclEye:
    """The twin of `NumpyEye` on a device: it takes the same arguments."""

    def __init__(
        self,
        grid: PathGrid,
        device: Device,
        lights: Floats,
        emission: Floats | None,
        opaque: Opaque | None,
    ) -> None:
        self.paths = OpenclPaths(grid, device)
        upload, absent = self.paths.upload, self.paths.output(4)
        self.lights: tuple[Any, Any] = (
            np.int32(len(lights)),
            upload(lights) if len(lights) else absent,
        )
        self.emission = absent if emission is None else upload(emission)
        self.opaque = [absent] * 2 if opaque is None else [*map(upload, opaque)]
        defines = {"EMISSION": emission is not None, "OCCLUSION": opaque is not None}
        self.program = self.paths.program(
            *("photons/scatter.cl", "preview/preview.cl"),
            defined=tuple(n for n, on in defines.items() if on),
        )

    def see(
        self,
        rays: Floats,
        numbers: Integers,
        per_depth: float,
        seed: int,
        most_steps: int,
        most_collisions: int,
        albedo: Floats,
        g: float,
    ) -> tuple[Floats, Floats, int]:
        """As `NumpyEye.see`."""
        paths, streams = self.paths, numbers.astype(np.uint32)
        count = rays.shape[1]
        seen, left = paths.output(16 * count), paths.output(32 * count)
        violations = paths.output(4 * paths.items)
        lights, uploaded = self.lights
        kernel(self.program, "see")(
            *(paths.queue, (paths.items,), (GROUP,), *paths.arguments, np.float32(per_depth)),
            *(paths.upload(rays), paths.upload(streams), np.int32(count), np.uint32(seed)),
            *(np.int32(most_steps), np.int32(most_collisions), *map(np.float32, (*albedo, g))),
            *(uploaded, lights, self.emission, *self.opaque, seen, left, violations),
        )
        results = (paths.read(seen, np.float32), paths.read(left, np.float32))
        flaws = int(paths.read(violations, np.int32).sum())
        return results[0].reshape(-1, 4), results[1].reshape(-1, 8), flaws
