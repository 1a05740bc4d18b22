# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights, as plain values in SI units, and the photons that they send into a medium.

Every spectral quantity is a scalar or (bands,). A light is anything with the two members

    spectrum                          what it emits, by band; see `multiple`
    emit(count, medium, rng, band)    `count` photons of one band, drawn with a Generator of NumPy

where emit returns

    origins     (count, 3) m, world space: on the domain's faces, or where the light itself is
    directions  (count, 3) unit vectors, the way the photons travel
    power       (count,) W carried by each; the expectation of their sum is the power that the
                light sends to the domain, with that of the photons that miss it

The photons of one call are spread evenly (`_strata`) and so depend on each other: a variance is
found from several calls. emit raises LightError for fewer photons than 1, and for a light whose
bands are not the medium's.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..errors import LightError
from .medium import LARGEST

_SKY_CELLS = (32, 64)  # in height and around: where a sky given as a function is bright
# Share of such a sky's photons that are spread over all of it, so that what its cells miss is lit.
_ANYWHERE = 0.1
# By the axis that x is moved to: where the new x, y and z come from.
_TURNS = np.array([(0, 1, 2), (2, 0, 1), (1, 2, 0)])


@dataclass(frozen=True)
class Sun:
    """Parallel light from far away.

    direction   (3,), the way the light travels; any length but 0
    irradiance  W/m^2 on a surface that faces it, scalar or (bands,)
    """

    direction: tuple
    irradiance: tuple | float

    def __post_init__(self):
        length = np.linalg.norm(self.direction)
        if len(self.direction) != 3 or not np.isfinite(length) or length == 0:
            raise LightError(f"A sun needs a direction of three numbers; it has {self.direction}.")
        _check_energy(self.irradiance, "irradiance of a sun")

    @property
    def spectrum(self):
        """The irradiance, scalar or (bands,)."""
        return self.irradiance

    def emit(self, count, medium, rng, band):
        """Photons on the lit faces, all of the same power: exactly the irradiance times the
        area that the domain shows to the sun."""
        irradiance = by_band(self.irradiance, medium.bands)[band]
        across, along = _strata(count, 2, rng)
        toward = np.divide(self.direction, np.linalg.norm(self.direction))
        directions = np.tile(toward, (count, 1))
        origins = _enter(medium.domain, directions, across, along)
        shown = np.abs(toward) @ _face_areas(medium.domain)
        return origins, directions, np.full(count, irradiance * shown / count)


@dataclass(frozen=True)
class Sky:
    """Light from everywhere outside.

    radiance  W/(m^2 sr), scalar or (bands,), or a function that takes the unit vector (3,)
              towards the sky and returns that, a scalar everywhere or (bands,) everywhere.
              `emit` is many times faster where the function also takes vectors (n, 3) and
              returns (n,) or (n, bands), as in lambda towards: towards[..., 2] > 0
    """

    radiance: tuple | float | Callable

    def __post_init__(self):
        if not callable(self.radiance):
            _check_energy(self.radiance, "radiance of the sky")

    @property
    def spectrum(self):
        """The radiance, scalar or (bands,), or the function that it is."""
        return self.radiance

    def towards(self, direction):
        """The radiance, W/(m^2 sr), that arrives from `direction` ((3,), pointing at the sky)."""
        if not callable(self.radiance):
            return self.radiance
        radiance = self.radiance(np.asarray(direction, float))
        _check_energy(radiance, "radiance of the sky")
        return radiance

    def emit(self, count, medium, rng, band):
        """Photons on all faces. Those of a uniform sky have the same power, exactly pi times
        radiance times surface in all; those of a function have power as it shines, and are
        more where it shines brighter."""
        if callable(self.radiance):
            return self._emit_by_brightness(count, medium, rng, band)
        radiance = by_band(self.radiance, medium.bands)[band]
        across, along, tilt, turn = _strata(count, 4, rng)
        areas = _face_areas(medium.domain)
        axis, rest = _pick(_edges(areas), across)
        upper = rest >= 0.5  # half the area across an axis is the face on its lower side
        origins = _on_faces(medium.domain, axis, upper, 2 * rest - upper, along)
        inwards = _tilted(1 - np.sqrt(1 - tilt), turn)  # Lambert: the squared cosine is uniform
        inwards[:, 0] *= 1 - 2 * upper
        power = np.pi * radiance * 2 * areas.sum() / count
        return origins, _turned(inwards, axis), np.full(count, power)

    def _emit_by_brightness(self, count, medium, rng, band):
        """Directions by the power that comes from their cell of the sky, then points of entry."""
        cells = _cell_centers()
        radiance = _over_directions(self.radiance, cells)
        shown = np.abs(cells) @ _face_areas(medium.domain)
        glow = _of_band(radiance(cells), medium.bands, band) * shown
        even = 1 / len(cells)
        chance = np.full(len(cells), even)
        if glow.any():
            chance = _ANYWHERE * even + (1 - _ANYWHERE) * glow / glow.sum()

        cell, height, across, along = _strata(count, 4, rng)
        cell, around = _pick(_edges(chance), cell)
        towards = _in_cells(cell, height, around)
        origins = _enter(medium.domain, -towards, across, along)
        shown = np.abs(towards) @ _face_areas(medium.domain)
        solid_angle = 4 * np.pi * even / chance[cell]  # that a photon stands for, times count
        power = _of_band(radiance(towards), medium.bands, band) * shown * solid_angle / count
        return origins, -towards, power


