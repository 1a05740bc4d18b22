# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons of lights follow the laws of radiometry.

Distributions are tested on independent photons, each from a separate call; powers on the means of
many calls, whose variance is measured. Each such test fails by chance for at most one seed in
FALSE_ALARMS, with Sidak's correction for several numbers.
"""

from functools import cache
from itertools import product
from math import asin, pi
from statistics import NormalDist

import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.transport import (
    AreaLight,
    DistantLight,
    Light,
    LocalLight,
    Medium,
    PointLight,
    Sky,
    SpotLight,
    Sun,
)
from lb_lighting.transport.lights.base import multiple
from lb_lighting.transport.lights.emission import Emission
from lb_lighting.transport.lights.sampling import face_areas, rank_1

FALSE_ALARMS = 10_000
SIZE = np.array((2.0, 3.0, 2.5))
LOWER = np.array((-1.0, 2.0, 3.0))
UPPER = LOWER + SIZE
AREAS = SIZE.prod() / SIZE  # of the faces across x, y and z
SHAPE = (4, 6, 5)
MEDIUM = Medium(np.ones(SHAPE), 0.5, (1.0, 1.0), 0.1, origin=LOWER)
OBLIQUE = Sun((0.6, -0.4, -1.1), (2.0, 5.0))
TOWARD = np.divide(OBLIQUE.direction, np.linalg.norm(OBLIQUE.direction))


def overhead(towards):
    return np.maximum(towards[..., 2], 0)


def everywhere(towards):
    return np.ones(towards.shape[:-1])


LIGHTS = {
    "sun": OBLIQUE,
    "sun along an axis": Sun((0, 0, 3), 1.0),
    "sky": Sky((1.0, 3.0)),
    "sky by direction": Sky(overhead),
    "point inside": PointLight((0, 3, 4), 5.0),
    "point outside": PointLight((4, 3, 4), 5.0),
    "spot inside": SpotLight((0, 3, 4), (1, 0.4, -0.2), 5.0, 1.2, 0.5),
    "spot outside": SpotLight((4, 3, 4), (-1, 0.1, 0), 5.0, 0.7),
    "area inside": AreaLight((0, 3, 4), (0, 1, 0), (0, 0, 2), 5.0),
    "area outside": AreaLight((4, 3, 4), (0, 1, 2), (0.5, 1, 0), 5.0, ellipse=True),
    "emission": Emission(
        Medium(np.ones(SHAPE), 0.5, (1, 1), 0, origin=LOWER, emission=np.ones(SHAPE))
    ),
}
every_light = pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS)


@pytest.mark.parametrize("lowest", [-0.5, 0.0, 0.3])
@pytest.mark.parametrize("per_edge", [4, 6, 7, 8, 11, 16])
def test_few_suns_stand_for_a_part_of_the_sky(lowest, per_edge):
    """For any number; the exact fluence is 2 pi (1 - z) W/m^2, and the flux pi (1 - z^2)."""
    sky = Sky(lambda towards: 1.0 * (towards[..., 2] > lowest))
    toward, irradiance, _ = sky.suns(MEDIUM, 0, per_edge)
    assert irradiance.sum() == pytest.approx(2 * pi * (1 - lowest), rel=0.01)
    off = toward.T @ irradiance + (0, 0, pi * (1 - lowest**2))
    # The same number of random ones has an error of about .6 / per_edge.
    assert np.linalg.norm(off) < 0.3 / per_edge * irradiance.sum()


def emitted(light, count=10_000, seed=1, band=0, medium=MEDIUM):
    return light.emit(count, medium, np.random.default_rng(seed), band)


@cache
def alone(light, count=2000, band=0, medium=MEDIUM):
    """Independent photons: each from a separate call."""
    rng = np.random.default_rng(2)
    calls = [light.emit(1, medium, rng, band) for _ in range(count)]
    return tuple(np.concatenate(parts) for parts in zip(*calls, strict=True))


def assert_law(values, cumulative):
    """The independent values (n,) have this distribution function (the inequality of Dvoretzky,
    Kiefer, Wolfowitz and Massart, for all n)."""
    values = np.sort(values)
    expected, n = cumulative(values), len(values)
    step = np.arange(n + 1) / n
    distance = max(np.max(step[1:] - expected), np.max(expected - step[:-1]))
    assert distance <= np.sqrt(np.log(2 * FALSE_ALARMS) / (2 * n))


def assert_shares(counts, expected):
    """chi^2 of independent counts (k,), in the normal approximation of Wilson and Hilferty."""
    assert expected.min() >= 5
    chi2, k = ((counts - expected) ** 2 / expected).sum(), counts.size - 1
    deviation = (np.cbrt(chi2 / k) - (1 - 2 / (9 * k))) / np.sqrt(2 / (9 * k))
    assert deviation <= NormalDist().inv_cdf(1 - 1 / FALSE_ALARMS)


def assert_powers(light, measure, expected, calls=100, count=2000, band=0):
    """The mean of measure(origins, directions, power) (k,) over many calls is `expected` (k,)."""
    rng = np.random.default_rng(3)
    found = np.array([measure(*light.emit(count, MEDIUM, rng, band)) for _ in range(calls)])
    found, expected = found.reshape(calls, -1), np.atleast_1d(expected)
    error = found.std(axis=0, ddof=1) / np.sqrt(calls)
    confidence = (1 - 1 / FALSE_ALARMS) ** (1 / expected.size)
    limit = NormalDist().inv_cdf((1 + confidence) / 2)
    # Low-discrepancy photons may have a mean without variance, up to rounding.
    assert np.all(np.abs(found.mean(axis=0) - expected) <= limit * error + 1e-9 * expected)
    return error


def through_square(origins, directions, power):
    """W through half of the box's middle plane across z, downwards and upwards."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (LOWER[2] + SIZE[2] / 2 - origins[:, 2]) / directions[:, 2]
        hit = origins + distance[:, None] * directions
        inside = (distance >= 0) & np.all((hit >= LOWER) & (hit <= UPPER), axis=1)
    inside &= hit[:, 0] < LOWER[0] + SIZE[0] / 2
    down = directions[:, 2] < 0
    return power[inside & down].sum(), power[inside & ~down].sum()


