# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice D3Q19 of paper 1, section 3: its directions and weights.

Direction 0 rests; 1 to 6 run along the axes; 7 to 18 along the diagonals of the faces.
The 18 moving ones are the 24 nearest neighbours in four dimensions, projected to three; this
is why the axial ones have twice the weight.
"""

from itertools import combinations, product

import numpy as np

from ...arrays import Floats, Integers

AXIAL, DIAGONAL = slice(1, 7), slice(7, 19)


def _directions() -> Integers:
    rest = [(0, 0, 0)]
    axial = [tuple(s * (a == axis) for a in range(3)) for axis in range(3) for s in (1, -1)]
    diagonal = []
    for first, second in combinations(range(3), 2):
        for s, t in product((1, -1), repeat=2):
            c = [0, 0, 0]
            c[first], c[second] = s, t
            diagonal.append(tuple(c))
    return np.array(rest + axial + diagonal)


def _weights() -> Floats:
    w = np.zeros(19)
    w[AXIAL], w[DIAGONAL] = 1 / 12, 1 / 24
    return w


DIRECTIONS = _directions()
"""(19, 3) int, c_m in voxels a step."""
UNIT = DIRECTIONS / np.maximum(1, np.linalg.norm(DIRECTIONS, axis=1, keepdims=True))
"""(19, 3), n_m: the same, normalized; 0 for the direction at rest."""
WEIGHTS = _weights()
"""(19,), the share of isotropic light in each direction; sums to 1, rest 0."""
