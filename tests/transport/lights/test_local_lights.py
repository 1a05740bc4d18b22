# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons of points, spots and area lights follow the laws of radiometry."""

from itertools import product
from math import asin, pi

import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.transport import (
    AreaLight,
    Medium,
    PointLight,
    SpotLight,
)
from tests.transport.lights.radiometry import LOWER, MEDIUM, SIZE, UPPER, assert_powers, emitted


def test_point_in_front_of_a_face_hits_it_by_its_solid_angle():
    """The solid angle of a rectangle a x b, seen from d above a corner, is asin(...)."""
    a, b, d = SIZE[1] / 2, SIZE[2] / 2, 1.7
    solid_angle = 4 * asin(a * b / np.sqrt((a**2 + d**2) * (b**2 + d**2)))
    light = PointLight((UPPER[0] + d, *(LOWER + SIZE / 2)[1:]), (7.0, 1.0))

    def through_face(origins, directions, power):
        with np.errstate(divide="ignore"):
            hit = origins - d / directions[:, :1] * directions
        inside = np.all((hit >= LOWER)[:, 1:] & (hit <= UPPER)[:, 1:], axis=1)
        return power[inside & (directions[:, 0] < 0)].sum()

    assert_powers(light, through_face, 7 * solid_angle / (4 * pi))
    total = emitted(light)[2].sum()
    assert 7 * solid_angle / (4 * pi) < total < 3.5


def test_point_outside_sends_a_cone_around_the_bounding_sphere():
    centre, radius = LOWER + SIZE / 2, np.linalg.norm(SIZE) / 2
    for axis, distance in product(range(3), (1.01 * radius, 4.0, 1e9)):
        position = centre - distance * np.eye(3)[axis]
        _origins, directions, power = emitted(PointLight(tuple(position), 1.0))
        sine = radius / distance
        tilt = np.linalg.norm(np.delete(directions, axis, axis=1), axis=1)
        assert np.all(directions[:, axis] > 0)
        assert 0.99 * sine < tilt.max() <= sine * (1 + 1e-6)
        # 1 - cosine without cancellation
        assert power.sum() == pytest.approx(sine**2 / (1 + np.sqrt(1 - sine**2)) / 2, rel=1e-6)


@pytest.mark.parametrize("distance", [0.1, 0.5, 3.0])
def test_a_soft_lamp_lights_as_a_disk_that_faces_the_place(distance):
    """A disk of uniform radiance (cosine law), integrated over rings of the same area."""
    radius, count = 0.5, 10_000
    squares = distance**2 + radius**2 * (np.arange(count) + 0.5) / count
    expected = np.mean(distance / squares**1.5)
    assert PointLight((0, 0, 0), 1.0, radius).falloff(distance) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("radius", [0.0, 0.1, 2.0])
def test_a_core_is_finite_and_keeps_the_light(radius):
    lamp, core = PointLight((0, 0, 0), 1.0, radius), 0.3
    distance = (np.arange(1000) + 0.5) / 1000 * core
    found, expected = (np.mean(distance**2 * lamp.falloff(distance, c)) for c in (core, 0.0))
    assert found == pytest.approx(expected, rel=1e-3)
    assert lamp.falloff(1e-9, core) == pytest.approx(lamp.peak(core) * lamp.falloff(core))
    assert lamp.falloff(0.4, core) == lamp.falloff(0.4)


def test_the_mean_falloff_is_that_of_points_in_each_voxel():
    lamp = PointLight(tuple(LOWER + 0.3 * SIZE), 1.0)
    found = lamp.mean_falloff(MEDIUM.domain, core=0.5)
    points = np.random.default_rng(3).uniform(-0.25, 0.25, (4000, 3))
    places = MEDIUM.domain.centers()[..., None, :] + points - lamp.position
    expected = lamp.falloff(np.linalg.norm(places, axis=-1), 0.5).mean(axis=-1)
    assert found == pytest.approx(expected, rel=0.05)


def total_of(light):
    """W that reach the box, of the photons that cross its bounding sphere."""
    return np.mean([emitted(light, seed=seed)[2].sum() for seed in range(20)])


@pytest.mark.parametrize("blend", [0.0, 0.3, 1.0])
def test_the_power_of_a_spot_is_that_within_its_falloff(blend):
    """The mean of the smoothstep is 1/2, so the soft edge keeps half of its light."""
    angle, power = 1.5, 5.0
    light = SpotLight((0, 3, 4), (2, -1, 0.5), power, angle, blend)
    cap = 1 - np.cos(angle / 2)
    assert total_of(light) == pytest.approx(power * cap / 2 * (1 - blend / 2), rel=1e-3)


def test_a_spot_shines_only_into_its_cone():
    light = SpotLight((0, 3, 4), (2, -1, 0.5), 5.0, 0.8, 0.2)
    _, directions, power = emitted(light)
    axis = np.divide(light.direction, np.linalg.norm(light.direction))
    angles = np.arccos(np.clip(directions @ axis, -1, 1))
    assert angles.max() < 0.4 + 1e-9
    inner = np.arccos(np.cos(0.4) + 0.2 * (1 - np.cos(0.4)))
    assert np.ptp(power[angles < inner]) == pytest.approx(0, abs=1e-12)
    assert power[angles > 0.3995].max() < 1e-3 * power.max()


