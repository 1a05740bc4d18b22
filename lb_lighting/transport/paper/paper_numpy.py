# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's lattice in NumPy float64: the twin of kernels/paper."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from math import prod

import numpy as np

from ...arrays import Floats, Integers
from ..lattice.d3q19 import DIRECTIONS
from ..medium import Medium


def step(
    f: Floats,
    omega: Floats,
    density: Floats,
    occlusion: Floats | None = None,
    keep_absorbed: bool = False,
) -> Floats:
    """One synchronous update of every node, paper 1, equation 2.

    f        (19, nx, ny, nz), light by direction
    omega    (19, 19), the collision matrix at density 1
    density  (nx, ny, nz)
    Returns the new f. The outermost nodes are the boundary: they send light but keep theirs, and
    light that flows into them is ignored. Opaque voxels send less light, by their occlusion.
    Absorbed light (direction 0) is kept only with `keep_absorbed`.
    """
    after = np.tensordot(omega, f, axes=1)
    after *= density
    after += f
    if occlusion is not None:
        after *= 1 - occlusion
    if not keep_absorbed:
        after[0] = 0

    new = f.copy()
    for m, c in enumerate(DIRECTIONS):
        new[m, 1:-1, 1:-1, 1:-1] = after[m][senders(density.shape, c)]
    return new


def senders(shape: Sequence[int], c: Integers) -> tuple[slice, ...]:
    """The slices (3,) of the nodes whose light along c reaches the inner nodes, in their order."""
    return tuple(slice(1 - int(d), n - 1 - int(d)) for n, d in zip(shape, c, strict=True))


def set_initial_light(f: Floats, inflow: Floats) -> None:
    """Fill f (19, nx, ny, nz): `inflow` (19,) at every boundary node, 0 between them."""
    f[...] = np.asarray(inflow)[:, None, None, None]
    f[:, 1:-1, 1:-1, 1:-1] = 0


class PaperReference:
    """The lattice of one medium; `paper_opencl.PaperLattice` takes the same calls."""

    def __init__(self, medium: Medium, keep_absorbed: bool) -> None:
        self.density = medium.density.astype(float)
        self.occlusion = medium.occlusion
        self.keep_absorbed = keep_absorbed

    @staticmethod
    def buffers(shape: Sequence[int], occluded: bool) -> dict[str, int]:
        """{name: bytes} of a lattice of this shape, float64."""
        nodes = prod(shape)
        plan = {
            "light": 19 * 8 * nodes,
            "collided light": 19 * 8 * nodes,
            "next light": 19 * 8 * nodes,
            "density": 8 * nodes,
        }
        if occluded:
            plan["occlusion"] = 4 * nodes
        return plan

    def start(self, inflow: Floats, omega: Floats) -> None:
        self.omega = omega
        self.f: Floats = np.empty((19, *self.density.shape))
        self.previous = self.f  # never written to: a step makes a new array
        set_initial_light(self.f, inflow)

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            self.previous = self.f
            self.f = step(self.f, self.omega, self.density, self.occlusion, self.keep_absorbed)

    def read(self, previous: bool = False) -> AbstractContextManager[Floats]:
        """The light, or that of one step before, (19, nx, ny, nz), as a context."""
        return nullcontext(self.previous if previous else self.f)
