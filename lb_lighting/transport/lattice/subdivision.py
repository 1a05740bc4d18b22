# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels that are too thick for the lattice, divided before the solve and merged after it.

docs/theory/physics.md, "Voxels that are too thick", has the measurements.
"""

from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from ...errors import MediumError
from ..field import Field
from ..lights.base import Light
from ..medium import Medium, repeated

# The edge of a voxel, weighted by density, above which voxels are divided: in transport mean free
# paths, and in diffusion lengths.
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


def divided(light: Light, pieces: int) -> Light:
    """The light for a medium whose voxels are divided."""
    return light.with_shadow_density(lambda density: repeated(density, pieces))


def merged(field: Field, pieces: int) -> Field:
    """The field of a divided medium, in the medium's own voxels."""

    def mean(values: Any) -> Any:
        if values is None:
            return None
        *outer, nx, ny, nz = values.shape
        split = (nx // pieces, pieces, ny // pieces, pieces, nz // pieces, pieces)
        return values.reshape(*outer, *split).mean(axis=(-5, -3, -1))

    domain = field.domain
    coarse = replace(
        domain,
        voxel_size=domain.voxel_size * pieces,
        shape=tuple(n // pieces for n in domain.shape),
    )
    variance = None if field.variance is None else mean(field.variance) / pieces**3
    names = ("fluence", "direct", "flux", "direct_flux", "by_light", "forward")
    grids = {name: mean(getattr(field, name)) for name in names}
    return replace(field, domain=coarse, variance=variance, handed=None, **grids)
