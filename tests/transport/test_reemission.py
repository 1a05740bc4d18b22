# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that the medium emits, or re-emits in another band."""

from functools import cache

import numpy as np
import pytest

from lb_lighting.transport import Sun
from tests.transport.hybrid_media import (
    INSIDE,
    OUTSIDE,
    SHAPE,
    SUN,
    H,
    cloud,
    imbalance,
    light_of,
    solved,
)

SHIFTS = {
    "pair": [[0, 0, 0], [0.8, 0, 0], [0, 0, 0]],
    "chain": [[0, 0, 0], [0.6, 0, 0], [0, 0.5, 0]],
    "cycle": [[0, 0.9, 0], [0.9, 0, 0], [0, 0, 0]],
    "all": [[0, 0.3, 0.5], [0.5, 0, 0.5], [0.5, 0.7, 0]],
}


@cache
def fluorescent(kind):
    """Under light of band 0 alone; half of all collisions absorb."""
    medium = cloud((1.0,) * 3, (1.0,) * 3, shift=SHIFTS.get(kind))
    return solved(medium, [Sun(SUN.direction, (3.0, 0.0, 0.0))], tolerance=1e-5)


@pytest.mark.parametrize("kind", SHIFTS)
def test_shifted_energy_is_conserved_in_every_band(kind):
    field = fluorescent(kind)
    assert np.abs(imbalance(field)).max() < 1e-4
    given_for_good = 1 - np.sum(SHIFTS[kind], axis=0)  # of what is absorbed, each band keeps that
    total = field.report.energy["shifted"].sum()
    assert abs(total) < 1e-6 * field.report.energy["entered"].sum() or given_for_good.min() > 0


@pytest.mark.parametrize("kind", SHIFTS)
def test_shifted_light_adds_up(kind):
    """What a band radiates anew is what the others absorb, by the matrix."""
    field, plain = fluorescent(kind), fluorescent("none")
    density = field_absorbed(field) * np.asarray(SHIFTS[kind])
    received = density.sum(axis=1) - density.sum(axis=0)
    assert field.report.energy["shifted"] == pytest.approx(
        received, abs=2e-4 * field.report.energy["entered"].sum()
    )
    assert np.all(field.fluence >= plain.fluence * (1 - 1e-6))


def field_absorbed(field):
    """(bands,) W absorbed, of light that its voxels' fluence tells."""
    return (cloud().density * light_of(field)).sum(axis=(1, 2, 3)) * H**3


def test_a_chain_of_shifts_reaches_its_end():
    bright = [fluorescent("chain").fluence[band].sum() for band in range(3)]
    assert bright[0] > bright[1] > bright[2] > 0
    assert not fluorescent("pair").fluence[2].any()


def test_more_shift_is_more_light():
    def received(share):
        medium = cloud((1.0,) * 2, (1.0,) * 2, shift=[[0, 0], [share, 0]])
        return solved(medium, [Sun(SUN.direction, (3.0, 0.0))]).fluence[1].sum()

    light = [received(share) for share in (0.0, 0.2, 0.4, 0.8)]
    assert light[0] == 0
    assert np.divide(light[2:], light[1]) == pytest.approx([2, 4], rel=1e-5)


def test_a_glowing_medium_lights_itself():
    glow = np.zeros(SHAPE)
    glow[3, 3, 2] = 4.0
    field = solved(cloud(emission=glow), [], tolerance=1e-5)
    assert field.report.energy["entered"] == pytest.approx(4.0 * H**3, rel=1e-4)
    assert np.unravel_index(light_of(field)[0].argmax(), SHAPE) == (3, 3, 2)
    assert field.by_light.shape == (0, 1, *SHAPE)


def test_all_of_a_lamp_inside_enters_and_part_of_one_outside():
    assert solved(cloud(), [INSIDE]).report.energy["entered"] == pytest.approx(5.0, rel=1e-3)
    assert 0.5 < solved(cloud(), [OUTSIDE]).report.energy["entered"][0] < 45
