# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarser lattices, on which light crosses in few steps what takes many on the finest.

A step moves light by one voxel: on a lattice of half the resolution twice as far, for an eighth of
the work. The change that a step still makes on the fine lattice becomes the source of the coarse
one. The light of the coarse lattice is nearly all that is still missing, and is added to the fine
one. A still coarser lattice corrects the coarse one in the same way. (Multigrid by correction:
A. Brandt, "Multi-level adaptive solutions to boundary-value problems", 1977.
docs/theory/physics.md, "Few steps", has measurements.)
"""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from ...arrays import Floats
from ..backend import Lattice
from .lattice_numpy import sum_of_eight

_SMALLEST = 8  # voxels, the longest edge that is not halved
_STEPS_OF_RESIDUAL = 2  # steps that the residual is averaged over, as light alternates between them
_SMOOTHING, _ON_COARSEST = 2, 32  # steps of coarser lattices: around corrections, and without
_CORRECTIONS = 2  # of a coarser lattice, each time that it is used


class Level:
    """A lattice and coarser ones, which are made when they are first needed.

    make  makes a lattice of the other arguments, those of `NumpyLattice`
    """

    def __init__(
        self,
        make: Callable[..., Lattice],
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Floats | float = 0.0,
        edge: float | None = None,
    ) -> None:
        self.make, self.optics = make, (albedo, g)
        self.depth, self.occlusion, self.occlusion_albedo = depth, occlusion, occlusion_albedo
        self.edge = edge or max(depth.shape)
        self.lattice = make(depth, albedo, g, occlusion, occlusion_albedo, edge=self.edge)

    @property
    def is_coarsest(self) -> bool:
        """Whether no coarser lattice would help."""
        return int(max(self.depth.shape)) <= _SMALLEST

    @cached_property
    def coarser(self) -> "Level":
        """The level of half the resolution."""
        opaque = _coarsened(self.occlusion, self.occlusion_albedo)
        depth = 2 * _mean(self.depth)
        return Level(self.make, depth, *self.optics, *opaque, edge=self.edge / 2)

    def correct(self) -> int:
        """Take some steps, and add the light that is still missing: the number of steps."""
        coarser = self.coarser.lattice
        # The residual is the light that flows after the steps, less the light that flows before.
        coarser.start_as_coarser()
        self.lattice.restrict(coarser, -1 / _STEPS_OF_RESIDUAL)
        self.lattice.advance(_STEPS_OF_RESIDUAL)
        self.lattice.restrict(coarser, 1 / _STEPS_OF_RESIDUAL)
        self.coarser._solve_residual()
        self.lattice.prolongate(coarser, 1.0)
        return _STEPS_OF_RESIDUAL

    def take_back(self) -> None:
        """Subtract the last correction."""
        self.lattice.prolongate(self.coarser.lattice, -1.0)

    def _solve_residual(self) -> None:
        """Find the light of the residual that the lattice was given."""
        if self.is_coarsest:
            self.lattice.advance(_ON_COARSEST)
            return
        for _ in range(_CORRECTIONS):
            self.lattice.advance(_SMOOTHING)
            self.correct()
        self.lattice.advance(_SMOOTHING)


def shapes(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """[(nx, ny, nz)] of all coarser lattices of a lattice."""
    coarser: list[tuple[int, ...]] = []
    while max(shape) > _SMALLEST:
        shape = tuple(-(-n // 2) for n in shape)
        coarser.append(shape)
    return coarser


def _mean(values: Floats) -> Floats:
    """The means of eight voxels each; beyond an odd edge there is nothing."""
    return sum_of_eight(np.asarray(values, float)) / 8


def _coarsened(
    occlusion: Floats | None, albedo: Floats | float
) -> tuple[Floats | None, Floats | float]:
    """(occlusion, its albedo) in voxels twice as large."""
    if occlusion is None:
        return None, 0.0
    opaque = _mean(occlusion)
    reflecting = _mean(occlusion * np.broadcast_to(albedo, occlusion.shape))
    return opaque, np.divide(reflecting, opaque, out=np.zeros(opaque.shape), where=opaque > 0)
