# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: the least work that should meet it.

Nothing is guessed that a moment's trial tells: what the `Pilot` tells of the medium in few voxels
is scaled to the voxels that are asked for. docs/measurements/speed-and-accuracy.md has what the
scaling was measured on.
"""

from dataclasses import dataclass, replace
from itertools import product
from math import ceil, hypot, inf, prod, sqrt
from time import perf_counter

import numpy as np

from ...errors import DeviceError, require_known
from .. import device as devices
from ..box import matter
from ..collision_source import is_soft_within
from ..lights.distant import FEW_VOXELS
from ..medium import deepest
from ..solver import Settings, require_memory
from .pilot import (
    EVENER,
    MERGES,
    effort,
    fly,
    work_of_rays,
)

# The relative error (L2) that each quality is to keep to, of all light as it is seen (`seen`).
TARGETS = {"preview": 0.20, "draft": 0.10, "final": 0.05, "reference": 0.02}
# The seconds that a solve may be expected to take at each, where there is a choice.
BUDGETS = {"preview": 20.0, "draft": 20.0, "final": inf, "reference": inf}
_SAFE = 0.85  # of the target, that what is expected must keep to
_STOP = 0.2  # of the target, that the lattice may leave
_NOISE = (0.3, 0.5)  # of the target, that photons may leave: the least, and the most
_HANDOVERS = (0.0, 1.0, 2.0, 4.0, inf)
_RAYS = (0.5, 1.0, 2.0, 4.0)
# What is left of the lattice's error where photons go before it.
_LEFT = (0, 1, 2, 4), (1, 0.75, 0.6, 0.45)  # by handover
_FIXED = 0.04  # s that a solve takes of however little; half of it without a lattice
_FEWEST_VOXELS = 8  # along the longest edge of a lattice
_FEWEST_PHOTONS = 10_000
_FEWEST_STEPS = 48
_NEARLY = 1.1  # times the smallest error, which is not worth more time


@dataclass(frozen=True)
class Plan:
    """How to solve a medium, and what that should come to.

    settings  `Settings`
    quality   the name of the target
    target    relative error (L2) of all light that was asked for, as it is seen
    error     that is expected, from stopping and noise too
    seconds   that are expected of the solve
    bytes     of memory
    device    its label
    reasons   [line]: what was chosen, and why
    spent     seconds that planning took
    budget    seconds that the solve was to take at most
    """

    settings: Settings
    quality: str
    target: float
    error: float
    seconds: float
    bytes: int
    device: str
    reasons: list
    spent: float
    budget: float = inf

    @property
    def meets_target(self):
        return self.error <= self.target

    @property
    def keeps_to_budget(self):
        return self.seconds <= self.budget


@dataclass(frozen=True)
class _Choice:
    """A way of solving, and what it should come to."""

    settings: Settings
    error: float
    seconds: float


def plan(
    medium,
    lights,
    quality="final",
    device=None,
    fixed=None,
    cancel=None,
    *,
    scattered=False,
    budget=None,
):
    """The `Plan` for lighting a medium.

    medium, lights, device, cancel  as for `solve`
    quality  "preview", "draft", "final" or "reference": errors of 20, 10, 5 and 2 %
    fixed    {name: value} of `Settings` that are not to be chosen
    scattered  whether surfaces show the light, and the renderer adds what lamps send them: then
             scattered light is never left out
    budget   seconds that the solve may be expected to take, or None for the quality's: 20 for
             preview and draft, any for the others
    Where no way within the budget is expected to meet the target, it is the most exact of them
    that fits into memory; where none is within the budget, the fastest.
    Raises what `solve` raises.
    """
    require_known(quality, tuple(TARGETS), "quality")
    start, target, fixed = perf_counter(), TARGETS[quality], dict(fixed or {})
    budget = BUDGETS[quality] if budget is None else budget
    if scattered:
        fixed.setdefault("scattering", "multiple")
    lights, most = list(lights), _most_scattered(medium)
    thin = most <= _SAFE * target and _may_be_single(fixed)
    if thin:
        fixed["scattering"] = "single"
    base = replace(Settings(tolerance=_STOP * target), **fixed)
    told = most if thin else None
    pilot = fly(medium, lights, base, target, device, cancel, thin=told, scattered=scattered)
    edge = max(matter(medium, lights).shape)
    # Photons do not know of a lamp's radius, which counts where it stands in the medium.
    soft = any(is_soft_within(light, medium.domain) for light in lights)
    choices = []
    for settings in _candidates(base, fixed, edge, (0.0,) if soft else _HANDOVERS):
        settings, error = _expected_error(settings, pilot, medium, edge, target)
        choices.append(_Choice(settings, error, _expected_seconds(settings, pilot, medium, edge)))
    good = [choice for choice in choices if choice.error <= _SAFE * target]
    wanted = min((choice.seconds for choice in good), default=None)
    if budget < inf and "photons" not in fixed:
        choices += _with_fewer_photons(choices, pilot, medium, edge, target, budget)
    ordered = _in_order(choices, target, budget)
    chosen, needed = _first_that_fits(ordered, medium, lights, device)
    settings = chosen.settings
    if "most_steps" not in fixed:
        settings = _stopped_in_time(settings, pilot, edge, budget)
    return Plan(
        settings,
        quality,
        target,
        chosen.error,
        chosen.seconds,
        needed,
        devices.choose(device).label,
        [
            *_reasons(settings, pilot, medium, lights),
            _of_the_outcome(chosen, quality, target, budget, wanted),
        ],
        perf_counter() - start,
        budget,
    )


def _in_order(choices, target, budget):
    """The choices, the best first."""
    fast = [choice for choice in choices if choice.seconds <= budget]
    good = [choice for choice in fast if choice.error <= _SAFE * target]
    least = min((choice.error for choice in fast), default=0.0)
    nearly = [choice for choice in fast if choice.error <= _NEARLY * least]
    return [
        # Noise is seen more than an even error of the same size is.
        *sorted(good, key=lambda choice: (choice.settings.handover > 0, choice.seconds)),
        *sorted(nearly, key=lambda choice: choice.seconds),
        *sorted(fast, key=lambda choice: choice.error),
        *sorted(choices, key=lambda choice: choice.seconds),
    ]


def _with_fewer_photons(choices, pilot, medium, edge, target, budget):
    """[choice]: those that trace too many photons for the budget, with as many as it allows."""
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


def _stopped_in_time(settings, pilot, edge, budget):
    """`Settings` whose lattice takes no more steps than a budget has the seconds for."""
    if budget == inf or settings.scattering == "single" or settings.handover == inf:
        return settings
    if not pilot.steps[0] or not pilot.solve:
        return settings
    a_step = pilot.solve / pilot.steps[0] * _growth(settings, pilot, edge) ** 3
    return replace(
        settings, most_steps=min(settings.most_steps, max(_FEWEST_STEPS, int(budget / a_step)))
    )


def _first_that_fits(choices, medium, lights, device):
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


def _most_scattered(medium):
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


# --- What a way of solving should come to --------------------------------------------------------


def _candidates(base, fixed, edge, handovers):
    """`Settings` to choose from: all combinations that leave what is fixed as it is."""
    merges = [m for m in MERGES if m == 1 or edge / m >= _FEWEST_VOXELS]
    usual = {"rays": _RAYS, "merge": merges, "handover": handovers}
    all_rays, merges, handovers = (
        [fixed[name]] if name in fixed else values for name, values in usual.items()
    )
    for rays in all_rays:
        if _may_be_single(fixed):
            yield replace(base, scattering="single", rays=rays)
        if fixed.get("scattering") != "single":
            for merge, handover in product(merges, handovers):
                yield replace(base, merge=merge, handover=handover, rays=rays)


def _may_be_single(fixed):
    if "scattering" in fixed:
        return fixed["scattering"] == "single"
    return not {"merge", "handover"} & set(fixed)


def _expected_error(settings, pilot, medium, edge, target):
    """(`Settings` with as many photons as keep to the target, the error expected of them)."""
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


def _of_merged(settings, pilot, growth):
    """The error of merging; growth is by how many voxels of the pilot the edges grow."""
    if not growth:
        return 0.0
    merging = pilot.merging * growth
    if not settings.handover:
        return merging
    # Photons' light is uneven in what the lattice is wrong by, too; measured: .35 of that at a
    # growth of 1, .7 at 3.
    return hypot(merging, pilot.error * growth / (growth + 1.6))


def _expected_seconds(settings, pilot, medium, edge):
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


def _edges(settings, pilot, edge):
    """Voxels that the lattice and its rays have along an edge, and those in the pilot."""
    large = edge / settings.merge * pilot.pieces.get(settings.merge, 1)
    return large, pilot.edge * pilot.pieces.get(0, 1)


def _growth(settings, pilot, edge):
    large, small = _edges(settings, pilot, edge)
    return large / small


def _path(handover, pilot, medium):
    """Collisions of a photon till it is handed over, over those of the pilot's."""
    of_one = 1 / (1 - float((medium.albedo * medium.g).max()))
    now, then = (min(1 + depth * of_one, pilot.collisions) for depth in (handover, pilot.traced))
    return now / then if then else 1.0  # where nothing collides


