# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: the cheapest ones that should meet it.

A `Pilot` solves the medium in few voxels; `expected` scales its errors and times to the voxels of
the solve, for each way of solving; the planner chooses the cheapest way that meets the target.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf
from time import perf_counter
from typing import Any

from ...errors import DeviceError, require_known
from .. import device as devices
from ..box import matter
from ..device import Device
from ..lights.base import Light
from ..medium import Medium, deepest
from ..solver import Settings, require_memory
from .expected import SAFE, Expectation
from .pilot import FEWEST_STEPS, MERGES, fly
from .reasons import outcome, reasons

# The target of each quality: the relative error (L2) of all visible light (`visibility`).
TARGETS = {"preview": 0.20, "draft": 0.10, "final": 0.05, "reference": 0.02}
# The budget of each quality: the expected seconds of a solve, if there is a choice.
BUDGETS = {"preview": 20.0, "draft": 20.0, "final": inf, "reference": inf}
STOP = 0.2  # share of the target: the error at which the lattice stops

_HANDOVERS = (0.0, 1.0, 2.0, 4.0, inf)
_RAYS = (0.5, 1.0, 2.0, 4.0)
_FEWEST_VOXELS = 8  # along the longest edge of a lattice
_FEWEST_PHOTONS = 10_000
_NEARLY = 1.1  # times the smallest error: a smaller gain is not worth more time


@dataclass(frozen=True)
class Plan:
    """Settings for a medium, with their expected error, time and memory.

    settings  `Settings`
    quality   the name of the target
    target    relative error (L2) of all visible light
    error     expected, including noise and the error of stopping the lattice early
    seconds   expected, of the solve
    bytes     of memory
    device    label of the device
    reasons   sentences that say what was chosen, and why
    spent     seconds that planning took
    budget    most seconds that the solve should take
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
        """Whether the expected error is within the target."""
        return self.error <= self.target

    @property
    def keeps_to_budget(self) -> bool:
        """Whether the expected time is within the budget."""
        return self.seconds <= self.budget


@dataclass(frozen=True)
class _Choice:
    """A way of solving, with its expected error and seconds."""

    settings: Settings
    error: float
    seconds: float


def plan(
    medium: Medium,
    lights: Iterable[Light],
    quality: str = "final",
    device: Device | str | None = None,
    fixed: Mapping[str, Any] | None = None,
    cancel: Callable[[], bool] | None = None,
    *,
    scattered: bool = False,
    budget: float | None = None,
) -> Plan:
    """Plan the lighting of a medium.

    medium, lights, device, cancel  as for `solve`
    quality    "preview", "draft", "final" or "reference": errors of 20, 10, 5 and 2 %
    fixed      {name: value} of the given `Settings`
    scattered  whether surfaces show the light while the renderer adds the direct light of lamps:
               scattered light is then never left out
    budget     largest expected time of the solve, s; None for the quality's: 20 for preview and
               draft, unlimited for the others
    If no way within the budget is expected to meet the target, the plan is the most accurate one
    within it; if none is within the budget, it is the fastest one. Raises what `solve` raises.
    """
    require_known(quality, tuple(TARGETS), "quality")
    start, target, fixed = perf_counter(), TARGETS[quality], dict(fixed or {})
    budget, lights = BUDGETS[quality] if budget is None else budget, list(lights)

    # Fix single scattering if an upper bound of the scattered light shows that it suffices.
    if scattered:
        fixed.setdefault("scattering", "multiple")
    bound = _largest_share_of_scattered(medium)
    thin = bound if bound <= SAFE * target and _may_be_single(fixed) else None
    if thin is not None:
        fixed["scattering"] = "single"
    base = replace(Settings(tolerance=STOP * target), **fixed)

    # Solve in few voxels, and scale the results to each way of solving in all voxels.
    pilot = fly(medium, lights, base, target, device, cancel, thin=thin, scattered=scattered)
    expected = Expectation(pilot, medium, max(matter(medium, lights).shape), target)
    choices = _choices(base, fixed, expected, _handovers(medium, lights))
    meeting = [choice.seconds for choice in choices if choice.error <= SAFE * target]
    if budget < inf and "photons" not in fixed:
        choices += _with_fewer_photons(choices, expected, budget)

    # Take the best choice that fits into memory.
    chosen, memory = _first_that_fits(_in_order(choices, target, budget), medium, lights, device)
    settings = chosen.settings
    if "most_steps" not in fixed:
        settings = _stopped_in_time(settings, expected, budget)
    quickest = min(meeting, default=None)
    sentences = [
        *reasons(settings, pilot, medium, lights, STOP),
        outcome(chosen.error, chosen.seconds, quality, target, budget, quickest),
    ]
    label, spent = devices.choose(device).label, perf_counter() - start
    expectation = chosen.error, chosen.seconds, memory
    return Plan(settings, quality, target, *expectation, label, sentences, spent, budget)


def _choices(
    base: Settings, fixed: Mapping[str, Any], expected: Expectation, handovers: Sequence[float]
) -> list[_Choice]:
    choices = []
    for candidate in _candidates(base, fixed, expected.edge, handovers):
        settings, error = expected.error(candidate)
        choices.append(_Choice(settings, error, expected.seconds(settings)))
    return choices


def _candidates(
    base: Settings, fixed: Mapping[str, Any], edge: int, handovers: Sequence[float]
) -> Iterator[Settings]:
    """`Settings` to choose from: all combinations with the fixed ones."""
    merges = [m for m in MERGES if m == 1 or edge / m >= _FEWEST_VOXELS]
    dials: dict[str, Sequence[Any]] = {"rays": _RAYS, "merge": merges, "handover": handovers}
    dials |= {name: [fixed[name]] for name in dials if name in fixed}
    for rays in dials["rays"]:
        if _may_be_single(fixed):
            yield replace(base, scattering="single", rays=rays)
        if fixed.get("scattering") != "single":
            for merge, handover in product(dials["merge"], dials["handover"]):
                yield replace(base, merge=merge, handover=handover, rays=rays)


def _handovers(medium: Medium, lights: Sequence[Light]) -> Sequence[float]:
    """Handovers to try. Photons ignore a lamp's radius, which matters inside the medium."""
    soft = any(light.is_soft_within(medium.domain) for light in lights)
    return (0.0,) if soft else _HANDOVERS


