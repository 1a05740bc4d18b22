# SPDX-License-Identifier: GPL-3.0-or-later
"""From an error target to settings: the least work that should meet it.

Nothing is guessed that a moment's trial tells. The medium is solved as a pilot, in few voxels, in
several ways; photons say how wrong the lattice is there; and what is seen is scaled to the voxels
that are asked for. docs/speed-and-accuracy.md has what the scaling was measured on.
"""

from dataclasses import dataclass, replace
from math import ceil, hypot, inf, prod, sqrt
from time import perf_counter

import numpy as np

from ..errors import DeviceError, MediumError, require_known
from . import device as devices
from .coarse import coarse
from .crop import Box
from .lights import FEW_VOXELS
from .medium import deepest
from .physical import is_within
from .solver import Settings, require_memory, solve

# The relative error (L2) of all light that each quality is to keep to.
TARGETS = {"preview": 0.20, "draft": 0.10, "final": 0.05, "reference": 0.02}
_PILOT = 32  # voxels along the longest edge of the pilot
_PHOTONS = (20_000, 60_000)  # of the pilot, twice: the more tell what each takes
_CLOSE = 0.10  # targets up to this are compared with photons; the others with what is usual:
_USUAL = 0.065  # error of the lattice without photons, the most of docs/physics.md
_FAR = 300  # collisions of a photon from which on the pilot's are handed over
_SAFE = 0.85  # of the target, that what is expected must keep to
_STOP = 0.2  # of the target, that the lattice may leave
_NOISE = (0.3, 0.5)  # of the target, that photons may leave: the least, and the most
_MERGES = (1, 2, 4, 8)
_HANDOVERS = (0.0, 1.0, 2.0, 4.0, inf)
# What is left of the lattice's error where photons go before it.
_LEFT = (0, 1, 2, 4), (1, 0.75, 0.6, 0.45)  # by handover
_FIXED = 0.04  # s that a solve takes of however little
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


@dataclass(frozen=True)
class Pilot:
    """What a solve in few voxels told.

    edge        voxels along the longest edge
    share       of scattered light in all light, in L2
    error       of the lattice alone, relative (L2)
    merging     what merging by 2 changes, relative (L2); infinite where it cannot be
    rays        s, of rays and all but the lattice
    solve       s, of the lattice, at `steps`
    steps       at `edge`, and at half of it
    trace       s a photon that is traced to a handover of `traced`
    traced      that handover, in transport optical depths
    noise       relative (L2), of one photon: of n it is the root of n less
    collisions  of a photon, mean, till it is absorbed or leaves
    """

    edge: int
    share: float
    rays: float
    error: float = inf
    merging: float = inf
    solve: float = 0.0
    steps: tuple = (0, 0)
    trace: float = 0.0
    traced: float = inf
    noise: float = 0.0
    collisions: float = 0.0


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
    pilot = _fly(medium, lights, base, target, device, cancel, told, scattered)
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


# --- The pilot -----------------------------------------------------------------------------------


def _most_scattered(medium):
    """What scattered light is at most, over unscattered: what scatters on the deepest line along
    an axis. Straight lines see less on average, and what scatters again is less still."""
    depth = medium.depth(medium.sigma_s.max())
    if medium.occlusion is not None:
        depth = depth + medium.occlusion
    return deepest(depth)


