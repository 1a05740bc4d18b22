# SPDX-License-Identifier: GPL-3.0-or-later
"""The two backends: NumPy in float64, and OpenCL on a device. Each is the other's twin.

This is the only place that asks which of them a device needs. Their modules are imported on demand:
OpenCL's need pyopencl.
"""

from functools import cache
from typing import Any, Protocol

from ..arrays import Array, Floats
from .device import Device


class Backend(Protocol):
    """What makes the objects that compute on one device.

    Objects of the two backends take the same calls and return the same quantities; the classes of
    the NumPy backend document them.
    """

    def lattice(
        self,
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Any = 0.0,
        edge: float | None = None,
    ) -> Any:
        """A lattice of the physical model; see `lattice_numpy.NumpyLattice`."""

    def lattice_memory(self, shape: tuple[int, ...], occluded: bool) -> dict[str, int]:
        """{what: bytes} of the device's memory for such a lattice and all coarser ones."""

    def sweep(self, turn: Any, voxels: Any, directed: bool) -> Any:
        """Beams of parallel light, tallied; see `sweep.NumpySweep`."""

    def glow(self, turn: Any, depth: Floats) -> Any:
        """Beams that take up a source of their own; see `sweep.NumpyGlow`."""

    def march(self, voxels: Any) -> Any:
        """Rays followed one by one; see `march.NumpyMarch`."""

    def paths(self, grid: Any) -> Any:
        """Free paths and photons; see `paths_numpy.NumpyPaths`."""

    def eye(self, grid: Any, lights: Array, emission: Array | None, opaque: Any) -> Any:
        """Paths from a camera; see `preview_numpy.NumpyEye`."""

    def least_corners(self, problem: Any) -> Floats:
        """The least trilinear majorants of super-voxels; see `majorants_numpy.least_corners`."""

    def paper_lattice(self, medium: Any, keep_absorbed: bool, kernel: str) -> Any:
        """The lattice of paper 1; see `paper_numpy.PaperReference`."""

    def paper_memory(self, shape: tuple[int, ...], kernel: str, occluded: bool) -> dict[str, int]:
        """{what: bytes} of the device's memory for that."""


@cache
def backend_of(device: Device) -> Backend:
    """The backend that computes on a device."""
    if device.is_numpy:
        from .backend_numpy import NumpyBackend

        return NumpyBackend()
    from .backend_opencl import OpenclBackend  # needs pyopencl

    return OpenclBackend(device)
