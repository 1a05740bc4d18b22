# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons of suns and skies follow the laws of radiometry."""

from itertools import product
from math import asin, pi

import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.transport import (
    Sky,
    Sun,
)
from lb_lighting.transport.lights.sampling import rank_1
from tests.transport.lights.radiometry import (
    AREAS,
    HALF,
    LIGHTS,
    LOWER,
    MEDIUM,
    OBLIQUE,
    SHAPE,
    SIZE,
    TOWARD,
    UPPER,
    alone,
    assert_law,
    assert_powers,
    assert_shares,
    emitted,
    everywhere,
    faces,
    overhead,
    through_square,
)


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


def test_light_from_outside_enters_by_the_faces_inwards():
    for name in ("sun", "sun along an axis", "sky", "sky by direction"):
        origins, directions, _power = emitted(LIGHTS[name])
        assert np.all((origins >= LOWER) & (origins <= UPPER))
        faces(origins, directions)


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


def test_impossible_radiances_are_refused():
    for value in (-1.0, np.nan, np.inf):
        light = Sky(lambda towards, value=value: np.where(towards[..., 2] > 0.97, value, 1.0))
        with pytest.raises(LightError, match="radiance of the sky must be between"):
            emitted(light)


@pytest.mark.parametrize("per_edge", range(1, 12))
def test_a_sun_sends_as_many_rays_into_each_column(per_edge):
    """All at different places, evenly spaced along both edges."""
    places = rank_1(per_edge**2)
    count = places.shape[1]
    assert per_edge**2 <= count <= per_edge**2 + 5
    for along in places:
        assert np.sort(along) == pytest.approx((np.arange(count) + 0.5) / count)


def test_the_shadow_density_of_a_sun_can_be_changed():
    sun = Sun((0, 0, -1), 1.0, shadow_density=np.ones(SHAPE))
    changed = sun.with_shadow_density(lambda density: density[:2])
    assert changed == sun
    assert changed.shadow_density.shape == (2, 6, 5)
