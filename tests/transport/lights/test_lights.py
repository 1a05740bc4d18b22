# SPDX-License-Identifier: GPL-3.0-or-later
"""What all lights have in common, and light that the medium emits."""

from itertools import product
from math import pi

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
from lb_lighting.transport.lights.sampling import face_areas
from tests.transport.lights.radiometry import (
    AREAS,
    LIGHTS,
    LOWER,
    MEDIUM,
    OBLIQUE,
    SHAPE,
    SIZE,
    TOWARD,
    alone,
    assert_law,
    assert_shares,
    emitted,
    every_light,
    overhead,
)


@every_light
def test_photons_have_a_place_a_direction_and_a_power(light):
    for count in (1, 7, 10_000):
        origins, directions, power = emitted(light, count)
        assert origins.shape == directions.shape == (count, 3)
        assert origins.dtype == directions.dtype == np.float64
        assert power.shape == (count,)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-14)
        assert np.all(power >= 0)


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


@pytest.mark.parametrize("name", ["point inside", "emission"])
def test_points_and_the_medium_shine_the_same_everywhere(name):
    _origins, directions, _power = alone(LIGHTS[name])
    for along in directions.T:
        assert_law(along, lambda x: (x + 1) / 2)
    assert_law(np.arctan2(*directions[:, :2].T), lambda x: (x + pi) / (2 * pi))


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


def test_a_light_without_spectrum_or_emit_is_refused():
    with pytest.raises(TypeError, match="abstract"):
        Light()


@pytest.mark.parametrize("light", [Sun((0, 0, -1), 1.0), Sky(1.0), PointLight((0, 3, 4), 1.0)])
def test_lights_without_radius_or_shadow_density_stay_as_they_are(light):
    assert light.hardened() == light
    assert light.with_shadow_density(lambda density: density + 1) == light
    assert not light.is_soft_within(MEDIUM.domain)
    assert light.softness(MEDIUM.domain) is None
