# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons of lights follow the laws of radiometry.

Distributions are tested on independent photons, each from a separate call; powers on the means of
many calls, whose variance is measured. Each such test fails by chance for at most one seed in
FALSE_ALARMS, with Sidak's correction for several numbers.
"""

from functools import cache
from statistics import NormalDist

import numpy as np
import pytest

from lb_lighting.transport import (
    AreaLight,
    Medium,
    PointLight,
    Sky,
    SpotLight,
    Sun,
)
from lb_lighting.transport.lights.emission import Emission

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


HALF = AREAS[2] / 2