def faces(origins, directions):
    """The face through which each photon enters: its axis, plus 3 for the upper face."""
    on = np.concatenate((origins == LOWER, origins == UPPER), axis=1)
    inwards = np.concatenate((directions > 0, directions < 0), axis=1)
    assert np.all((on & inwards).any(axis=1))
    return np.argmax(on & inwards, axis=1)


@every_light
def test_photons_have_a_place_a_direction_and_a_power(light):
    for count in (1, 7, 10_000):
        origins, directions, power = emitted(light, count)
        assert origins.shape == directions.shape == (count, 3)
        assert origins.dtype == directions.dtype == np.float64
        assert power.shape == (count,)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-14)
        assert np.all(power >= 0)


def test_light_from_outside_enters_by_the_faces_inwards():
    for name in ("sun", "sun along an axis", "sky", "sky by direction"):
        origins, directions, _power = emitted(LIGHTS[name])
        assert np.all((origins >= LOWER) & (origins <= UPPER))
        faces(origins, directions)


@every_light
def test_the_seed_determines_the_photons(light):
    first, same, other = (np.hstack(emitted(light, seed=seed)[:2]) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert np.any(first != other, axis=1).all()


def test_consecutive_calls_draw_different_photons():
    rng = np.random.default_rng(1)
    one, two = (OBLIQUE.emit(1000, MEDIUM, rng, 0)[0] for _ in range(2))
    assert not (one == two).all(axis=1).any()


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (OBLIQUE, np.outer((2.0, 5.0), np.abs(TOWARD) @ AREAS)),
        (Sun((0, -7, 0), 3.0), 3 * AREAS[1]),
        (LIGHTS["sky"], np.outer((1.0, 3.0), 2 * pi * AREAS.sum())),
        (LIGHTS["point inside"], 5.0),
        (PointLight((-1.1, 3, 4), 5.0), 5.0),  # outside, but inside the bounding sphere
        (Emission(Medium(MEDIUM.density, 0.5, 1, 0, emission=MEDIUM.density * 4)), 4 * SIZE.prod()),
    ],
)
def test_power_is_exact(light, expected):
    for band, total in enumerate(np.ravel(expected)):
        for count in (1, 999):
            power = emitted(light, count, band=band)[2]
            assert power.sum() == pytest.approx(total, rel=1e-12)
            assert np.ptp(power) == 0


