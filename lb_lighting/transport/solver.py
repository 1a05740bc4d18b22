# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice solve: a medium and its lights go in, a field of light comes out."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ..errors import SettingsError, require_known, require_whole
from . import device as devices
from . import hybrid, memory
from .device import Device
from .field import Clock, Field
from .medium import Medium
from .monitor import Monitor
from .paper import model as paper


class Model(Protocol):
    """A model of transport: the modules `hybrid` and `paper.model`."""

    def solve(
        self,
        medium: Medium,
        lights: Sequence[Any],
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
_MOST_RAYS = 16  # times the usual number along an edge: 256 times as many


@dataclass(frozen=True)
class Settings:
    """How to solve.

    model             "physical": SI units, light scattered in the medium on the lattice, all other
                      light exact. "paper": the lattice of paper 1. Lengths are in voxels and a
                      density of 1 scatters fully, whatever the voxel size; `paper_units` brings a
                      medium there

    Of the physical model:
    scattering        "multiple", or "single": uncollided light alone, which is what a shader
                      needs to scatter it once; no lattice, and the fluence is 0
    rays              of uncollided light along a voxel's edge, over the usual number; no fewer
                      than one are sent
    merge             the voxels along each edge that scattered light is found in as one;
                      uncollided light keeps the medium's own. Media that shift light between
                      bands are not merged
    handover          how far light is traced as photons before the lattice takes it over, in
                      transport optical depths: 0 for not at all, infinity for photons alone
    traced_collisions the collision, or a later one, at which the lattice takes over; 1 and a
                      handover of 0 need no photons, and the light has no noise
    photons           to trace for each band that differs; None for 64 a voxel
    seed              of the photons, 0 to 2^32 - 1
    tolerance         the relative error (L2) of the lattice's light, estimated, at which it stops
    most_steps        at which it stops without
    divide            the pieces that voxels are divided in along each edge; None for 1, or more
                      where voxels are so thick that it takes them

    Of the paper's:
    steps             lattice steps; None for the paper's, twice the longest edge
    keep_absorbed     keep what was absorbed and emit it again (the paper's direction 0), or drop
                      it at each step, which shows the loss
    kernel            "naive", "final" or "coalesced": the paper's three, all with the same result
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
    lights: Iterable[Any],
    settings: Settings | None = None,
    device: Device | str | None = None,
    progress: Callable[[str, float], None] | None = None,
    cancel: Callable[[], bool] | None = None,
    residual: Callable[[float], None] | None = None,
) -> Field:
    """Light a medium.

    medium    a `Medium`. For the paper's model it has at least 3 voxels along each edge; the
              outermost ones are the boundary, where light enters
    lights    those of `lights.py`; for the paper's model `Sun` and `Sky`. At least one, or the
              medium's emission
    settings  `Settings`, default if None
    device    None for the best, or part of the label of one of `device.devices()`
    progress  called as progress(stage, fraction) with fraction from 0 to 1
    cancel    called without arguments; the solve ends with `Cancelled` where it returns true
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
    """Refuse a domain of `shape` voxels that is too large for the device, before it is made.

    settings and device are those of `solve`. The defaults are the most that a scene usually has,
    for use before the medium is known: three bands, opaque voxels and four lights.
    Returns the bytes of the solve; DeviceError names the largest resolution that fits.
    """
    settings = settings or Settings()
    chosen = devices.choose(device)
    footprint = MODELS[settings.model].footprint
    return memory.require_memory(
        chosen, shape, lambda s: footprint(s, settings, chosen, bands, occluded, lights)
    )
