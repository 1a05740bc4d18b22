# SPDX-License-Identifier: GPL-3.0-or-later
"""Uncollided light against the Beer-Lambert law, the inverse square, a furnace, and photons."""

from functools import cache

import numpy as np
import pytest

from lb_lighting.transport import AreaLight, Medium, PointLight, Sky, SpotLight, Sun, trace
from lb_lighting.transport.device import devices
from lb_lighting.transport.lights.emission import Emission
from lb_lighting.transport.uncollided.casting import cast
from tests.tracing import Beam, assert_mean
from tests.transport.uncollided.beams import (
    SUN,
    H,
    accounted,
    on_every_device,
    on_opencl,
    parts,
    patchy,
)

LIGHTS = {
    "sun": SUN,
    "sun along an axis": Sun((0, -1, 0), 1.0),
    "sky": Sky(0.1),
    "sky by direction": Sky(lambda towards: np.maximum(towards[..., 2], 0)),
    "point inside": PointLight((-0.5, 0.33, 2.2), 3.0),
    "soft point inside": PointLight((-0.5, 0.33, 2.2), 3.0, 0.3),
    "point outside": PointLight((-5, 3, 2.2), 3.0),
    "spot": SpotLight((-5, 3, 2.2), (1, -0.55, 0), 3.0, 0.25, 0.6),
    "area": AreaLight((-0.5, 0.6, 3.7), (1, 0, 0), (0, -0.8, 0.2), 3.0),
    "beam": Beam((-0.93, 0.01, 2.0), (0.2, 0.1, 1), diffuse=True),
    "emission": Emission(patchy()),
}


@cache
def light_of(kind, device, occluded=True):
    return cast(patchy(occluded), LIGHTS[kind], 0, 2.0, device, per_edge=4)


def samples(medium, per_edge):
    """(nx, ny, nz, per_edge^3, 3) m, points distributed evenly over each voxel."""
    offsets = ((np.arange(per_edge) + 0.5) / per_edge - 0.5) * medium.voxel_size
    grid = np.stack(np.meshgrid(offsets, offsets, offsets, indexing="ij"), axis=-1)
    return medium.domain.centers()[..., None, :] + grid.reshape(-1, 3)


@on_every_device
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("forward", [True, False])
def test_slabs_attenuate_by_the_beer_lambert_law(axis, forward, device):
    depth = np.array([0.3, 0, 1e-5, 2.0, 0.7, 8.0, 0.01])  # of the voxels, in the sun's way
    sigma, irradiance = 2.5, 3.0
    density = (depth if forward else depth[::-1]) / (sigma * H)
    shape = [1, 1, 1]
    shape[axis] = len(depth)
    medium = Medium(density.reshape(shape) * np.ones([n + 2 * (n == 1) for n in shape]), H, 1, 0)
    direction = np.eye(3)[axis] * (1 if forward else -1)
    result = cast(medium, Sun(direction, irradiance), 0, sigma, device)

    def along(values):
        """(7,) of the middle row, in the direction of the sun; all rows are alike."""
        rows = np.moveaxis(values, axis, -1).reshape(9, -1)
        assert np.allclose(rows, rows[4], rtol=2e-6, atol=1e-9 * abs(rows).max())
        return rows[4] if forward else rows[4][::-1]

    entering = irradiance * np.exp(-np.concatenate([[0], np.cumsum(depth)[:-1]]))
    share = -np.expm1(-depth)
    mean = np.divide(share, depth, out=np.ones(7), where=depth > 0)
    thick = np.maximum(depth, 1e-3)
    place = np.where(depth > 1e-3, 1 / thick - 1 / np.expm1(thick), 0.5 - depth / 12) - 0.5
    power = entering * share * H**2
    unit = 1e-9  # of a tally, in the strongest light
    light = entering * mean
    assert along(result.direct) == pytest.approx(light, rel=1e-5, abs=unit * light.max())
    assert along(result.collided.power) == pytest.approx(power, rel=1e-5, abs=unit * power.max())
    position = along(result.collided.position[axis]) * (1 if forward else -1)
    assert position == pytest.approx(power * place * H, rel=1e-5, abs=1e-7 * power.max() * H)
    assert result.collided.direction[axis] == pytest.approx(
        direction[axis] * result.collided.power, rel=1e-6
    )
    assert result.flux[axis] == pytest.approx(direction[axis] * result.direct, rel=1e-6)
    far_side, area = 2 * axis + forward, 9 * H**2
    assert result.left[far_side] == pytest.approx(
        area * irradiance * np.exp(-depth.sum()), rel=1e-5, abs=unit * area * irradiance
    )
    assert np.delete(result.left, far_side) == pytest.approx(0)