def test_faces_get_their_share_to_a_photon():
    for light, shares in (
        (OBLIQUE, np.array((TOWARD[0], 0, 0, 0, -TOWARD[1], -TOWARD[2])) * np.tile(AREAS, 2)),
        (LIGHTS["sky"], np.tile(AREAS, 2)),
    ):
        origins, directions, _power = emitted(light, 10_000)
        found = np.bincount(faces(origins, directions), minlength=6)
        assert np.all(np.abs(found - 10_000 * shares / shares.sum()) < 1)


def test_sun_along_an_axis_lights_one_face():
    for axis, sign in product(range(3), (-1, 1)):
        direction = np.zeros(3)
        direction[axis] = sign
        origins, directions, _power = emitted(Sun(tuple(5 * direction), 1.0))
        assert np.all(directions == direction)
        assert np.all(origins[:, axis] == (LOWER if sign > 0 else UPPER)[axis])


@pytest.mark.parametrize("name", ["sun", "sky"])
def test_points_of_entry_are_uniform(name):
    origins, directions, _power = alone(LIGHTS[name])
    face = faces(origins, directions)
    thirds = np.minimum(3 * (origins - LOWER) / SIZE, 2).astype(int)
    bins = np.zeros((6, 3, 3, 3))
    np.add.at(bins, (face, *thirds.T), 1)
    expected = np.zeros((6, 3, 3, 3))
    seen = np.abs(TOWARD) * AREAS if name == "sun" else AREAS
    lit = [0, 4, 5] if name == "sun" else range(6)
    for f in lit:
        on_face = [slice(None)] * 3
        on_face[f % 3] = 2 * (f // 3)
        expected[f, *on_face] = seen[f % 3]
    expected *= len(face) / expected.sum()
    assert not bins[expected == 0].any()
    assert_shares(bins[expected > 0], expected[expected > 0])


def test_sky_obeys_the_cosine_law():
    origins, directions, _power = alone(LIGHTS["sky"])
    axis = faces(origins, directions) % 3
    rows = np.arange(len(axis))
    cosine = np.abs(directions[rows, axis])
    assert_law(cosine**2, lambda x: x)
    around = np.arctan2(directions[rows, (axis + 1) % 3], directions[rows, (axis + 2) % 3])
    assert_law(around, lambda x: (x + pi) / (2 * pi))


@pytest.mark.parametrize("name", ["point inside", "emission"])
def test_points_and_the_medium_shine_the_same_everywhere(name):
    _origins, directions, _power = alone(LIGHTS[name])
    for along in directions.T:
        assert_law(along, lambda x: (x + 1) / 2)
    assert_law(np.arctan2(*directions[:, :2].T), lambda x: (x + pi) / (2 * pi))


HALF = AREAS[2] / 2
OVERHEAD = 2 * pi / 3 * HALF  # the integral of cosine^2 over the upper hemisphere


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (OBLIQUE, (-5 * TOWARD[2] * HALF, 0)),
        (Sky(2.0), (2 * pi * HALF, 2 * pi * HALF)),
        (Sky(overhead), (OVERHEAD, 0)),
        (Sky(lambda towards: float(max(towards[2], 0))), (OVERHEAD, 0)),
        (Sky(everywhere), (pi * HALF, pi * HALF)),
        (
            Sky(lambda towards: np.stack((everywhere(towards), towards[..., 2] < 0), axis=-1)),
            (0, pi * HALF),
        ),
    ],
    ids=["sun", "even sky", "sky", "sky by single vectors", "constant sky", "two bands"],
)
def test_power_through_a_surface_inside(light, expected):
    """Half of the middle plane gets its irradiance, from photons through all faces."""
    assert_powers(light, through_square, expected, band=1)


