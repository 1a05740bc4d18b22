# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps: light from a point, a spot or an area."""

from dataclasses import dataclass, replace
from math import ceil, prod

import numpy as np

from ...errors import LightError
from .base import (
    LocalLight,
    by_band,
    check_direction,
    check_energy,
    check_place,
)
from .sampling import (
    GOLDEN,
    even_directions,
    frame_of,
    rank_1,
    rays_to,
    sight,
    strata,
    tilted,
)

_RAYS_AT_ONCE = 2**18  # that a light makes
_MOST_RAYS = 2**22  # of a point light: voxels far away get fewer rays then
# Of an area light: how many points stand for it at least and at most; and how many times the rays
# of a point light they have together, for each alone leaves its own pattern.
_FEWEST_POINTS, _MOST_POINTS, _RAYS_OF_AREA = 16, 2**12, 2
# Around a lamp: to how many voxels away light is not about that at their centre; points along their
# edges by which its mean is found there; and the core of a point, in voxels, wide enough for these.
_NEAR, _FINE, _POINT_CORE = 4, 8, 0.25
_NO_SLATS = np.pi / 2 - 1e-4  # rad, half the spread from which an area light has no grid


class _AtPoint(LocalLight):
    """What lights at a `position` share: photons and rays into the cone that counts.

    Such a light has a `power`, and says by `_relative` how strong it is in directions (n, 3), over
    a point of that power that shines the same everywhere; `_strongest` is the most of that.

    Its `radius` dims it close by: it lights a place as a disk that faces the place, which is the
    soft falloff of Cycles. Its photons and rays come from a point all the same; `softness` says
    what share of them counts.
    """

    is_beam = True
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
        point = self.hardened()
        core = _POINT_CORE * domain.voxel_size
        return self.mean_falloff(domain) / point.mean_falloff(domain, core)

    def is_soft_within(self, domain):
        """Whether the light has a radius and stands in the domain."""
        place = np.asarray(self.position)
        within = np.all((place >= domain.origin) & (place <= domain.upper))
        return bool(self.radius > 0 and within)

    def hardened(self):
        """The same light from a point."""
        return replace(self, radius=0.0)


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
        check_place(self.position, "point light")
        check_energy(self.power, "power of a point light")


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
        check_place(self.position, "spot")
        check_direction(self.direction, "spot")
        check_energy(self.power, "power of a spot")
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
class AreaLight(LocalLight):
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
            check_place(place, "area light")
        check_direction(np.cross(self.u, self.v), "area light")
        check_energy(self.power, "power of an area light")
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