@on_every_device
@pytest.mark.parametrize("direction", [(0.3, 0.2, -0.93), (1, 1, 1), (-1, 2, 0), (1, 0.3, -0.15)])
def test_an_oblique_sun_is_attenuated_by_its_path_through_the_box(direction, device):
    medium, sigma = Medium(np.ones((6, 5, 4)), H, 1, 0), 3.0
    result = cast(medium, Sun(direction, 1.0), 0, sigma, device)
    toward = np.divide(direction, np.linalg.norm(direction))
    points, upper = samples(medium, 20), np.array(medium.domain.upper)
    with np.errstate(divide="ignore"):
        ways = np.where(toward > 0, points, upper - points) / abs(toward)
    expected = np.exp(-sigma * ways.min(axis=-1)).mean(axis=-1)
    assert np.abs(result.direct / expected - 1).max() < 5e-3
    assert result.collided.power == pytest.approx(sigma * H**3 * result.direct, rel=1e-6)


@on_opencl
@pytest.mark.parametrize("sigma", [0.0, 2.0])
@pytest.mark.parametrize("position", [(1.03, 0.97, 1.11), (-0.3, 0.5, 2.9)], ids=["in", "out"])
def test_a_point_light_falls_off_by_the_square_and_by_absorption(position, sigma, device):
    medium = Medium(np.ones((16, 16, 16)), 0.125, 1, 0)
    result = cast(medium, PointLight(position, 2.0), 0, sigma, device)
    way = samples(medium, 8) - position
    squared = (way**2).sum(axis=-1)
    to_border = np.zeros_like(squared)  # outside is vacuum
    if not np.all(np.array(position) > 0):
        with np.errstate(divide="ignore"):
            faces = (np.where(way > 0, 0, 2.0) - position) / way
        to_border = np.clip(faces.max(axis=-1), 0, 1)
    light = 2.0 * np.exp(-sigma * (1 - to_border) * np.sqrt(squared)) / (4 * np.pi * squared)
    far = np.abs(medium.domain.centers() - position).max(axis=-1) > 2 * medium.voxel_size
    error = (result.direct / light.mean(axis=-1) - 1)[far]
    outwards = medium.domain.centers()[far] - position
    outwards /= np.linalg.norm(outwards, axis=-1, keepdims=True)
    flux = (np.moveaxis(result.flux, 0, -1)[far] * outwards).sum(axis=-1)
    assert flux == pytest.approx(result.direct[far], rel=5e-2)  # all of it flows outwards
    assert np.sqrt((error**2).mean()) < 3e-3
    assert np.abs(error).max() < 2.5e-2


@on_opencl
def test_a_soft_lamp_is_a_point_dimmed_close_by(device):
    medium, position = Medium(np.ones((12, 12, 12)), 0.1, 1, 0), (0.62, 0.57, 0.61)
    soft, point = (cast(medium, PointLight(position, 2.0, r), 0, 1.0, device) for r in (0.3, 0.0))
    distance = np.linalg.norm(medium.domain.centers() - position, axis=-1)
    share = 2 * (distance / 0.3) ** 2 * (1 - distance / np.hypot(distance, 0.3))
    far = distance > 0.25  # where a voxel is about its centre
    assert (soft.direct / point.direct)[far] == pytest.approx(share[far], rel=0.03)
    for what in ("power", "position", "direction"):
        dimmed = getattr(soft.collided, what) / (soft.direct / point.direct)
        assert dimmed == pytest.approx(getattr(point.collided, what), rel=1e-4, abs=1e-9)


