# SPDX-License-Identifier: GPL-3.0-or-later
"""How light fades on its way; kernels/uncollided/attenuation.cl does the same."""

from math import factorial

import numpy as np

_THIN = 0.5  # optical depth up to which series are used


def fade(depth):
    """How light fades over optical depths (n,), all finite down to a depth of 0.

    Returns (n,) each: exp(-depth); the mean of that over the way, m = (1 - exp(-depth)) / depth;
    (1 - m) / depth; and where on the way it collides, on average, from 0 to 1.
    """
    through = np.exp(-depth)
    thin = depth < _THIN
    t, far = np.where(thin, depth, 0), np.where(thin, 1, depth)
    lost = _series(t, [(-1) ** n / factorial(n + 2) for n in range(14)])
    mean = 1 - t * lost
    place = _series(t, [1 / 2, -1 / 12, 0, 1 / 720, 0, -1 / 30240, 0, 1 / 1209600])
    mean_far = -np.expm1(-far) / far
    return (
        through,
        np.where(thin, mean, mean_far),
        np.where(thin, lost, (1 - mean_far) / far),
        np.where(thin, place, 1 / far + np.exp(-far) / np.expm1(-far)),
    )


def own_place(depth, mean, place):
    """(n,) where on a way light that starts evenly on it collides, on average, from 0 to 1."""
    thin = depth < _THIN
    t = np.where(thin, depth, 0)
    # Of s (1 - exp(-t s)) over s from 0 to 1, and of 1 - exp(-t s), both by t.
    moment = _series(t, [(-1) ** n / (factorial(n + 1) * (n + 3)) for n in range(14)])
    share = _series(t, [(-1) ** n / factorial(n + 2) for n in range(14)])
    far = (0.5 - mean * place) / np.where(thin, 1, 1 - mean)
    return np.where(thin, moment / share, far)


def _series(t, coefficients):
    return np.polynomial.polynomial.polyval(t, coefficients)
