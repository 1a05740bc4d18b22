# SPDX-License-Identifier: GPL-3.0-or-later
"""Multigrid: coarser lattices, on which light crosses the domain in fewer steps.

A step carries light by one voxel: on a lattice of half the resolution, this is twice as far, for an
eighth of the work. The residual of the fine lattice is restricted to a source of the coarse one.
The coarse solution is nearly all of the error; it is prolongated and added. The coarse lattice is
corrected in the same way. This is the correction scheme of A. Brandt, "Multi-level adaptive
solutions to boundary-value problems", 1977. docs/theory/physics.md, "Few steps", has the
measurements.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ...arrays import Array, Floats
from ..backend import Lattice
from .lattice_numpy import sum_of_eight

_SMALLEST = 8  # voxels, the longest edge that is not coarsened
_BETWEEN = 2  # steps between the two restrictions, which average out oscillating light
_SMOOTHING, _ON_COARSEST = 2, 32  # steps of coarser lattices: around corrections; of the coarsest
_CORRECTIONS = 2  # of a coarser lattice at each visit: a W-cycle


class Level:
    """A lattice and its coarser ones, which are made when they are first needed.

    make  makes a lattice; it and the other arguments are those of `NumpyLattice`
    """

    def __init__(
        self,
        make: Callable[..., Lattice],
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Any = 0.0,
        edge: float | None = None,
    ) -> None:
        self.make, self.optics = make, (albedo, g)
        self.depth, self.opaque = depth, (occlusion, occlusion_albedo)
        self.edge = edge or max(depth.shape)
        self.lattice = make(depth, albedo, g, occlusion, occlusion_albedo, edge=self.edge)

    @property
    def is_coarsest(self) -> bool:
        """Whether there is no coarser lattice."""
        return max(self.depth.shape) <= _SMALLEST

    @cached_property
    def coarser(self) -> "Level":
        """The level of half the resolution."""
        optics = (*self.optics, *_halved(*self.opaque))
        return Level(self.make, 2 * _mean(self.depth), *optics, edge=self.edge / 2)

    def correct(self) -> int:
        """Take two steps and add the coarse-grid correction. Returns the number of steps."""
        coarser = self.coarser.lattice
        coarser.start_as_coarser()
        self.lattice.restrict(coarser, -1 / _BETWEEN)
        self.lattice.advance(_BETWEEN)
        self.lattice.restrict(coarser, 1 / _BETWEEN)
        self.coarser._light()
        self.lattice.prolongate(coarser, 1.0)
        return _BETWEEN

    def take_back(self) -> None:
        """Undo the last correction."""
        self.lattice.prolongate(self.coarser.lattice, -1.0)

    def _light(self) -> None:
        """Solve for the light of the source that was restricted to this lattice."""
        if self.is_coarsest:
            self.lattice.advance(_ON_COARSEST)
            return
        for _ in range(_CORRECTIONS):
            self.lattice.advance(_SMOOTHING)
            self.correct()
        self.lattice.advance(_SMOOTHING)


def shapes(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """The shapes of all coarser lattices of a lattice."""
    coarser = []
    while max(shape) > _SMALLEST:
        shape = tuple(-(-n // 2) for n in shape)
        coarser.append(shape)
    return coarser


def _mean(values: Array) -> Floats:
    """The means of eight voxels each; there is nothing beyond an odd edge."""
    return sum_of_eight(np.asarray(values, float)) / 8


def _halved(occlusion: Floats | None, albedo: Any) -> tuple[Floats | None, Any]:
    """(occlusion, its albedo) in voxels twice as large."""
    if occlusion is None:
        return None, 0.0
    opaque = _mean(occlusion)
    reflecting = _mean(occlusion * np.broadcast_to(albedo, occlusion.shape))
    return opaque, np.divide(reflecting, opaque, out=np.zeros(opaque.shape), where=opaque > 0)
