# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: the least work that should meet it.

The `Pilot`, a solve of the medium in few voxels, measures errors and times; they are scaled to the
voxels of the solve. docs/measurements/speed-and-accuracy.md has the measurements behind the
scaling.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import hypot, inf, sqrt
from time import perf_counter
from typing import Any

import numpy as np

from ...errors import DeviceError, require_known
from .. import device as devices
from ..box import matter
from ..collision_source import is_soft_within
from ..device import Device
from ..lights.distant import FEW_VOXELS
from ..medium import Medium, deepest
from ..monitor import Cancel
from ..solver import Settings, require_memory
from .pilot import (
    EVENER,
    MERGES,
    Pilot,
    effort,
    fly,
    work_of_rays,
)
from .reasons import choices_made, outcome

# The target of each quality: the relative error (L2) of all visible light (`visibility`).
TARGETS = {"preview": 0.20, "draft": 0.10, "final": 0.05, "reference": 0.02}
# The budget of each quality: the expected seconds of a solve, where there is a choice.
BUDGETS = {"preview": 20.0, "draft": 20.0, "final": inf, "reference": inf}
_SAFE = 0.85  # share of the target that the expected error must meet
_STOP = 0.2  # share of the target that the lattice may leave
_NOISE = (0.3, 0.5)  # least and largest share of the target that photons may leave
_HANDOVERS = (0.0, 1.0, 2.0, 4.0, inf)
_RAYS = (0.5, 1.0, 2.0, 4.0)
# The share of the lattice's error that is left if photons precede it.
_LEFT = (0, 1, 2, 4), (1, 0.75, 0.6, 0.45)  # by handover
_FIXED = 0.04  # s of any solve; half of it without a lattice
_FEWEST_VOXELS = 8  # along the longest edge of a lattice
_FEWEST_PHOTONS = 10_000
_FEWEST_STEPS = 48
_NEARLY = 1.1  # times the smallest error: a smaller error is not worth more time


@dataclass(frozen=True)
class Plan:
    """How to solve a medium, and the error, time and memory to expect.

    settings  `Settings`
    quality   the name of the target
    target    relative error (L2) of all visible light that was asked for
    error     expected error, including that of stopping and noise
    seconds   expected time of the solve
    bytes     memory of the solve
    device    the label of the device
    reasons   [sentence]: what was chosen, and why
    spent     seconds of planning
    budget    largest expected time that was asked for, seconds
    """

    settings: Settings
    quality: str
    target: float
    error: float
    seconds: float
    bytes: int
    device: str
    reasons: list[str]
    spent: float
    budget: float = inf

    @property
    def meets_target(self) -> bool:
        return self.error <= self.target

    @property
    def keeps_to_budget(self) -> bool:
        return self.seconds <= self.budget


@dataclass(frozen=True)
class _Choice:
    """A way of solving, and its expected error and time."""

    settings: Settings
    error: float
    seconds: float


def plan(
    medium: Medium,
    lights: Iterable[Any],
    quality: str = "final",
    device: Device | str | None = None,
    fixed: dict[str, Any] | None = None,
    cancel: Cancel | None = None,
    *,
    scattered: bool = False,
    budget: float | None = None,
) -> Plan:
    """The `Plan` for lighting a medium.

    medium, lights, device, cancel  as for `solve`
    quality  "preview", "draft", "final" or "reference": errors of 20, 10, 5 and 2 %
    fixed    {name: value} of `Settings` that the caller chooses
    scattered  whether surfaces show the light, and the renderer adds what lamps send them: then
             scattered light is never left out
    budget   largest expected time in seconds, or None for the quality's: 20 for preview and
             draft, any for the others
    If nothing within the budget should meet the target, the plan is the most accurate one within
    the budget that fits into memory; if nothing is within the budget, the fastest one.
    Raises what `solve` raises.
    """
    require_known(quality, tuple(TARGETS), "quality")
    start, target, fixed = perf_counter(), TARGETS[quality], dict(fixed or {})
    budget = BUDGETS[quality] if budget is None else budget
    if scattered:
        fixed.setdefault("scattering", "multiple")
    lights, most = list(lights), _most_scattered(medium)

    # Fly the pilot. Thin media need no lattice, whatever it would find.
    is_thin = most <= _SAFE * target and _may_be_single(fixed)
    if is_thin:
        fixed["scattering"] = "single"
    base = replace(Settings(tolerance=_STOP * target), **fixed)
    thin = most if is_thin else None
    pilot = fly(medium, lights, base, target, device, cancel, thin=thin, scattered=scattered)

    # Choose the best settings that fit into memory.
    edge = max(matter(medium, lights).shape)
    choices = _choices(medium, lights, base, fixed, pilot, edge, target)
    accurate = [choice for choice in choices if choice.error <= _SAFE * target]
    needed_seconds = min((choice.seconds for choice in accurate), default=None)
    if budget < inf and "photons" not in fixed:
        choices += _with_fewer_photons(choices, pilot, medium, edge, target, budget)
    ordered = _in_order(choices, target, budget)
    chosen, needed = _first_that_fits(ordered, medium, lights, device)
    settings = chosen.settings
    if "most_steps" not in fixed:
        settings = _stopped_in_time(settings, pilot, edge, budget)

    # Explain them.
    reasons = choices_made(settings, pilot, medium, lights, _STOP)
    expected = chosen.error, chosen.seconds
    reasons.append(outcome(*expected, quality, target, budget, needed_seconds))
    label, spent = devices.choose(device).label, perf_counter() - start
    return Plan(settings, quality, target, *expected, needed, label, reasons, spent, budget)


