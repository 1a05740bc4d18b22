# SPDX-License-Identifier: GPL-3.0-or-later
"""Moments and lobes: the angular distribution of light in voxels, as source iteration stores it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from ...arrays import Floats
from ..box import Box
from ..field import Field
from ..lights.base import Light
from ..lights.distant import Sun
from ..lights.lamps import PunctualLight
from ..medium import Domain
from .quadrature import (
    DEGREES,
    harmonics,
    phase_function,
    third,
)

BY_DEGREE = DEGREES.reshape(-1, 1, 1, 1)
"""(9, 1, 1, 1): the degrees of moments (9, nx, ny, nz)."""


@dataclass
class BandMoments:
    """One band's `ScatteringMoments`, over a scale, in the voxels of a box.

    moments  (9, of the box)
    lobes    (beams, of the box)
    g        mean cosine of the lobes
    """

    moments: Floats
    lobes: Floats
    g: float

    @classmethod
    def dark(cls, beams: int, shape: tuple[int, ...]) -> Self:
        """Moments of 0."""
        return cls(np.zeros((9, *shape), np.float32), np.zeros((beams, *shape), np.float32), 0.0)

    def into(self, directions: Floats, cosines: Sequence[Floats]) -> Floats:
        """(n, of the box) W/(m^2 sr), scattered into n directions, over sigma_s.

        cosines  by beam, of the angles between the directions and the beam: (n, 1, 1, 1) or
                 (n, of the box)
        """
        basis = harmonics(directions.T).T.astype(np.float32)
        source: Floats = np.tensordot(basis, self.moments, axes=1)
        for lobe, cosine in zip(self.lobes, cosines, strict=True):
            source += lobe * phase_function(cosine, np.float32(self.g))
        return source


def of_lobes(fluence: Floats, flux: Floats, g: float) -> Floats:
    """(9, nx, ny, nz) W/m^2: moments of light with this fluence and flux after it has scattered.

    The light is taken as a Henyey-Greenstein lobe about its flux.

    fluence  (nx, ny, nz) W/m^2
    flux     (3, nx, ny, nz) W/m^2
    g        of the medium
    """
    flux = np.asarray(flux, float)  # its square may exceed float32
    strength = np.linalg.norm(flux, axis=0)
    direction = np.divide(flux, strength, out=np.zeros(flux.shape), where=strength > 0)
    cosine = np.divide(strength, fluence, out=np.zeros(strength.shape), where=fluence > 0)
    return of_lobe(fluence, direction, g * np.minimum(cosine, 1))


def of_lobe(light: Floats, direction: Floats, cosine: Floats | float) -> Floats:
    """The moments of light (nx, ny, nz) in a lobe of a mean cosine about unit vectors (3, ...)."""
    return light * harmonics(direction) * np.asarray(cosine) ** BY_DEGREE


def way_of(beam: Light, domain: Domain) -> Floats:
    """(3, 1, 1, 1) or (3, nx, ny, nz): unit vectors, a beam's direction of travel in each voxel.

    beam  a light that `is_beam`: a `Sun` or a `PunctualLight`
    """
    if isinstance(beam, Sun):
        way = np.reshape(beam.direction, (3, 1, 1, 1))
    else:
        assert isinstance(beam, PunctualLight)
        way = np.moveaxis(domain.centers() - beam.position, -1, 0)
    length = np.linalg.norm(way, axis=0)
    directions: Floats = np.divide(way, length, out=np.zeros(way.shape), where=length > 0)
    return directions


def beside_beams(
    field: Field, band: int, numbers: Sequence[int], ways: Sequence[Floats], box: Box
) -> tuple[Floats, Floats]:
    """(fluence (of the box), flux (3, of the box)) W/m^2 of uncollided light, without the beams'.

    numbers, ways  of the beams: in the list of lights; unit vectors as of `way_of`, in the box
    """
    assert field.direct_flux is not None
    assert field.by_light is not None
    fluence, flux = box.of(field.direct[band]), box.of(field.direct_flux[band])
    for number, way in zip(numbers, ways, strict=True):
        beam = box.of(field.by_light[number, band])
        fluence, flux = fluence - beam, flux - way * beam
    # Rounding leaves values below 0 where all light is the beams'.
    return np.maximum(fluence, 0), flux


def lobes_of(thirds: Floats, ways: Sequence[Floats]) -> Floats:
    """The lobes (beams, ...) whose third moments along each of the ways add up to `thirds`."""
    count = len(ways)
    if count <= 1:
        return thirds
    pairs = np.broadcast_arrays(*(third(np.sum(a * b, axis=0)) for a in ways for b in ways))
    matrix = np.stack(pairs, axis=-1).reshape(*pairs[0].shape, count, count)
    # Beams of nearly the same direction share a lobe.
    inverse = np.linalg.pinv(matrix.astype(float), rtol=0.03)
    lobes: Floats = np.einsum("...ij,j...->i...", inverse, thirds).astype(np.float32)
    return lobes