def test_power_of_a_sky_by_direction_that_is_the_same_everywhere():
    def total(_origins, _directions, power):
        return power.sum()

    expected = 2 * pi * AREAS.sum()
    error = assert_powers(Sky(everywhere), total, expected)
    assert error < 1e-4 * expected


def test_power_by_face_of_a_sky_by_direction():
    def by_face(origins, directions, power):
        return np.bincount(faces(origins, directions), power, minlength=6)

    # The integral of cosine x height over the quarter sphere that a side face sees is 2/3.
    sides = [2 / 3 * AREAS[0], 2 / 3 * AREAS[1]]
    assert_powers(Sky(overhead), by_face, [*sides, 0, *sides, 2 * pi / 3 * AREAS[2]])


def test_sky_that_its_cells_miss_is_not_lost():
    """A ring between two rows of cell centres, with a broad light elsewhere that gets photons."""
    inner, outer = 0.48, 0.52

    def ring(towards):
        return (towards[..., 0] > inner) & (towards[..., 0] < outer)

    def antiderivative(x):
        """Of the area of the box as seen, integrated around x: faces across x, and the others."""
        return pi * AREAS[0] * x**2 + 2 * (AREAS[1] + AREAS[2]) * (x * np.sqrt(1 - x**2) + asin(x))

    def from_ring(_origins, directions, power):
        return power[ring(-directions)].sum()

    expected = 100 * (antiderivative(outer) - antiderivative(inner))
    light = Sky(lambda towards: 100 * ring(towards) + (towards[..., 0] < 0))
    error = assert_powers(light, from_ring, expected, count=5000)
    assert error < 0.05 * expected


def test_bright_part_of_a_sky_gets_the_photons():
    """9 of 10 photons follow the brightness of their band; 1 of 10 is distributed evenly."""

    def radiance(towards):
        return np.stack((-towards[..., 2] + 1, towards[..., 2] > 0.9), axis=-1)

    towards = -emitted(Sky(radiance), band=1)[1]
    assert np.mean(towards[:, 2] > 0.85) > 0.9


@pytest.mark.parametrize(
    ("single", "both"),
    [
        (lambda t: max(t[2], 0.0), overhead),
        (lambda t: (t / np.linalg.norm(t))[..., 2] + 1, lambda t: t[..., 2] + 1),
        (lambda t: np.linalg.norm(t - (0, 0, 1)), lambda t: np.sqrt(2 - 2 * t[..., 2])),
        (lambda t: abs(t[:2]), lambda t: abs(t[..., :2])),
    ],
    ids=["refuses arrays", "another norm", "one number", "another row"],
)
def test_functions_of_single_vectors_give_the_same_light(single, both):
    for found, expected in zip(emitted(Sky(single), 500), emitted(Sky(both), 500), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)


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


def coloured_emission():
    rng = np.random.default_rng(4)
    emission = rng.random((2, *SHAPE)) * (rng.random((2, *SHAPE)) < 0.7) * [[[[1.0]]], [[[40.0]]]]
    emission[:, -1] = 0
    return Medium(np.ones(SHAPE), 0.5, (1, 1), 0, origin=LOWER, emission=emission)


@pytest.mark.parametrize("band", [0, 1])
def test_voxels_emit_their_share_to_a_photon(band):
    medium = coloured_emission()
    origins, _directions, power = emitted(Emission(medium), 50_000, band=band, medium=medium)
    voxels = np.floor((origins - LOWER) / 0.5).astype(int)
    found = np.zeros(SHAPE)
    np.add.at(found, tuple(voxels.T), 1)
    emission = medium.emission[band].astype(float)
    expected = 50_000 * emission / emission.sum()
    assert np.all(np.abs(found - expected) < 1)
    assert not found[emission == 0].any()
    assert power.sum() == pytest.approx(emission.sum() * 0.5**3)


