# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solve in few voxels tells is what is true of them."""

from math import inf

import numpy as np
import pytest

from lb_lighting.transport import Settings, Sky, solve
from lb_lighting.transport.pilot import EVENER, fly
from tests.transport.test_planner import SUN, cube, error

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


def test_what_rays_are_off_is_foretold():
    """To a factor of 2.5: the suns that stand for a sky are now better placed and now worse."""
    medium = cube(n=24, depth=4.0)
    pilot = fly(medium, [ZENITH], Settings(), 0.2)

    def single(rays):
        return solve(medium, [ZENITH], Settings(scattering="single", rays=rays))

    truth = single(6.0)
    for rays in (0.5, 1.0, 2.0):
        found = error(single(rays), truth)
        foretold = pilot.sampling * rays**-EVENER
        assert 0.4 < foretold / found < 2.5


def test_merging_is_seen():
    medium = cube()
    pilot = fly(medium, [SUN], Settings(), 0.2)
    whole, half = (solve(medium, [SUN], Settings(merge=merge)) for merge in (1, 2))
    assert pilot.merging == pytest.approx(error(half, whole), rel=0.05)
    light = whole.fluence + whole.direct
    share = np.linalg.norm(whole.fluence) / np.linalg.norm(light)
    assert pilot.share == pytest.approx(share, rel=0.01)


def test_where_only_scattered_light_is_shown_it_is_what_errors_are_of():
    medium = cube(depth=2.0)
    every, scattered = (fly(medium, [SUN], Settings(), 0.2, scattered=s) for s in (False, True))
    assert scattered.sampling == 0 < every.sampling
    assert scattered.merging == pytest.approx(every.merging / every.share, rel=1e-5)


def test_media_that_are_too_dark_for_a_lattice_still_tell_of_photons():
    pilot = fly(cube(n=12, depth=400, albedo=0.4), [SUN], Settings(), 0.05)
    assert pilot.error == pilot.merging == inf
    assert pilot.noise > 0
    assert pilot.trace > 0
    assert pilot.steps == (0, 0)
