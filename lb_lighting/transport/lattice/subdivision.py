# SPDX-License-Identifier: GPL-3.0-or-later
"""The division of voxels that are too thick for the lattice.

docs/theory/physics.md, "Voxels that are too thick", has the measurements.
"""

from math import ceil

import numpy as np

from ...errors import MediumError
from ..medium import Medium

# The edge of a voxel, weighted by density, above which voxels are divided: in transport mean free
# paths and in diffusion lengths.
_THICKEST, _DARKEST = 3.0, 0.9
_MOST_PIECES = 4


def wished_pieces(medium: Medium) -> tuple[int, int]:
    """(pieces that improve the light, pieces without which it would be wrong), along each edge.

    Optical depths are weighted by the albedo, the share of light that the lattice carries.
    Raises MediumError if the second number would be over 4.
    """
    density = medium.density.astype(float)
    mean = np.sum(density**2) / max(np.sum(density), np.finfo(float).tiny)
    depth = medium.sigma_s * medium.voxel_size * mean
    transport = 1 - medium.albedo * medium.g
    lengths = depth * np.sqrt(3 * (1 - medium.albedo) * transport)
    thick = min(2, ceil(float((depth * transport).max()) / _THICKEST))
    dark = max(1, ceil(float(lengths.max()) / _DARKEST))
    if dark > _MOST_PIECES:
        raise MediumError(
            f"The medium absorbs too strongly for its voxels, which are {lengths.max():.1f} "
            f"diffusion lengths thick; raise the resolution {ceil(dark / _MOST_PIECES)} times, or "
            "lower the density."
        )
    return max(thick, dark), dark
