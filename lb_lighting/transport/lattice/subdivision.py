# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely voxels that are too thick for the lattice are divided.

docs/theory/physics.md, "Voxels that are too thick", says what was measured.
"""

from math import ceil

import numpy as np

from ...errors import MediumError
from ..medium import Medium

# Voxels, weighed by what they hold, that are thicker than this are divided: in transport free
# paths of scattering, and in diffusion lengths of absorption (docs/theory/physics.md says why).
_THICKEST, _DARKEST = 3.0, 0.9
_MOST_PIECES = 4


def wished_pieces(medium: Medium) -> tuple[int, int]:
    """(pieces that improve the light, pieces without which it would be wrong), along each edge.

    Depths count by the albedo, the share of light that the lattice carries.
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
            f"The medium absorbs so strongly that light fades {lengths.max():.1f} times by a "
            f"factor of e within a voxel; raise the resolution {ceil(dark / _MOST_PIECES)} times, "
            "or lower the density."
        )
    return max(thick, dark), dark