def _fly(medium, lights, base, target, device, cancel, thin, scattered=False):
    """The `Pilot` of a medium; thin is the share of scattered light where that needs no lattice to
    be known, or None."""
    pieces = ceil(max(medium.shape) / _PILOT)
    small = medium if pieces == 1 else medium.merged(pieces)
    lights = [_as_a_point(coarse(light, pieces)) for light in lights]

    def solved(**changes):
        settings = replace(base, scattering="multiple", merge=1, handover=0.0, photons=None)
        return solve(small, lights, replace(settings, **changes), device, cancel=cancel)

    if thin is not None:
        solved(scattering="single")  # makes programs ready
        start = perf_counter()
        solved(scattering="single")
        once = perf_counter() - start
        return Pilot(max(small.shape), thin, 2 * once if medium.g.max() > 0 else once)
    half = _unless_too_dark(solved, merge=2)  # first, as a first solve makes programs ready
    start = perf_counter()
    whole = _unless_too_dark(solved)
    seconds = perf_counter() - start
    traced, handover = [], inf
    if whole is None or target <= _CLOSE:
        # To their end, where that is not far: a lattice that takes over has an error, too.
        far = whole is not None and _collisions(small, whole) > _FAR
        handover = 4.0 if far else inf
        traced = [solved(handover=handover, seed=n, photons=p) for n, p in enumerate(_PHOTONS)]
    return _seen(small, half, whole, seconds, traced, handover, scattered)


def _as_a_point(light):
    return replace(light, radius=0.0) if getattr(light, "radius", 0) else light


def _unless_too_dark(solved, **changes):
    try:
        return solved(**changes)
    except MediumError:
        return None


def _seen(medium, half, whole, seconds, traced, handover, scattered):
    """The `Pilot` from fields: in merged voxels, in all, and of photons, twice or not at all.

    seconds   that the second took
    handover  that of the photons
    """
    best = traced[-1] if whole is None else whole
    light, share = _all(best), float(np.linalg.norm(best.fluence))
    everything = float(np.linalg.norm(light)) or 1.0
    size = (share if scattered else everything) or 1.0
    noise, error = 0.0, _USUAL * everything / size
    if traced:
        few, many = map(_all, traced)
        # Of one photon, were it alone.
        noise = float(np.linalg.norm(few - many)) / size / sqrt(sum(1 / p for p in _PHOTONS))
        # The noise of the two is independent: it drops out of the product.
        error = sqrt(max(float(np.vdot(light - few, light - many)), 0.0)) / size
    solving = best.report.seconds.get("solve", 0.0)
    return Pilot(
        edge=max(medium.shape),
        share=share / everything,
        error=inf if whole is None else error,
        merging=inf if None in (half, whole) else float(np.linalg.norm(light - _all(half))) / size,
        rays=best.report.seconds["direct"] if whole is None else seconds - solving,
        solve=solving,
        steps=tuple(field.report.steps if field else 0 for field in (whole, half)),
        traced=handover,
        trace=_of_each([field.report.seconds["trace"] for field in traced]),
        noise=noise,
        collisions=_collisions(medium, best),
    )


def _of_each(seconds):
    """s a photon, from two numbers of them: there is much else that a trace takes time for."""
    if not seconds:
        return 0.0
    (few, many), (short, long) = _PHOTONS, seconds
    return max((long - short) / (many - few), long / many / 4)


def _all(field):
    return (field.fluence + field.direct).astype(float)


def _collisions(medium, field):
    """Mean number of a photon's collisions: what collides over what enters."""
    colliding = medium.sigma_t[:, None, None, None] * medium.density * _all(field)
    entered = float(np.sum(field.report.energy["entered"])) or 1.0
    return float(colliding.sum()) * medium.voxel_size**3 / entered


# --- What a way of solving should come to --------------------------------------------------------


def _candidates(base, fixed, edge, handovers):
    """`Settings` to choose from: all combinations that leave what is fixed as it is."""
    if _may_be_single(fixed):
        yield replace(base, scattering="single")
    if fixed.get("scattering") == "single":
        return
    merges = [m for m in _MERGES if m == 1 or edge / m >= _FEWEST_VOXELS]
    for merge in [fixed["merge"]] if "merge" in fixed else merges:
        for handover in [fixed["handover"]] if "handover" in fixed else handovers:
            yield replace(base, merge=merge, handover=handover)


def _may_be_single(fixed):
    if "scattering" in fixed:
        return fixed["scattering"] == "single"
    return not {"merge", "handover"} & set(fixed)


