# SPDX-License-Identifier: GPL-3.0-or-later
"""The types of arrays, by what their elements are; docstrings give their shapes and units."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

type Array = NDArray[Any]
type Floats = NDArray[np.floating[Any]]
type Integers = NDArray[np.integer[Any]]
type Booleans = NDArray[np.bool_]
type Vector = Sequence[float] | Floats  # (3,)
type Spectrum = float | Sequence[float] | Floats  # one value for all bands, or (bands,)
