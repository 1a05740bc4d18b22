# SPDX-License-Identifier: GPL-3.0-or-later
"""Norms of the light in a medium that count only visible light.

A picture shows light that scatters towards the camera or falls on surfaces. Light that crosses
empty air does neither: it can fill a domain while the small cloud in it is dark. So the squares of
the fluence are weighted by sigma_s times density, the power that a voxel scatters per fluence. In a
medium of leaves, this is the area that shows light.
"""

import numpy as np

from ...arrays import Floats
from ..medium import Medium


def weights(medium: Medium, surfaces: bool = False) -> Floats:
    """(bands, nx, ny, nz) float64: scattering in each voxel, relative to the largest.

    surfaces  whether surfaces show light: voxels in front of opaque ones then count by the light
              that these reflect. They also count if nothing else scatters
    All weights are 0 in a medium that only absorbs, where nothing is visible.
    """
    density = medium.density / (float(medium.density.max()) or 1.0)
    scattering = medium.sigma_s[:, None, None, None] * density.astype(float)
    if medium.occlusion is not None and (surfaces or not scattering.any()):
        scale = float(medium.density.max()) or 1.0
        scattering = scattering + _before_opaque(medium) / (medium.voxel_size * scale)
    return scattering / (scattering.max() or 1.0)


def size(grid: Floats, weight: Floats) -> float:
    """The weighted L2 norm of light (bands, nx, ny, nz)."""
    return float(np.sqrt(np.vdot(weight, np.square(grid, dtype=float))))


def mean_share(part: Floats, whole: Floats, weight: Floats) -> float:
    """The share of a part of the light in the weighted mean; 0 where nothing is visible.

    Around a lamp in a medium it is larger than the share in the L2 norm, as the lamp's direct light
    is very bright in a few voxels.
    """
    means = [float(np.vdot(weight, grid.astype(float))) for grid in (part, whole)]
    return means[0] / means[1] if means[1] else 0.0


def _before_opaque(medium: Medium) -> Floats:
    """(bands, nx, ny, nz): the reflecting faces of opaque voxels beside each voxel."""
    occlusion, albedo = medium.occlusion, medium.occlusion_albedo
    assert occlusion is not None
    assert albedo is not None
    free = 1 - occlusion.astype(float)
    albedo = albedo if albedo.ndim == 4 else albedo[:, None, None, None]
    reflecting = np.pad(occlusion * albedo, ((0, 0), (1, 1), (1, 1), (1, 1)))
    inner = slice(1, -1)
    faces = np.zeros((medium.bands, *medium.shape))
    for axis in (1, 2, 3):
        for beside in (slice(None, -2), slice(2, None)):
            at: list[slice] = [slice(None), inner, inner, inner]
            at[axis] = beside
            faces += reflecting[tuple(at)]
    return free * faces
