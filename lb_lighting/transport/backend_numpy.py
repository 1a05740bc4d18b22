# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend in NumPy float64: the oracle of the kernels, and the solver without OpenCL."""

from collections.abc import Sequence

from .lattice.lattice_numpy import NumpyLattice
from .medium import Medium
from .paper.paper_numpy import PaperReference
from .photons.majorants_numpy import least_corners
from .photons.paths_numpy import NumpyPaths
from .preview.preview_numpy import NumpyEye
from .uncollided.march import NumpyMarch
from .uncollided.sweep import NumpyGlow, NumpySweep


class NumpyBackend:
    """See `backend.Backend`."""

    lattice = staticmethod(NumpyLattice)
    lattice_memory = staticmethod(NumpyLattice.buffers)
    sweep = staticmethod(NumpySweep)
    glow = staticmethod(NumpyGlow)
    march = staticmethod(NumpyMarch)
    paths = staticmethod(NumpyPaths)
    eye = staticmethod(NumpyEye)
    least_corners = staticmethod(least_corners)

    @staticmethod
    def paper_lattice(medium: Medium, keep_absorbed: bool, kernel: str) -> PaperReference:
        return PaperReference(medium, keep_absorbed)  # it has no kernels to choose from

    @staticmethod
    def paper_memory(shape: Sequence[int], kernel: str, occluded: bool) -> dict[str, int]:
        return PaperReference.buffers(shape, occluded)
