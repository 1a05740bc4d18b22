# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions of direction: harmonics, the phase function, and a quadrature of few directions."""

from collections.abc import Sequence
from itertools import product
from math import pi

import numpy as np

from ...arrays import Floats
from ..lights.sampling import (
    GOLDEN,
    even_directions,
    frame_of,
    tilted,
)

_EVEN, _AIMED = 32, 24  # directions distributed evenly, and additional ones about that of each sun
_AIM = 0.7  # mean cosine of the latter to the sun's direction
_EXACT = 4  # degree of the polynomials that the quadrature integrates exactly
FACTORS = np.sqrt(np.array([1, 3, 3, 3, 15, 15, 15, 1.25, 3.75]) / (4 * pi))
DEGREES = np.repeat(np.arange(3), (1, 3, 5))  # of `harmonics`


def harmonics(directions: Floats) -> Floats:
    """(9, ...) real spherical harmonics of the degrees 0, 1, 1, 1, 2 ... of unit vectors (3, ...):
    FACTORS times `polynomials`."""
    polynomial = polynomials(directions)
    return FACTORS.reshape(-1, *[1] * (polynomial.ndim - 1)) * polynomial


def polynomials(directions: Floats) -> Floats:
    """(9, ...): 1, x, y, z, x y, y z, z x, 3 z^2 - 1, x^2 - y^2."""
    x, y, z = directions
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, 3 * z * z - 1, x * x - y * y])


def phase_function(cosine: Floats, g: float | np.floating) -> Floats:
    """The Henyey-Greenstein phase function, 1/sr.

    cosine  (...), of the scattering angle
    g       mean cosine
    """
    values: Floats = (1 - g * g) / (4 * pi) / (1 + g * g - 2 * g * cosine) ** 1.5
    return values


def directions_for(suns: Sequence[Floats], g: float) -> tuple[Floats, Floats]:
    """A quadrature for a medium lit by suns: (n, 3) unit vectors and (n,) weights in sr.

    suns  [(3,) unit vector], the directions of travel
    g     mean cosine of the phase function
    It is exact for polynomials up to the fourth degree, and for the once-scattered light of each
    sun times `harmonics` and times `third`.
    """
    u = (np.arange(_AIMED) + 0.5) / _AIMED
    aimed = tilted(1 - _cosine_at(u, _AIM), np.arange(_AIMED) * GOLDEN % 1)
    even = _EVEN if suns else _EVEN + _AIMED
    sets = [even_directions(np.arange(even), even), *(aimed @ frame_of(sun) for sun in suns)]
    directions = np.concatenate(sets)
    density = np.full(len(directions), even / (4 * pi))
    for sun in suns:
        density += _AIMED * phase_function(directions @ sun, _AIM)
    return directions, _corrected(directions, 1 / density, suns, g)


def _cosine_at(u: Floats, g: float) -> Floats:
    """The cosine that a share u of the light scattered by `phase_function` exceeds."""
    q = (1 - g * g) / (1 - g + 2 * g * u)
    cosine: Floats = (1 + g * g - q * q) / (2 * g)
    return cosine


def _corrected(directions: Floats, weights: Floats, suns: Sequence[Floats], g: float) -> Floats:
    """The exact weights closest to the given ones, in relative terms (least squares)."""
    powers = [n for n in product(range(_EXACT + 1), repeat=3) if sum(n) <= _EXACT]
    functions = [np.prod(directions**n, axis=1) for n in powers]
    integrals = [_integral(n) for n in powers]
    for sun in suns:
        cosine = directions @ sun
        scattered = phase_function(cosine, g)
        functions += [*(scattered * harmonics(directions.T)), scattered * third(cosine)]
        integrals += [*(harmonics(sun) * g**DEGREES), g**3]
    basis = np.array(functions)
    defect = integrals - basis @ weights
    corrected: Floats = weights * (1 + np.linalg.lstsq(basis * weights, defect, rcond=1e-9)[0])
    return corrected


def _integral(powers: Sequence[int]) -> float:
    """The integral of x^i y^j z^k over all directions, sr."""
    if any(n % 2 for n in powers):
        return 0.0
    halves = [n // 2 for n in powers]
    # 4 pi (i - 1)!! (j - 1)!! (k - 1)!! / (i + j + k + 1)!!
    odd = [float(np.prod(np.arange(1, 2 * n, 2))) for n in (*halves, sum(halves) + 1)]
    return 4 * pi * odd[0] * odd[1] * odd[2] / odd[3]


def third(cosine: Floats) -> Floats:
    """The Legendre polynomial of the third degree."""
    return (5 * cosine**3 - 3 * cosine) / 2