@on_opencl
def test_a_spot_is_the_point_light_within_its_cone(device):
    medium, position = Medium(np.ones((16, 16, 16)), 0.125, 1, 0), (1.0, 1.0, 5.0)
    spot = SpotLight(position, (0, 0, -1), 2.0, 0.5, 0.5)
    lit, point = (
        cast(medium, light, 0, 0.7, device) for light in (spot, PointLight(position, 2.0))
    )
    way = samples(medium, 4) - position
    cosine = -way[..., 2] / np.linalg.norm(way, axis=-1)
    edge = np.cos(0.25)
    share = np.clip((cosine - edge) / (0.5 * (1 - edge)), 0, 1)
    expected = (share**2 * (3 - 2 * share)).mean(axis=-1)
    assert lit.direct / point.direct == pytest.approx(expected, abs=0.02)
    assert np.linalg.norm(lit.direct - expected * point.direct) < 4e-3 * np.linalg.norm(lit.direct)


def angle_filled(points, a, b):
    """sr of the rectangle |x| < a, |y| < b, z = 0 as points (..., 3) see it."""
    x, y, d = np.moveaxis(np.abs(points), -1, 0)

    def corner(x, y):
        return np.arctan2(x * y, d * np.sqrt(x**2 + y**2 + d**2))

    return sum(corner(a + i * x, b + j * y) for i in (-1, 1) for j in (-1, 1))


@on_opencl
@pytest.mark.parametrize(
    ("size", "height", "allowed"),
    [(0.5, 3.0, 0.02), (3, 3.0, 0.02), (3, 2.3, 0.03), (1, 1.3, 0.12)],
)
def test_an_area_light_is_as_bright_as_the_angle_that_it_fills(size, height, allowed, device):
    """Its radiance is 1, and it shines downwards. The last one is inside; most of the error (L2) is
    in the voxels in which it lies."""
    medium = Medium(np.ones((16, 16, 16)), 0.125, 1, 0)
    center = (1.1, 0.9, height)
    light = AreaLight(center, (size, 0, 0), (0, -size / 2, 0), np.pi * size**2 / 2)
    found = cast(medium, light, 0, 0.0, device, per_edge=6)
    points = samples(medium, 4) - center
    seen = np.where(points[..., 2] < 0, angle_filled(points, size / 2, size / 4), 0)
    expected = seen.mean(axis=-1)
    assert np.linalg.norm(found.direct - expected) < allowed * np.linalg.norm(expected)
    assert found.direct.sum() == pytest.approx(expected.sum(), rel=3e-2)
    assert not found.direct[expected == 0].any()
    assert np.all(found.flux[2] <= 0)


@on_opencl
def test_light_that_misses_the_domain_is_none(device):
    medium = Medium(np.ones((4, 4, 4)), 0.1, 1, 0)
    away = SpotLight((0.2, 0.2, 1), (0, 0, 1), 1.0, 0.5)
    result = cast(medium, away, 0, 1.0, device)
    assert result.entered == 0
    assert not result.direct.any()


@on_opencl
def test_a_void_under_a_uniform_sky_is_as_bright_as_the_sky(device):
    result = cast(Medium(np.zeros((12, 9, 14)), H, 1, 0), Sky(0.5), 0, 1.0, device)
    assert np.abs(result.direct / (2 * np.pi) - 1).max() < 1e-2
    assert np.abs(result.flux).max() < 1e-2 * 2 * np.pi  # as much flows either way
    assert not result.collided.power.any()
    surface = 2 * H**2 * (12 * 9 + 9 * 14 + 14 * 12)
    assert result.entered == pytest.approx(0.5 * np.pi * surface, rel=1e-3)