# --- What was chosen, and why --------------------------------------------------------------------


def _reasons(settings, pilot, medium, lights):
    """[line] for people, but for what it should come to."""
    if settings.scattering == "single":
        return [
            f"No lattice: scattered light is at most {pilot.share:.1%} of the light that is seen, "
            "so it is enough to scatter light once, in the shader.",
            _of_rays(settings, pilot),
        ]
    return [
        f"Scattered light is needed: it is {pilot.share:.0%} of the light that is seen.",
        _of_photons(settings, pilot),
        _of_merging(settings, pilot, medium),
        _of_rays(settings, pilot),
        f"The lattice stops when {settings.tolerance:.1%} of its light is still to come, "
        f"{_STOP:.0%} of the target.",
        _of_space(medium, lights),
    ]


def _of_the_outcome(chosen, quality, target, budget, wanted):
    """A line: whether the target and the budget should be kept to, and what else it would take.

    wanted  s that it takes to keep to the target; None where nothing does
    """
    met = chosen.error <= target
    error = f"The error should be {chosen.error:.1%}" + (
        f"; the target is {target:.0%}." if met else f", above the target of {target:.0%}."
    )
    limit = f"{quality.capitalize()} is meant to end within {budget:.0f} s"
    if chosen.seconds > budget:
        return (
            f"{error} It should take about {chosen.seconds:.0f} s. {limit}, but no way of solving "
            "is faster at this resolution."
        )
    if met:
        return error
    if wanted is None or wanted <= budget:
        return f"{error} No way of solving is more exact here."
    return (
        f"{error} Meeting the target would take about {wanted:.0f} s. {limit}; "
        "choose Final to allow more time."
    )


