# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's lattice update in NumPy float64: the oracle of the kernels, and the solver
where no OpenCL runtime exists."""

from math import prod

import numpy as np

from .device import require_memory
from .lattice import DIRECTIONS


def step(f, omega, density, occlusion=None, keep_absorbed=False):
    """One synchronous update of every node, paper 1, equation 2.

    f        (19, nx, ny, nz), light by direction
    omega    (19, 19), the collision matrix at density 1
    density  (nx, ny, nz)
    Returns the new f. The outermost nodes are the boundary: they send light and keep theirs,
    and whatever flows into them is ignored. Opaque voxels send less on, by their occlusion.
    Light that was absorbed (direction 0) is kept only where `keep_absorbed`.
    """
    after = f + density * np.tensordot(omega, f, axes=1)
    if occlusion is not None:
        after *= 1 - occlusion
    if not keep_absorbed:
        after[0] = 0

    new = f.copy()
    for m, (cx, cy, cz) in enumerate(DIRECTIONS):
        nx, ny, nz = density.shape
        # Node r receives what left r - c_m.
        new[m, 1:-1, 1:-1, 1:-1] = after[
            m, 1 - cx : nx - 1 - cx, 1 - cy : ny - 1 - cy, 1 - cz : nz - 1 - cz
        ]
    return new


def initial_light(shape, inflow):
    """(19, nx, ny, nz) float64: `inflow` (19,) at every boundary node, 0 between them."""
    f = np.zeros((19, *shape))
    f += np.asarray(inflow, float)[:, None, None, None]
    f[:, 1:-1, 1:-1, 1:-1] = 0
    return f


class ReferenceLattice:
    """The lattice of one medium in NumPy, used just as `paper.PaperLattice`."""

    def __init__(self, medium, keep_absorbed, device):
        self.bytes = require_memory(device, medium.shape, self.buffers)
        self.density = medium.density.astype(float)
        self.occlusion = medium.occlusion
        self.keep_absorbed = keep_absorbed

    @staticmethod
    def buffers(shape):
        """{what: bytes} for a lattice of this shape: two states, and the work of a collision."""
        state = 19 * 8 * prod(shape)
        return {"light": state, "collision": 2 * state, "previous light": state}

    def start(self, inflow, omega):
        self.omega = omega
        self.previous = self.f = initial_light(self.density.shape, inflow)

    def advance(self, steps):
        for _ in range(steps):
            self.previous = self.f
            self.f = step(self.f, self.omega, self.density, self.occlusion, self.keep_absorbed)

    def read(self):
        """(light, light one step before), each (19, nx, ny, nz)."""
        return self.f, self.previous
