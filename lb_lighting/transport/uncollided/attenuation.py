# SPDX-License-Identifier: GPL-3.0-or-later
"""Attenuation of light along a path; kernels/uncollided/attenuation.cl is the twin."""

from collections.abc import Sequence
from math import factorial
from typing import NamedTuple

import numpy as np

from ...arrays import Floats

_THIN = 0.5  # optical depth up to which series are used


class Attenuation(NamedTuple):
    """Attenuation along paths of optical depth t; each (n,), finite down to t = 0.

    transmittance       T = exp(-t)
    mean_transmittance  m = (1 - T) / t, the mean of the transmittance over the path
    source_score        (1 - m) / t, the uncollided path length of light that is emitted evenly
                        along the path, over the length of the path
    collision_place     mean place of the collisions of light that enters, 0 to 1 along the path
    """

    transmittance: Floats
    mean_transmittance: Floats
    source_score: Floats
    collision_place: Floats


def attenuate(depth: Floats) -> Attenuation:
    """The `Attenuation` along paths of optical depths (n,)."""
    transmittance = np.exp(-depth)
    thin = depth < _THIN
    t, far = np.where(thin, depth, 0), np.where(thin, 1, depth)
    source_score = _series(t, [(-1) ** n / factorial(n + 2) for n in range(14)])
    mean = 1 - t * source_score
    place = _series(t, [1 / 2, -1 / 12, 0, 1 / 720, 0, -1 / 30240, 0, 1 / 1209600])
    mean_far = -np.expm1(-far) / far
    return Attenuation(
        transmittance,
        np.where(thin, mean, mean_far),
        np.where(thin, source_score, (1 - mean_far) / far),
        np.where(thin, place, 1 / far + np.exp(-far) / np.expm1(-far)),
    )


def source_collision_place(depth: Floats, mean: Floats, place: Floats) -> Floats:
    """(n,), 0 to 1: mean place of the collisions of light that is emitted evenly along the path.

    mean, place  `mean_transmittance` and `collision_place` of the depths
    """
    thin = depth < _THIN
    t = np.where(thin, depth, 0)
    # Integrals of s (1 - exp(-t s)) and of 1 - exp(-t s) over s from 0 to 1, both over t.
    moment = _series(t, [(-1) ** n / (factorial(n + 1) * (n + 3)) for n in range(14)])
    share = _series(t, [(-1) ** n / factorial(n + 2) for n in range(14)])
    far = (0.5 - mean * place) / np.where(thin, 1, 1 - mean)
    return np.where(thin, moment / share, far)


def _series(t: Floats, coefficients: Sequence[float]) -> Floats:
    values: Floats = np.polynomial.polynomial.polyval(t, coefficients)
    return values