def _of_photons(settings, pilot):
    if settings.handover == inf:
        return f"Photons alone, {settings.photons:,}: the lattice would be less exact, or slower."
    if not pilot.noise:
        return f"No photons: the lattice is at most about {pilot.error:.1%} off."
    alone = f"the lattice alone is {pilot.error:.1%} off"
    if not settings.handover:
        return f"No photons: {alone}."
    return (
        f"{settings.photons:,} photons for {settings.handover:g} transport optical depths: {alone}."
    )


def _of_merging(settings, pilot, medium):
    if settings.merge == 1 and pilot.merging == inf:
        return "Scattered light in all voxels: larger ones would be too dark for the lattice."
    if settings.merge == 1:
        return f"Scattered light in all voxels: in larger ones it is {pilot.merging:.1%} off."
    edge = ceil(max(medium.shape) / settings.merge)
    return f"Scattered light in voxels of {settings.merge} times the edge, {edge} along the domain."


def _of_rays(settings, pilot):
    number = "the usual number" if settings.rays == 1 else f"{settings.rays:g} times the number"
    if not pilot.sampling:
        return f"Unscattered light by {number} of rays, as it is not shown itself."
    return f"Unscattered light by {number} of rays; the usual number is {pilot.sampling:.1%} off."


def _of_space(medium, lights):
    filled = prod(matter(medium, lights).shape) / prod(medium.shape)
    if filled == 1:
        return "The lattice covers the domain: there is matter all over."
    return f"The lattice covers {filled:.0%} of the domain: the rest is empty."
