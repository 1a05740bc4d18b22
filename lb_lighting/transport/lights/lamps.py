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

The photons of one call are spread evenly (`strata`) and so depend on each other: a variance is
found from several calls. emit raises LightError for fewer photons than 1, and for a light whose
bands are not the medium's.

A light may have a third,

    rays(medium, band, per_edge)      the same light as rays, spread as regularly as they can be

which returns (the power of the strongest ray in W, an iterator of such triples as emit's): the
same rays at every call, about per_edge^2 or more of them through each voxel that the light reaches.
Where all that it sends comes from far away, or from everywhere, it has instead

    suns(medium, band, per_edge)      the same light as parallel light from a few directions

which returns (unit directions (n, 3) that it travels, irradiances (n,) W/m^2, the rays along a
voxel's edge that each takes).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil, prod

import numpy as np

from ...errors import LightError
from ..medium import LARGEST
from .sampling import (
    GOLDEN,
    SKY_CELLS,
    cell_centers,
    cell_quarters,
    entry_points,
    even_directions,
    face_areas,
    frame_of,
    in_cells,
    intervals,
    pick,
    points_on_faces,
    rank_1,
    rays_to,
    sight,
    strata,
    tilted,
    turned_to,
)

# Share of the photons of a sky that is a function which are spread over all of it, so that what its
# cells miss is lit.
_ANYWHERE = 0.1
_RAYS_AT_ONCE = 2**18  # that a light makes
# Of a sky: how many suns stand for it, by per_edge^2; and the per_edge of these, where the domain
# has few voxels along its edge. Where it has more, a single one matters less, and rays are many.
_SUNS, _SUN_PER_EDGE, FEW_VOXELS = 2.5, 2, 48
_MOST_RAYS = 2**22  # of a point light: voxels far away get fewer rays then
# Of an area light: how many points stand for it at least and at most; and how many times the rays
# of a point light they have together, for each alone leaves its own pattern.
_FEWEST_POINTS, _MOST_POINTS, _RAYS_OF_AREA = 16, 2**12, 2
# Around a lamp: to how many voxels away light is not about that at their centre; points along their
# edges by which its mean is found there; and the core of a point, in voxels, wide enough for these.
_NEAR, _FINE, _POINT_CORE = 4, 8, 0.25
_NO_SLATS = np.pi / 2 - 1e-4  # rad, half the spread from which an area light has no grid


@dataclass(frozen=True)
class Sun:
    """Parallel light from far away.

    direction   (3,), the way the light travels; any length but 0
    irradiance  W/m^2 on a surface that faces it, scalar or (bands,)
    shadow_density  (nx, ny, nz) or None: what stands in for the medium's density where this light
                has not scattered yet. The density is a mean over directions; leaves that lie flat
                stop more than that of a sun above them, and less of one at the horizon. Photons
                do not know of it: where light is traced, the medium's own density counts
    """

    direction: tuple
    irradiance: tuple | float
    shadow_density: np.ndarray | None = field(default=None, compare=False, repr=False)

    def __post_init__(self):
        if self.shadow_density is not None:
            density = np.asarray(self.shadow_density, np.float32)
            if not np.all((density >= 0) & (density <= LARGEST)):
                raise LightError("A sun's shadow density must be finite and not negative.")
            object.__setattr__(self, "shadow_density", density)
        _check_direction(self.direction, "sun")
        _check_energy(self.irradiance, "irradiance of a sun")

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

    def seen(self, bands):
        """A function of unit vectors towards it, (n, 3), to its radiance, (n, bands) W/(m^2 sr)."""
        if not callable(self.radiance):
            radiance = by_band(self.radiance, bands)
            return lambda towards: np.tile(radiance, (len(towards), 1))
        look = _over_directions(self.radiance, cell_centers())

        def radiances(towards):
            radiance = look(towards)
            return np.stack([_of_band(radiance, bands, n) for n in range(bands)], axis=1)

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
        _check_energy(radiance, "radiance of the sky")
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
        glow = _of_band(radiance(points), medium.bands, band).reshape(len(cells), -1).mean(axis=1)
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
        irradiance = _of_band(radiance(towards), medium.bands, band) * solid_angle
        return towards, irradiance, 4 * np.pi * even * glow.sum()


class _AtPoint:
    """What lights at a `position` share: photons and rays into the cone that counts.

    Such a light has a `power`, and says by `_relative` how strong it is in directions (n, 3), over
    a point of that power that shines the same everywhere; `_strongest` is the most of that.

    Its `radius` dims it close by: it lights a place as a disk that faces the place, which is the
    soft falloff of Cycles. Its photons and rays come from a point all the same; `softness` says
    what share of them counts.
    """

    _strongest = 1.0

    @property
    def spectrum(self):
        """The power, scalar or (bands,)."""
        return self.power

    def emit(self, count, medium, rng, band):
        """Photons from the point, spread evenly over directions and with power as it shines there;
        where it is outside, only into the cone around the domain's bounding sphere, and some of
        these pass the domain."""
        tilt, turn = strata(count, 2, rng)
        axis, spread = self._cone(medium.domain)
        directions = tilted(spread * tilt, turn) @ frame_of(axis)
        origins = np.tile(np.asarray(self.position, float), (count, 1))
        power = by_band(self.power, medium.bands)[band] * spread / 2 / count
        return origins, directions, power * self._relative(directions)

    def rays(self, medium, band, per_edge):
        """Rays spread evenly over the cone, or over all directions: per_edge^2 through the face
        of a voxel in the farthest corner, but _MOST_RAYS at most."""
        domain = medium.domain
        axis, spread = self._cone(domain)
        count = min(rays_to(domain, self.position, spread, per_edge), _MOST_RAYS)
        power = by_band(self.power, medium.bands)[band] * spread / 2 / count

        def pieces():
            for first in range(0, count, _RAYS_AT_ONCE):
                numbers = np.arange(first, min(first + _RAYS_AT_ONCE, count))
                directions = even_directions(numbers, count, spread) @ frame_of(axis)
                origins = np.broadcast_to(np.asarray(self.position, float), directions.shape)
                yield origins, directions, power * self._relative(directions)

        return power * self._strongest, pieces()

    def _cone(self, domain):
        """((3,) m its axis, 1 - the cosine of its half angle): where it shines on the domain."""
        return sight(self.position, domain)

    def _relative(self, directions):
        return np.ones(len(directions))

    def falloff(self, distance, core=0.0):
        """1/m^2, fluence over power / 4 pi, of nothing but distances in m: 1/r^2 for a point.

        core  m, the distance within which it rises in a straight line to a peak that is finite, to
              the same sum over the core
        """
        edge = np.maximum(distance, core)
        slant = np.hypot(edge, self.radius)
        falloff = 2 / (slant * (slant + edge))
        if core > 0:
            falloff *= 1 + (self.peak(core) - 1) * (1 - distance / edge)
        return falloff

    def peak(self, core):
        """What `falloff` with a core is at the lamp, over what it is where the core ends."""
        if core == 0:
            return 1.0
        share = (np.arange(64) + 0.5) / 64
        within = share**2 * self.falloff(core * share)
        return 12 * float(np.mean(within) / self.falloff(core)) - 3

    def mean_falloff(self, domain, core=0.0):
        """(nx, ny, nz) 1/m^2: the mean over each voxel of `falloff`."""

        def falloff(places):
            return self.falloff(np.linalg.norm(places - self.position, axis=-1), core)

        centers = domain.centers()
        means = falloff(centers)
        voxel = np.floor(np.subtract(self.position, domain.origin) / domain.voxel_size)
        first, last = np.clip([voxel - _NEAR, voxel + _NEAR + 1], 0, domain.shape).astype(int)
        near = tuple(map(slice, first, last))
        steps = ((np.arange(_FINE) + 0.5) / _FINE - 0.5) * domain.voxel_size
        inside = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        means[near] = falloff(centers[near][..., None, :] + inside).mean(axis=-1)
        return means

    def softness(self, domain):
        """(nx, ny, nz): the light in each voxel over that of a point; None for a point."""
        if self.radius == 0:
            return None
        point = replace(self, radius=0.0)
        core = _POINT_CORE * domain.voxel_size
        return self.mean_falloff(domain) / point.mean_falloff(domain, core)


@dataclass(frozen=True)
class PointLight(_AtPoint):
    """Light from a point, the same in all directions.

    position  (3,) m
    power     W, scalar or (bands,)
    radius    m, see `falloff`
    """

    position: tuple
    power: tuple | float
    radius: float = 0.0

    def __post_init__(self):
        _check_place(self.position, "point light")
        _check_energy(self.power, "power of a point light")


@dataclass(frozen=True)
class SpotLight(_AtPoint):
    """Light from a point into a cone, as Blender has it.

    position   (3,) m
    direction  (3,), the axis of the cone, the way the light travels; any length but 0
    power      W, scalar or (bands,), of the point light that is as strong as this on the axis;
               a spot sends out only the cone's share of it
    angle      rad, the full angle of the cone, over 0 and up to pi
    blend      0 to 1, how much of the cone its soft edge takes: with c the cosine to the axis and
               h that of half the angle, the light falls off by the smoothstep of
               (c - h) / (blend (1 - h))
    radius     m, see `falloff`
    """

    position: tuple
    direction: tuple
    power: tuple | float
    angle: float
    blend: float = 0.0
    radius: float = 0.0

    def __post_init__(self):
        _check_place(self.position, "spot")
        _check_direction(self.direction, "spot")
        _check_energy(self.power, "power of a spot")
        if not 0 < self.angle <= np.pi + 1e-6:
            raise LightError(f"A spot's angle must be over 0 and at most pi; it is {self.angle}.")
        if not 0 <= self.blend <= 1:
            raise LightError(f"A spot's blend must lie between 0 and 1; it is {self.blend}.")

    def _cone(self, domain):
        own = np.asarray(self.direction, float), 2 * np.sin(self.angle / 4) ** 2
        return min(own, sight(self.position, domain), key=lambda cone: cone[1])

    def _relative(self, directions):
        axis = np.divide(self.direction, np.linalg.norm(self.direction))
        inside = directions @ axis - np.cos(self.angle / 2)
        soft = self.blend * 2 * np.sin(self.angle / 4) ** 2
        share = np.clip(inside / max(soft, np.finfo(float).tiny), 0, 1)
        return share**2 * (3 - 2 * share)


@dataclass(frozen=True)
class AreaLight:
    """Light from one side of a flat rectangle or ellipse, by the cosine (Lambert).

    center   (3,) m
    u, v     (3,) m, its edges, or the axes of an ellipse, in full; it shines where u x v points
    power    W, scalar or (bands,)
    ellipse  whether it is one
    spread   rad, the full angle at which Blender's grid of slats in front of it lets nothing
             through any more; pi for no grid. The power is that which the grid lets through
    """

    center: tuple
    u: tuple
    v: tuple
    power: tuple | float
    ellipse: bool = False
    spread: float = np.pi

    def __post_init__(self):
        for place in (self.center, self.u, self.v):
            _check_place(place, "area light")
        _check_direction(np.cross(self.u, self.v), "area light")
        _check_energy(self.power, "power of an area light")
        if not 0 < self.spread <= np.pi + 1e-6:
            raise LightError(
                f"The spread of an area light must be over 0 and at most pi; it is {self.spread}."
            )

    @property
    def spectrum(self):
        """The power, scalar or (bands,)."""
        return self.power

    def emit(self, count, medium, rng, band):
        """Photons from all over it, spread evenly over directions and with power as it shines
        there; some of them pass the domain."""
        across, along, tilt, turn = strata(count, 4, rng)
        axis, spread = self._cone(medium.domain)
        directions = tilted(spread * tilt, turn) @ frame_of(axis)
        power = by_band(self.power, medium.bands)[band] * spread / 2 / count
        return self._points(across, along), directions, power * self._relative(directions)

    def rays(self, medium, band, per_edge):
        """Those of points spread evenly over it: together _RAYS_OF_AREA per_edge^2 or more through
        the face of a voxel in the farthest corner, but _MOST_RAYS at most."""
        domain = medium.domain
        points = self._points(*rank_1(self._count(domain)))
        axis, spread = self._cone(domain)
        wanted = rays_to(domain, self.center, spread, per_edge) * _RAYS_OF_AREA
        count = ceil(min(wanted, _MOST_RAYS) / len(points))  # of each
        power = by_band(self.power, medium.bands)[band] * spread / 2 / (count * len(points))
        frame = frame_of(axis)

        def pieces():
            for number, point in enumerate(points):
                turn = GOLDEN * number / count  # so that the errors of points differ
                directions = even_directions(np.arange(count), count, spread, turn) @ frame
                origins = np.broadcast_to(point, directions.shape)
                yield origins, directions, power * self._relative(directions)

        return power * self._strongest, pieces()

    def _count(self, domain):
        """How many points stand for it: about as far from each other as from what they light."""
        lower, upper = np.array((domain.origin, domain.upper))
        reach = (np.abs(self.u) + np.abs(self.v)) / 2
        gap = np.maximum(np.maximum(lower - reach - self.center, self.center - reach - upper), 0)
        step = max(np.linalg.norm(gap), domain.voxel_size / 2)
        wanted = prod(ceil(np.linalg.norm(edge) / step) for edge in (self.u, self.v))
        return int(np.clip(wanted, _FEWEST_POINTS, _MOST_POINTS))

    def _points(self, across, along):
        """(n, 3) m: points on it by two shares (n,) of it, evenly where these are."""
        if self.ellipse:
            radius, turn = np.sqrt(across), 2 * np.pi * along
            x, y = radius * np.cos(turn) / 2, radius * np.sin(turn) / 2
        else:
            x, y = across - 0.5, along - 0.5
        return np.outer(x, self.u) + np.outer(y, self.v) + self.center

    def _cone(self, domain):
        """((3,) its axis, 1 - the cosine of its half angle): where it shines on the domain."""
        half = min(self.spread, np.pi) / 2
        reach = np.linalg.norm(np.abs(self.u) + np.abs(self.v)) / 2
        own = np.cross(self.u, self.v), 2 * np.sin(half / 2) ** 2
        return min(own, sight(self.center, domain, reach), key=lambda cone: cone[1])

    def _relative(self, directions):
        """(n,): how strong it is in directions, over a point that shines the same everywhere."""
        normal = np.cross(self.u, self.v)
        cosine = directions @ normal / np.linalg.norm(normal)
        half = min(self.spread, np.pi) / 2
        if half > _NO_SLATS:
            return 4 * np.maximum(cosine, 0)
        # cosine times (tan half - tan of the angle), over its integral that makes it a share.
        sine = np.sqrt(np.maximum(1 - cosine**2, 0))
        through = np.where(cosine > 0, cosine * np.tan(half) - sine, 0)
        return 4 * np.maximum(through, 0) / (np.tan(half) - half)

    @property
    def _strongest(self):
        half = min(self.spread, np.pi) / 2
        return 4.0 if half > _NO_SLATS else 4 * np.tan(half) / (np.tan(half) - half)


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
            self._edges[band] = intervals(self.spectrum[band].ravel())
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


def darkness(lights):
    """The LightError that tells why a medium is dark in some lights."""
    if any(np.any(getattr(light, "power", 0)) for light in lights):
        return LightError(
            "There is no light on what is to be lit: no lamp shines on it; turn or move one, or "
            "add a sun."
        )
    return LightError("There is no light; add a sun, or a world with a colour that is not black.")


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
    return float(factor) if all(same(row[band], factor * row[base]) for row in rows) else None


def same(values, others):
    """Whether values are the same but for rounding: an emission is stored in float32, and a
    multiple of it is rounded again."""
    return np.allclose(values, others, rtol=1e-6, atol=0)


def bands_of(light):
    """How many bands the spectrum of a light has: 1 is the same in all."""
    spectrum = light.spectrum
    return np.size(spectrum(np.array((0.0, 0.0, 1.0))) if callable(spectrum) else spectrum)


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


def _check_place(place, what):
    if len(place) != 3 or not np.all(np.isfinite(place)):
        raise LightError(f"A {what} needs a position; it has {place}.")


def _check_direction(direction, what):
    length = np.linalg.norm(direction)
    if len(direction) != 3 or not np.isfinite(length) or length == 0:
        raise LightError(f"A {what} needs a direction of three numbers; it has {direction}.")


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


BEAMS = Sun, PointLight, SpotLight  # lights whose unscattered light comes from one direction
