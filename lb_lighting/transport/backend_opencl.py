# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend on an OpenCL device, in float32. Importing this module needs pyopencl."""

from ..arrays import Floats
from .device import Device
from .lattice.lattice_opencl import OpenclLattice
from .medium import Medium
from .paper.paper_opencl import PaperLattice
from .photons.majorants import Problem
from .photons.majorants_opencl import least_corners
from .photons.path_grid import PathGrid
from .photons.paths_opencl import OpenclPaths
from .photons.tallies import Opaque
from .preview.preview_opencl import OpenclEye
from .uncollided.march_opencl import OpenclMarch
from .uncollided.sweep import Turn, Voxels
from .uncollided.sweep_opencl import OpenclGlow, OpenclSweep


class OpenclBackend:
    """See `backend.Backend`."""

    lattice_memory = staticmethod(OpenclLattice.buffers)
    paper_memory = staticmethod(PaperLattice.buffers)

    def __init__(self, device: Device) -> None:
        self.device = device

    def lattice(
        self,
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Floats | float = 0.0,
        edge: float | None = None,
    ) -> OpenclLattice:
        return OpenclLattice(depth, albedo, g, occlusion, occlusion_albedo, self.device, edge)

    def sweep(self, turn: Turn, voxels: Voxels, directed: bool) -> OpenclSweep:
        return OpenclSweep(turn, voxels, directed, self.device)

    def glow(self, turn: Turn, depth: Floats) -> OpenclGlow:
        return OpenclGlow(turn, depth, self.device)

    def march(self, voxels: Voxels) -> OpenclMarch:
        return OpenclMarch(self.device, voxels)

    def paths(self, grid: PathGrid) -> OpenclPaths:
        return OpenclPaths(grid, self.device)

    def eye(
        self, grid: PathGrid, lights: Floats, emission: Floats | None, opaque: Opaque | None
    ) -> OpenclEye:
        return OpenclEye(grid, self.device, lights, emission, opaque)

    def least_corners(self, problem: Problem) -> Floats:
        return least_corners(problem, self.device)

    def paper_lattice(self, medium: Medium, keep_absorbed: bool, kernel: str) -> PaperLattice:
        return PaperLattice(medium, keep_absorbed, self.device, kernel)
