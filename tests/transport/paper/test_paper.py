# SPDX-License-Identifier: GPL-3.0-or-later
"""The solve as the paper states it: boundary light, steps, bands, and what is refused."""

import numpy as np
import pytest

from lb_lighting.errors import Cancelled, DeviceError, LightError, MediumError, SettingsError
from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, device, solve
from lb_lighting.transport.lattice.d3q19 import UNIT
from lb_lighting.transport.paper.model import boundary_inflow

SHAPE = (8, 9, 10)
DOWN = Sun((0, 0, -1), 2.0)


def cloud(sigma_s=0.792, sigma_a=0.008, g=0.9, **extra):
    density = np.random.default_rng(5).random(SHAPE)
    return Medium(density, 1.0, sigma_s, sigma_a, g, **extra)


def solved(medium, lights=(DOWN,), progress=None, cancel=None, **settings):
    return solve(medium, lights, Settings("paper", **settings), "NumPy", progress, cancel)


def test_sun_enters_in_proportion_to_positive_dot_products():
    direction = np.array([0.3, 0.2, -0.93])
    inflow = boundary_inflow([Sun(tuple(direction), 5.0)], 1)[0]
    cosine = UNIT @ direction
    assert np.all(inflow[cosine <= 0] == 0)
    lit = cosine > 0
    ratios = inflow[lit] / cosine[lit]
    np.testing.assert_allclose(ratios, ratios[0])
    assert inflow.sum() == pytest.approx(5.0)


def test_sky_enters_isotropically():
    assert boundary_inflow([Sky(0.5)], 1).sum() == pytest.approx(4 * np.pi * 0.5)


def test_sky_by_direction_lights_from_there():
    inflow = boundary_inflow([Sky(lambda towards: float(towards[2] > 0))], 1)[0]
    assert np.all(inflow[UNIT[:, 2] >= 0] == 0)
    assert np.all(inflow[UNIT[:, 2] < 0] > 0)


def test_steps_are_twice_the_longest_edge():
    assert solved(cloud()).report.steps == 20
    assert solved(cloud(), steps=7).report.steps == 7


def test_light_is_linear_in_irradiance():
    one, three = (solved(cloud(), [Sun((0, 0, -1), e)]) for e in (1.0, 3.0))
    np.testing.assert_allclose(three.fluence, 3 * one.fluence, rtol=1e-6)


def test_lit_side_is_brighter():
    light = solved(Medium(np.ones((16, 16, 16)), 1.0, 0.6, 0.2, 0.0)).fluence[0]
    assert light[4:-4, 4:-4, 12].mean() > 1.5 * light[4:-4, 4:-4, 3].mean()


def test_flux_points_where_the_light_goes():
    flux = solved(Medium(np.full(SHAPE, 0.2), 1.0, 0.6, 0.2)).flux[0]
    assert flux[2, 3:-3, 3:-3, 3:-3].mean() < 0
    assert abs(flux[0, 3:-3, 3:-3, 3:-3].mean()) < 1e-6


def test_empty_space_is_lit_fully():
    light = solved(Medium(np.zeros(SHAPE), 1.0, 0.8, 0), [Sky(1.0)]).fluence
    np.testing.assert_allclose(light, 4 * np.pi, rtol=1e-6)


def test_kept_absorption_shows_more_light():
    medium = cloud(sigma_a=0.2, sigma_s=0.6)
    assert solved(medium, keep_absorbed=True).fluence.sum() > solved(medium).fluence.sum()


def test_coloured_sun_on_a_grey_medium_is_one_run():
    field = solved(cloud(sigma_s=(0.792,) * 3), [Sun((0, 0, -1), (1.0, 0.5, 0.0))])
    assert field.report.runs == 1
    np.testing.assert_allclose(field.fluence[1], field.fluence[0] / 2, rtol=1e-6)
    assert not field.fluence[2].any()


