# SPDX-License-Identifier: GPL-3.0-or-later
"""The two backends: NumPy in float64, and OpenCL on a device. Each is the other's twin.

Only this module asks which of them a device needs. It imports their modules on demand, because
OpenCL's need pyopencl.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

from ..arrays import Floats, Integers
from .device import Device
from .monitor import NO_MONITOR, Monitor

if TYPE_CHECKING:
    from .lattice.lattice_numpy import Source
    from .medium import Medium
    from .photons.majorants import Problem
    from .photons.path_grid import PathGrid
    from .photons.tallies import Opaque, Selection
    from .photons.tallies import Tallies as PhotonTallies
    from .uncollided.sweep import Beam, Tallies, Turn, Voxels


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


class Sweep(Protocol):
    """Parallel beams through voxels; `sweep.NumpySweep` documents the members."""

    def run(self, beams: Sequence[Beam], monitor: Monitor = NO_MONITOR) -> tuple[Floats, int]:
        """Send beams that come from the same side."""

    def read(self) -> Tallies:
        """The tallies of all beams."""


class Glow(Protocol):
    """Beams with one emission each; `sweep.NumpyGlow` documents the members."""

    def run(
        self, beams: Sequence[Beam], glows: Sequence[Floats], monitor: Monitor = NO_MONITOR
    ) -> Floats:
        """Send beams that come from the same side."""


class March(Protocol):
    """Rays followed one by one; `march.NumpyMarch` documents the members."""

    def march(
        self,
        places: Floats,
        directions: Floats,
        weights: Floats,
        starts: Integers,
        faces: Integers,
    ) -> None:
        """Send rays."""

    def read(self) -> tuple[Floats, Floats | None, Floats]:
        """(tallies, reflected light, sums) of all rays."""


class Paths(Protocol):
    """Free paths and photons; `paths_numpy.NumpyPaths` documents the members."""

    def free_paths(
        self, rays: Floats, indices: Integers, per_depth: float, seed: int, most_steps: int
    ) -> tuple[Floats, int, int]:
        """(distances, collisions, violations) of free paths."""

    def start_tallies(
        self,
        shape: tuple[int, ...],
        lower: float,
        per_cell: float,
        selection: Selection,
        opaque: Opaque | None,
    ) -> None:
        """Empty the tallies."""

    def trace_photons(
        self,
        photons: Floats,
        copies: int,
        first: int,
        per_depth: float,
        seed: int,
        most_steps: int,
        optics: tuple[float, float],
        spacing: float,
        last: int,
    ) -> None:
        """Trace photons into the tallies."""

    def take_batch(self, batch: int) -> None:
        """Add the scores since the last batch to the variance."""

    def read_tallies(self) -> PhotonTallies:
        """The tallies of all batches."""


class Eye(Protocol):
    """Paths from a camera; `preview_numpy.NumpyEye` documents the members."""

    def see(
        self,
        rays: Floats,
        numbers: Integers,
        per_depth: float,
        seed: int,
        most_steps: int,
        most_collisions: int,
        albedo: Floats,
        g: float,
    ) -> tuple[Floats, Floats, int]:
        """(light seen, paths that left, number of violated majorants)."""


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

    The objects of both backends have the interfaces above; the classes of the NumPy backend
    document their parameters and results.
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

    def sweep(self, turn: Turn, voxels: Voxels, directed: bool) -> Sweep:
        """Parallel beams through voxels; see `sweep.NumpySweep`."""

    def glow(self, turn: Turn, depth: Floats) -> Glow:
        """Beams with one emission each; see `sweep.NumpyGlow`."""

    def march(self, voxels: Voxels) -> March:
        """Rays followed one by one; see `march.NumpyMarch`."""

    def paths(self, grid: PathGrid) -> Paths:
        """Free paths and photons; see `paths_numpy.NumpyPaths`."""

    def eye(
        self, grid: PathGrid, lights: Floats, emission: Floats | None, opaque: Opaque | None
    ) -> Eye:
        """Paths from a camera; see `preview_numpy.NumpyEye`."""

    def least_corners(self, problem: Problem) -> Floats:
        """The least trilinear majorants of super-voxels; see `majorants_numpy.least_corners`."""

    def paper_lattice(self, medium: Medium, keep_absorbed: bool, kernel: str) -> PaperLattice:
        """The lattice of paper 1; see `paper_numpy.PaperReference`."""

    def paper_memory(self, shape: Sequence[int], kernel: str, occluded: bool) -> dict[str, int]:
        """{what: bytes} of the device's memory for such a lattice."""


@cache
def backend_of(device: Device) -> Backend:
    """The backend that computes on a device."""
    if device.is_numpy:
        from .backend_numpy import NumpyBackend

        return NumpyBackend()
    from .backend_opencl import OpenclBackend  # needs pyopencl

    return OpenclBackend(device)