def test_a_distant_spot_is_a_point_of_its_power():
    middle = LOWER + SIZE / 2
    position = tuple(middle - (0, 0, 500.0))
    spot = SpotLight(position, (0, 0, 1), 7.0, 0.5, 0.1)
    assert total_of(spot) == pytest.approx(total_of(PointLight(position, 7.0)), rel=1e-6)


@pytest.mark.parametrize("spread", [np.pi, 2.0, 0.3])
@pytest.mark.parametrize("ellipse", [False, True])
def test_an_area_light_sends_out_its_power_to_one_side(ellipse, spread):
    light = AreaLight((0, 3, 4), (0, 1, 0), (0, 0.3, 2), 5.0, ellipse, spread)
    origins, directions, _ = emitted(light)
    assert total_of(light) == pytest.approx(5.0, rel=1e-3)
    assert directions[:, 0].min() >= np.cos(spread / 2) - 1e-9
    y, z = (origins - light.center)[:, 1:].T
    across, along = y - 0.3 * z / 2, z / 2  # shares of the edges
    assert np.all(origins[:, 0] == 0)
    edge = np.hypot(across, along) if ellipse else np.maximum(abs(across), abs(along))
    assert 0.49 < edge.max() <= 0.5
    inner = np.mean(edge < 0.25)  # evenly over it: a quarter of its area, whatever its shape
    assert inner == pytest.approx(0.25, abs=0.01)


def test_slats_block_light_by_their_angle():
    """The intensity is the cosine times (tan of half the spread, h, minus tan of the angle): the
    share within the angle a is (tan(h) sin^2(a) - a + sin(a) cos(a)) / (tan(h) - h)."""
    half, angle = 0.6, 0.35
    light = AreaLight((0, 3, 4), (0, 1, 0), (0, 0, 1), 5.0, spread=2 * half)
    _, directions, power = emitted(light, 100_000)
    share = np.tan(half) * np.sin(angle) ** 2 - angle + np.sin(angle) * np.cos(angle)
    share /= np.tan(half) - half
    inner = power[directions[:, 0] > np.cos(angle)].sum()
    assert inner / power.sum() == pytest.approx(share, rel=2e-3)


@pytest.mark.parametrize("shining", [1, -1])
def test_an_area_light_lights_a_face_by_its_view_factor(shining):
    """Two parallel squares of edge a at the distance a: .1998 (Howell, C-11)."""
    medium = Medium(np.ones((2, 2, 2)), 0.5, 1, 0)
    light = AreaLight((0.5, 0.5, 2.0), (shining, 0, 0), (0, -1, 0), 3.0)
    reached = []
    for seed in range(20):
        origins, directions, power = emitted(light, 20_000, seed, medium=medium)
        hit = origins - directions / np.where(directions[:, 2:], directions[:, 2:], np.inf)
        inside = np.all((hit[:, :2] >= 0) & (hit[:, :2] <= 1), axis=1)
        reached.append(power[inside & (directions[:, 2] < 0)].sum())
    assert np.mean(reached) == pytest.approx(3 * 0.1998 if shining > 0 else 0, rel=5e-3)


@pytest.mark.parametrize(
    ("light", "sentence"),
    [
        (lambda: SpotLight((0, 0), (0, 0, 1), 1.0, 1.0), "spot needs a position"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 0), 1.0, 1.0), "spot needs a direction"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 1), -1.0, 1.0), "power of a spot must be"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 1), 1.0, 0.0), "spot's angle"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 1), 1.0, 1.0, 1.1), "spot's blend"),
        (lambda: AreaLight((0, 0, np.nan), (1, 0, 0), (0, 1, 0), 1.0), "needs a position"),
        (lambda: AreaLight((0, 0, 0), (1, 0, 0), (2, 0, 0), 1.0), "needs a direction"),
        (lambda: AreaLight((0, 0, 0), (1, 0, 0), (0, 1, 0), np.inf), "power of an area light"),
        (lambda: AreaLight((0, 0, 0), (1, 0, 0), (0, 1, 0), 1.0, spread=4.0), "spread of an"),
    ],
)
def test_impossible_lamps_are_refused(light, sentence):
    with pytest.raises(LightError, match=sentence):
        light()


def test_point_at_the_centre():
    light = PointLight(tuple(LOWER + SIZE / 2), 1.0)
    np.testing.assert_allclose(emitted(light)[1].mean(axis=0), 0, atol=1e-3)


def test_a_lamp_with_a_radius_is_soft_where_it_stands():
    inside = PointLight(tuple(LOWER + SIZE / 2), 1.0, radius=0.1)
    outside = PointLight(tuple(LOWER - 1), 1.0, radius=0.1)
    assert inside.is_soft_within(MEDIUM.domain)
    assert not outside.is_soft_within(MEDIUM.domain)
    assert inside.hardened() == PointLight(inside.position, 1.0)
