# SPDX-License-Identifier: GPL-3.0-or-later
"""What photons leave behind: the layout of the tallies, as in kernels/photons/photons.cl."""

from typing import NamedTuple

import numpy as np

from ...arrays import Array, Floats

type Wanted = tuple[bool, bool, bool]  # whether these tallies are: direct, flux, handed
type Opaque = tuple[Floats, Floats]  # occlusion (nx, ny, nz), and its albedo in one band


UNIT = 2.0**24  # of a tally, in a weight of 1
HEAVIEST = 64.0  # weight that a photon may start with

# What a voxel's tallies count. A signed quantity q in [-1, 1] is counted as (1 + q) / 2.
# Of light that has neither collided nor been reflected: its weight. Of light that has:
WEIGHT = 0  # its weight
FLUX = 1  # three, where they are wanted: weight and direction
FLUX_TALLIES = 3

# Of photons that are handed over:
POWER = 0  # their weight
POSITION = 1  # three: weight and place in the voxel, from -1/2 to 1/2
DIRECTION = 4  # three: weight and direction before the last collision
HANDED_TALLIES = 7

# What is counted for all photons together.
ABSORBED = 0
LEFT_THROUGH = 1  # six: faces -x, +x, -y, +y, -z, +z
HANDED = 7
LOST = 8  # the weight of those that took too many steps
LOST_PHOTONS = 9  # how many these are, and so on
VIOLATIONS = 10
COLLISIONS = 11
SUMS = 12


class Tallies(NamedTuple):
    """What the photons of all batches scored, as weights.

    direct, scattered, handed  (voxels, tallies), of the quantities above
    deviation                  (voxels,) sum of the squared deviations of the batches' scattered
                               weight from its mean
    sums                       (SUMS,) of all photons together
    """

    direct: Floats
    scattered: Floats
    handed: Floats
    deviation: Floats
    sums: Floats


def kinds(direct: bool, flux: bool, handed: bool) -> tuple[int, int, int]:
    """(direct, scattered, handed): tallies of a voxel, of what is wanted."""
    return int(direct), 1 + (FLUX_TALLIES if flux else 0), HANDED_TALLIES if handed else 0


def in_weights(sums: Array) -> Floats:
    """(SUMS,) float64 of sums (SUMS,) in units: weights, then counts as they are."""
    weights = np.asarray(sums, float)
    weights[:LOST_PHOTONS] /= UNIT
    return weights