def _choices(
    medium: Medium,
    lights: Sequence[Any],
    base: Settings,
    fixed: dict[str, Any],
    pilot: Pilot,
    edge: int,
    target: float,
) -> list[_Choice]:
    """All ways of solving that leave what is fixed as it is."""
    # Photons ignore a lamp's radius, which matters where it stands in the medium.
    is_soft = any(is_soft_within(light, medium.domain) for light in lights)
    choices = []
    for candidate in _candidates(base, fixed, edge, (0.0,) if is_soft else _HANDOVERS):
        settings, error = _expected_error(candidate, pilot, medium, edge, target)
        choices.append(_Choice(settings, error, _expected_seconds(settings, pilot, medium, edge)))
    return choices


def _in_order(choices: Sequence[_Choice], target: float, budget: float) -> list[_Choice]:
    """The choices, the best first."""
    fast = [choice for choice in choices if choice.seconds <= budget]
    good = [choice for choice in fast if choice.error <= _SAFE * target]
    least = min((choice.error for choice in fast), default=0.0)
    nearly = [choice for choice in fast if choice.error <= _NEARLY * least]
    return [
        # Noise is more visible than a smooth error of the same size.
        *sorted(good, key=lambda choice: (choice.settings.handover > 0, choice.seconds)),
        *sorted(nearly, key=lambda choice: choice.seconds),
        *sorted(fast, key=lambda choice: choice.error),
        *sorted(choices, key=lambda choice: choice.seconds),
    ]


def _with_fewer_photons(
    choices: Sequence[_Choice],
    pilot: Pilot,
    medium: Medium,
    edge: int,
    target: float,
    budget: float,
) -> list[_Choice]:
    """The choices that trace too many photons for the budget, with as many as it allows."""
    found = []
    for choice in choices:
        settings = choice.settings
        if not settings.photons or choice.seconds <= budget:
            continue
        of_one = pilot.trace * _path(settings.handover, pilot, medium)
        rest = choice.seconds - settings.photons * of_one
        if rest + _FEWEST_PHOTONS * of_one > budget:
            continue
        fewer = replace(settings, photons=int((budget - rest) / of_one))
        error = _expected_error(fewer, pilot, medium, edge, target)[1]
        found.append(_Choice(fewer, error, _expected_seconds(fewer, pilot, medium, edge)))
    return found


def _stopped_in_time(settings: Settings, pilot: Pilot, edge: int, budget: float) -> Settings:
    """`Settings` whose lattice takes no more steps than fit into a budget."""
    if budget == inf or settings.scattering == "single" or settings.handover == inf:
        return settings
    if not pilot.steps[0] or not pilot.solve:
        return settings
    a_step = pilot.solve / pilot.steps[0] * _growth(settings, pilot, edge) ** 3
    return replace(
        settings, most_steps=min(settings.most_steps, max(_FEWEST_STEPS, int(budget / a_step)))
    )


def _first_that_fits(
    choices: Sequence[_Choice],
    medium: Medium,
    lights: Sequence[Any],
    device: Device | str | None,
) -> tuple[_Choice, int]:
    """(choice, bytes of its memory)."""
    for number, choice in enumerate(choices, 1):
        try:
            arguments = (medium.bands, medium.occlusion is not None, len(lights))
            needed = require_memory(medium.shape, choice.settings, device, *arguments)
        except DeviceError:
            if number == len(choices):
                raise
        else:
            return choice, needed
    raise AssertionError("there is always a choice")


def _most_scattered(medium: Medium) -> float:
    """What scattered light is at most of all light, as it is seen: what scatters on the deepest
    line along an axis.

    Light that is scattered once more is K times the light, and in the norm of `seen` K is a
    symmetric kernel, no larger than the largest of its row sums: what scatters from a voxel on,
    averaged over directions. Straight lines see less of that on average than the deepest one.
    """
    depth = medium.depth(medium.sigma_s.max())
    if medium.occlusion is not None:
        depth = depth + medium.occlusion
    return deepest(depth)


# --- Expected errors and times --------------------------------------------------------


