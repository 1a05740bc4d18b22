# SPDX-License-Identifier: GPL-3.0-or-later
"""The medium's own emission as a light."""

import numpy as np

from ...arrays import Floats
from ...errors import LightError
from ..medium import BaseMedium
from .base import DistantLight, Photons
from .distant import Sky
from .sampling import (
    intervals,
    r_sequence,
    sample_discrete,
    tilted,
)


class Emission(DistantLight):
    """The isotropic emission of a medium; `emit` and `suns` must be given the same medium.

    medium  one with an `emission`, (bands, nx, ny, nz) W/m^3
    Raises LightError if it has none.
    """

    def __init__(self, medium: BaseMedium) -> None:
        if medium.emission is None:
            raise LightError("The medium emits no light; give it an emission.")
        self._emission: Floats = medium.emission
        self._edges: dict[int, Floats] = {}  # by band: they take as long as many photons

    @property
    def spectrum(self) -> Floats:
        """The emission of the medium, (bands, nx, ny, nz) W/m^3."""
        return self._emission

    def emit(self, count: int, medium: BaseMedium, rng: np.random.Generator, band: int) -> Photons:
        """Photons from the voxels in proportion to their emission, all of the same power."""
        if band not in self._edges:
            self._edges[band] = intervals(self._emission[band].ravel())
        edges = self._edges[band]
        across, y, z, tilt, turn = r_sequence(count, 5, rng)
        voxel, x = sample_discrete(edges, across)
        corner = np.stack(np.unravel_index(voxel, medium.domain.shape), axis=1)
        within = np.stack((x, y, z), axis=1)
        h = medium.domain.voxel_size
        power = np.full(count, edges[-1] * h**3 / count)
        return medium.domain.origin + (corner + within) * h, tilted(2 * tilt, turn), power

    def suns(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[Floats, Floats, int]:
        """The suns of a uniform sky. Their strengths, (n,), add up to 1 W/m^3: the light from all
        directions equals that of a voxel with this emission."""
        return Sky(1 / (4 * np.pi)).suns(medium, band, per_edge)