def test_bands_that_differ_are_run_each():
    lights = [Sun((0, 0, -1), 1.0), Sky((0.1, 0.2, 0.3))]
    medium = cloud(sigma_s=(0.5, 0.5, 0.7))
    field = solved(medium, lights)
    assert field.report.runs == 3
    for band in range(3):
        alone = solved(
            cloud(sigma_s=float(medium.sigma_s[band])),
            [lights[0], Sky(lights[1].radiance[band])],
        )
        np.testing.assert_allclose(field.fluence[band], alone.fluence[0], rtol=1e-6)


def test_dark_first_band_does_not_darken_the_others():
    field = solved(cloud(sigma_s=(0.5,) * 2), [Sun((0, 0, -1), (0.0, 1.0))])
    assert not field.fluence[0].any()
    assert field.fluence[1].any()


def test_voxel_size_plays_no_part_in_the_papers_model():
    density = np.random.default_rng(6).random(SHAPE)
    fields = [solved(Medium(density, h, 0.7, 0.1)).fluence for h in (1.0, 0.01)]
    np.testing.assert_array_equal(*fields)


def test_residual_falls_with_steps():
    assert solved(cloud(), steps=80).report.residual < solved(cloud(), steps=20).report.residual


def test_report_says_what_ran():
    report = solved(cloud()).report
    assert report.model == "paper"
    assert report.device == device.numpy_device().label
    assert report.bytes > 0
    assert set(report.seconds) == {"prepare", "solve", "read"}


def test_progress_rises_to_one():
    heard = []
    solved(cloud(), progress=lambda stage, share: heard.append(share))
    assert heard == sorted(heard)
    assert heard[-1] == 1


def test_cancel_ends_the_solve():
    with pytest.raises(Cancelled):
        solved(cloud(), cancel=lambda: True)


@pytest.mark.parametrize("excess", [2.001, 3.0])
def test_unstable_media_are_refused(excess):
    medium = Medium(np.ones(SHAPE), 1.0, excess, 0.0)
    with pytest.raises(MediumError, match="unstable above 2"):
        solved(medium)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"model": "exact"}, "no model called 'exact'"),
        ({"kernel": "fast"}, "no kernel"),
        ({"steps": 0}, "from 1 to"),
    ],
)
def test_bad_settings_are_refused(settings, words):
    with pytest.raises(SettingsError, match=words):
        Settings(**settings)


@pytest.mark.parametrize(
    ("lights", "words"),
    [
        ([], "There is no light"),
        ([Sun((0, 0, -1), 0.0)], "There is no light"),
        ([PointLight((0, 0, 0), 1.0)], "replace the PointLight"),
        ([Sun((0, 0, -1), (1.0, 2.0))], "2 bands where the medium has 1"),
    ],
)
def test_lights_without_a_place_are_refused(lights, words):
    with pytest.raises(LightError, match=words):
        solved(cloud(), lights)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sun((0, 0, 0), 1.0),
        lambda: Sun((0, 0, np.nan), 1.0),
        lambda: Sun((0, 0, -1), -1.0),
        lambda: Sky(np.inf),
        lambda: Sky((0.0, np.nan)),
        lambda: Sky(1e39),
        lambda: PointLight((0, np.inf, 0), 1.0),
    ],
)
def test_impossible_lights_are_refused(make):
    with pytest.raises(LightError):
        make()


def test_flat_lattices_are_refused():
    with pytest.raises(MediumError, match="3 voxels or more"):
        solved(Medium(np.ones((1, 8, 8)), 1.0, 0.5, 0))


def test_emission_is_refused_by_the_papers_model():
    with pytest.raises(MediumError, match="no emission"):
        solved(cloud(emission=np.ones(SHAPE)))


def test_unknown_device_is_refused_with_the_known_ones():
    with pytest.raises(DeviceError, match="NumPy"):
        solve(cloud(), [DOWN], device="a device that nobody has")
