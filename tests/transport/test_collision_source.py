# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand-over from photons to the lattice, and walls."""

from functools import cache
from math import inf

import numpy as np
import pytest

from lb_lighting.transport import Medium, Sun, trace
from tests.tracing import assert_same_light
from tests.transport.hybrid_media import SUN, difference, imbalance, light_of, solved


def test_flux_leads_away_from_the_light():
    thick = Medium(np.ones((8, 8, 8)), 1.0, 1.0, 0.01)
    flux = solved(thick, [Sun((0, 0, -1), 1.0)]).flux[0]
    assert flux[2, 2:-2, 2:-2, :4].mean() < 0
    assert abs(flux[0].mean()) < 1e-5 * abs(flux[2]).mean()


def screen(albedo):
    """A wall in two halves of thin haze, under a vertical sun."""
    occlusion = np.zeros((8, 8, 8))
    occlusion[:, :, 3] = 1
    return Medium(
        np.full(occlusion.shape, 0.05), 1.0, 1.0, 0.0, occlusion=occlusion, occlusion_albedo=albedo
    )


def test_a_wall_throws_a_shadow_and_reflects_by_its_albedo():
    down = Sun((0, 0, -1), 1.0)
    black, white = (solved(screen(albedo), [down], tolerance=1e-5) for albedo in (0.0, 1.0))
    for field in (black, white):
        assert not light_of(field)[0, :, :, :3].any()
        assert np.abs(imbalance(field)).max() < 1e-4
    assert white.fluence[0, :, :, 4:].mean() > 5 * black.fluence[0, :, :, 4:].mean()
    assert white.report.energy["absorbed"][0] < 1e-5 * white.report.energy["entered"][0]


@pytest.mark.parametrize(
    ("density", "albedo", "too_much"),
    [(0.3, 0.5, 0.0), (0.3, 0.9, 0.0), (0.0, 0.5, 0.15), (0.0, 0.9, 0.27)],
)
def test_light_between_two_walls_is_that_of_photons(density, albedo, too_much):
    """A corridor: what its walls reflect is not caught between them. In the void too much of it
    gets to the other wall: no light grazes walls there (docs/theory/physics.md, "Where not to
    trust it").
    """
    occlusion = np.zeros((8, 8, 8))
    occlusion[[1, 6]] = 1
    medium = Medium(
        np.full(occlusion.shape, density), 1.0, 1, 0, occlusion=occlusion, occlusion_albedo=albedo
    )
    lights = [Sun((-0.5, 0.1, -1), 1.0)]
    corridor = np.s_[0, 2:6]
    lattice, photons = solved(medium, lights).fluence[corridor], trace(medium, lights, 100_000)
    # The noise of the photons' mean is below 1 %.
    expected = (1 + too_much) * photons.fluence[corridor].mean()
    assert lattice.mean() == pytest.approx(expected, rel=0.08)


CUBE = Medium(np.ones((8, 8, 8)), 0.125, 7.6, 0.4, 0.5)


@cache
def handed_over(transport_depth):
    return solved(CUBE, handover=transport_depth, photons=400_000, tolerance=1e-4)


@pytest.mark.parametrize(("transport_depth", "model_error"), [(0.0, 0.06), (2.0, 0.02)])
def test_all_handovers_agree(transport_depth, model_error):
    """With Monte Carlo alone, within the lattice's error and twice the expected (L2) noise.

    The square of the noise is that of 10 or more independent ones: 4 times its mean is reached by
    chance by at most one seed in 60,000.
    """
    field, exact = handed_over(transport_depth), handed_over(inf)
    variance = exact.variance.sum() + (0 if field.variance is None else field.variance.sum())
    noise = 2 * np.sqrt(variance) / np.linalg.norm(exact.fluence)
    assert noise < 0.05
    assert difference(field.fluence, exact.fluence) < model_error + noise


@pytest.mark.parametrize("transport_depth", [0.0, 2.0, inf])
def test_all_handovers_conserve_energy(transport_depth):
    field = handed_over(transport_depth)
    assert np.abs(imbalance(field)).max() < 1e-4
    assert (field.variance is None) == (transport_depth == 0)
    assert field.report.steps == 0 if transport_depth == inf else field.report.steps > 0


def test_the_lattice_takes_over_at_a_later_collision():
    first, third = (solved(CUBE, traced_collisions=n, photons=50_000) for n in (1, 3))
    assert first.variance is None
    assert third.variance is not None
    assert difference(third.fluence, first.fluence) < 0.1


def test_photons_alone_are_those_of_a_trace():
    traced = trace(CUBE, [SUN], 400_000, seed=1)
    assert_same_light(handed_over(inf), traced)
    assert difference(handed_over(inf).direct, traced.direct) < 0.05
