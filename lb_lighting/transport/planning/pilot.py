# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium solved in few voxels, in several ways, to predict the errors and times of its solve.

Only the box of all matter is solved, and light is weighted by its visibility (`visibility`), so
that empty air around a medium changes neither the prediction nor its quality.

Photons measure the error of the lattice. Two small sets suffice: their noise is independent and
drops out of the product of their differences from the lattice.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, hypot, inf, prod, sqrt
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Floats
from ...errors import MediumError
from .. import device as devices
from ..box import Box, matter
from ..device import Device
from ..field import Field
from ..lattice.subdivision import wished_pieces
from ..lights.base import Light
from ..lights.distant import FEW_VOXELS, Sky, Sun
from ..medium import Medium
from ..monitor import Cancel
from ..resample import Resampling
from ..solver import Settings, solve
from .visibility import mean_share, size, weights

MERGES = (1, 2, 4, 8)  # voxels along an edge that a plan may merge
_EDGE = 32  # voxels along the longest edge of the pilot
_PHOTONS = (20_000, 60_000)  # of two sets; the larger one measures the time of a photon
_ALONE = 4  # the larger set is so many times larger where there is no lattice
_PROBES = 500  # photons that count collisions if there is no lattice
_SHARP, _MORE = 0.02, 4  # targets up to the first value use this many times more photons
_CLOSE = 0.10  # targets up to this measure the lattice's error; the others assume the usual one:
_USUAL = 0.065  # the largest error of the lattice without photons in docs/theory/physics.md
_FAR = 300  # collisions of a photon beyond which the lattice takes over in the pilot, too
_ROUGH, _ROUGHEST = 0.5, 0.25  # rays of solves that do not measure the error of rays
# Limits of a pilot: collisions of photons (two cores do about 5 million a second), voxels of the
# lattice times steps (about 40 million a second), and pieces of a voxel's edge. Targets below
# _CLOSE may take _LONGER times as much.
_COLLISIONS, _VOXEL_STEPS, _PIECES, _LONGER = 6e6, 6e7, 2, 8
FEWEST_STEPS = 48
EVENER = 1.3  # the error of rays is proportional to this power of 1 / (rays along an edge)


@dataclass(frozen=True)
class Pilot:
    """The measurements of a solve in few voxels. Errors are relative, of all visible light.

    edge        voxels along the longest edge, of the box that holds all matter
    share       share of scattered light in all light
    mean        the same of the means: how much darker a picture is without scattered light
    once        s, of a solve of uncollided light alone
    sampling    error of the usual number of rays; 0 where uncollided light is not shown
    error       of the lattice alone; infinite if it cannot be used
    merging     change by merging 2 voxels along an edge; infinite if that is impossible
    rays        s, of everything but the lattice in a solve with one
    solve       s, of the lattice, for `steps`
    steps       of the lattice at `edge`, and at half of it
    trace       s, of each photon, traced to a handover of `traced`
    traced      that handover, in transport optical depths
    noise       of one photon; that of n is smaller by the square root of n
    collisions  mean number of a photon's collisions until it is absorbed or leaves
    pieces      {voxels merged along an edge: pieces that the lattice divides them into}; at 0 the
                pieces of the pilot's voxels
    air         work of uncollided light in the whole domain, relative to that in the box
    """

    edge: int
    share: float
    once: float
    mean: float = 0.0
    sampling: float = 0.0
    error: float = inf
    merging: float = inf
    rays: float = 0.0
    solve: float = 0.0
    steps: tuple[int, int] = (0, 0)
    trace: float = 0.0
    traced: float = inf
    noise: float = 0.0
    collisions: float = 0.0
    pieces: dict[int, int] = field(default_factory=dict)
    air: float = 1.0


