# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of the light in a medium is seen, and norms that count that alone.

A picture shows what light is scattered to, or what falls on surfaces. Light that crosses empty air
is in neither: a domain may be full of it and the picture of a small cloud in it still be dark. So
the squares of light are weighed by sigma_s times density, the power that a voxel scatters over its
fluence; of a medium of leaves that is the area that shows light.
"""

import numpy as np


def weights(medium, surfaces=False):
    """(bands, nx, ny, nz) float64, what scatters in each voxel, over the most in any.

    surfaces  whether surfaces show light: then what lies before opaque voxels counts, too, by what
              these reflect. It does so as well where nothing else scatters
    All zeros where nothing is seen: in a medium that only absorbs.
    """
    density = medium.density / (float(medium.density.max()) or 1.0)
    found = medium.sigma_s[:, None, None, None] * density.astype(float)
    if medium.occlusion is not None and (surfaces or not found.any()):
        scale = float(medium.density.max()) or 1.0
        found = found + _before_opaque(medium) / (medium.voxel_size * scale)
    return found / (found.max() or 1.0)


def size(grid, weight):
    """L2 of light (bands, nx, ny, nz), its squares weighed."""
    return float(np.sqrt(np.vdot(weight, np.square(grid, dtype=float))))


def mean_share(part, whole, weight):
    """What a part of light is of the whole, in the mean of what is seen; 0 where nothing is.

    It is more than the share in L2 of a lamp that stands in a medium, whose own light is very
    bright in few voxels.
    """
    means = [float(np.vdot(weight, grid.astype(float))) for grid in (part, whole)]
    return means[0] / means[1] if means[1] else 0.0


def _before_opaque(medium):
    """(bands, nx, ny, nz), the reflecting faces of opaque voxels next to each voxel."""
    free = 1 - medium.occlusion.astype(float)
    albedo = medium.occlusion_albedo
    albedo = albedo if albedo.ndim == 4 else albedo[:, None, None, None]
    reflecting = np.pad(medium.occlusion * albedo, ((0, 0), (1, 1), (1, 1), (1, 1)))
    inner = slice(1, -1)
    faces = np.zeros((medium.bands, *medium.shape))
    for axis in (1, 2, 3):
        for beside in (slice(None, -2), slice(2, None)):
            at = [slice(None), inner, inner, inner]
            at[axis] = beside
            faces += reflecting[tuple(at)]
    return free * faces
