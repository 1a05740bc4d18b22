# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: the least work that should meet it.

Nothing is guessed that a moment's trial tells: what the `Pilot` tells of the medium in few voxels
is scaled to the voxels that are asked for. docs/speed-and-accuracy.md has what the scaling was
measured on.
"""

from dataclasses import dataclass, replace
from itertools import product
from math import ceil, hypot, inf, prod, sqrt
from time import perf_counter

import numpy as np

from ..errors import DeviceError, require_known
from . import device as devices
from .crop import Box
from .lights import FEW_VOXELS
from .medium import deepest
from .physical import is_within
from .pilot import EVENER, MERGES, effort, fly
from .solver import Settings, require_memory

# The relative error (L2) of all light that each quality is to keep to.
TARGETS = {"preview": 0.20, "draft": 0.10, "final": 0.05, "reference": 0.02}
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


@dataclass(frozen=True)
class Plan:
    """How to solve a medium, and what that should come to.

    settings  `Settings`
    quality   the name of the target
    target    relative error (L2) of all light that was asked for
    error     that is expected, from stopping and noise too
    seconds   that are expected of the solve
    bytes     of memory
    device    its label
    reasons   [line]: what was chosen, and why
    spent     seconds that planning took
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

    @property
    def meets_target(self):
        return self.error <= self.target


def plan(medium, lights, quality="final", device=None, fixed=None, cancel=None, *, scattered=False):
    """The `Plan` for lighting a medium.

    medium, lights, device, cancel  as for `solve`
    quality  "preview", "draft", "final" or "reference": errors of 20, 10, 5 and 2 %
    fixed    {name: value} of `Settings` that are not to be chosen
    scattered  whether scattered light is all that is to be shown, as on surfaces: errors are
             relative to it then, and it is never left out
    Where no way is expected to meet the target, it is the most exact one that fits into memory.
    Raises what `solve` raises.
    """
    require_known(quality, tuple(TARGETS), "quality")
    start, target, fixed = perf_counter(), TARGETS[quality], dict(fixed or {})
    if scattered:
        fixed.setdefault("scattering", "multiple")
    lights, most = list(lights), _most_scattered(medium)
    thin = most <= _SAFE * target and _may_be_single(fixed)
    if thin:
        fixed["scattering"] = "single"
    base = replace(Settings(tolerance=_STOP * target), **fixed)
    told = most if thin else None
    pilot = fly(medium, lights, base, target, device, cancel, thin=told, scattered=scattered)
    edge, choices = max(medium.shape), []
    # Photons do not know of a lamp's radius, which counts where it stands in the medium.
    soft = any(getattr(light, "radius", 0) and is_within(light, medium.domain) for light in lights)
    for settings in _candidates(base, fixed, edge, (0.0,) if soft else _HANDOVERS):
        settings, error = _expected_error(settings, pilot, medium, edge, target)
        choices.append((_expected_seconds(settings, pilot, medium, edge), error, settings))
    # Noise is seen more than an even error of the same size is.
    choices.sort(key=lambda choice: (choice[2].handover > 0, choice[0]))
    good = [choice for choice in choices if choice[1] <= _SAFE * target]
    rest = sorted(choices, key=lambda choice: choice[1])
    seconds, error, settings, needed = _first_that_fits([*good, *rest], medium, lights, device)
    return Plan(
        settings,
        quality,
        target,
        error,
        seconds,
        needed,
        devices.choose(device).label,
        _reasons(settings, pilot, medium, error, target),
        perf_counter() - start,
    )


def _first_that_fits(choices, medium, lights, device):
    for number, (seconds, error, settings) in enumerate(choices, 1):
        try:
            arguments = (medium.bands, medium.occlusion is not None, len(lights))
            needed = require_memory(medium.shape, settings, device, *arguments)
        except DeviceError:
            if number == len(choices):
                raise
        else:
            return seconds, error, settings, needed
    raise AssertionError("there is always a choice")


