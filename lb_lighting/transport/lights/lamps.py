# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps: light from a point, a spot or an area."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, prod
from typing import Self

import numpy as np

from ...arrays import Floats, Spectrum, Vector
from ...errors import LightError
from ..medium import BaseMedium, Domain
from .base import (
    LocalLight,
    Photons,
    by_band,
    check_direction,
    check_energy,
    check_place,
)
from .sampling import (
    GOLDEN,
    Cone,
    bounding_cone,
    even_directions,
    frame_of,
    r_sequence,
    rank_1,
    rays_to,
    tilted,
)

_RAYS_AT_ONCE = 2**18  # rays in one piece of `rays`
_MOST_RAYS = 2**22  # of a point light: beyond this, distant voxels get fewer rays
# The points that stand for an area light: least and largest number; and the rays of all of them
# over those of a point light, as the rays of each point leave a pattern that the others average.
_FEWEST_POINTS, _MOST_POINTS, _RAYS_OF_AREA = 16, 2**12, 2
# Around a lamp: the distance, in voxels, within which light at a voxel's centre is not its mean;
# points along a voxel's edge that the mean is taken over there; and the core of a point light, in
# voxels, large enough for these points.
_NEAR, _FINE, _POINT_CORE = 4, 8, 0.25
_NO_SLATS = np.pi / 2 - 1e-4  # rad, half the spread from which an area light has no grid