def _candidates(
    base: Settings, fixed: dict[str, Any], edge: int, handovers: Sequence[float]
) -> Iterator[Settings]:
    """All combinations of `Settings` that keep the fixed ones."""
    usual: dict[str, Sequence[float]] = {
        "rays": _RAYS,
        "merge": [m for m in MERGES if m == 1 or edge / m >= _FEWEST_VOXELS],
        "handover": handovers,
    }
    all_rays, merges, handovers = (
        [fixed[name]] if name in fixed else values for name, values in usual.items()
    )
    for rays in all_rays:
        if _may_be_single(fixed):
            yield replace(base, scattering="single", rays=rays)
        if fixed.get("scattering") != "single":
            for merge, handover in product(merges, handovers):
                yield replace(base, merge=merge, handover=handover, rays=rays)


def _may_be_single(fixed: dict[str, Any]) -> bool:
    if "scattering" in fixed:
        return bool(fixed["scattering"] == "single")
    return not {"merge", "handover"} & set(fixed)


def _expected_error(
    settings: Settings, pilot: Pilot, medium: Medium, edge: int, target: float
) -> tuple[Settings, float]:
    """(`Settings` with enough photons for the target, their expected error)."""
    sampling = pilot.sampling * settings.rays**-EVENER
    if edge > FEW_VOXELS >= pilot.edge:  # half of the rays are taken along an edge
        sampling *= 2**EVENER
    if settings.scattering == "single":
        return settings, hypot(max(pilot.share, pilot.mean), sampling)
    large = edge / settings.merge
    merging = _of_merged(settings, pilot, pilot.edge * (1 / large - 1 / edge))
    left = 0.0 if settings.handover == inf else float(np.interp(settings.handover, *_LEFT))
    lattice = left * pilot.error if left else 0.0
    error = hypot(lattice, merging, sampling, settings.tolerance if left else 0.0)
    if not settings.handover:
        return settings, error
    noise = pilot.noise * large / pilot.edge  # of one photon in all
    if not noise:  # it traced none
        return settings, inf
    allowed = sqrt(max((_SAFE * target) ** 2 - error**2, 0.0))
    allowed = min(max(allowed, _NOISE[0] * target), _NOISE[1] * target)
    photons = settings.photons or max(_FEWEST_PHOTONS, round((noise / allowed) ** 2))
    return replace(settings, photons=photons), hypot(error, noise / sqrt(photons))


def _of_merged(settings: Settings, pilot: Pilot, growth: float) -> float:
    """The error of merging; growth is that of the edges, in voxels of the pilot."""
    if not growth:
        return 0.0
    merging = pilot.merging * growth
    if not settings.handover:
        return merging
    # Photons' light is uneven in what the lattice is wrong by, too; measured: .35 of that at a
    # growth of 1, .7 at 3.
    return hypot(merging, pilot.error * growth / (growth + 1.6))


def _expected_seconds(settings: Settings, pilot: Pilot, medium: Medium, edge: int) -> float:
    scale = pilot.air * effort(settings.rays)
    once = pilot.once * scale * work_of_rays(edge) / work_of_rays(pilot.edge)
    if settings.scattering == "single":
        return once + _FIXED / 2
    seconds = _FIXED + (once if settings.merge > 1 else 0.0)
    if settings.handover:
        photons = settings.photons or 0
        seconds += photons * pilot.trace * _path(settings.handover, pilot, medium)
    if settings.handover == inf:
        # Where light goes forward rays are taken twice.
        twice = 2 if medium.g.max() > 0 else 1
        return float(seconds + twice * once / settings.merge**3)
    large, small = _edges(settings, pilot, edge)
    seconds += pilot.rays * scale * work_of_rays(large) / work_of_rays(small)
    if pilot.steps[0]:
        now, before = pilot.steps
        growth = min(max(np.log2(now / before), 0.0), 1.0) if before else 1.0
        seconds += pilot.solve * _growth(settings, pilot, edge) ** (3 + growth)
    return float(seconds)


def _edges(settings: Settings, pilot: Pilot, edge: int) -> tuple[float, float]:
    """Voxels of the lattice and its rays along an edge: of the solve, and of the pilot."""
    large = edge / settings.merge * pilot.pieces.get(settings.merge, 1)
    return large, pilot.edge * pilot.pieces.get(0, 1)


def _growth(settings: Settings, pilot: Pilot, edge: int) -> float:
    large, small = _edges(settings, pilot, edge)
    return large / small


def _path(handover: float, pilot: Pilot, medium: Medium) -> float:
    """Collisions of a photon before the lattice takes over, relative to the pilot's."""
    of_one = 1 / (1 - float((medium.albedo * medium.g).max()))
    now, then = (min(1 + depth * of_one, pilot.collisions) for depth in (handover, pilot.traced))
    return now / then if then else 1.0  # where nothing collides
