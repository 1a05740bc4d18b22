# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium solved in few voxels, in several ways, to see what its solve will take and be worth.

Photons tell how wrong the lattice is: two sets of few are enough, as their noise is independent,
and drops out of the product of both differences.
"""

from dataclasses import dataclass, field, replace
from math import ceil, hypot, inf, sqrt
from time import perf_counter

import numpy as np

from ..errors import MediumError
from .coarse import coarse
from .solver import solve
from .thick import wished_pieces

MERGES = (1, 2, 4, 8)  # voxels along an edge that may be planned to be merged
_EDGE = 32  # voxels along the longest edge of the pilot
_PHOTONS = (20_000, 60_000)  # the more tell what each takes
_SHARP, _MORE = 0.02, 4  # targets up to this need so many times more to see the lattice's error
_CLOSE = 0.10  # targets up to this are compared with photons; the others with what is usual:
_USUAL = 0.065  # error of the lattice without photons, the most of docs/physics.md
_FAR = 300  # collisions of a photon from which on the pilot's are handed over
_ROUGH, _ROUGHEST = 0.5, 0.25  # rays where these are not what is looked at
EVENER = 1.3  # the power of rays along an edge that their error goes down with


@dataclass(frozen=True)
class Pilot:
    """What a solve in few voxels told. Errors are relative (L2), of what is shown.

    edge        voxels along the longest edge
    share       of scattered light in all light, in L2
    once        s, of unscattered light alone, with all else that a solve takes
    sampling    error of the usual number of rays; 0 where unscattered light is not shown
    error       of the lattice alone; infinite where it cannot be
    merging     what merging by 2 changes; infinite where it cannot be
    rays        s, of rays and all but the lattice where there is one
    solve       s, of the lattice, at `steps`
    steps       at `edge`, and at half of it
    trace       s a photon that is traced to a handover of `traced`
    traced      that handover, in transport optical depths
    noise       of one photon: of n it is the root of n less
    collisions  of a photon, mean, till it is absorbed or leaves
    pieces      {voxels merged along an edge: in how many pieces the lattice divides them}; at 0
                in how many it divided the pilot's
    """

    edge: int
    share: float
    once: float
    sampling: float = 0.0
    error: float = inf
    merging: float = inf
    rays: float = 0.0
    solve: float = 0.0
    steps: tuple = (0, 0)
    trace: float = 0.0
    traced: float = inf
    noise: float = 0.0
    collisions: float = 0.0
    pieces: dict = field(default_factory=dict)


def fly(medium, lights, settings, target, device=None, cancel=None, *, thin=None, scattered=False):
    """The `Pilot` of a medium.

    settings  `Settings`: its model, and the tolerance
    target    relative error that is asked for
    thin      the share of scattered light where that needs no lattice to be known, or None
    The others are those of `planner.plan`. Raises what `solve` raises.
    """
    pieces = ceil(max(medium.shape) / _EDGE)
    small = medium if pieces == 1 else medium.merged(pieces)
    lights = [_as_a_point(coarse(light, pieces)) for light in lights]

    def solved(**changes):
        plain = {"scattering": "multiple", "rays": 1.0, "merge": 1, "handover": 0.0}
        changed = replace(settings, **plain | {"photons": None} | changes)
        return solve(small, lights, changed, device, cancel=cancel)

    rough = solved(scattering="single", rays=_ROUGH)  # first: it makes programs ready
    start = perf_counter()
    single = solved(scattering="single")
    once = perf_counter() - start
    sampling = _of_usual(_size(single.direct - rough.direct) / (_size(single.direct) or 1.0))
    pilot = Pilot(max(small.shape), thin or 0.0, once, sampling)
    if thin is not None:
        return pilot
    pieces = {merge: _pieces(medium.merged(merge), settings) for merge in MERGES}
    pilot = replace(pilot, pieces={0: _pieces(small, settings), **pieces})
    return _with_scattered(pilot, small, single, solved, target, scattered)


def effort(rays):
    """Seconds that rays take, over those of the usual number: few hardly fill a device (measured
    in media of 32^3 voxels in a sky: .47 for half of them along an edge)."""
    return rays**2 if rays >= 1 else 0.3 + 0.7 * rays**2


def _pieces(medium, settings):
    """In how many pieces voxels are divided; in one where they are too dark for any number."""
    if settings.divide:
        return settings.divide
    try:
        return wished_pieces(medium)[0]
    except MediumError:
        return 1


def _as_a_point(light):
    return replace(light, radius=0.0) if getattr(light, "radius", 0) else light


def _with_scattered(pilot, medium, single, solved, target, scattered):
    """The `Pilot` with all that scattered light tells.

    single  the `Field` of unscattered light
    solved  a function that solves the medium, and takes changes of `Settings`
    """
    half = _unless_too_dark(solved, merge=2, rays=_ROUGH)
    start = perf_counter()
    whole = _unless_too_dark(solved, rays=_ROUGH)
    seconds = perf_counter() - start
    few = many = None
    if whole is None or target <= _CLOSE:
        # To their end, where that is not far: a lattice that takes over has an error, too.
        far = whole is not None and _collisions(medium, single, whole) > _FAR
        counts = [n * (_MORE if target <= _SHARP else 1) for n in _PHOTONS]
        pilot = replace(pilot, traced=4.0 if far else inf)
        few, many = (
            solved(handover=pilot.traced, seed=seed, photons=count, rays=_ROUGHEST)
            for seed, count in enumerate(counts)
        )
    best = many if whole is None else whole
    scattered_light, light = _size(best.fluence), _size(best.fluence + single.direct)
    size = (scattered_light if scattered else light) or 1.0
    pilot = replace(
        pilot,
        share=scattered_light / (light or 1.0),
        # What few rays do to scattered light is in the error of the lattice.
        sampling=0.0 if scattered else pilot.sampling,
        collisions=_collisions(medium, single, best),
    )
    if whole is not None:
        pilot = _with_lattice(pilot, half, whole, seconds, size)
        pilot = replace(pilot, error=_USUAL * light / size)
    return pilot if few is None else _with_photons(pilot, whole, few, many, counts, size)


def _with_lattice(pilot, half, whole, seconds, size):
    """The `Pilot` with what the lattice takes, and what merging its voxels costs.

    half, whole  its `Field`s, the first in merged voxels, or None
    seconds      that the whole one took
    size         L2 of the light that errors are relative to
    """
    solving, casting = (whole.report.seconds.get(name, 0.0) for name in ("solve", "direct"))
    return replace(
        pilot,
        merging=inf if half is None else _size(whole.fluence - half.fluence) / size,
        rays=seconds - solving - casting + casting / effort(_ROUGH),
        solve=solving,
        steps=tuple(field.report.steps if field else 0 for field in (whole, half)),
    )


def _with_photons(pilot, whole, few, many, counts, size):
    """The `Pilot` with what two sets of photons tell, and how wrong the lattice is.

    counts  (2,) of photons
    size    as above
    """
    # Of one photon, were it alone.
    noise = _size(few.fluence - many.fluence) / size / sqrt(sum(1 / count for count in counts))
    short, long = (field.report.seconds["trace"] for field in (few, many))
    # There is much else that a trace takes time for.
    trace = max((long - short) / (counts[1] - counts[0]), long / counts[1] / 4)
    pilot = replace(pilot, noise=noise, trace=trace)
    if whole is None:
        return pilot
    off = [(whole.fluence - field.fluence).astype(float) for field in (few, many)]
    return replace(pilot, error=sqrt(max(float(np.vdot(*off)), 0.0)) / size)


def _unless_too_dark(solved, **changes):
    try:
        return solved(**changes)
    except MediumError:
        return None


def _of_usual(change):
    """The error of the usual number of rays, from what half of them change."""
    return change / hypot(1, _ROUGH**-EVENER)


def _size(grid):
    return float(np.linalg.norm(grid.astype(float)))


def _collisions(medium, single, field):
    """Mean number of a photon's collisions: what collides over what enters."""
    light = (field.fluence + single.direct).astype(float)
    colliding = medium.sigma_t[:, None, None, None] * medium.density * light
    entered = float(np.sum(field.report.energy["entered"])) or 1.0
    return float(colliding.sum()) * medium.voxel_size**3 / entered