@dataclass(frozen=True)
class PointLight:
    """Light from a point, the same in all directions.

    position  (3,) m
    power     W, scalar or (bands,)
    """

    position: tuple
    power: tuple | float

    def __post_init__(self):
        if len(self.position) != 3 or not np.all(np.isfinite(self.position)):
            raise LightError(f"A point light needs a position; it has {self.position}.")
        _check_energy(self.power, "power of a point light")

    @property
    def spectrum(self):
        """The power, scalar or (bands,)."""
        return self.power

    def emit(self, count, medium, rng, band):
        """Photons from the point, all of the same power; where it is outside, only into the cone
        around the domain's bounding sphere, and some of these pass the domain."""
        power = by_band(self.power, medium.bands)[band]
        tilt, turn = _strata(count, 2, rng)
        lower, upper = np.array((medium.domain.origin, medium.domain.upper))
        axis = (lower + upper) / 2 - self.position
        distance, radius = np.linalg.norm(axis), np.linalg.norm(upper - lower) / 2
        spread = 2.0  # 1 - cosine of the cone's half angle
        if distance > radius:
            sine_squared = (radius / distance) ** 2
            spread = sine_squared / (1 + np.sqrt(1 - sine_squared))  # keeps its digits far away
        directions = _tilted(spread * tilt, turn) @ _frame(axis)
        origins = np.tile(np.asarray(self.position, float), (count, 1))
        return origins, directions, np.full(count, power * spread / 2 / count)


class Emission:
    """The light of the medium itself, the same in all directions; emit takes that same medium.

    medium  one with an `emission`, (bands, nx, ny, nz) W/m^3
    """

    def __init__(self, medium):
        if medium.emission is None:
            raise LightError("The medium emits no light; give it an emission.")
        self.spectrum = medium.emission
        self._edges = {}  # by band: finding them takes as long as many photons

    def emit(self, count, medium, rng, band):
        """Photons from the voxels in proportion to their emission, all of the same power."""
        if band not in self._edges:
            self._edges[band] = _edges(self.spectrum[band].ravel())
        edges = self._edges[band]
        voxel, y, z, tilt, turn = _strata(count, 5, rng)
        voxel, x = _pick(edges, voxel)
        corner = np.stack(np.unravel_index(voxel, medium.domain.shape), axis=1)
        within = np.stack((x, y, z), axis=1)
        h = medium.domain.voxel_size
        power = np.full(count, edges[-1] * h**3 / count)
        return medium.domain.origin + (corner + within) * h, _tilted(2 * tilt, turn), power


def multiple(lights, medium, band, base):
    """The number m for which the lights emit in `band` exactly m times what they emit in `base`.

    None where there is none, so that `band` must be solved for itself. A sky that is a function
    of colours counts as such: nobody knows all its directions.
    """
    rows = [_rows(light.spectrum, medium.bands) for light in lights]
    total, total_base = (sum(row[b].sum(dtype=float) for row in rows) for b in (band, base))
    if total_base == 0:
        return None if total else 0.0
    factor = total / total_base
    # 1e-6: an emission is stored in float32, and a multiple of it is rounded again.
    alike = (np.allclose(row[band], factor * row[base], rtol=1e-6, atol=0) for row in rows)
    return float(factor) if all(alike) else None


def by_band(value, bands):
    """A spectral quantity as (bands,) float64; LightError if it has another number of bands."""
    value = np.atleast_1d(np.asarray(value, float))
    if value.shape not in ((1,), (bands,)):
        raise LightError(f"A light has {value.size} bands where the medium has {bands}.")
    return np.broadcast_to(value, (bands,))


def _rows(spectrum, bands):
    """(bands, n): two bands are multiples of each other where, and only where, their rows are."""
    if callable(spectrum):
        radiance = spectrum(np.array((0.0, 0.0, 1.0)))
        by_band(radiance, bands)  # refuses another number of bands
        return np.ones((bands, 1)) if np.size(radiance) == 1 else np.eye(bands)
    if np.ndim(spectrum) > 1:
        return spectrum.reshape(bands, -1)
    return by_band(spectrum, bands)[:, None]


