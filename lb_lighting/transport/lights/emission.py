# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of the medium itself."""

import numpy as np

from ...errors import LightError
from .base import DistantLight
from .distant import Sky
from .sampling import (
    intervals,
    pick,
    strata,
    tilted,
)


class Emission(DistantLight):
    """The light of the medium itself, the same in all directions; emit takes that same medium.

    medium  one with an `emission`, (bands, nx, ny, nz) W/m^3
    """

    def __init__(self, medium):
        if medium.emission is None:
            raise LightError("The medium emits no light; give it an emission.")
        self._emission = medium.emission
        self._edges = {}  # by band: finding them takes as long as many photons

    @property
    def spectrum(self):
        """The emission of the medium, (bands, nx, ny, nz) W/m^3."""
        return self._emission

    def emit(self, count, medium, rng, band):
        """Photons from the voxels in proportion to their emission, all of the same power."""
        if band not in self._edges:
            self._edges[band] = intervals(self._emission[band].ravel())
        edges = self._edges[band]
        voxel, y, z, tilt, turn = strata(count, 5, rng)
        voxel, x = pick(edges, voxel)
        corner = np.stack(np.unravel_index(voxel, medium.domain.shape), axis=1)
        within = np.stack((x, y, z), axis=1)
        h = medium.domain.voxel_size
        power = np.full(count, edges[-1] * h**3 / count)
        return medium.domain.origin + (corner + within) * h, tilted(2 * tilt, turn), power

    def suns(self, medium, band, per_edge):
        """Those of a sky that sends as much from everywhere as a voxel of the emission 1 W/m^3
        does to everywhere: their strengths, (n,), add up to 1 W/m^3."""
        return Sky(1 / (4 * np.pi)).suns(medium, band, per_edge)
