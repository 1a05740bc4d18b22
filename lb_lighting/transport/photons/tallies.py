# SPDX-License-Identifier: GPL-3.0-or-later
"""The layout of the photons' tallies, the same as in kernels/photons/photons.cl."""

from typing import NamedTuple

import numpy as np

from ...arrays import Array, Floats

# Which quantities are tallied: (uncollided light, flux, collision source).
type Selection = tuple[bool, bool, bool]
type Opaque = tuple[Floats, Floats]  # occlusion (nx, ny, nz), and its albedo in one band

UNIT = 2.0**24  # units of a tally in a weight of 1
HEAVIEST = 64.0  # the largest weight that a photon may start with

# The contents of a voxel's tallies. A signed quantity q in [-1, 1] is counted as (1 + q) / 2.
# Uncollided light has one tally, its weight. Scattered or reflected light has:
WEIGHT = 0  # its weight
FLUX = 1  # three, if the flux is tallied: weight times direction
FLUX_TALLIES = 3

# Photons that become a collision source have:
POWER = 0  # their weight
POSITION = 1  # three: weight times the position in the voxel, from -1/2 to 1/2
DIRECTION = 4  # three: weight times the direction before the last collision
HANDOVER_TALLIES = 7

# Sums over all photons.
ABSORBED = 0
LEFT_THROUGH = 1  # six: faces -x, +x, -y, +y, -z, +z
HANDOVER = 7  # the weight of those that become a collision source
LOST = 8  # the weight of those that took too many steps
LOST_PHOTONS = 9  # their number; the sums below are numbers as well
VIOLATIONS = 10
COLLISIONS = 11
SUMS = 12


class Tallies(NamedTuple):
    """The scores of the photons of all batches, as weights.

    direct, scattered, source  (voxels, tallies) of uncollided light, scattered light and the
                               collision source, in the order above
    deviation                  (voxels,) sum of the squared deviations of the batches' scattered
                               weight from its mean
    sums                       (SUMS,) sums over all photons
    """

    direct: Floats
    scattered: Floats
    source: Floats
    deviation: Floats
    sums: Floats


def kinds(direct: bool, flux: bool, source: bool) -> tuple[int, int, int]:
    """The numbers of a voxel's tallies: (uncollided light, scattered light, collision source)."""
    return int(direct), 1 + (FLUX_TALLIES if flux else 0), HANDOVER_TALLIES if source else 0


def in_weights(sums: Array) -> Floats:
    """(SUMS,) float64 from sums (SUMS,) in units: as weights, except for the numbers."""
    weights = np.asarray(sums, float)
    weights[:LOST_PHOTONS] /= UNIT
    return weights
