# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from far away: suns and skies."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from ...errors import LightError
from ..medium import LARGEST
from .base import (
    DistantLight,
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
    pick,
    points_on_faces,
    strata,
    tilted,
    turned_to,
)

# Share of the photons of a sky that is a function which are spread over all of it, so that what its
# cells miss is lit.
_ANYWHERE = 0.1
# Of a sky: how many suns stand for it, by per_edge^2; and the per_edge of these, where the domain
# has few voxels along its edge. Where it has more, a single one matters less, and rays are many.
_SUNS, _SUN_PER_EDGE, FEW_VOXELS = 2.5, 2, 48


@dataclass(frozen=True)
class Sun(DistantLight):
    """Parallel light from far away.

    direction   (3,), the way the light travels; any length but 0
    irradiance  W/m^2 on a surface that faces it, scalar or (bands,)
    shadow_density  (nx, ny, nz) or None: what stands in for the medium's density where this light
                has not scattered yet. The density is a mean over directions; leaves that lie flat
                stop more than that of a sun above them, and less of one at the horizon. Photons
                do not know of it: where light is traced, the medium's own density counts
    """

    is_beam = True

    direction: tuple
    irradiance: tuple | float
    shadow_density: np.ndarray | None = field(default=None, compare=False, repr=False)

    def __post_init__(self):
        if self.shadow_density is not None:
            density = np.asarray(self.shadow_density, np.float32)
            if not np.all((density >= 0) & (density <= LARGEST)):
                raise LightError("A sun's shadow density must be finite and not negative.")
            object.__setattr__(self, "shadow_density", density)
        check_direction(self.direction, "sun")
        check_energy(self.irradiance, "irradiance of a sun")

    @property
    def spectrum(self):
        """The irradiance, scalar or (bands,)."""
        return self.irradiance

    def emit(self, count, medium, rng, band):
        """Photons on the lit faces, all of the same power: exactly the irradiance times the
        area that the domain shows to the sun."""
        irradiance = by_band(self.irradiance, medium.bands)[band]
        across, along = strata(count, 2, rng)
        toward = np.divide(self.direction, np.linalg.norm(self.direction))
        directions = np.tile(toward, (count, 1))
        origins = entry_points(medium.domain, directions, across, along)
        shown = np.abs(toward) @ face_areas(medium.domain)
        return origins, directions, np.full(count, irradiance * shown / count)

    def suns(self, medium, band, per_edge):
        """Its unit direction, (1, 3); its irradiance, (1,) W/m^2; per_edge."""
        toward = np.divide([self.direction], np.linalg.norm(self.direction))
        return toward, by_band(self.irradiance, medium.bands)[[band]], per_edge

    def with_shadow_density(self, change):
        """As of `Light`."""
        if self.shadow_density is None:
            return self
        return replace(self, shadow_density=change(self.shadow_density))


