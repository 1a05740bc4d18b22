# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from far away: suns and skies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any, Self

import numpy as np

from ...arrays import Floats, Spectrum, Vector
from ...errors import LightError
from ..medium import LARGEST, BaseMedium
from .base import (
    Directional,
    DistantLight,
    Photons,
    by_band,
    check_direction,
    check_energy,
    of_band,
)
from .sampling import (
    SKY_CELLS,
    cell_centers,
    cell_quarters,
    entry_points,
    even_directions,
    face_areas,
    in_cells,
    intervals,
    points_on_faces,
    r_sequence,
    sample_discrete,
    tilted,
    turned_to,
)

# Share of the photons of a sky given as a function that is distributed evenly over the sky, so that
# light missed by the centres of its cells is sampled as well.
_ANYWHERE = 0.1
# Of a sky: the number of suns that stand for it, over per_edge^2; and the per_edge of each, if no
# edge of the domain has more than FEW_VOXELS voxels. Larger domains need fewer rays of each sun, as
# a single voxel matters less.
_SUNS, _SUN_PER_EDGE, FEW_VOXELS = 2.5, 2, 48


@dataclass(frozen=True)
class Sun(DistantLight):
    """Parallel light from far away.

    direction   (3,), the direction of travel; any length but 0
    irradiance  W/m^2 on a surface that faces the sun, scalar or (bands,)
    shadow_density  (nx, ny, nz), replaces the medium's density for this sun's uncollided light; or
                None. The medium's density is a mean over directions: horizontal leaves block more
                of a sun overhead and less of a sun at the horizon. Photons ignore the shadow
                density and meet that of the medium
    """

    is_beam = True

    direction: Vector
    irradiance: Spectrum
    shadow_density: Floats | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.shadow_density is not None:
            density = np.asarray(self.shadow_density, np.float32)
            if not np.all((density >= 0) & (density <= LARGEST)):
                raise LightError("A sun's shadow density must be finite and not negative.")
            object.__setattr__(self, "shadow_density", density)
        check_direction(self.direction, "sun")
        check_energy(self.irradiance, "irradiance of a sun")

    @property
    def spectrum(self) -> Spectrum:
        """The irradiance, scalar or (bands,)."""
        return self.irradiance

    def emit(self, count: int, medium: BaseMedium, rng: np.random.Generator, band: int) -> Photons:
        """Photons on the lit faces, all of the same power: their sum is exactly the irradiance
        times the area of the domain as seen from the sun."""
        irradiance = by_band(self.irradiance, medium.bands)[band]
        across, along = r_sequence(count, 2, rng)
        toward = np.divide(self.direction, np.linalg.norm(self.direction))
        directions = np.tile(toward, (count, 1))
        origins = entry_points(medium.domain, directions, across, along)
        seen_area = np.abs(toward) @ face_areas(medium.domain)
        return origins, directions, np.full(count, irradiance * seen_area / count)

    def suns(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[Floats, Floats, int]:
        """Its unit direction, (1, 3); its irradiance, (1,) W/m^2; per_edge."""
        toward = np.divide(np.array([self.direction]), np.linalg.norm(self.direction))
        return toward, by_band(self.irradiance, medium.bands)[[band]], per_edge

    def with_shadow_density(self, change: Callable[[Floats], Floats]) -> Self:
        """The same sun after `change` of its shadow density, if it has one."""
        if self.shadow_density is None:
            return self
        return replace(self, shadow_density=change(self.shadow_density))


@dataclass(frozen=True)
class Sky(DistantLight):
    """Light from all directions outside.

    radiance  W/(m^2 sr), scalar or (bands,); or a function that takes the unit vector (3,) towards
              the sky and returns that: a scalar for all directions or (bands,) for all. `emit` is
              many times faster if the function also takes vectors (n, 3) and returns (n,) or
              (n, bands), as in lambda towards: towards[..., 2] > 0
    """

    radiance: Spectrum | Directional

    def __post_init__(self) -> None:
        if not callable(self.radiance):
            check_energy(self.radiance, "radiance of the sky")

    @property
    def spectrum(self) -> Spectrum | Directional:
        """The radiance, scalar or (bands,), or as a function."""
        return self.radiance

    def towards(self, direction: Vector) -> Any:
        """The radiance, W/(m^2 sr), that arrives from `direction` ((3,), pointing at the sky)."""
        if not callable(self.radiance):
            return self.radiance
        radiance = self.radiance(np.asarray(direction, float))
        check_energy(radiance, "radiance of the sky")
        return radiance

    def seen(self, bands: int) -> Callable[[Floats], Floats]:
        """A function of unit vectors towards the sky, (n, 3), that returns the radiance,
        (n, bands) W/(m^2 sr)."""
        if not callable(self.radiance):
            uniform = by_band(self.radiance, bands)
            return lambda towards: np.tile(uniform, (len(towards), 1))
        radiance_of = _over_directions(self.radiance, cell_centers())

        def radiances(towards: Floats) -> Floats:
            radiance = radiance_of(towards)
            return np.stack([of_band(radiance, bands, n) for n in range(bands)], axis=1)

        return radiances

    def emit(self, count: int, medium: BaseMedium, rng: np.random.Generator, band: int) -> Photons:
        """Photons on all faces.

        Those of a uniform sky have the same power: their sum is exactly pi times radiance times
        surface. The photons of a function are sampled by its brightness (importance sampling) and
        weighted.
        """
        if callable(self.radiance):
            return self._emit_by_brightness(self.radiance, count, medium, rng, band)
        radiance = by_band(self.radiance, medium.bands)[band]
        across, along, tilt, turn = r_sequence(count, 4, rng)
        areas = face_areas(medium.domain)
        axis, place = sample_discrete(intervals(areas), across)
        upper = place >= 0.5  # half the area across an axis is the face on its lower side
        origins = points_on_faces(medium.domain, axis, upper, 2 * place - upper, along)
        inwards = tilted(1 - np.sqrt(1 - tilt), turn)  # Lambert: the squared cosine is uniform
        inwards[:, 0] *= 1 - 2 * upper
        power = np.pi * radiance * 2 * areas.sum() / count
        return origins, turned_to(inwards, axis), np.full(count, power)

    def suns(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[Floats, Floats, int]:
        """Suns in _SUNS per_edge^2 directions, denser where the sky is brighter.

        Returns the unit directions of travel, (n, 3); their irradiance, (n,) W/m^2; the rays of
        each along a voxel's edge.
        """
        count = ceil(_SUNS * per_edge**2)
        if callable(self.radiance):
            across, turn = r_sequence(count, 2, np.random.default_rng(0))
            # Each sun lights all voxels, so directions are sampled by fluence, not by power.
            towards, irradiance, fluence = _sampled_by_brightness(
                self.radiance, across, turn, medium, band
            )
            mean = irradiance.mean()
            irradiance *= fluence / mean if mean else 0  # so that the few suns add up to the sky
        else:
            towards = even_directions(np.arange(count), count)
            radiance = by_band(self.radiance, medium.bands)[band]
            irradiance = np.full(count, 4 * np.pi * radiance)
        per_edge_of_each = _SUN_PER_EDGE if max(medium.shape) <= FEW_VOXELS else 1
        return -towards, irradiance / count, per_edge_of_each

    def parts(self) -> Sequence["Sky"]:
        """The uniform part of the sky, if it is not dark, and the remainder, likewise."""
        if not callable(self.radiance):
            return [self]
        function, cells = self.radiance, cell_centers()
        radiance = _over_directions(function, cells)(cells)
        check_energy(radiance, "radiance of the sky")
        least = radiance.min(axis=0)
        uneven = Sky(lambda towards: np.maximum(np.subtract(function(towards), least), 0))
        even = [Sky(least)] if np.any(least) else []
        return even + ([uneven] if np.any(radiance > least) else [])

    def _emit_by_brightness(
        self,
        function: Directional,
        count: int,
        medium: BaseMedium,
        rng: np.random.Generator,
        band: int,
    ) -> Photons:
        """Photons with directions by the power of their cell of the sky, then points of entry."""
        row, turn, across, along = r_sequence(count, 4, rng)
        areas = face_areas(medium.domain)
        towards, irradiance, _ = _sampled_by_brightness(function, row, turn, medium, band, areas)
        origins = entry_points(medium.domain, -towards, across, along)
        seen_area = np.abs(towards) @ areas
        return origins, -towards, irradiance * seen_area / count


def _sampled_by_brightness(
    function: Directional,
    across: Floats,
    turn: Floats,
    medium: BaseMedium,
    band: int,
    areas: Floats | None = None,
) -> tuple[Floats, Floats, float]:
    """Directions (n, 3) towards a sky given as a function, by the light from their cell of it; the
    (n,) W/m^2 of the whole sky that each estimates; and the light of all cells.

    across, turn  (n,) in [0, 1), choose the row, and the cell in the row: points that cover this
                  square evenly give directions that cover the sky evenly
    areas         (3,) m^2, of the faces: light is then power through them, W; without them it is
                  fluence, W/m^2
    """
    cells, points = cell_centers(), cell_quarters()
    radiance = _over_directions(function, points)
    light = of_band(radiance(points), medium.bands, band).reshape(len(cells), -1).mean(axis=1)
    if areas is not None:
        light = light * (np.abs(cells) @ areas)
    even = 1 / len(cells)
    probability = np.full(len(cells), even)
    if light.any():
        probability = _ANYWHERE * even + (1 - _ANYWHERE) * light / light.sum()

    edges, columns = intervals(probability), SKY_CELLS[1]
    row, height = sample_discrete(edges[::columns], across)
    begin, end = edges[row * columns], edges[(row + 1) * columns]
    cell, around = sample_discrete(edges, (begin + turn * (end - begin)) / edges[-1])
    towards = in_cells(cell, height, around)
    solid_angle = 4 * np.pi * even / probability[cell]
    irradiance = of_band(radiance(towards), medium.bands, band) * solid_angle
    return towards, irradiance, float(4 * np.pi * even * light.sum())


def _over_directions(radiance: Directional, probe: Floats) -> Directional:
    """A sky's function for directions (n, 3): called once for all if possible, else one by one.

    The directions `probe` show which.
    """

    def together(directions: Floats) -> Floats:
        return np.asarray(radiance(directions), float)

    def one_by_one(directions: Floats) -> Floats:
        return np.array([radiance(direction) for direction in directions], float)

    sample = slice(None, None, 307)  # covers rows and columns of the sky's cells
    expected = one_by_one(probe[sample])
    try:
        with np.errstate(all="ignore"):
            values = together(probe)
    except Exception:  # a function written for one direction may raise anything
        return one_by_one
    fits = values.shape == (len(probe), *expected.shape[1:])
    is_same = fits and np.allclose(values[sample], expected, equal_nan=True)
    return together if is_same else one_by_one
