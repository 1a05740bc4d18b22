# SPDX-License-Identifier: GPL-3.0-or-later
"""Bands and lights in one trace are what they are in traces of their own.

Each test would fail by chance for at most one seed in 10 000, see tests/tracing.py.
"""

import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.transport import Medium, PointLight, Sky, Sun
from lb_lighting.transport.photons.trace import trace
from tests.tracing import Beam, assert_mean, assert_same_light

SHAPE, H = (5, 6, 4), 0.25  # voxels, m
SUN = Sun((-0.5, 0.3, 0.8), 1.5)
GLOW = np.random.default_rng(2).random(SHAPE)
PHOTONS = 60_000


def blotchy(sigma_s=2.0, sigma_a=0.4, g=0.3, emission=None):
    density = np.random.default_rng(1).uniform(0, 2, SHAPE)
    return Medium(density, H, sigma_s, sigma_a, g, origin=(2, 0, -1), emission=emission)


def band(field, number):
    """A field of one band of it."""
    alone = type(field)(field.domain, *(v[number : number + 1] for v in light(field)), field.report)
    alone.variance = field.variance[number : number + 1]
    return alone


def light(field):
    return field.fluence, field.direct, field.flux


def test_bands_are_as_if_traced_alone():
    sigma_s, sigma_a, g = (0.5, 2.0, 4.0), (0.1, 0.3, 0.0), (0.0, 0.6, -0.4)
    lights = [Sun(SUN.direction, (1.0, 2.0, 0.5)), Sky(0.2)]
    together = trace(blotchy(sigma_s, sigma_a, g), lights, PHOTONS, seed=1)
    assert together.report.runs == 6
    for number in range(3):
        optics = sigma_s[number], sigma_a[number], g[number]
        lights = [Sun(SUN.direction, (1.0, 2.0, 0.5)[number]), Sky(0.2)]
        alone = trace(blotchy(*optics), lights, PHOTONS, seed=10 + number)
        assert_same_light(band(together, number), alone)
        assert together.direct[number].sum() == pytest.approx(alone.direct.sum(), rel=0.02)
        for part in ("entered", "absorbed"):
            found, expected = (f.report.energy[part] for f in (together, alone))
            assert found[number] == pytest.approx(expected[0], rel=0.03, abs=1e-9)


def test_alike_bands_are_traced_once():
    optics = ((2.0, 2.0, 2.0), 0.4, 0.3)
    field = trace(blotchy(*optics), [Sun(SUN.direction, (1.0, 2.0, 0.5))], 5000)
    assert field.report.runs == 1
    for values in light(field):
        assert np.array_equal(values[1], 2 * values[0])
        assert np.array_equal(values[2], values[0] / 2)
    assert np.array_equal(field.variance[1], 4 * field.variance[0])
    energy = field.report.energy
    assert energy["entered"][1] == pytest.approx(2 * energy["entered"][0])
    assert np.allclose(energy["left"][2], energy["left"][0] / 2)


def test_coloured_lights_over_a_grey_medium_are_traced_once_each():
    """Their colours differ, and so each band is another mixture of the same two runs."""
    medium = blotchy((2.0, 2.0, 2.0), 0.4, 0.3)
    sun, sky = Sun(SUN.direction, (3.0, 1.0, 0.0)), Sky((0.1, 0.4, 0.9))
    field = trace(medium, [sun, sky], 2 * PHOTONS, seed=4)
    assert field.report.runs == 2
    assert np.ptp(field.report.energy["entered"]) > 1
    for number in range(3):
        lights = [Sun(SUN.direction, sun.irradiance[number]), Sky(sky.radiance[number])]
        alone = trace(blotchy(), lights, PHOTONS, seed=20 + number)
        assert_same_light(band(field, number), alone)


def test_band_without_light_is_dark():
    field = trace(blotchy((2.0, 2.0), 0.4), [Sun(SUN.direction, (1.0, 0.0))], 1000)
    for values in light(field):
        assert values[0].any()
        assert not values[1].any()