@dataclass(frozen=True)
class Sky(DistantLight):
    """Light from everywhere outside.

    radiance  W/(m^2 sr), scalar or (bands,), or a function that takes the unit vector (3,)
              towards the sky and returns that, a scalar everywhere or (bands,) everywhere.
              `emit` is many times faster where the function also takes vectors (n, 3) and
              returns (n,) or (n, bands), as in lambda towards: towards[..., 2] > 0
    """

    radiance: tuple | float | Callable

    def __post_init__(self):
        if not callable(self.radiance):
            check_energy(self.radiance, "radiance of the sky")

    @property
    def spectrum(self):
        """The radiance, scalar or (bands,), or the function that it is."""
        return self.radiance

    def towards(self, direction):
        """The radiance, W/(m^2 sr), that arrives from `direction` ((3,), pointing at the sky)."""
        if not callable(self.radiance):
            return self.radiance
        radiance = self.radiance(np.asarray(direction, float))
        check_energy(radiance, "radiance of the sky")
        return radiance

    def seen(self, bands):
        """A function of unit vectors towards it, (n, 3), to its radiance, (n, bands) W/(m^2 sr)."""
        if not callable(self.radiance):
            radiance = by_band(self.radiance, bands)
            return lambda towards: np.tile(radiance, (len(towards), 1))
        look = _over_directions(self.radiance, cell_centers())

        def radiances(towards):
            radiance = look(towards)
            return np.stack([of_band(radiance, bands, n) for n in range(bands)], axis=1)

        return radiances

    def emit(self, count, medium, rng, band):
        """Photons on all faces. Those of a uniform sky have the same power, exactly pi times
        radiance times surface in all; those of a function have power as it shines, and are
        more where it shines brighter."""
        if callable(self.radiance):
            return self._emit_by_brightness(count, medium, rng, band)
        radiance = by_band(self.radiance, medium.bands)[band]
        across, along, tilt, turn = strata(count, 4, rng)
        areas = face_areas(medium.domain)
        axis, rest = pick(intervals(areas), across)
        upper = rest >= 0.5  # half the area across an axis is the face on its lower side
        origins = points_on_faces(medium.domain, axis, upper, 2 * rest - upper, along)
        inwards = tilted(1 - np.sqrt(1 - tilt), turn)  # Lambert: the squared cosine is uniform
        inwards[:, 0] *= 1 - 2 * upper
        power = np.pi * radiance * 2 * areas.sum() / count
        return origins, turned_to(inwards, axis), np.full(count, power)

    def suns(self, medium, band, per_edge):
        """A sun in each of SUNS per_edge^2 directions, more where the sky is brighter.

        Returns the unit directions in which their light goes, (n, 3); their irradiance, (n,) W/m^2;
        the rays of each along a voxel's edge.
        """
        count = ceil(_SUNS * per_edge**2)
        if callable(self.radiance):
            across, turn = strata(count, 2, np.random.default_rng(0))
            # Each sun lights all voxels: what counts is their fluence, not what enters.
            towards, irradiance, fluence = self._bright(across, turn, medium, band)
            sent = irradiance.mean()
            irradiance *= fluence / sent if sent else 0  # so few suns need not add up to the sky
        else:
            towards = even_directions(np.arange(count), count)
            radiance = by_band(self.radiance, medium.bands)[band]
            irradiance = np.full(count, 4 * np.pi * radiance)
        of_each = _SUN_PER_EDGE if max(medium.shape) <= FEW_VOXELS else 1
        return -towards, irradiance / count, of_each

    def parts(self):
        """[Sky]: what comes evenly from everywhere, where there is any, and the rest, likewise."""
        if not callable(self.radiance):
            return [self]
        cells = cell_centers()
        radiance = _over_directions(self.radiance, cells)(cells)
        check_energy(radiance, "radiance of the sky")
        least = radiance.min(axis=0)
        rest = Sky(lambda towards: np.maximum(np.subtract(self.radiance(towards), least), 0))
        even = [Sky(least)] if np.any(least) else []
        return even + ([rest] if np.any(radiance > least) else [])

    def _emit_by_brightness(self, count, medium, rng, band):
        """Directions by the power that comes from their cell of the sky, then points of entry."""
        row, turn, across, along = strata(count, 4, rng)
        towards, irradiance, _ = self._bright(row, turn, medium, band, face_areas(medium.domain))
        origins = entry_points(medium.domain, -towards, across, along)
        shown = np.abs(towards) @ face_areas(medium.domain)
        return origins, -towards, irradiance * shown / count

    def _bright(self, across, turn, medium, band, areas=None):
        """Directions (n, 3) towards a sky that is a function, by the light that comes from their
        cell of it; the (n,) W/m^2 for which each would stand alone; and the light of all cells.

        across and turn are the (n,) in [0, 1) that choose them: the row, and the cell in the row,
        so that what is spread evenly over both is spread evenly over the sky. The light is a
        power, W, through faces of the areas (3,) m^2, or without them a fluence, W/m^2.
        """
        cells, points = cell_centers(), cell_quarters()
        radiance = _over_directions(self.radiance, points)
        glow = of_band(radiance(points), medium.bands, band).reshape(len(cells), -1).mean(axis=1)
        if areas is not None:
            glow = glow * (np.abs(cells) @ areas)
        even = 1 / len(cells)
        chance = np.full(len(cells), even)
        if glow.any():
            chance = _ANYWHERE * even + (1 - _ANYWHERE) * glow / glow.sum()

        edges, columns = intervals(chance), SKY_CELLS[1]
        row, height = pick(edges[::columns], across)
        begin, end = edges[row * columns], edges[(row + 1) * columns]
        cell, around = pick(edges, (begin + turn * (end - begin)) / edges[-1])
        towards = in_cells(cell, height, around)
        solid_angle = 4 * np.pi * even / chance[cell]
        irradiance = of_band(radiance(towards), medium.bands, band) * solid_angle
        return towards, irradiance, 4 * np.pi * even * glow.sum()


def _over_directions(radiance, probe):
    """A sky's function for (n, 3) directions: all at once if it can, else one by one.

    Whether it can is tried on the directions `probe`.
    """

    def together(directions):
        return np.asarray(radiance(directions), float)

    def one_by_one(directions):
        return np.array([radiance(direction) for direction in directions], float)

    some = slice(None, None, 307)  # spread over rows and columns of the sky's cells
    expected = one_by_one(probe[some])
    try:
        with np.errstate(all="ignore"):
            values = together(probe)
    except Exception:  # whatever a function does that was written for one direction
        return one_by_one
    fits = values.shape == (len(probe), *expected.shape[1:])
    return together if fits and np.allclose(values[some], expected, equal_nan=True) else one_by_one