class PunctualLight(LocalLight):
    """The common part of point lights and spots: photons and rays from `position` into a cone.

    `_intensity` is the radiant intensity in directions (n, 3) relative to an isotropic point light
    of the same `power`, and `_peak_intensity` its maximum.

    The `radius` dims the light close by: each place is lit as by a disk that faces it, the soft
    falloff of Cycles. Photons and rays still start at a point; `softness` is the share of them that
    counts.
    """

    is_beam = True
    _peak_intensity = 1.0

    position: Vector
    power: Spectrum
    radius: float

    @property
    def spectrum(self) -> Spectrum:
        """The power, scalar or (bands,)."""
        return self.power

    def emit(self, count: int, medium: BaseMedium, rng: np.random.Generator, band: int) -> Photons:
        """Photons from the position in evenly distributed directions, weighted by the intensity.

        From outside, they go only into the cone around the domain's bounding sphere; some of them
        miss the domain.
        """
        tilt, turn = r_sequence(count, 2, rng)
        axis, versine = self._cone(medium.domain)
        directions = tilted(versine * tilt, turn) @ frame_of(axis)
        origins = np.tile(np.asarray(self.position, float), (count, 1))
        power = by_band(self.power, medium.bands)[band] * versine / 2 / count
        return origins, directions, power * self._intensity(directions)

    def rays(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[float, Iterator[Photons]]:
        """Rays evenly distributed over the cone, or over all directions.

        per_edge^2 of them cross a voxel's face in the farthest corner of the domain, unless this
        would take more than _MOST_RAYS in all.
        """
        domain = medium.domain
        axis, versine = self._cone(domain)
        count = min(rays_to(domain, self.position, versine, per_edge), _MOST_RAYS)
        power = float(by_band(self.power, medium.bands)[band]) * versine / 2 / count

        def pieces() -> Iterator[Photons]:
            for first in range(0, count, _RAYS_AT_ONCE):
                numbers = np.arange(first, min(first + _RAYS_AT_ONCE, count))
                directions = even_directions(numbers, count, versine) @ frame_of(axis)
                origins = np.broadcast_to(np.asarray(self.position, float), directions.shape)
                yield origins, directions, power * self._intensity(directions)

        return power * self._peak_intensity, pieces()

    def _cone(self, domain: Domain) -> Cone:
        """The `Cone`, its axis in m, in which the light shines on the domain."""
        return bounding_cone(self.position, domain)

    def _intensity(self, directions: Floats) -> Floats:
        """(n,): the intensity in directions over that of an isotropic point light."""
        return np.ones(len(directions))

    def falloff(self, distance: Floats, core: float = 0.0) -> Floats:
        """1/m^2: fluence over power / 4 pi as a function of distance in m; 1/r^2 for a point.

        core  m, the distance within which the falloff is a linear ramp with a finite peak and the
              same integral over the core
        """
        edge = np.maximum(distance, core)
        slant = np.hypot(edge, self.radius)
        falloff: Floats = 2 / (slant * (slant + edge))
        if core > 0:
            falloff *= 1 + (self.peak(core) - 1) * (1 - distance / edge)
        return falloff

    def peak(self, core: float) -> float:
        """The `falloff` with a core at the lamp, over that at the end of the core."""
        if core == 0:
            return 1.0
        share = (np.arange(64) + 0.5) / 64
        within = share**2 * self.falloff(core * share)
        return 12 * float(np.mean(within) / self.falloff(np.asarray(core))) - 3

    def mean_falloff(self, domain: Domain, core: float = 0.0) -> Floats:
        """(nx, ny, nz) 1/m^2: the mean of `falloff` over each voxel."""

        def falloff(places: Floats) -> Floats:
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

    def softness(self, domain: Domain) -> Floats | None:
        """(nx, ny, nz): the light in each voxel over that of a point light; None for a point."""
        if self.radius == 0:
            return None
        core = _POINT_CORE * domain.voxel_size
        return self.mean_falloff(domain) / self.hardened().mean_falloff(domain, core)

    def is_soft_within(self, domain: Domain) -> bool:
        """Whether the light has a radius and stands in the domain."""
        place = np.asarray(self.position)
        is_within = np.all((place >= domain.origin) & (place <= domain.upper))
        return bool(self.radius > 0 and is_within)


@dataclass(frozen=True)
class PointLight(PunctualLight):
    """Isotropic light from a point.

    position  (3,) m
    power     W, scalar or (bands,)
    radius    m, see `falloff`
    """

    position: Vector
    power: Spectrum
    radius: float = 0.0

    def __post_init__(self) -> None:
        check_place(self.position, "point light")
        check_energy(self.power, "power of a point light")

    def hardened(self) -> Self:
        """The same light with a radius of 0."""
        return replace(self, radius=0.0)


@dataclass(frozen=True)
class SpotLight(PunctualLight):
    """Light from a point into a cone, as in Blender.

    position   (3,) m
    direction  (3,), the axis of the cone in the direction of travel; any length but 0
    power      W, scalar or (bands,), of the point light that has the same intensity on the axis;
               a spot sends out only the cone's share of it
    angle      rad, the full angle of the cone, over 0 and up to pi
    blend      0 to 1, the share of the cone that its soft edge covers: with c the cosine to the
               axis and h that of half the angle, the light falls off by the smoothstep of
               (c - h) / (blend (1 - h))
    radius     m, see `falloff`
    """

    position: Vector
    direction: Vector
    power: Spectrum
    angle: float
    blend: float = 0.0
    radius: float = 0.0

    def __post_init__(self) -> None:
        check_place(self.position, "spot")
        check_direction(self.direction, "spot")
        check_energy(self.power, "power of a spot")
        if not 0 < self.angle <= np.pi + 1e-6:
            raise LightError(f"A spot's angle must be over 0 and at most pi; it is {self.angle}.")
        if not 0 <= self.blend <= 1:
            raise LightError(f"A spot's blend must lie between 0 and 1; it is {self.blend}.")

    def hardened(self) -> Self:
        """The same light with a radius of 0."""
        return replace(self, radius=0.0)

    def _cone(self, domain: Domain) -> Cone:
        beam = np.asarray(self.direction, float), 2 * np.sin(self.angle / 4) ** 2
        return min(beam, bounding_cone(self.position, domain), key=lambda cone: cone[1])

    def _intensity(self, directions: Floats) -> Floats:
        axis = np.divide(self.direction, np.linalg.norm(self.direction))
        inside = directions @ axis - np.cos(self.angle / 2)
        soft = self.blend * 2 * np.sin(self.angle / 4) ** 2
        share = np.clip(inside / max(soft, np.finfo(float).tiny), 0, 1)
        smooth: Floats = share**2 * (3 - 2 * share)
        return smooth


@dataclass(frozen=True)
class AreaLight(LocalLight):
    """Light from one side of a flat rectangle or ellipse, by the cosine law (Lambert).

    center   (3,) m
    u, v     (3,) m, the edges, or the full axes of an ellipse; the light shines towards u x v
    power    W, scalar or (bands,), after the grid of `spread`
    ellipse  whether it is an ellipse
    spread   rad, the full angle beyond which Blender's grid of slats in front of the lamp blocks
             all light; pi for no grid
    """

    center: Vector
    u: Vector
    v: Vector
    power: Spectrum
    ellipse: bool = False
    spread: float = np.pi

    def __post_init__(self) -> None:
        for place in (self.center, self.u, self.v):
            check_place(place, "area light")
        check_direction(np.cross(self.u, self.v), "area light")
        check_energy(self.power, "power of an area light")
        if not 0 < self.spread <= np.pi + 1e-6:
            raise LightError(
                f"The spread of an area light must be over 0 and at most pi; it is {self.spread}."
            )

    @property
    def spectrum(self) -> Spectrum:
        """The power, scalar or (bands,)."""
        return self.power

    def emit(self, count: int, medium: BaseMedium, rng: np.random.Generator, band: int) -> Photons:
        """Photons from all of the area in evenly distributed directions, weighted by the intensity;
        some of them miss the domain."""
        across, along, tilt, turn = r_sequence(count, 4, rng)
        axis, versine = self._cone(medium.domain)
        directions = tilted(versine * tilt, turn) @ frame_of(axis)
        power = by_band(self.power, medium.bands)[band] * versine / 2 / count
        return self._points(across, along), directions, power * self._intensity(directions)

    def rays(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[float, Iterator[Photons]]:
        """Rays from points evenly distributed over the area.

        _RAYS_OF_AREA per_edge^2 or more of them cross a voxel's face in the farthest corner of the
        domain, unless this would take more than about _MOST_RAYS in all.
        """
        domain = medium.domain
        points = self._points(*rank_1(self._point_count(domain)))
        axis, versine = self._cone(domain)
        rays = rays_to(domain, self.center, versine, per_edge) * _RAYS_OF_AREA
        count = ceil(min(rays, _MOST_RAYS) / len(points))  # of each point
        total = count * len(points)
        power = float(by_band(self.power, medium.bands)[band]) * versine / 2 / total
        frame = frame_of(axis)

        def pieces() -> Iterator[Photons]:
            for number, point in enumerate(points):
                turn = GOLDEN * number / count  # so the errors of the points differ
                directions = even_directions(np.arange(count), count, versine, turn) @ frame
                origins = np.broadcast_to(point, directions.shape)
                yield origins, directions, power * self._intensity(directions)

        return power * self._peak_intensity, pieces()

    def _point_count(self, domain: Domain) -> int:
        """The number of points that represent the area: their spacing is about their distance to
        the domain."""
        lower, upper = np.array((domain.origin, domain.upper))
        reach = (np.abs(self.u) + np.abs(self.v)) / 2
        gap = np.maximum(np.maximum(lower - reach - self.center, self.center - reach - upper), 0)
        step = max(np.linalg.norm(gap), domain.voxel_size / 2)
        count = prod(ceil(np.linalg.norm(edge) / step) for edge in (self.u, self.v))
        return int(np.clip(count, _FEWEST_POINTS, _MOST_POINTS))

    def _points(self, across: Floats, along: Floats) -> Floats:
        """(n, 3) m: the points of the area at the coordinates (n,) in [0, 1]; the map preserves
        area."""
        x: Floats
        y: Floats
        if self.ellipse:
            radius, turn = np.sqrt(across), 2 * np.pi * along
            x, y = radius * np.cos(turn) / 2, radius * np.sin(turn) / 2
        else:
            x, y = across - 0.5, along - 0.5
        points: Floats = np.outer(x, self.u) + np.outer(y, self.v) + self.center
        return points

    def _cone(self, domain: Domain) -> Cone:
        """The `Cone` in which the light shines on the domain."""
        half = min(self.spread, np.pi) / 2
        reach = float(np.linalg.norm(np.abs(self.u) + np.abs(self.v)) / 2)
        grid = np.cross(self.u, self.v), 2 * np.sin(half / 2) ** 2
        return min(grid, bounding_cone(self.center, domain, reach), key=lambda cone: cone[1])

    def _intensity(self, directions: Floats) -> Floats:
        """(n,): the intensity in directions over that of an isotropic light of the same power."""
        normal = np.cross(self.u, self.v)
        cosine = directions @ normal / np.linalg.norm(normal)
        half = min(self.spread, np.pi) / 2
        intensity: Floats
        if half > _NO_SLATS:
            intensity = 4 * np.maximum(cosine, 0)
            return intensity
        # cosine times (tan half - tan of the angle), normalized by its integral.
        sine = np.sqrt(np.maximum(1 - cosine**2, 0))
        unblocked = np.where(cosine > 0, cosine * np.tan(half) - sine, 0)
        intensity = 4 * np.maximum(unblocked, 0) / (np.tan(half) - half)
        return intensity

    @property
    def _peak_intensity(self) -> float:
        half = min(self.spread, np.pi) / 2
        return 4.0 if half > _NO_SLATS else float(4 * np.tan(half) / (np.tan(half) - half))