@on_every_device
def test_a_medium_that_glows_like_the_sky_is_a_furnace(device):
    """Voxels emit as much as they absorb of the sky, at any density."""
    density, sigma, radiance = patchy().density, 6.0, 0.25
    glow = 4 * np.pi * radiance * sigma * density
    medium = Medium(density, H, sigma, 0, emission=glow)
    both = [cast(medium, light, 0, sigma, device) for light in (Sky(radiance), Emission(medium))]
    direct = sum(result.direct for result in both)
    assert np.abs(direct / (4 * np.pi * radiance) - 1).max() < 1e-2
    collided = sum(result.collided.power for result in both)
    assert collided == pytest.approx(glow * H**3, rel=1e-2)
    # Uniform light collides in the middle on average, and in all directions.
    for moment, scale in (("position", H), ("direction", 1)):
        moments = sum(getattr(result.collided, moment) for result in both)
        assert np.abs(moments).max() < 1e-2 * scale * collided.max()


@on_opencl
@pytest.mark.parametrize("lit", ["sun", "sky", "point inside", "spot", "area", "emission"])
def test_photons_collide_first_where_rays_do(lit, device):
    """Of 16 traces, in the voxels that 20 photons of each or more reach; a false alarm comes once
    in 10 000 seeds, see `assert_near`. The rays' own error is taken for 1 % of a voxel's light.
    """
    medium, photons = patchy(occluded=False), 8192
    light, dark = LIGHTS[lit], Medium(medium.density, H, 1.5, 0.5, origin=medium.origin)
    lights, traced = ([], medium) if lit == "emission" else ([light], dark)
    result = cast(medium, light, 0, 2.0, device, per_edge=12)
    options = {"device": device, "handover": 1}
    fields = [trace(traced, lights, photons, seed=s, **options) for s in range(16)]
    least = 20 * result.entered / photons  # W
    power = medium.albedo[0] * result.collided.power
    for kind, scale in (("power", 1), ("position", H / 2), ("direction", 1)):
        found = np.array([getattr(field.collision_source, kind)[0] for field in fields])
        expected = medium.albedo[0] * getattr(result.collided, kind)
        bright = power > least
        # Relative to the largest possible moment of that power, shifted away from 0.
        size = scale * power[bright]
        shift = 2.0
        assert_mean(
            found[..., bright] / size + shift, expected[..., bright] / size + shift, rounding=5e-3
        )
    bright = result.direct > least / H**2
    assert_mean([field.direct[0][bright] for field in fields], result.direct[bright], rounding=1e-2)


@on_every_device
@pytest.mark.parametrize("lit", LIGHTS)
@pytest.mark.parametrize("occluded", [True, False])
def test_no_light_is_lost_or_made(lit, occluded, device):
    result = light_of(lit, device, occluded)
    assert result.entered > 0
    assert accounted(result) == pytest.approx(result.entered, rel=1e-5)
    assert result.direct.min() >= 0
    assert result.collided.power.min() >= 0


@on_opencl
@pytest.mark.parametrize("lit", LIGHTS)
@pytest.mark.parametrize("occluded", [True, False])
def test_devices_do_as_the_twin(lit, occluded, device):
    found = parts(light_of(lit, device, occluded))
    for what, twin in parts(light_of(lit, devices()[-1], occluded)).items():
        assert np.abs(found[what] - twin).max() <= 1e-5 * np.abs(twin).max(), what


@on_opencl
@pytest.mark.parametrize("lit", ["sun", "sky", "emission"])
def test_the_same_problem_gives_the_same_bits(lit, device):
    again = parts(cast(patchy(), LIGHTS[lit], 0, 2.0, device, per_edge=4))
    for what, before in parts(light_of(lit, device)).items():
        assert np.array_equal(again[what], before), what
