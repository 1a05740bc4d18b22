# SPDX-License-Identifier: GPL-3.0-or-later
"""The collision source: light at the collision where the lattice takes over.

That is the first collision, found by exact rays, or a later one, found by photons. Docs:
docs/theory/physics.md.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..arrays import Floats
from .band_light import BandLight
from .box import Box
from .context import Context
from .field import Field
from .lattice.lattice_numpy import Source
from .lights.base import Light, by_band
from .lights.distant import Sky
from .lights.sampling import face_areas
from .medium import Medium
from .uncollided import casting
from .uncollided.cache import Rays, parts

_MOST_MISSING = 10.0  # absorption depth of voxels up to which `_add_missing` is used


class BandSource:
    """The collision source of one band, in the voxels of a box.

    power      (nx, ny, nz) W/m^2, over the squared edge of a voxel
    reflected  (nx, ny, nz) W/m^2, what opaque voxels send into each voxel
    place      (3, nx, ny, nz) W/m^2, power times the position of the collisions relative to the
               voxel's centre, in voxels
    direction  (3, nx, ny, nz) W/m^2, power times the mean direction after the collisions
    """

    def __init__(self, medium: Medium, box: Box) -> None:
        self.voxel_size, self.box = medium.voxel_size, box
        self.power, self.reflected = np.zeros((2, *box.shape))
        self.place, self.direction = np.zeros((2, 3, *box.shape))

    def add(self, moments: casting.Moments, share: float, mean_cosine: float) -> None:
        """Add collisions.

        share        the share of their power that scatters
        mean_cosine  of the angle by which it turns
        """
        area = self.voxel_size**2
        self.power += moments.power * (share / area)
        self.place += moments.position * (share / (area * self.voxel_size))
        self.direction += moments.direction * (share * mean_cosine / area)

    def add_reflected(self, power: Floats) -> None:
        """Add what opaque voxels reflect into each voxel of the box, (nx, ny, nz) W."""
        self.reflected += power / self.voxel_size**2

    def largest(self) -> float:
        """The largest power in a voxel, W/m^2."""
        return float(np.maximum(np.abs(self.power).max(), self.reflected.max()))

    def scaled(self, transport_depth: Floats, scale: float) -> Source:
        """The lattice's `Source`, divided by a scale.

        transport_depth  (nx, ny, nz), transport optical depth of a voxel's edge
        """
        drift = transport_depth * self.place + self.direction
        return Source(self.power / scale, drift / scale, self.reflected / scale)


def count_first_collisions(
    medium: Medium,
    box: Box,
    lights: Sequence[Light],
    lit: Mapping[int, BandLight],
    context: Context,
) -> None:
    """Add uncollided light to {band: `BandLight`}, and count the power that scatters."""
    for light in lit.values():
        light.energy["scattered"] = 0.0
    for number, rays in _each_light(medium, box, lights, context):
        for band, light in lit.items():
            cast, albedo = rays.cast(band, medium.sigma_t[band]), medium.albedo[band]
            light.add_uncollided(number, cast)
            collided = cast.collided.power.sum(dtype=float)
            light.energy["entered"] += cast.entered
            light.energy["absorbed"] += cast.stopped + (1 - albedo) * collided
            light.energy["left"] += cast.left
            light.energy["scattered"] += albedo * collided + cast.sent_back


def first_collisions(
    medium: Medium,
    box: Box,
    lights: Sequence[Light],
    lit: Mapping[int, BandLight],
    context: Context,
) -> dict[int, BandSource]:
    """{band: source} of first collisions; adds uncollided light to {band: `BandLight`}."""
    sources = {band: BandSource(medium, box) for band in lit}
    for number, rays in _each_light(medium, box, lights, context):
        for band, light in lit.items():
            uncollided = rays.cast(band, medium.sigma_t[band])
            if _is_uniform(rays.light, medium, band):
                _add_missing(rays, band, uncollided, sources[band], light)
            else:
                _add_collided(rays, band, number, uncollided, sources[band], light)
            light.add_uncollided(number, uncollided)
    return sources


def last_collisions(
    medium: Medium,
    box: Box,
    lights: Sequence[Light],
    traced: Field,
    lit: Mapping[int, BandLight],
    context: Context,
) -> dict[int, BandSource]:
    """{band: source} of the photons' last collisions.

    Adds uncollided light, and the light that the photons scored on their way, to
    {band: `BandLight`}.
    """
    sources = {band: _traced_source(medium, box, band, traced, lit[band]) for band in lit}
    for number, rays in _each_light(medium, box, lights, context):
        for band, light in lit.items():
            cast = rays.cast(band, medium.sigma_t[band], shadowed=False)
            light.add_uncollided(number, cast)
            if rays.light.is_beam:
                ahead = _cast_forward(rays, band, cast, shadowed=False)[0]
                shade = ahead.shade.of
                shade(light.forward[number])[...] += ahead.over(cast)[0]
    return sources


def _each_light(
    medium: Medium, box: Box, lights: Sequence[Light], context: Context
) -> Iterator[tuple[int, Rays]]:
    """(number of its light, `Rays`) of each part of the lights, one at a time: casts take much
    memory."""
    how = context.settings.rays, context.device, context.monitor
    for number, part in parts(lights):
        yield number, Rays(medium, box, part, *how)


def _add_collided(
    rays: Rays,
    band: int,
    number: int,
    uncollided: casting.Cast,
    source: BandSource,
    lit: BandLight,
) -> None:
    """Add the first collisions of a light to a source."""
    cast, share, mean_cosine = _cast_forward(rays, band, uncollided)
    source.add(cast.collided, share, mean_cosine)
    if cast.reflected is not None:
        source.add_reflected(cast.reflected)
    if cast is not uncollided:  # there is a forward peak
        lit.add_forward_peak(number, cast, uncollided)
    collided = cast.collided.power.sum(dtype=float)
    lit.energy["entered"] += cast.entered
    lit.energy["absorbed"] += cast.stopped + (1 - share) * collided
    lit.energy["left"] += cast.left


def _add_missing(
    rays: Rays,
    band: int,
    uncollided: casting.Cast,
    source: BandSource,
    lit: BandLight,
) -> None:
    """Add the light that absorption removes from a uniform sky to a source, as negative power.

    Without absorption a uniform sky lights everything evenly, however the medium scatters. The
    missing light is the light that the medium would emit if it re-emitted all that it absorbs of
    the sky. So a white medium is exact, and a bright one leaves little to the lattice.
    """
    medium = rays.medium
    assert isinstance(rays.light, Sky)
    assert not callable(rays.light.radiance)
    radiance = float(by_band(rays.light.radiance, medium.bands)[band])
    # Larger values are errors of the rays, and would make scattered light negative.
    np.minimum(uncollided.direct, 4 * np.pi * radiance, out=uncollided.direct)
    cast, share, mean_cosine = _cast_forward(rays.missing, band, None)
    source.add(cast.collided, -share, mean_cosine)
    lit.fluence += 4 * np.pi * radiance - cast.direct - uncollided.direct
    lit.flux -= cast.flux + uncollided.flux
    collided = cast.collided.power.sum(dtype=float)
    lit.energy["absorbed"] += cast.entered - (1 - share) * collided
    through_faces = np.pi * radiance * np.repeat(face_areas(medium.domain), 2)
    lit.energy["entered"] += through_faces.sum()
    lit.energy["left"] += through_faces - cast.left


def _cast_forward(
    rays: Rays, band: int, uncollided: casting.Cast | None, shadowed: bool = True
) -> tuple[casting.Cast, float, float]:
    """(`casting.Cast`, share of its collisions that scatters, mean cosine of that).

    The forward peak counts as uncollided: of the light that scatters, the share f = g^2 goes
    straight on, and the remainder has the mean cosine (g - f) / (1 - f) (Joseph, Wiscombe and
    Weinman, "The delta-Eddington approximation for radiative flux transfer", 1976).

    uncollided  the cast that counts the forward peak as scattered, if there is one
    """
    medium, light = rays.medium, rays.light
    albedo, g = medium.albedo[band], medium.g[band]
    # A soft lamp dims its own light, but not light that goes on from a collision near it.
    forward = 0.0 if light.is_soft_within(medium.domain) else max(g, 0.0) ** 2
    cast = uncollided
    if forward > 0 or cast is None:
        sigma_t = medium.sigma_t[band] - forward * medium.sigma_s[band]
        cast = rays.cast(band, sigma_t, shadowed, peaked=False)
    share = albedo * (1 - forward) / (1 - albedo * forward)
    return cast, share, (g - forward) / (1 - forward)


def _traced_source(
    medium: Medium, box: Box, band: int, traced: Field, lit: BandLight
) -> BandSource:
    """The source of a trace's last collisions; adds the light of its photons to a `BandLight`."""
    assert traced.flux is not None
    lit.fluence += traced.fluence[band]
    lit.flux += traced.flux[band]
    energy = traced.report.energy
    for where in lit.energy:
        lit.energy[where] += energy[where][band]
    lit.energy["absorbed"] += energy["lost"][band]
    source, last = BandSource(medium, box), traced.collision_source
    if last is not None:
        moments = (last.power[band], last.position[band], last.direction[band])
        source.add(casting.Moments(*map(box.of, moments)), 1.0, medium.g[band])
    return source


def _is_uniform(light: object, medium: Medium, band: int) -> bool:
    """Whether a light is a uniform sky, and `_add_missing` is accurate for it."""
    uniform = isinstance(light, Sky) and not callable(light.radiance) and medium.occlusion is None
    if not uniform or medium.sigma_a[band] > medium.sigma_s[band]:
        return False
    # Missing light much brighter than the light itself would leave too few digits.
    return bool(medium.depth(medium.sigma_a[band]).max() <= _MOST_MISSING)