def test_voxels_emit_by_chance_where_photons_are_few():
    medium = coloured_emission()
    origins = alone(Emission(medium), band=1, medium=medium)[0]
    place = (origins - LOWER) / 0.5
    for within in (place % 1).T:
        assert_law(within, lambda x: x)
    found = np.zeros(SHAPE)
    np.add.at(found, tuple(np.floor(place).astype(int).T), 1)
    expected = medium.emission[1] * (len(place) / medium.emission[1].sum(dtype=float))
    often = expected > 10
    few = expected[~often].sum()
    assert_shares(np.append(found[often], found[~often].sum()), np.append(expected[often], few))


def test_photons_of_a_call_are_spread_evenly():
    """Estimates vary far less than with independent photons (measured: 1/170 and 1/5)."""
    count = 2000
    for light, less in ((OBLIQUE, 30), (Sky(2.0), 3)):
        total = emitted(light)[2].sum()
        share = 2 * (-TOWARD[2] if light is OBLIQUE else pi) * HALF / total
        independent = total * np.sqrt(share * (1 - share) / count)
        rng = np.random.default_rng(5)
        found = [through_square(*light.emit(count, MEDIUM, rng, 0))[0] for _ in range(100)]
        assert np.var(found) < independent**2 / less


DARK = Medium(np.ones(SHAPE), 0.5, (1, 1), 0, emission=np.zeros(SHAPE))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "light",
    [
        Sun((0, 0, -1), 0.0),
        Sky(0.0),
        Sky(lambda towards: 0.0),
        PointLight((0, 0, 0), 0.0),
        SpotLight((0, 0, 0), (0, 0, 1), 0.0, 1.0),
        AreaLight((0, 0, 0), (1, 0, 0), (0, 1, 0), 0.0),
        Emission(DARK),
    ],
)
def test_lights_that_are_off_emit_nothing(light):
    origins, directions, power = emitted(light, 100)
    assert not power.any()
    assert np.all(np.isfinite(origins))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)


@pytest.mark.parametrize(
    "light",
    [
        Sun((0, 0, -1), (1, 2, 3)),
        Sky((1, 2, 3)),
        Sky(lambda towards: (1, 2, 3)),
        Sky(lambda towards: np.ones((*towards.shape[:-1], 3))),
        PointLight((0, 0, 0), (1, 2, 3)),
        SpotLight((0, 0, 0), (0, 0, 1), (1, 2, 3), 1.0),
        AreaLight((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 2, 3)),
    ],
)
def test_other_bands_than_the_mediums_are_refused(light):
    with pytest.raises(LightError, match="3 bands where the medium has 2"):
        emitted(light)
    with pytest.raises(LightError, match="3 bands where the medium has 2"):
        multiple([light], MEDIUM, 0, 1)


def test_impossible_radiances_are_refused():
    for value in (-1.0, np.nan, np.inf):
        light = Sky(lambda towards, value=value: np.where(towards[..., 2] > 0.97, value, 1.0))
        with pytest.raises(LightError, match="radiance of the sky must be between"):
            emitted(light)


def test_no_photons_are_refused():
    for light, count in product(LIGHTS.values(), (0, -1)):
        with pytest.raises(LightError, match="1 photon or more"):
            emitted(light, count)


def test_media_without_emission_are_no_light():
    with pytest.raises(LightError, match="emits no light"):
        Emission(MEDIUM)


def grey_emission():
    emission = np.random.default_rng(6).random(SHAPE) * np.array((1, 0.3))[:, None, None, None]
    return Emission(Medium(np.ones(SHAPE), 0.5, (1, 1), 0, emission=emission))


@pytest.mark.parametrize(
    ("lights", "expected"),
    [
        ([OBLIQUE], 2.5),
        ([Sky((1.0, 3.0)), PointLight((0, 0, 0), (2, 6))], 3.0),
        ([Sky((1.0, 3.0)), OBLIQUE], None),
        ([Sky((1.0, 3.0)), Sun((0, 0, 1), 0.0)], 3.0),
        ([Sky(overhead), Sun((0, 0, 1), 1.0)], 1.0),
        ([Sky(overhead), OBLIQUE], None),
        ([Sky(lambda towards: (1, 1))], None),
        ([Sky((0.0, 1.0))], None),
        ([Sky((1.0, 0.0))], 0.0),
        ([Sky(0.0)], 0.0),
        ([grey_emission()], 0.3),
        ([grey_emission(), Sky((1.0, 0.3))], 0.3),
        ([grey_emission(), Sky((1.0, 0.3001))], None),
        ([Emission(coloured_emission())], None),
    ],
)
def test_bands_that_are_multiples_are_known(lights, expected):
    found = multiple(lights, MEDIUM, 1, 0)
    assert found == (None if expected is None else pytest.approx(expected, rel=1e-6))


