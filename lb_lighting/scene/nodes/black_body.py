# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's colours of black bodies."""

import numpy as np

from ...arrays import Floats

_COLDEST, _HOTTEST = 800.0, 12000.0  # K, the range in which Blender's colours vary
# Polynomials in the logarithm of the temperature over 1000 K, one for each band, highest power
# first. They are fitted to Blender's colours and within 0.002 of them, as a test checks.
_BLACK_COLORS = (
    (-0.0205316, 0.189166, -0.676005, 0.985976, 0.440387, -3.59694, 4.6013),
    (0.00460183, -0.04879, 0.198716, -0.31755, -0.141376, 1.07191, 0.0389298),
    (-0.00754266, 0.119195, -0.638263, 1.38747, -0.954002, 0.469202, -0.179434),
)


def black_body_color(kelvin: float | Floats) -> Floats:
    """(..., 3): Blender's linear colour (Rec. 709) of a black body, with a luminance of 1.

    kelvin  (...) K, the temperature
    """
    logarithm = np.log(np.clip(kelvin, _COLDEST, _HOTTEST) / 1000)
    return np.maximum(np.stack([np.polyval(c, logarithm) for c in _BLACK_COLORS], axis=-1), 0)
