# SPDX-License-Identifier: GPL-3.0-or-later
"""Attenuation along a path against integrals."""

import numpy as np
import pytest

from lb_lighting.transport.uncollided.attenuation import attenuate, source_collision_place

DEPTHS = np.array([0.0, 1e-12, 1e-4, 0.1, 0.4999, 0.5, 0.5001, 1.0, 3.0, 20.0])


def mean(values):
    """The mean over a path, of values (n, points) at the middles of equal intervals."""
    return values.mean(axis=1)


@pytest.fixture
def places():
    """(1, points), from 0 to 1 along the path."""
    return (np.arange(100_000)[None] + 0.5) / 100_000


def test_means_over_a_path_are_their_integrals(places):
    t = DEPTHS[:, None]
    transmittance, mean_transmittance, source_score, _ = attenuate(DEPTHS)
    assert transmittance == pytest.approx(np.exp(-DEPTHS), rel=1e-12)
    assert mean_transmittance == pytest.approx(mean(np.exp(-t * places)), rel=1e-6)
    # Light that is emitted at a place has the remaining path before it.
    assert source_score == pytest.approx(mean((1 - places) * np.exp(-t * places)), rel=1e-6)


def test_places_of_collisions_are_their_integrals(places):
    t = DEPTHS[1:, None]
    _, mean_transmittance, _, place = attenuate(DEPTHS[1:])
    density = np.exp(-t * places)
    assert place == pytest.approx(mean(places * density) / mean(density), rel=1e-6)
    emitted = -np.expm1(-t * places) / t  # density of the collisions of light emitted before
    expected = mean(places * emitted) / mean(emitted)
    values = source_collision_place(DEPTHS[1:], mean_transmittance, place)
    assert values == pytest.approx(expected, rel=1e-6)


def test_collisions_in_an_empty_voxel_have_finite_places():
    _, mean_transmittance, _, place = attenuate(np.zeros(1))
    assert place == pytest.approx(1 / 2)
    assert source_collision_place(np.zeros(1), mean_transmittance, place) == pytest.approx(2 / 3)
