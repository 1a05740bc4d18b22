# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice solve: a medium and its lights go in, a field of light comes out."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..errors import SettingsError, require_known, require_whole
from . import device as devices
from . import hybrid, memory
from .device import Device
from .field import Clock, Field
from .lights.base import Light
from .medium import Medium
from .monitor import Monitor
from .paper import model as paper


class Model(Protocol):
    """A model of transport: the modules `hybrid` and `paper.model`."""

    def solve(
        self,
        medium: Medium,
        lights: Sequence[Light],
        settings: "Settings",
        device: Device,
        clock: Clock,
        needed: int,
        monitor: Monitor,
    ) -> Field:
        """As `solve`; needed is the memory of the solve in bytes."""

    def footprint(
        self,
        shape: Sequence[int],
        settings: "Settings",
        device: Device,
        bands: int,
        occluded: bool,
        lights: int = 4,
    ) -> memory.Footprint:
        """The memory of a solve of `shape` voxels for a number of lights."""


MODELS: dict[str, Model] = {"physical": hybrid, "paper": paper}
KERNELS = ("naive", "final", "coalesced")
SCATTERINGS = ("multiple", "single")
_MOST_RAYS = 16  # times the usual number along an edge: 256 times as many rays


@dataclass(frozen=True)
class Settings:
    """The settings of a solve.

    model             "physical": SI units, light scattered in the medium on the lattice, all other
                      light exact. "paper": the lattice of paper 1. Lengths are in voxels, and
                      a density of 1 scatters all light in a voxel of any size; `paper_units`
                      converts a medium

    Of the physical model:
    scattering        "multiple", or "single": uncollided light alone, which is what a shader
                      needs to scatter it once; no lattice, and the fluence is 0
    rays              rays of uncollided light along a voxel's edge, relative to the usual number;
                      at least one is sent
    merge             voxels along each edge that are merged into one for scattered light;
                      uncollided light keeps the medium's voxels. Media that shift light between
                      bands are not merged
    handover          how far light is traced as photons before the lattice takes it over, in
                      transport optical depths: 0 for not at all, infinity for photons alone
    traced_collisions the earliest collision at which the lattice takes over; with 1 and a handover
                      of 0 there are no photons, and the light has no noise
    photons           number of photons for each distinct band; None for 64 per voxel
    seed              of the photons, 0 to 2^32 - 1
    tolerance         estimated relative error (L2) of the lattice's light at which it stops
    most_steps        lattice steps after which it stops in any case
    divide            pieces that voxels are divided into along each edge; None for 1, or more if
                      the voxels are too thick for the lattice

    Of the paper's model:
    steps             lattice steps; None for the paper's number, twice the longest edge
    keep_absorbed     whether absorbed light is kept and emitted again (the paper's direction 0);
                      otherwise each step drops it, which shows the loss
    kernel            "naive", "final" or "coalesced", the paper's three kernels; all give the same
                      result
    """

    model: str = "physical"
    scattering: str = "multiple"
    rays: float = 1.0
    merge: int = 1
    handover: float = 0.0
    traced_collisions: int = 1
    photons: int | None = None
    seed: int = 0
    tolerance: float = 1e-2
    most_steps: int = 20_000
    divide: int | None = None
    steps: int | None = None
    keep_absorbed: bool = False
    kernel: str = "final"

    def __post_init__(self) -> None:
        for choice, known, what in (
            (self.model, tuple(MODELS), "model"),
            (self.scattering, SCATTERINGS, "scattering"),
            (self.kernel, KERNELS, "kernel"),
        ):
            require_known(choice, known, what)
        if not self.handover >= 0:
            raise SettingsError(f"The handover must not be negative; it is {self.handover}.")
        if not 0 < self.rays <= _MOST_RAYS:
            raise SettingsError(
                f"The rays must be more than 0 times, and up to {_MOST_RAYS} times, the usual "
                f"number; they are {self.rays}."
            )
        if not 0 < self.tolerance < 1:
            raise SettingsError(f"The tolerance must lie between 0 and 1; it is {self.tolerance}.")
        require_whole(self.seed, "seed", 0, 2**32 - 1)
        require_whole(self.merge, "number of voxels merged along an edge", 1, 64)
        require_whole(self.traced_collisions, "number of traced collisions", 1, 2**31 - 1)
        require_whole(self.most_steps, "number of steps", 1, 2**31 - 1)
        for value, what, highest in (
            (self.photons, "number of photons", 2**40),
            (self.divide, "number of pieces of a voxel's edge", 64),
            (self.steps, "number of steps", 2**31 - 1),
        ):
            if value is not None:
                require_whole(value, what, 1, highest)


def solve(
    medium: Medium,
    lights: Iterable[Light],
    settings: Settings | None = None,
    device: Device | str | None = None,
    progress: Callable[[str, float], None] | None = None,
    cancel: Callable[[], bool] | None = None,
    residual: Callable[[float], None] | None = None,
) -> Field:
    """Light a medium.

    medium    a `Medium`. For the paper's model it has at least 3 voxels along each edge; the
              outermost ones are the boundary, where light enters
    lights    see `Light`; the paper's model takes `Sun` and `Sky`. At least one, unless the medium
              emits light
    settings  `Settings`; None for the defaults
    device    None for the best, or part of the label of one of `device.devices()`
    progress  called as progress(stage, fraction) with fraction from 0 to 1
    cancel    called without arguments; the solve raises `Cancelled` once it returns true
    residual  called as residual(error) while the lattice converges, with its estimated relative
              error, before the matching progress; not by the paper's model
    Returns a `Field` in W/m^2. Raises MediumError, LightError, SettingsError or DeviceError.
    Source: paper 1, section 3; docs/theory/physics.md for the physical model.
    """
    settings = settings or Settings()
    clock = Clock()
    with clock("prepare"):
        used = devices.choose(device)
        all_lights, occluded = list(lights), medium.occlusion is not None
        arguments = medium.bands, occluded, len(all_lights)
        needed = require_memory(medium.shape, settings, used, *arguments)
    model = MODELS[settings.model]
    monitor = Monitor(progress, cancel, residual)
    return model.solve(medium, all_lights, settings, used, clock, needed, monitor)


def require_memory(
    shape: Sequence[int],
    settings: Settings | None = None,
    device: Device | str | None = None,
    bands: int = 3,
    occluded: bool = True,
    lights: int = 4,
) -> int:
    """Refuse a domain of `shape` voxels that is too large for the device, before it is allocated.

    settings and device are those of `solve`. The defaults suit most scenes before the medium is
    known: three bands, opaque voxels and four lights.
    Returns the bytes of the solve. Raises DeviceError with the largest resolution that fits.
    """
    settings = settings or Settings()
    chosen = devices.choose(device)
    footprint = MODELS[settings.model].footprint
    return memory.require_memory(
        chosen, shape, lambda s: footprint(s, settings, chosen, bands, occluded, lights)
    )
