# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions of direction: harmonics, the phase function, and few directions that integrate both."""

from itertools import product
from math import pi

import numpy as np

from ..lights.sampling import (
    GOLDEN,
    even_directions,
    frame_of,
    tilted,
)

_EVEN, _AIMED = 32, 24  # directions from everywhere, and more along the way of each sun
_AIM = 0.7  # mean cosine of those
_EXACT = 4  # degree of the polynomials that the weights of directions are exact for
FACTORS = np.sqrt(np.array([1, 3, 3, 3, 15, 15, 15, 1.25, 3.75]) / (4 * pi))
DEGREES = np.repeat(np.arange(3), (1, 3, 5))  # of `harmonics`


def harmonics(directions):
    """(9, ...) real spherical harmonics of the degrees 0, 1, 1, 1, 2 ... of unit vectors (3, ...):
    factors times `polynomials`."""
    polynomial = polynomials(directions)
    return FACTORS.reshape(-1, *[1] * (polynomial.ndim - 1)) * polynomial


def polynomials(directions):
    """(9, ...): 1, x, y, z, x y, y z, z x, 3 z^2 - 1, x^2 - y^2."""
    x, y, z = directions
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, 3 * z * z - 1, x * x - y * y])


def phase_function(cosine, g):
    """Of Henyey and Greenstein, 1/sr."""
    return (1 - g * g) / (4 * pi) / (1 + g * g - 2 * g * cosine) ** 1.5


def directions_for(suns, g):
    """((n, 3) unit vectors, (n,) sr their weights) for light that suns bring to a medium.

    suns  [(3,) unit vector]
    Exact for polynomials up to the fourth degree; and for a sun's own light, once scattered, times
    `harmonics` and `third`.
    """
    u = (np.arange(_AIMED) + 0.5) / _AIMED
    aimed = tilted(1 - _cosine_at(u, _AIM), np.arange(_AIMED) * GOLDEN % 1)
    even = _EVEN if suns else _EVEN + _AIMED
    found = [even_directions(np.arange(even), even), *(aimed @ frame_of(sun) for sun in suns)]
    found = np.concatenate(found)
    density = np.full(len(found), even / (4 * pi))
    for sun in suns:
        density += _AIMED * phase_function(found @ sun, _AIM)
    return found, _corrected(found, 1 / density, suns, g)


def _cosine_at(u, g):
    """The cosine that a share u of light which `phase_function` scatters exceeds."""
    q = (1 - g * g) / (1 - g + 2 * g * u)
    return (1 + g * g - q * q) / (2 * g)


def _corrected(directions, weights, suns, g):
    """The weights, changed by as little as makes them exact, over what they were."""
    powers = [n for n in product(range(_EXACT + 1), repeat=3) if sum(n) <= _EXACT]
    basis = [np.prod(directions**n, axis=1) for n in powers]
    wanted = [_integral(n) for n in powers]
    for sun in suns:
        cosine = directions @ sun
        scattered = phase_function(cosine, g)
        basis += [*(scattered * harmonics(directions.T)), scattered * third(cosine)]
        wanted += [*(harmonics(sun) * g**DEGREES), g**3]
    basis = np.array(basis)
    return weights * (1 + np.linalg.lstsq(basis * weights, wanted - basis @ weights, rcond=1e-9)[0])


def _integral(powers):
    """Of x^i y^j z^k over all directions, sr."""
    if any(n % 2 for n in powers):
        return 0.0
    halves = [n // 2 for n in powers]
    # 4 pi (i - 1)!! (j - 1)!! (k - 1)!! / (i + j + k + 1)!!
    odd = [float(np.prod(np.arange(1, 2 * n, 2))) for n in (*halves, sum(halves) + 1)]
    return 4 * pi * odd[0] * odd[1] * odd[2] / odd[3]


def third(cosine):
    """Legendre's polynomial of the third degree."""
    return (5 * cosine**3 - 3 * cosine) / 2