def _may_be_single(fixed: Mapping[str, Any]) -> bool:
    if "scattering" in fixed:
        return bool(fixed["scattering"] == "single")
    return not {"merge", "handover"} & set(fixed)


def _in_order(choices: Sequence[_Choice], target: float, budget: float) -> list[_Choice]:
    """The choices, best first."""
    fast = [choice for choice in choices if choice.seconds <= budget]
    good = [choice for choice in fast if choice.error <= SAFE * target]
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
    choices: Sequence[_Choice], expected: Expectation, budget: float
) -> list[_Choice]:
    """The choices whose photons exceed the budget, with as many photons as fit into it."""
    affordable = []
    for choice in choices:
        settings = choice.settings
        if not settings.photons or choice.seconds <= budget:
            continue
        of_one = expected.seconds_of_photon(settings.handover)
        others = choice.seconds - settings.photons * of_one
        if others + _FEWEST_PHOTONS * of_one > budget:
            continue
        fewer = replace(settings, photons=int((budget - others) / of_one))
        affordable.append(_Choice(fewer, expected.error(fewer)[1], expected.seconds(fewer)))
    return affordable


def _stopped_in_time(settings: Settings, expected: Expectation, budget: float) -> Settings:
    """`Settings` whose lattice takes no more steps than the budget allows."""
    if budget == inf or settings.scattering == "single" or settings.handover == inf:
        return settings
    a_step = expected.seconds_of_step(settings)
    if not a_step:
        return settings
    steps = max(FEWEST_STEPS, int(budget / a_step))
    return replace(settings, most_steps=min(settings.most_steps, steps))


def _first_that_fits(
    choices: Sequence[_Choice],
    medium: Medium,
    lights: Sequence[Light],
    device: Device | str | None,
) -> tuple[_Choice, int]:
    """The first choice that fits into memory, and its bytes."""
    arguments = (medium.bands, medium.occlusion is not None, len(lights))
    for number, choice in enumerate(choices, 1):
        try:
            return choice, require_memory(medium.shape, choice.settings, device, *arguments)
        except DeviceError:
            if number == len(choices):
                raise
    raise AssertionError("there is always a choice")


def _largest_share_of_scattered(medium: Medium) -> float:
    """An upper bound of scattered light's share of all visible light: the scattering probability
    along the deepest line parallel to an axis.

    One more scattering is a linear operator K. In the norm of `visibility` its kernel is symmetric,
    so its norm is at most its largest row sum: the probability of scattering again, averaged over
    directions. The probability along the deepest line is larger than this average.
    """
    depth = medium.depth(medium.sigma_s.max())
    if medium.occlusion is not None:
        depth = depth + medium.occlusion
    return deepest(depth)