LAMPS = {kind: light for kind, light in LIGHTS.items() if isinstance(light, LocalLight)}
FAR = {kind: light for kind, light in LIGHTS.items() if isinstance(light, DistantLight)}


def test_every_light_has_rays_or_suns():
    assert LAMPS.keys() | FAR.keys() == LIGHTS.keys()
    assert not LAMPS.keys() & FAR.keys()


@pytest.mark.parametrize("light", LAMPS.values(), ids=LAMPS)
def test_rays_are_the_same_light_every_time(light):
    strongest, pieces = light.rays(MEDIUM, 0, 12)
    rays = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    _, directions, power = rays
    assert power.min() >= 0
    assert power.max() == pytest.approx(strongest, rel=1e-3)
    assert power.max() <= strongest * (1 + 1e-12)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1)
    assert power.sum() == pytest.approx(emitted(light)[2].sum(), rel=5e-3)
    again = [np.concatenate(parts) for parts in zip(*light.rays(MEDIUM, 0, 12)[1], strict=True)]
    for first, second in zip(rays, again, strict=True):
        assert np.array_equal(first, second)


@pytest.mark.parametrize("light", FAR.values(), ids=FAR)
def test_suns_are_the_same_light_every_time(light):
    """The power through the faces of the domain is that of its photons; for emission, that of a sky
    whose light adds up to 1 W/m^2."""
    directions, strengths, _ = suns = light.suns(MEDIUM, 0, 12)
    assert strengths.min() >= 0
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1)
    brought = strengths @ np.abs(directions) @ face_areas(MEDIUM.domain)
    sky = Sky(1 / (4 * pi)) if isinstance(light, Emission) else light
    assert brought == pytest.approx(emitted(sky)[2].sum(), rel=1e-2)
    for first, second in zip(suns, light.suns(MEDIUM, 0, 12), strict=True):
        assert np.array_equal(first, second)


@pytest.mark.parametrize("per_edge", range(1, 12))
def test_a_sun_sends_as_many_rays_into_each_column(per_edge):
    """All at different places, evenly spaced along both edges."""
    places = rank_1(per_edge**2)
    count = places.shape[1]
    assert per_edge**2 <= count <= per_edge**2 + 5
    for along in places:
        assert np.sort(along) == pytest.approx((np.arange(count) + 0.5) / count)


def test_a_light_without_spectrum_or_emit_is_refused():
    with pytest.raises(TypeError, match="abstract"):
        Light()


@pytest.mark.parametrize("light", [Sun((0, 0, -1), 1.0), Sky(1.0), PointLight((0, 3, 4), 1.0)])
def test_lights_without_radius_or_shadow_density_stay_as_they_are(light):
    assert light.hardened() == light
    assert light.with_shadow_density(lambda density: density + 1) == light
    assert not light.is_soft_within(MEDIUM.domain)
    assert light.softness(MEDIUM.domain) is None


def test_a_lamp_with_a_radius_is_soft_where_it_stands():
    inside = PointLight(tuple(LOWER + SIZE / 2), 1.0, radius=0.1)
    outside = PointLight(tuple(LOWER - 1), 1.0, radius=0.1)
    assert inside.is_soft_within(MEDIUM.domain)
    assert not outside.is_soft_within(MEDIUM.domain)
    assert inside.hardened() == PointLight(inside.position, 1.0)


def test_the_shadow_density_of_a_sun_can_be_changed():
    sun = Sun((0, 0, -1), 1.0, shadow_density=np.ones(SHAPE))
    changed = sun.with_shadow_density(lambda density: density[:2])
    assert changed == sun
    assert changed.shadow_density.shape == (2, 6, 5)
