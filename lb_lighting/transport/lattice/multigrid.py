# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarser lattices, on which light crosses in few steps what takes many on the finest.

A step carries light one voxel on: on a lattice of half the resolution twice as far, for an eighth
of the work. What a step still changes on the fine lattice is handed down as a source; what the
coarse one makes of that is nearly all that is still to come, and is added. The coarse one is helped
in the same way. (Multigrid, by correction: A. Brandt, "Multi-level adaptive solutions to
boundary-value problems", 1977. docs/theory/physics.md, "Few steps", says what was measured.)
"""

from functools import cached_property

import numpy as np

from .lattice_numpy import sum_of_eight

_SMALLEST = 8  # voxels, the longest edge that is not halved
_BETWEEN = 2  # steps between two looks at what flows: what goes to and fro is averaged out
_SMOOTHING, _ON_COARSEST = 2, 32  # steps of coarser lattices: around corrections, and without
_CORRECTIONS = 2  # of a coarser lattice, each time that it is used


class Level:
    """A lattice, and coarser ones that are made when they are needed first.

    make  function that makes a lattice of what follows, the arguments of `NumpyLattice`
    """

    def __init__(self, make, depth, albedo, g, occlusion=None, occlusion_albedo=0.0, edge=None):
        self.make, self.optics = make, (albedo, g)
        self.depth, self.opaque = depth, (occlusion, occlusion_albedo)
        self.edge = edge or max(depth.shape)
        self.lattice = make(depth, albedo, g, occlusion, occlusion_albedo, edge=self.edge)

    @property
    def is_coarsest(self):
        return max(self.depth.shape) <= _SMALLEST

    @cached_property
    def coarser(self):
        optics = (*self.optics, *_halved(*self.opaque))
        return Level(self.make, 2 * _mean(self.depth), *optics, edge=self.edge / 2)

    def correct(self):
        """Take two steps, and add what is still to come: the number of steps."""
        coarser = self.coarser.lattice
        coarser.start_as_coarser()
        self.lattice.hand_down(coarser, -1 / _BETWEEN)
        self.lattice.advance(_BETWEEN)
        self.lattice.hand_down(coarser, 1 / _BETWEEN)
        self.coarser._light()
        self.lattice.take_up(coarser, 1.0)
        return _BETWEEN

    def take_back(self):
        """Take away what the last correction added."""
        self.lattice.take_up(self.coarser.lattice, -1.0)

    def _light(self):
        """Turn what the lattice is given into light."""
        if self.is_coarsest:
            self.lattice.advance(_ON_COARSEST)
            return
        for _ in range(_CORRECTIONS):
            self.lattice.advance(_SMOOTHING)
            self.correct()
        self.lattice.advance(_SMOOTHING)


def shapes(shape):
    """[(nx, ny, nz)] of all coarser lattices of a lattice."""
    found = []
    while max(shape) > _SMALLEST:
        shape = tuple(-(-n // 2) for n in shape)
        found.append(shape)
    return found


def _mean(values):
    """Of eight voxels each; beyond an odd edge there is nothing."""
    return sum_of_eight(np.asarray(values, float)) / 8


def _halved(occlusion, albedo):
    """(occlusion, its albedo) in voxels twice as large."""
    if occlusion is None:
        return None, 0.0
    opaque = _mean(occlusion)
    reflecting = _mean(occlusion * np.broadcast_to(albedo, occlusion.shape))
    return opaque, np.divide(reflecting, opaque, out=np.zeros(opaque.shape), where=opaque > 0)
