# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solve in few voxels tells is what is true of them."""

from math import inf

import numpy as np
import pytest

from lb_lighting.transport import Medium, PointLight, Settings, Sky, solve
from lb_lighting.transport.planning import pilot as pilots
from lb_lighting.transport.planning.pilot import EVENER, fly
from tests.transport.planning.test_planner import SUN, cube, error

ZENITH = Sky(lambda towards: 1.0 * (towards[..., 2] > 0.9))


def test_errors_are_seen_as_they_are():
    """The lattice's own error, of a few photons, beside that of very many."""
    medium = cube(g=0.85)
    pilot = fly(medium, [SUN], Settings(), 0.05)
    truth = solve(medium, [SUN], Settings(handover=inf, photons=4_000_000))
    # 4000 photons a voxel leave some .4 % of noise.
    assert pilot.error == pytest.approx(error(solve(medium, [SUN]), truth), abs=0.012)
    assert pilot.edge == 16


def test_tight_targets_are_compared_more_sharply():
    medium = cube(g=0.85)
    truth = solve(medium, [SUN], Settings(handover=inf, photons=4_000_000))
    pilot = fly(medium, [SUN], Settings(), 0.02)
    assert pilot.error == pytest.approx(error(solve(medium, [SUN]), truth), abs=0.006)


def test_loose_targets_trace_no_photons():
    pilot = fly(cube(g=0.85), [SUN], Settings(), 0.2)
    assert pilot.noise == 0
    assert pilot.error == 0.065


def test_the_error_of_few_rays_is_predicted():
    """To a factor of 2.5: the suns that stand for a sky are now better placed and now worse."""
    medium = cube(n=24, depth=4.0)
    pilot = fly(medium, [ZENITH], Settings(), 0.2)

    def single(rays):
        return solve(medium, [ZENITH], Settings(scattering="single", rays=rays))

    truth = single(6.0)
    for rays in (0.5, 1.0, 2.0):
        found = error(single(rays), truth)
        predicted = pilot.sampling * rays**-EVENER
        assert 0.4 < predicted / found < 2.5


def test_merging_is_seen():
    medium = cube()
    pilot = fly(medium, [SUN], Settings(), 0.2)
    whole, half = (solve(medium, [SUN], Settings(merge=merge)) for merge in (1, 2))
    assert pilot.merging == pytest.approx(error(half, whole), rel=0.05)
    light = whole.fluence + whole.direct
    share = np.linalg.norm(whole.fluence) / np.linalg.norm(light)
    assert pilot.share == pytest.approx(share, rel=0.01)


def test_errors_of_surfaces_are_of_all_light_that_they_show():
    medium = cube(depth=2.0)
    every, scattered = (fly(medium, [SUN], Settings(), 0.2, scattered=s) for s in (False, True))
    assert scattered.sampling == 0 < every.sampling
    assert scattered.merging == pytest.approx(every.merging, rel=1e-5)


@pytest.mark.parametrize("light", [SUN, Sky(1.0), PointLight((-0.3, 0.4, 0.5), 1.0)])
def test_empty_air_around_a_medium_changes_nothing_that_is_told(light):
    def surrounded(by):
        density = np.pad(np.ones((12,) * 3), by)
        return Medium(density, 1 / 12, 5.0, 0.05, 0.3, origin=(-by / 12,) * 3)

    near, far = (fly(surrounded(by), [light], Settings(), 0.1) for by in (2, 8))
    for name in ("edge", "share", "merging", "error", "noise", "collisions"):
        tolerance = 1e-3 if name != "noise" else np.inf  # more photons miss the medium
        assert getattr(far, name) == pytest.approx(getattr(near, name), rel=tolerance)
    assert far.noise > near.noise
    alone = fly(surrounded(0), [light], Settings(), 0.1)
    assert alone.share == pytest.approx(near.share, rel=0.02)
    assert alone.error == pytest.approx(near.error, abs=0.01)


def test_a_small_cloud_in_a_large_domain_is_seen_as_it_is():
    """Also where something as good as nothing fills the domain, as simulations have it."""
    density = np.full((64,) * 3, 1e-9)
    density[24:40, 24:40, 8:24] = 1
    pilot = fly(Medium(density, 1 / 16, 8.0, 0.08), [SUN], Settings(), 0.2)
    alone = fly(cube(), [SUN], Settings(), 0.2)
    assert pilot.share == pytest.approx(alone.share, abs=0.05)


def test_a_lamp_in_a_medium_does_not_outshine_what_is_scattered():
    """Its light is very bright in few voxels, which a picture shows as few pixels."""
    lamp = PointLight((0.5, 0.5, 0.5), 1.0)
    medium = cube(depth=2.0)
    field = solve(medium, [lamp])
    mean = field.fluence.mean() / (field.fluence + field.direct).mean()
    pilot = fly(medium, [lamp], Settings(), 0.2)
    assert pilot.mean == pytest.approx(mean, rel=0.01)
    assert pilot.mean > 1.5 * pilot.share


@pytest.mark.parametrize("surfaces", [False, True])
def test_media_that_only_absorb_show_nothing(surfaces):
    pilot = fly(cube(depth=5.0, albedo=0.0), [SUN], Settings(), 0.1, scattered=surfaces)
    assert pilot.share == 0
    assert np.isfinite([pilot.sampling, pilot.merging, pilot.error]).all()


@pytest.mark.parametrize(("depth", "albedo"), [(300, 0.5), (30_000, 0.9999), (30_000, 1.0)])
def test_a_pilot_takes_no_more_work_in_deep_media(depth, albedo, monkeypatch):
    """Counted: wherever it is looked at, and however often light collides there."""
    axis = np.linspace(-1, 1, 16)
    ball = 1.0 * (sum(a**2 for a in np.meshgrid(axis, axis, axis)) < 1)
    medium = Medium(ball, 1 / 16, depth * albedo, depth * (1 - albedo), 0.6)
    steps = photons = 0

    def counted(*arguments, **options):
        nonlocal steps, photons
        field = solve(*arguments, **options)
        pieces = 1 if field.report.steps == 0 else 2
        steps += field.report.steps * ball.size * pieces**3
        photons += arguments[2].photons or 0
        return field

    monkeypatch.setattr(pilots, "solve", counted)
    found = fly(medium, [SUN], Settings(tolerance=0.02), 0.1)
    assert steps <= 4 * 6e7
    assert photons * min(found.collisions, 300) <= 3 * 6e6


def test_media_that_are_too_dark_for_a_lattice_still_tell_of_photons():
    pilot = fly(cube(n=12, depth=400, albedo=0.4), [SUN], Settings(), 0.05)
    assert pilot.error == pilot.merging == inf
    assert pilot.noise > 0
    assert pilot.trace > 0
    assert pilot.steps == (0, 0)
