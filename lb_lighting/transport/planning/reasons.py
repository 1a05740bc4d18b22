# SPDX-License-Identifier: GPL-3.0-or-later
"""The sentences that tell artists what a plan chose, and why."""

from collections.abc import Sequence
from math import ceil, inf, prod
from typing import Any

from ..box import matter
from ..medium import Medium
from ..solver import Settings
from .pilot import Pilot


def choices_made(
    settings: Settings, pilot: Pilot, medium: Medium, lights: Sequence[Any], stop: float
) -> list[str]:
    """[sentence]: why the settings are what they are.

    stop  the share of the error target that the lattice may leave
    """
    if settings.scattering == "single":
        return [
            f"No lattice: scattered light is at most {pilot.share:.1%} of the visible light. The "
            "shader scatters light once, which is enough.",
            _of_rays(settings, pilot),
        ]
    return [
        f"Scattered light is needed: it is {pilot.share:.0%} of the visible light.",
        _of_photons(settings, pilot),
        _of_merging(settings, pilot, medium),
        _of_rays(settings, pilot),
        f"The lattice stops at an error of {settings.tolerance:.1%}, {stop:.0%} of the target.",
        _of_space(medium, lights),
    ]


def outcome(
    error: float, seconds: float, quality: str, target: float, budget: float, needed: float | None
) -> str:
    """A sentence: whether the expected error and time meet the target and the budget.

    needed  seconds that meeting the target takes; None if no settings meet it
    """
    met = error <= target
    expected = f"The error should be {error:.1%}" + (
        f"; the target is {target:.0%}." if met else f", above the target of {target:.0%}."
    )
    limit = f"{quality.capitalize()} is meant to end within {budget:.0f} s"
    if seconds > budget:
        return (
            f"{expected} It should take about {seconds:.0f} s. {limit}, but no settings are "
            "faster at this resolution."
        )
    if met:
        return expected
    if needed is None or needed <= budget:
        return f"{expected} No settings are more accurate here."
    return (
        f"{expected} Meeting the target would take about {needed:.0f} s. {limit}; "
        "choose Final to allow more time."
    )


def _of_photons(settings: Settings, pilot: Pilot) -> str:
    if settings.handover == inf:
        return f"{settings.photons:,} photons alone: a lattice would be less accurate or slower."
    if not pilot.noise:
        return f"No photons: the error of the lattice is at most about {pilot.error:.1%}."
    alone = f"the lattice alone has an error of {pilot.error:.1%}"
    if not settings.handover:
        return f"No photons: {alone}."
    depth = f"{settings.handover:g} transport optical depths"
    return f"{settings.photons:,} photons over {depth}: {alone}."


def _of_merging(settings: Settings, pilot: Pilot, medium: Medium) -> str:
    if settings.merge == 1 and pilot.merging == inf:
        return "Scattered light in all voxels: larger ones would absorb too much for the lattice."
    if settings.merge == 1:
        return f"Scattered light in all voxels: in larger ones its error is {pilot.merging:.1%}."
    edge = ceil(max(medium.shape) / settings.merge)
    return f"Scattered light in voxels {settings.merge} times as large: {edge} along the domain."


def _of_rays(settings: Settings, pilot: Pilot) -> str:
    number = "the usual" if settings.rays == 1 else f"{settings.rays:g} times the usual"
    if not pilot.sampling:
        return f"Direct light from {number} number of rays, as it is not shown itself."
    return (
        f"Direct light from {number} number of rays; the usual number has an error of "
        f"{pilot.sampling:.1%}."
    )


def _of_space(medium: Medium, lights: Sequence[Any]) -> str:
    filled = prod(matter(medium, lights).shape) / prod(medium.shape)
    if filled == 1:
        return "The lattice covers the whole domain: matter fills it."
    return f"The lattice covers {filled:.0%} of the domain; the remainder is empty."