def fly(
    medium: Medium,
    lights: Sequence[Light],
    settings: Settings,
    target: float,
    device: Device | str | None = None,
    cancel: Cancel | None = None,
    *,
    thin: float | None = None,
    scattered: bool = False,
) -> Pilot:
    """Measure the `Pilot` of a medium.

    settings  its model and tolerance are used
    target    relative error of the plan
    thin      share of scattered light if it is known and small; None to measure it
    The other arguments are those of `planner.plan`. Raises what `solve` raises.
    """
    box = matter(medium, lights)
    whole, medium = medium, _within(medium, box)
    pieces = ceil(max(medium.shape) / _EDGE)
    small = medium if pieces == 1 else medium.merged(pieces)
    cropped = [light.with_shadow_density(box.of).hardened() for light in lights]
    small_lights = Resampling(merge=pieces).lights(cropped)

    def solved(**changes: Any) -> Field:
        plain: dict[str, Any] = {"scattering": "multiple", "rays": 1.0, "merge": 1, "handover": 0.0}
        changed = replace(settings, **plain | {"photons": None} | changes)
        return solve(small, small_lights, changed, device, cancel=cancel)

    # Uncollided light. The rough solve comes first: it builds the programs.
    rough = solved(scattering="single", rays=_ROUGH)
    start = perf_counter()
    single = solved(scattering="single")
    once = perf_counter() - start
    weight = weights(small, surfaces=scattered)
    light = size(single.direct, weight)
    sampling = _of_usual(size(single.direct - rough.direct, weight) / (light or 1.0))
    if max(whole.shape) > FEW_VOXELS >= max(medium.shape):
        sampling *= 2**EVENER  # large domains take half of the rays along an edge
    air = _air(whole.shape, medium.shape, lights)
    pilot = Pilot(max(small.shape), thin or 0.0, once, sampling=sampling, air=air)
    if thin is not None:
        return pilot

    # Scattered light.
    divided = {merge: _pieces(medium.merged(merge), settings) for merge in MERGES}
    pilot = replace(pilot, pieces={0: _pieces(small, settings), **divided})
    is_slow = devices.choose(device).is_numpy
    flight = _Flight(small, weight, single, solved, target, _is_dark(medium), is_slow)
    pilot = flight.with_scattered(pilot)
    if scattered:
        # The error of the lattice includes that of using few rays.
        pilot = replace(pilot, sampling=0.0)
    missing = (prod(whole.shape) / prod(medium.shape)) ** (2 / 3)  # most photons miss the box
    return replace(pilot, noise=pilot.noise * sqrt(missing), trace=pilot.trace / missing)


def effort(rays: float) -> float:
    """Time of rays, relative to the usual number. Few rays do not fill a device: with half of them
    along an edge, media of 32^3 voxels under a sky took .47 of the time."""
    return rays**2 if rays >= 1 else 0.3 + 0.7 * rays**2


def work_of_rays(edge: float) -> float:
    """The work of rays, in units of one ray through one voxel; see `hybrid`."""
    return edge**3 * (4 if edge <= FEW_VOXELS else 1)


def _within(medium: Medium, box: Box) -> Medium:
    """The part of a medium in a `Box` of its voxels."""
    if box.is_whole:
        return medium
    origin = np.add(medium.origin, np.multiply(box.lower, medium.voxel_size))
    names = ("density", "emission", "occlusion", "occlusion_albedo")
    grids = {name: box.of(getattr(medium, name)) for name in names}
    return medium.altered(origin=tuple(origin), **grids)


def _air(whole: Sequence[int], box: Sequence[int], lights: Sequence[Light]) -> float:
    """The work of uncollided light in a domain, relative to a box in it (both are shapes). Rays of
    suns and skies stay in the box; rays of lamps cross the whole domain."""
    work = [work_of_rays(max(shape)) / max(shape) ** 3 for shape in (whole, box)]
    if all(isinstance(light, (Sun, Sky)) for light in lights):
        return work[0] / work[1]
    return prod(whole) * work[0] / (prod(box) * work[1])


def _pieces(medium: Medium, settings: Settings) -> int:
    """Pieces that voxels are divided into; 1 if they are too dark for any number."""
    if settings.divide:
        return settings.divide
    try:
        return wished_pieces(medium)[0]
    except MediumError:
        return 1


