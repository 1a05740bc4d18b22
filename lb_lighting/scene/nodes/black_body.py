# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of black bodies, as Blender has them."""

import numpy as np

from ...arrays import Floats

_COLDEST, _HOTTEST = 800.0, 12000.0  # K, between which Blender knows colours
# Of the colours that Blender gives black bodies: polynomials in the logarithm of the temperature in
# 1000 K, by band, the highest power first. Fitted to them; they are within 0.002 (the tests).
_BLACK_COLORS = (
    (-0.0205316, 0.189166, -0.676005, 0.985976, 0.440387, -3.59694, 4.6013),
    (0.00460183, -0.04879, 0.198716, -0.31755, -0.141376, 1.07191, 0.0389298),
    (-0.00754266, 0.119195, -0.638263, 1.38747, -0.954002, 0.469202, -0.179434),
)


def black_body_color(kelvin: float | Floats) -> Floats:
    """(..., 3): the linear colour (Rec. 709), of a luminance of 1, that Blender gives a black body.

    kelvin  (...) K, its temperature
    """
    logarithm = np.log(np.clip(kelvin, _COLDEST, _HOTTEST) / 1000)
    return np.maximum(np.stack([np.polyval(c, logarithm) for c in _BLACK_COLORS], axis=-1), 0)
