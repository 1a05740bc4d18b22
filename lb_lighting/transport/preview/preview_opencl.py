# SPDX-License-Identifier: GPL-3.0-or-later
"""What rays from a camera see, on an OpenCL device: kernels/preview/preview.cl."""

import numpy as np

from ..photons.paths_opencl import GROUP, OpenclPaths, kernel


class OpenclEye:
    """Sees through one `PathGrid` on a device; `NumpyEye` does the same.

    lights    (n, 8) float32, see preview/preview.cl
    emission  (voxels, 4) float32: in three bands what shines on one fine cell, W/(m^2 sr); or None
    opaque    (occlusion (nx, ny, nz), its albedo (voxels, 4)), float32 each; or None
    """

    def __init__(self, grid, device, lights, emission, opaque):
        self.paths = OpenclPaths(grid, device)
        upload, absent = self.paths.upload, self.paths.output(4)
        self.lights = np.int32(len(lights)), upload(lights) if len(lights) else absent
        self.emission = absent if emission is None else upload(emission)
        self.opaque = [absent] * 2 if opaque is None else [*map(upload, opaque)]
        defines = {"EMISSION": emission is not None, "OCCLUSION": opaque is not None}
        self.program = self.paths.program(
            *("photons/scatter.cl", "preview/preview.cl"),
            defined=tuple(n for n, on in defines.items() if on),
        )

    def see(self, rays, numbers, per_depth, seed, most_steps, most_collisions, albedo, g):
        """(seen (n, 4), left (n, 8), number of bounds that were violated), see preview/preview.cl.

        rays     (6, n) float32, as those of free_paths
        numbers  (n,) of the rays, which choose their random numbers
        albedo   (3,)
        """
        paths, numbers = self.paths, numbers.astype(np.uint32)
        count = rays.shape[1]
        seen, left = paths.output(16 * count), paths.output(32 * count)
        violations = paths.output(4 * paths.items)
        lights, uploaded = self.lights
        kernel(self.program, "see")(
            *(paths.queue, (paths.items,), (GROUP,), *paths.arguments, np.float32(per_depth)),
            *(paths.upload(rays), paths.upload(numbers), np.int32(count), np.uint32(seed)),
            *(np.int32(most_steps), np.int32(most_collisions), *map(np.float32, (*albedo, g))),
            *(uploaded, lights, self.emission, *self.opaque, seen, left, violations),
        )
        results = (paths.read(seen, np.float32), paths.read(left, np.float32))
        flaws = int(paths.read(violations, np.int32).sum())
        return results[0].reshape(-1, 4), results[1].reshape(-1, 8), flaws
