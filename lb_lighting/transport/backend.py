# SPDX-License-Identifier: GPL-3.0-or-later
"""The two backends: NumPy in float64, and OpenCL on a device. Each is the other's twin.

This is the only place that asks which of them a device needs. Their modules are imported on demand:
OpenCL's need pyopencl.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

from ..arrays import Array, Floats
from .device import Device

if TYPE_CHECKING:
    from .lattice.lattice_numpy import Source
    from .medium import Medium


class Lattice(Protocol):
    """A lattice of the physical model; `lattice_numpy.NumpyLattice` documents the members."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(nx, ny, nz) voxels."""

    def start(self, source: Source) -> None:
        """Remove all light, and set the source."""

    def start_as_coarser(self) -> None:
        """Remove all light, and wait for the residual of a finer lattice."""

    def advance(self, steps: int) -> None:
        """Take a number of steps."""

    def restrict(self, coarser: Any, factor: float) -> None:
        """Add to the source of a coarser lattice a factor times the light that flowed last."""

    def prolongate(self, coarser: Any, factor: float) -> None:
        """Add a factor times the light of a coarser lattice."""

    def fluence(self, every: int = 1) -> Floats:
        """(nx, ny, nz) W/m^2, of every n-th layer along x."""

    def flux(self) -> Floats:
        """(3, nx, ny, nz) W/m^2."""

    def leaving(self) -> Iterator[Floats]:
        """For each direction the light that leaves each voxel, (nx, ny, nz) W/m^2."""

    def lost(self) -> tuple[Floats, float]:
        """(light that leaves through each face (6,), light that opaque voxels absorb)."""


class PaperLattice(Protocol):
    """The lattice of paper 1; `paper_numpy.PaperReference` documents the members."""

    def start(self, inflow: Floats, omega: Floats) -> None:
        """Set the light that enters by direction, (19,), and the collision matrix (19, 19)."""

    def advance(self, steps: int) -> None:
        """Take a number of steps."""

    def read(self, previous: bool = False) -> AbstractContextManager[Floats]:
        """The light, or that of one step before, (19, nx, ny, nz), as a context."""


class Backend(Protocol):
    """Makes the objects that compute on one device.

    Objects of the two backends take the same calls and return the same quantities; the classes of
    the NumPy backend document them.
    """

    def lattice(
        self,
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Floats | float = 0.0,
        edge: float | None = None,
    ) -> Lattice:
        """A lattice of the physical model; see `lattice_numpy.NumpyLattice`."""

    def lattice_memory(self, shape: Sequence[int], occluded: bool) -> dict[str, int]:
        """{what: bytes} of the device's memory for such a lattice and all coarser ones."""

    def sweep(self, turn: Any, voxels: Any, directed: bool) -> Any:
        """Beams of parallel light, tallied; see `sweep.NumpySweep`."""

    def glow(self, turn: Any, depth: Floats) -> Any:
        """Beams with a source along their way; see `sweep.NumpyGlow`."""

    def march(self, voxels: Any) -> Any:
        """Rays followed one by one; see `march.NumpyMarch`."""

    def paths(self, grid: Any) -> Any:
        """Free paths and photons; see `paths_numpy.NumpyPaths`."""

    def eye(self, grid: Any, lights: Array, emission: Array | None, opaque: Any) -> Any:
        """Paths from a camera; see `preview_numpy.NumpyEye`."""

    def least_corners(self, problem: Any) -> Floats:
        """The least trilinear majorants of super-voxels; see `majorants_numpy.least_corners`."""

    def paper_lattice(self, medium: Medium, keep_absorbed: bool, kernel: str) -> PaperLattice:
        """The lattice of paper 1; see `paper_numpy.PaperReference`."""

    def paper_memory(self, shape: Sequence[int], kernel: str, occluded: bool) -> dict[str, int]:
        """{what: bytes} of the device's memory for that."""


@cache
def backend_of(device: Device) -> Backend:
    """The backend that computes on a device."""
    if device.is_numpy:
        from .backend_numpy import NumpyBackend

        return NumpyBackend()
    from .backend_opencl import OpenclBackend  # needs pyopencl

    return OpenclBackend(device)
