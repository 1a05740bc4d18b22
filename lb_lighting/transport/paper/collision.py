# SPDX-License-Identifier: GPL-3.0-or-later
"""The collision matrix of paper 1, section 3, and its diffusion coefficient."""

import numpy as np

from ...arrays import Floats
from ...errors import MediumError
from ..lattice.d3q19 import UNIT, WEIGHTS


def phase_matrix(g: float) -> Floats:
    """The normalized phase function pn (18, 18) between the moving directions, equations 8 and 9.

    Entry [i, j] is for scattering from direction j + 1 into i + 1; the weighted sum of each
    column is 1. |g| = 1 is the limit: only forward, or only backward. MediumError beyond it.
    """
    if not abs(g) <= 1:
        raise MediumError(f"g must lie between -1 and 1; it is {g}.")
    cosine = np.round(UNIT[1:] @ UNIT[1:].T, 12)
    if abs(g) == 1:
        p = (cosine == g).astype(float)
    else:
        p = (1 - g * g) / (1 - 2 * g * cosine + g * g) ** 1.5
    # The sum of equation 8, (sum over axial of 2p + sum over diagonal of p) / 24, is the
    # weighted mean of the column.
    return p / (WEIGHTS[1:] @ p)


def collision_matrix(sigma_s: float, sigma_a: float, g: float = 0.0) -> Floats:
    """Omega (19, 19) of equations 5 to 7, with sigma_s modulated by the phase function.

    sigma_s, sigma_a  per lattice spacing (the paper has no other unit of length)
    Entry [i, j] moves light from direction j into i; each column sums to 0. Row 0 collects the
    absorbed light, and column 0 emits it again.
    """
    omega = np.zeros((19, 19))
    omega[0, 0] = -1
    omega[0, 1:] = sigma_a
    omega[1:, 0] = WEIGHTS[1:]
    omega[1:, 1:] = sigma_s * WEIGHTS[1:, None] * phase_matrix(g)
    omega[range(1, 19), range(1, 19)] -= sigma_s + sigma_a
    return omega


def diffusion_coefficient(sigma_s: float, sigma_a: float) -> float:
    """D of equation 4, in squared lattice spacings per step, for isotropic scattering."""
    return (2 / (sigma_s + sigma_a) - 1) / (4 * (1 + sigma_a))