def test_lights_add_up():
    glowing = blotchy(emission=GLOW)
    lamps = [SUN, Sky(0.3), PointLight((2.6, 0.8, -0.5), 1.2), PointLight((0, 0, 4), 9.0)]
    together = trace(glowing, lamps, 2 * PHOTONS, seed=1)
    assert together.report.runs == len(lamps) + 1
    parts = [trace(blotchy(), [lamp], PHOTONS, seed=5 + n) for n, lamp in enumerate(lamps)]
    parts.append(trace(glowing, [], PHOTONS, seed=9))
    total = parts[0]
    for part in parts[1:]:
        total.fluence += part.fluence
        total.direct += part.direct
        total.variance += part.variance
    assert_same_light(together, total)
    assert together.direct.sum() == pytest.approx(total.direct.sum(), rel=0.02)
    entered = sum(part.report.energy["entered"][0] for part in parts)
    # Of a lamp outside only what hits the domain enters, which is a matter of chance.
    assert together.report.energy["entered"][0] == pytest.approx(entered, rel=0.01)


def test_emission_leaves_or_is_absorbed():
    power = GLOW.sum() * H**3
    report = trace(blotchy(sigma_a=0, emission=GLOW), [], 5000).report
    assert report.energy["entered"][0] == pytest.approx(power, rel=1e-5)
    assert report.energy["left"].sum() == pytest.approx(power, rel=1e-5)
    report = trace(blotchy(sigma_s=0, sigma_a=1e5, emission=GLOW), [], 5000).report
    assert report.energy["absorbed"][0] == pytest.approx(power, rel=1e-3)


def test_emission_of_bands_in_another_pattern():
    glow = np.stack([GLOW, GLOW[::-1]])
    field = trace(blotchy((2.0, 2.0), 0.4, emission=glow), [], PHOTONS)
    assert field.report.runs == 2
    for number in range(2):
        alone = trace(blotchy(emission=glow[number]), [], PHOTONS, seed=30 + number)
        assert_same_light(band(field, number), alone)


def test_vacuum_lets_all_through():
    """The mean chord of a convex body is 4 V / S."""
    medium = Medium(np.zeros(SHAPE), H, 1.0, 1.0)
    samples = []
    for seed in range(24):
        field = trace(medium, [Sky(1)], 4096, seed=seed)
        assert not field.fluence.any()
        energy = field.report.energy
        assert energy["left"].sum() == pytest.approx(energy["entered"][0], rel=1e-12)
        samples.append(field.direct[0])
    assert_mean(samples, np.full(SHAPE, 4 * np.pi))


def test_light_that_misses_does_nothing():
    miss = Beam((0, 0, 0), (-1, 0, 0))
    field = trace(blotchy(), [miss, SUN], 2000)
    assert field.report.runs == 2
    assert field.report.energy["entered"][0] == pytest.approx(
        trace(blotchy(), [SUN], 1000).report.energy["entered"][0], rel=1e-5
    )


class Uneven(Beam):
    """With two photons that are ten thousand times as bright as all before."""

    def emit(self, count, medium, rng, band):
        origins, directions, power = super().emit(count, medium, rng, band)
        power[2000:2002] *= 1e4
        return origins, directions, power


def test_photons_of_any_brightness_keep_their_power():
    uneven = Uneven((3, 0.7, -1), (0, 0, 1), diffuse=True)
    report = trace(blotchy(), [uneven], 32 * 2002).report
    assert report.energy["entered"][0] == pytest.approx((2000 + 2e4) / 2002, rel=1e-5)


def test_dark_lights_are_skipped():
    dark = Sun((0, 0, 1), 0.0)
    assert trace(blotchy(), [dark, SUN, Sky(0)], 100).report.runs == 1
    for lights in ([], [dark], [dark, Sky(0), PointLight((0, 0, 0), 0)]):
        with pytest.raises(LightError, match="no light"):
            trace(blotchy(), lights, 100)


def test_light_of_other_bands_is_refused():
    with pytest.raises(LightError, match="2 bands where the medium has 1"):
        trace(blotchy(), [Sun((0, 0, 1), (1.0, 2.0))], 100)


def test_sky_that_is_dark_almost_everywhere_is_traced():
    """A disc so small that the first photons, which tell how bright a light is, miss it."""
    cosine = 0.999
    disc = Sky(lambda towards: 10.0 * (towards @ np.array((0.6, 0.0, 0.8)) > cosine))
    medium = Medium(np.zeros((2, 2, 2)), 1.0, 1.0, 0.0)
    entered = [
        trace(medium, [disc], 200_000, seed=seed).report.energy["entered"] for seed in range(12)
    ]
    # Radiance x solid angle x what a cube of 2 m shows to that direction.
    assert_mean(np.ravel(entered), 10 * 2 * np.pi * (1 - cosine) * 4 * (0.6 + 0.8))