def _check_energy(value, what):
    value = np.asarray(value, float)
    bad = value[~((value >= 0) & (value <= LARGEST))]  # NaN is neither
    if bad.size:
        raise LightError(f"The {what} must be between 0 and {LARGEST:.2g}; it is {bad[0]:g}.")


def _strata(count, dimensions, rng):
    """(dimensions, count) in [0, 1): points spread evenly, shifted as a whole at random.

    The first coordinate ascends, one point in each interval of 1 / count, so that photons which
    follow each other start close to each other. The others are the R sequence (M. Roberts, "The
    Unreasonable Effectiveness of Quasirandom Sequences", 2018). The shift makes every mean over
    the points unbiased, and the points of two calls independent.
    """
    if count < 1:
        raise LightError(f"A light sends 1 photon or more; {count} were asked for.")
    root = 2.0  # of x^dimensions = x + 1: the golden ratio for 2
    for _ in range(50):
        root = (1 + root) ** (1 / dimensions)
    number = np.arange(count)
    points = np.outer(root ** -np.arange(dimensions), number)
    points += rng.random((dimensions, 1))
    points[1:] -= np.floor(points[1:])
    points[0] /= count
    return np.minimum(points, np.nextafter(1, 0), out=points)


def _edges(weights):
    """(n + 1,) where the intervals begin and end that weights (n,) have when laid side by side."""
    return np.concatenate(([0.0], np.cumsum(weights, dtype=float)))


def _pick(edges, u):
    """The interval that each u (count,) in [0, 1) falls to, and where in it, in [0, 1).

    Where all are empty it is the last.
    """
    target = u * edges[-1]
    picked = np.minimum(np.searchsorted(edges, target, side="right") - 1, len(edges) - 2)
    start, width = edges[picked], edges[picked + 1] - edges[picked]
    rest = np.divide(target - start, width, out=np.zeros_like(u), where=width > 0)
    return picked, np.minimum(rest, np.nextafter(1, 0))


def _face_areas(domain):
    """(3,) m^2: the area of the faces across each axis."""
    extent = np.multiply(domain.shape, domain.voxel_size)
    return extent.prod() / extent


def _enter(domain, directions, across, along):
    """(count, 3) m: where rays of `directions` enter the domain, uniform over what it shows them.

    across and along are the (count,) in [0, 1) that choose the place.
    """
    areas = np.abs(directions) * _face_areas(domain)
    ends = np.cumsum(areas, axis=1)
    target = across * ends[:, 2]
    axis = (target >= ends[:, 0]).astype(int) + (target >= ends[:, 1])
    picked = (np.arange(len(axis)), axis)
    across = np.clip(1 - (ends[picked] - target) / areas[picked], 0, 1)
    return _on_faces(domain, axis, directions[picked] < 0, across, along)


def _on_faces(domain, axis, upper, across, along):
    """(count, 3) m: points on the lower or upper face across each `axis`, by two shares of it."""
    shares = _turned(np.stack((upper, across, along), axis=1), axis)
    return domain.origin + shares * np.multiply(domain.shape, domain.voxel_size)


def _turned(vectors, axis):
    """Vectors (count, 3) with x moved to `axis` (count,), and y and z to those that follow it."""
    return np.take_along_axis(vectors, _TURNS[axis], axis=1)


def _tilted(drop, turn):
    """(count, 3) unit vectors with x = 1 - drop, `turn` turns around the x axis.

    Uniform over the sphere where drop is uniform in [0, 2], and turn in [0, 1].
    """
    radius, angle = np.sqrt(drop * (2 - drop)), 2 * np.pi * turn
    return np.stack((1 - drop, radius * np.cos(angle), radius * np.sin(angle)), axis=1)


def _frame(axis):
    """(3, 3): orthogonal unit rows, the first along `axis`, whatever its length."""
    if not axis.any():
        return np.eye(3)
    first = axis / np.linalg.norm(axis)
    second = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    second /= np.linalg.norm(second)
    return np.stack((first, second, np.cross(first, second)))


def _in_cells(cell, height, around):
    """(count, 3) unit vectors in cells of the sky, all of the same solid angle."""
    rows, columns = _SKY_CELLS
    row, column = np.divmod(cell, columns)
    return _tilted(2 * (row + height) / rows, (column + around) / columns)


@cache
def _cell_centers():
    return _in_cells(np.arange(_SKY_CELLS[0] * _SKY_CELLS[1]), 0.5, 0.5)


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


def _of_band(radiance, bands, band):
    """(n,) of the radiance (n,) or (n, bands) of n directions; LightError where it cannot be."""
    _check_energy(radiance, "radiance of the sky")
    radiance = radiance.reshape(len(radiance), -1)
    by_band(radiance[0], bands)  # refuses another number of bands
    return np.broadcast_to(radiance, (len(radiance), bands))[:, band]
