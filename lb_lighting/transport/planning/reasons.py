# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan and its reasons, in sentences for the artist."""

from collections.abc import Sequence
from math import ceil, inf, prod

from ..box import matter
from ..lights.base import Light
from ..medium import Medium
from ..solver import Settings
from .pilot import Pilot


def reasons(
    settings: Settings, pilot: Pilot, medium: Medium, lights: Sequence[Light], stop: float
) -> list[str]:
    """A sentence for each choice.

    stop  share of the target at which the lattice stops
    """
    if settings.scattering == "single":
        return [
            f"No lattice: scattered light is at most {pilot.share:.1%} of the visible light, so "
            "the shader scatters light once, and that is enough.",
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
    error: float,
    seconds: float,
    quality: str,
    target: float,
    budget: float,
    quickest: float | None,
) -> str:
    """Whether the plan is expected to meet the target and the budget, and what would help.

    error, seconds  expected
    quickest        seconds of the fastest way that meets the target; None if there is none
    """
    met = error <= target
    sentence = f"Expected error {error:.1%}" + (
        f"; the target is {target:.0%}." if met else f", above the target of {target:.0%}."
    )
    limit = f"{quality.capitalize()} aims to finish within {budget:.0f} s"
    if seconds > budget:
        return (
            f"{sentence} It should take about {seconds:.0f} s. {limit}, but nothing is faster at "
            "this resolution."
        )
    if met:
        return sentence
    if quickest is None or quickest <= budget:
        return f"{sentence} No settings are more accurate here."
    return (
        f"{sentence} Meeting the target would take about {quickest:.0f} s. {limit}; choose Final "
        "to allow more time."
    )


def _of_photons(settings: Settings, pilot: Pilot) -> str:
    if settings.handover == inf:
        return f"Photons only, {settings.photons:,}: the lattice would be less accurate or slower."
    if not pilot.noise:
        return f"No photons: the error of the lattice is at most about {pilot.error:.1%}."
    lattice = f"the error of the lattice alone is {pilot.error:.1%}"
    if not settings.handover:
        return f"No photons: {lattice}."
    depth = f"{settings.handover:g} transport optical depths"
    return f"{settings.photons:,} photons for the first {depth}: {lattice}."


def _of_merging(settings: Settings, pilot: Pilot, medium: Medium) -> str:
    if settings.merge == 1 and pilot.merging == inf:
        return "Scattered light in all voxels: larger ones would be too dark for the lattice."
    if settings.merge == 1:
        return (
            f"Scattered light in all voxels: larger ones would add an error of {pilot.merging:.1%}."
        )
    edge = ceil(max(medium.shape) / settings.merge)
    return f"Scattered light in voxels {settings.merge} times as large, {edge} along the domain."


def _of_rays(settings: Settings, pilot: Pilot) -> str:
    number = "the usual number" if settings.rays == 1 else f"{settings.rays:g} times the number"
    if not pilot.sampling:
        return f"Direct light from {number} of rays; it is not shown itself."
    error = f"{pilot.sampling:.1%}"
    return f"Direct light from {number} of rays; the usual number has an error of {error}."


def _of_space(medium: Medium, lights: Sequence[Light]) -> str:
    filled = prod(matter(medium, lights).shape) / prod(medium.shape)
    if filled == 1:
        return "The lattice covers the whole domain: matter fills it."
    return f"The lattice covers {filled:.0%} of the domain: the rest is empty."