def _is_dark(medium: Medium) -> bool:
    """Whether voxels are too dark for the lattice however finely they are divided."""
    try:
        wished_pieces(medium)
    except MediumError:
        return True
    return False


class _Traced(NamedTuple):
    """The `Field`s of a smaller and a larger set of photons, and their numbers of photons."""

    few: Field
    many: Field
    counts: list[int]


@dataclass
class _Flight:
    """Solves a medium of few voxels in several ways.

    weight   see `visibility.weights`
    single   the `Field` of uncollided light
    solved   solves the medium, with changes of `Settings`
    target   relative error
    is_dark  whether the lattice cannot be used in the plan's voxels either
    is_slow  whether photons take many times as long as with OpenCL
    """

    medium: Medium
    weight: Floats
    single: Field
    solved: Callable[..., Field]
    target: float
    is_dark: bool
    is_slow: bool

    @property
    def patience(self) -> int:
        """The factor on the time that the pilot may take: larger for a tight target."""
        return 1 if self.target >= _CLOSE else _LONGER

    def with_scattered(self, pilot: Pilot) -> Pilot:
        """The `Pilot` with all measurements of scattered light."""
        pieces = pilot.pieces[0]
        half = self._lattice(pieces, merge=2)
        start = perf_counter()
        whole = self._lattice(pieces)
        seconds = perf_counter() - start
        traced: _Traced | None = None
        is_close = self.target < _CLOSE or (self.target == _CLOSE and not self.is_slow)
        if whole is None or is_close:
            pilot, traced = self._traced(pilot, whole)
        best = traced.many if whole is None and traced else whole
        assert best is not None
        whole_light = best.fluence + self.single.direct
        light = size(whole_light, self.weight) or 1.0
        pilot = replace(
            pilot,
            share=size(best.fluence, self.weight) / light,
            mean=mean_share(best.fluence, whole_light, self.weight),
            collisions=self._collisions(best),
        )
        if whole is not None:
            pilot = self._with_lattice(pilot, half, whole, seconds, light)
        elif not self.is_dark:
            pilot = self._with_finer_lattice(pilot)
        return self._with_photons(pilot, whole, traced, light) if traced else pilot

    def _lattice(self, pieces: int, **changes: Any) -> Field | None:
        """The `Field` of the lattice, within a pilot's number of steps; None if the pilot's voxels
        are too dark for it or would need too many pieces."""
        if pieces > _PIECES * (1 if self.patience == 1 else 2):
            return None
        try:
            return self.solved(rays=_ROUGH, most_steps=self._most_steps(pieces), **changes)
        except MediumError:
            return None

    def _most_steps(self, pieces: int) -> int:
        voxels = self.medium.density.size * pieces**3 * self._runs
        return max(FEWEST_STEPS, int(_VOXEL_STEPS * self.patience / voxels))

    @property
    def _runs(self) -> int:
        return max(self.single.report.runs, 1)

    def _traced(self, pilot: Pilot, whole: Field | None) -> tuple[Pilot, _Traced]:
        """(`Pilot` with the handover of its photons, two sets of them)."""
        probe = whole
        if probe is None:
            probe = self.solved(handover=inf, photons=_PROBES, rays=_ROUGHEST)
        collisions = self._collisions(probe)
        # Trace photons to their end if it is near: a lattice would add its own error.
        if whole is not None and whole.report.converged and collisions > _FAR:
            pilot = replace(pilot, traced=4.0)
            transport = 1 / (1 - float((self.medium.albedo * self.medium.g).max()))
            collisions = min(collisions, 1 + 4.0 * transport)
        counts = [n * (_MORE if self.target <= _SHARP else 1) for n in _PHOTONS]
        if whole is None:  # photons alone: measure their time well
            counts[1] *= _ALONE
        allowed = _COLLISIONS * self.patience / (max(collisions, 1.0) * self._runs * sum(counts))
        counts = [
            round(max(_PROBES, counts[0] * min(allowed, 1.0)) * n / counts[0]) for n in counts
        ]
        changes: dict[str, Any] = {"handover": pilot.traced, "rays": _ROUGHEST}
        changes["most_steps"] = self._most_steps(pilot.pieces[0])
        few, many = (
            self.solved(seed=seed, photons=count, **changes) for seed, count in enumerate(counts)
        )
        return pilot, _Traced(few, many, counts)

    def _with_lattice(
        self, pilot: Pilot, half: Field | None, whole: Field, seconds: float, light: float
    ) -> Pilot:
        """The `Pilot` with the time of the lattice, and the error of merging its voxels.

        half, whole  the lattice's `Field`s in merged voxels, or None, and in all voxels
        seconds      that `whole` took
        light        norm of all light, to which errors are relative
        """
        solving, casting = (whole.report.seconds.get(name, 0.0) for name in ("solve", "direct"))
        off = inf if half is None else size(whole.fluence - half.fluence, self.weight) / light
        return replace(
            pilot,
            # Include the residual of a lattice that has not converged.
            error=hypot(_USUAL, 0.0 if whole.report.converged else whole.report.residual),
            merging=off,
            rays=seconds - solving - casting + casting / effort(_ROUGH),
            solve=solving,
            steps=(whole.report.steps, half.report.steps if half else 0),
        )

    def _with_finer_lattice(self, pilot: Pilot) -> Pilot:
        """The `Pilot` if its voxels are too dark for the lattice, but those of the plan are not: it
        takes a few steps to measure their time."""
        start = perf_counter()
        tried = self.solved(divide=1, most_steps=FEWEST_STEPS, rays=_ROUGH)
        solving = tried.report.seconds.get("solve", 0.0)
        others = perf_counter() - start - solving
        steps = tried.report.steps
        pieces = pilot.pieces | {0: 1}
        return replace(
            pilot, error=_USUAL, rays=others, solve=solving, steps=(steps, steps), pieces=pieces
        )

    def _with_photons(
        self, pilot: Pilot, whole: Field | None, traced: _Traced, light: float
    ) -> Pilot:
        """The `Pilot` with the noise and time of photons, and the measured error of the lattice.

        light  as in `_with_lattice`
        """
        few, many, counts = traced
        # The noise of a single photon.
        between = size(few.fluence - many.fluence, self.weight) / light
        noise = between / sqrt(sum(1 / count for count in counts))
        short, long = (field.report.seconds["trace"] for field in (few, many))
        # A trace also spends time on other work.
        trace = max((long - short) / (counts[1] - counts[0]), long / counts[1] / 4)
        pilot = replace(pilot, noise=noise, trace=trace)
        if whole is None:
            return pilot
        one, other = ((whole.fluence - field.fluence).astype(float) for field in (few, many))
        squared = float(np.vdot(self.weight * one, other)) / light**2
        # The part of the error that noise hides, if the noise is even over the voxels.
        voxels = float(self.weight.sum() ** 2 / (np.vdot(self.weight, self.weight) or 1.0))
        unknown = noise**2 / sqrt(counts[0] * counts[1] * max(voxels, 1.0))
        error = sqrt(max(squared, 0.0) + unknown)
        # If noise hides the error, assume no more than the usual one.
        return replace(pilot, error=error if squared > 2 * unknown else min(error, pilot.error))

    def _collisions(self, field: Field) -> float:
        """Mean number of a photon's collisions: power that collides over power that enters."""
        light = (field.fluence + self.single.direct).astype(float)
        colliding = self.medium.sigma_t[:, None, None, None] * self.medium.density * light
        entered = float(np.sum(field.report.energy["entered"])) or 1.0
        return float(colliding.sum()) * self.medium.voxel_size**3 / entered


def _of_usual(change: float) -> float:
    """The error of the usual number of rays, from the change due to using half of them."""
    return change / hypot(1.0, _ROUGH**-EVENER)