def _most_scattered(medium):
    """What scattered light is at most, over unscattered: what scatters on the deepest line along
    an axis. Straight lines see less on average, and what scatters again is less still."""
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
        return settings, hypot(pilot.share, sampling)
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
    once = pilot.once * effort(settings.rays) * _rays(edge) / _rays(pilot.edge)
    if settings.scattering == "single":
        return once + _FIXED / 2
    # What the lattice and its rays have along an edge, in the pilot, too.
    large = edge / settings.merge * pilot.pieces.get(settings.merge, 1)
    small = pilot.edge * pilot.pieces.get(0, 1)
    seconds = _FIXED + (once if settings.merge > 1 else 0.0)
    if settings.handover:
        photons = settings.photons or 0
        seconds += photons * pilot.trace * _path(settings.handover, pilot, medium)
    if settings.handover == inf:
        # Where light goes forward rays are taken twice.
        twice = 2 if medium.g.max() > 0 else 1
        return float(seconds + twice * once / settings.merge**3)
    seconds += pilot.rays * effort(settings.rays) * _rays(large) / _rays(small)
    if pilot.steps[0]:
        now, before = pilot.steps
        growth = min(max(np.log2(now / before), 0.0), 1.0) if before else 1.0
        seconds += pilot.solve * (large / small) ** (3 + growth)
    return float(seconds)


def _path(handover, pilot, medium):
    """Collisions of a photon till it is handed over, over those of the pilot's."""
    of_one = 1 / (1 - float((medium.albedo * medium.g).max()))
    now, then = (min(1 + depth * of_one, pilot.collisions) for depth in (handover, pilot.traced))
    return now / then if then else 1.0  # where nothing collides


def _rays(edge):
    """The work of rays, in units of one's way through a voxel; see `physical`."""
    return edge**3 * (4 if edge <= FEW_VOXELS else 1)


# --- What was chosen, and why --------------------------------------------------------------------


def _reasons(settings, pilot, medium, error, target):
    """[line] for people."""
    if settings.scattering == "single":
        return [
            f"No lattice: scattered light is {pilot.share:.1%} of all light or less, so scattering "
            "it once, in the shader, is enough.",
            _of_rays(settings, pilot),
        ]
    return [
        f"Scattered light is found: it is {pilot.share:.0%} of all light.",
        _of_photons(settings, pilot),
        _of_merging(settings, pilot, medium),
        _of_rays(settings, pilot),
        f"Steps end where {settings.tolerance:.1%} is left, {_STOP:.0%} of the target.",
        _of_space(medium),
        f"The error should be {error:.1%}; the target is {target:.0%}."
        if error <= target
        else f"The error should be {error:.1%}, above the target of {target:.0%}: nothing that is "
        "planned for is more exact here.",
    ]


def _of_photons(settings, pilot):
    if settings.handover == inf:
        return f"Photons alone, {settings.photons:,}: the lattice would be less exact, or slower."
    if not pilot.noise:
        return f"No photons: the lattice is some {pilot.error:.1%} off at most."
    alone = f"the lattice alone is {pilot.error:.1%} off"
    if not settings.handover:
        return f"No photons: {alone}."
    return (
        f"{settings.photons:,} photons for {settings.handover:g} transport optical depths: {alone}."
    )


def _of_merging(settings, pilot, medium):
    if settings.merge == 1:
        return f"Scattered light in all voxels: in larger ones it is {pilot.merging:.1%} off."
    edge = ceil(max(medium.shape) / settings.merge)
    return f"Scattered light in voxels of {settings.merge} times the edge, {edge} along the domain."


def _of_rays(settings, pilot):
    number = "the usual number" if settings.rays == 1 else f"{settings.rays:g} times the number"
    if not pilot.sampling:
        return f"Unscattered light by {number} of rays, as it is not shown itself."
    return f"Unscattered light by {number} of rays; the usual number is {pilot.sampling:.1%} off."


def _of_space(medium):
    grids = [grid for grid in (medium.density, medium.occlusion) if grid is not None]
    filled = prod(Box.around(grids).shape) / prod(medium.shape)
    if filled == 1:
        return "The lattice covers the domain: there is matter all over."
    return f"The lattice covers {filled:.0%} of the domain: the rest is empty."