def _expected_error(settings, pilot, medium, edge, target):
    """(`Settings` with as many photons as keep to the target, the error expected of them)."""
    if settings.scattering == "single":
        return settings, pilot.share
    large = edge / settings.merge
    # What merging costs goes with the edge of voxels.
    merging = pilot.edge * pilot.merging * (1 / large - 1 / edge) if settings.merge > 1 else 0.0
    left = 0.0 if settings.handover == inf else float(np.interp(settings.handover, *_LEFT))
    lattice = left * pilot.error if left else 0.0
    error = hypot(lattice, merging, settings.tolerance if left else 0.0)
    if not settings.handover:
        return settings, error
    noise = pilot.noise * large / pilot.edge  # of one photon in all
    if not noise:  # it traced none
        return settings, inf
    allowed = sqrt(max((_SAFE * target) ** 2 - error**2, 0.0))
    allowed = min(max(allowed, _NOISE[0] * target), _NOISE[1] * target)
    photons = settings.photons or max(_FEWEST_PHOTONS, round((noise / allowed) ** 2))
    return replace(settings, photons=photons), hypot(error, noise / sqrt(photons))


def _expected_seconds(settings, pilot, medium, edge):
    rays = pilot.rays * _rays(edge) / _rays(pilot.edge)
    # Where light goes forward a lattice takes rays twice.
    once = rays / 2 if medium.g.max() > 0 else rays
    if settings.scattering == "single":
        return once + _FIXED
    large = edge / settings.merge
    seconds = _FIXED + pilot.rays * _rays(large) / _rays(pilot.edge)
    if settings.merge > 1:
        seconds += once
    if settings.handover:
        photons = settings.photons or 0
        seconds += photons * pilot.trace * _path(settings.handover, pilot, medium)
    if settings.handover != inf and pilot.steps[0]:
        now, before = pilot.steps
        growth = min(max(np.log2(now / before), 0.0), 1.0) if before else 1.0
        seconds += pilot.solve * (large / pilot.edge) ** (3 + growth)
    return float(seconds)


def _path(handover, pilot, medium):
    """Collisions of a photon till it is handed over, over those of the pilot's."""
    of_one = 1 / (1 - float((medium.albedo * medium.g).max()))
    now, then = (min(1 + depth * of_one, pilot.collisions) for depth in (handover, pilot.traced))
    return now / then


def _rays(edge):
    """The work of rays, in units of one's way through a voxel; see `physical`."""
    return edge**3 * (4 if edge <= FEW_VOXELS else 1)


# --- What was chosen, and why --------------------------------------------------------------------


def _reasons(settings, pilot, medium, error, target):
    """[line] for people."""
    if settings.scattering == "single":
        return [
            f"No lattice: scattered light is {pilot.share:.1%} of all light or less, so scattering "
            "it once, in the shader, is enough."
        ]
    return [
        f"Scattered light is found: it is {pilot.share:.0%} of all light.",
        _of_photons(settings, pilot, target),
        _of_merging(settings, pilot, medium),
        f"Steps end where {settings.tolerance:.1%} is left, {_STOP:.0%} of the target.",
        _of_space(medium),
        f"The error should be {error:.1%}; the target is {target:.0%}."
        if error <= target
        else f"The error should be {error:.1%}, above the target of {target:.0%}: nothing that is "
        "planned for is more exact here.",
    ]


def _of_photons(settings, pilot, target):
    if settings.handover == inf:
        return f"Photons alone, {settings.photons:,}: the lattice would be less exact, or slower."
    if target > _CLOSE:
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


def _of_space(medium):
    grids = [grid for grid in (medium.density, medium.occlusion) if grid is not None]
    filled = prod(Box.around(grids).shape) / prod(medium.shape)
    if filled == 1:
        return "The lattice covers the domain: there is matter all over."
    return f"The lattice covers {filled:.0%} of the domain: the rest is empty."
