# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend on an OpenCL device, in float32. Importing this module needs pyopencl."""

from .device import Device
from .lattice.lattice_opencl import OpenclLattice
from .paper.paper_opencl import PaperLattice
from .photons.majorants_opencl import least_corners
from .photons.paths_opencl import OpenclPaths
from .preview.preview_opencl import OpenclEye
from .uncollided.march_opencl import OpenclMarch
from .uncollided.sweep_opencl import OpenclGlow, OpenclSweep


class OpenclBackend:
    """See `backend.Backend`."""

    lattice_memory = staticmethod(OpenclLattice.buffers)
    paper_memory = staticmethod(PaperLattice.buffers)

    def __init__(self, device: Device):
        self.device = device

    def lattice(self, depth, albedo, g, occlusion=None, occlusion_albedo=0.0, edge=None):
        return OpenclLattice(depth, albedo, g, occlusion, occlusion_albedo, self.device, edge)

    def sweep(self, turn, voxels, directed):
        return OpenclSweep(turn, voxels, directed, self.device)

    def glow(self, turn, depth):
        return OpenclGlow(turn, depth, self.device)

    def march(self, voxels):
        return OpenclMarch(self.device, voxels)

    def paths(self, grid):
        return OpenclPaths(grid, self.device)

    def eye(self, grid, lights, emission, opaque):
        return OpenclEye(grid, self.device, lights, emission, opaque)

    def least_corners(self, problem):
        return least_corners(problem, self.device)

    def paper_lattice(self, medium, keep_absorbed, kernel):
        return PaperLattice(medium, keep_absorbed, self.device, kernel)
