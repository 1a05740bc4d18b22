# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium solved in few voxels, in several ways, to see what its solve will take and be worth.

Only the box that holds all matter is solved, and light counts by what is seen of it (`seen`): so
empty air around a medium changes neither what is told nor how well.

Photons tell how wrong the lattice is: two sets of few are enough, as their noise is independent,
and drops out of the product of both differences.
"""

from dataclasses import dataclass, field, replace
from math import ceil, hypot, inf, prod, sqrt
from time import perf_counter

import numpy as np

from ...errors import MediumError
from .. import device as devices
from ..box import matter
from ..lattice.subdivision import wished_pieces
from ..lights.distant import FEW_VOXELS, Sky, Sun
from ..resample import Resampling
from ..solver import solve
from .visibility import mean_share, size, weights

MERGES = (1, 2, 4, 8)  # voxels along an edge that may be planned to be merged
_EDGE = 32  # voxels along the longest edge of the pilot
_PHOTONS = (20_000, 60_000)  # the more tell what each takes
_ALONE = 4  # times the second of these, where there is no lattice
_PROBES = 500  # photons that tell how often light collides, where no lattice does
_SHARP, _MORE = 0.02, 4  # targets up to this need so many times more to see the lattice's error
_CLOSE = 0.10  # targets up to this are compared with photons; the others with what is usual:
_USUAL = 0.065  # error of the lattice without photons, the most of docs/theory/physics.md
_FAR = 300  # collisions of a photon from which on the pilot's are handed over
_ROUGH, _ROUGHEST = 0.5, 0.25  # rays where these are not what is looked at
# What a pilot may take: collisions of photons (two cores do some 5 million a second), steps of a
# voxel of the lattice (some 40 million), and pieces of a voxel's edge; and so many times more for
# targets below _CLOSE.
_COLLISIONS, _VOXEL_STEPS, _PIECES, _LONGER = 6e6, 6e7, 2, 8
_FEWEST_STEPS = 48
EVENER = 1.3  # the power of rays along an edge that their error goes down with


@dataclass(frozen=True)
class Pilot:
    """What a solve in few voxels told. Errors are relative, of all light, as it is seen.

    edge        voxels along the longest edge, of the box that holds all matter
    share       of scattered light in all light
    mean        the same in the mean: by how much a picture is darker without it
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
    air         the work of unscattered light in the whole domain, over that in the box
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
    steps: tuple = (0, 0)
    trace: float = 0.0
    traced: float = inf
    noise: float = 0.0
    collisions: float = 0.0
    pieces: dict = field(default_factory=dict)
    air: float = 1.0


def fly(medium, lights, settings, target, device=None, cancel=None, *, thin=None, scattered=False):
    """The `Pilot` of a medium.

    settings  `Settings`: its model, and the tolerance
    target    relative error that is asked for
    thin      the share of scattered light where that needs no lattice to be known, or None
    The others are those of `planner.plan`. Raises what `solve` raises.
    """
    box = matter(medium, lights)
    whole, medium = medium, _within(medium, box)
    pieces = ceil(max(medium.shape) / _EDGE)
    small = medium if pieces == 1 else medium.merged(pieces)
    small_lights = Resampling(merge=pieces).lights([_shaded_within(light, box) for light in lights])
    small_lights = [_as_a_point(light) for light in small_lights]

    def solved(**changes):
        plain = {"scattering": "multiple", "rays": 1.0, "merge": 1, "handover": 0.0}
        changed = replace(settings, **plain | {"photons": None} | changes)
        return solve(small, small_lights, changed, device, cancel=cancel)

    rough = solved(scattering="single", rays=_ROUGH)  # first: it makes programs ready
    start = perf_counter()
    single = solved(scattering="single")
    once = perf_counter() - start
    weight = weights(small, surfaces=scattered)
    light = size(single.direct, weight)
    sampling = _of_usual(size(single.direct - rough.direct, weight) / (light or 1.0))
    if max(whole.shape) > FEW_VOXELS >= max(medium.shape):
        sampling *= 2**EVENER  # half of the rays along an edge are sent through so large a domain
    air = _air(whole.shape, medium.shape, lights)
    pilot = Pilot(max(small.shape), thin or 0.0, once, sampling=sampling, air=air)
    if thin is not None:
        return pilot
    pieces = {merge: _pieces(medium.merged(merge), settings) for merge in MERGES}
    pilot = replace(pilot, pieces={0: _pieces(small, settings), **pieces})
    is_slow = devices.choose(device).is_numpy
    flight = _Flight(small, weight, single, solved, target, _is_dark(medium), is_slow)
    pilot = flight.with_scattered(pilot)
    if scattered:
        # What few rays do to scattered light is in the error of the lattice.
        pilot = replace(pilot, sampling=0.0)
    missing = (prod(whole.shape) / prod(medium.shape)) ** (2 / 3)  # photons that meet no matter
    return replace(pilot, noise=pilot.noise * sqrt(missing), trace=pilot.trace / missing)


def effort(rays):
    """Seconds that rays take, over those of the usual number: few hardly fill a device (measured
    in media of 32^3 voxels in a sky: .47 for half of them along an edge)."""
    return rays**2 if rays >= 1 else 0.3 + 0.7 * rays**2


def work_of_rays(edge):
    """The work of rays, in units of one's way through a voxel; see `physical`."""
    return edge**3 * (4 if edge <= FEW_VOXELS else 1)


def _within(medium, box):
    """The medium in a `Box` of its voxels."""
    if box.is_whole:
        return medium
    origin = np.add(medium.origin, np.multiply(box.lower, medium.voxel_size))
    names = ("density", "emission", "occlusion", "occlusion_albedo")
    grids = {name: box.of(getattr(medium, name)) for name in names}
    return medium.altered(origin=tuple(origin), **grids)


def _shaded_within(light, box):
    shadow = getattr(light, "shadow_density", None)
    return light if shadow is None else replace(light, shadow_density=box.of(shadow))


def _air(whole, box, lights):
    """How much more work unscattered light is in a domain than in a box (shapes) in it: rays of
    suns and skies begin and end there, those of lamps cross all of it."""
    work = [work_of_rays(max(shape)) / max(shape) ** 3 for shape in (whole, box)]
    if all(isinstance(light, (Sun, Sky)) for light in lights):
        return work[0] / work[1]
    return prod(whole) * work[0] / (prod(box) * work[1])


def _pieces(medium, settings):
    """In how many pieces voxels are divided; in one where they are too dark for any number."""
    if settings.divide:
        return settings.divide
    try:
        return wished_pieces(medium)[0]
    except MediumError:
        return 1


def _is_dark(medium):
    """Whether voxels are too dark for the lattice, in however many pieces."""
    try:
        wished_pieces(medium)
    except MediumError:
        return True
    return False


def _as_a_point(light):
    return replace(light, radius=0.0) if getattr(light, "radius", 0) else light


@dataclass
class _Flight:
    """Ways to solve a medium of few voxels.

    weight   see `seen.weights`
    single   the `Field` of unscattered light
    solved   a function that solves the medium, and takes changes of `Settings`
    target   relative error
    is_dark  whether the lattice cannot be used in the voxels that it is planned for either
    is_slow  whether photons take many times as long as they do by OpenCL
    """

    medium: object
    weight: np.ndarray
    single: object
    solved: object
    target: float
    is_dark: bool
    is_slow: bool

    @property
    def patience(self):
        """How many times longer a pilot may take where the target is tight."""
        return 1 if self.target >= _CLOSE else _LONGER

    def with_scattered(self, pilot):
        """The `Pilot` with all that scattered light tells."""
        pieces = pilot.pieces[0]
        half = self._lattice(pieces, merge=2)
        start = perf_counter()
        whole = self._lattice(pieces)
        seconds = perf_counter() - start
        few = many = None
        is_close = self.target < _CLOSE or (self.target == _CLOSE and not self.is_slow)
        if whole is None or is_close:
            pilot, few, many, counts = self._traced(pilot, whole)
        best = many if whole is None else whole
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
        return pilot if few is None else self._with_photons(pilot, whole, few, many, counts, light)

    def _lattice(self, pieces, **changes):
        """The `Field` of the lattice, stepped as far as a pilot may take; None where it cannot be
        in the pilot's voxels, or would have to be divided in too many."""
        if pieces > _PIECES * (1 if self.patience == 1 else 2):
            return None
        try:
            return self.solved(rays=_ROUGH, most_steps=self._most_steps(pieces), **changes)
        except MediumError:
            return None

    def _most_steps(self, pieces):
        voxels = self.medium.density.size * pieces**3 * self._runs
        return max(_FEWEST_STEPS, int(_VOXEL_STEPS * self.patience / voxels))

    @property
    def _runs(self):
        return max(self.single.report.runs, 1)

    def _traced(self, pilot, whole):
        """(the `Pilot` with how far photons went, the `Field`s of few and of many, their
        numbers)."""
        probe = whole
        if whole is None:
            probe = self.solved(handover=inf, photons=_PROBES, rays=_ROUGHEST)
        collisions = self._collisions(probe)
        # To their end, where that is not far: a lattice that takes over has an error, too.
        if whole is not None and whole.report.converged and collisions > _FAR:
            pilot = replace(pilot, traced=4.0)
            of_one = 1 / (1 - float((self.medium.albedo * self.medium.g).max()))
            collisions = min(collisions, 1 + 4.0 * of_one)
        counts = [n * (_MORE if self.target <= _SHARP else 1) for n in _PHOTONS]
        if whole is None:  # what they take counts, as nothing else is left
            counts[1] *= _ALONE
        allowed = _COLLISIONS * self.patience / (max(collisions, 1.0) * self._runs * sum(counts))
        counts = [
            round(max(_PROBES, counts[0] * min(allowed, 1.0)) * n / counts[0]) for n in counts
        ]
        traced = {"handover": pilot.traced, "rays": _ROUGHEST}
        traced["most_steps"] = self._most_steps(pilot.pieces[0])
        few, many = (
            self.solved(seed=seed, photons=count, **traced) for seed, count in enumerate(counts)
        )
        return pilot, few, many, counts

    def _with_lattice(self, pilot, half, whole, seconds, light):
        """The `Pilot` with what the lattice takes, and what merging its voxels costs.

        half, whole  its `Field`s, the first in merged voxels, or None
        seconds      that the whole one took
        light        its size, which errors are relative to
        """
        solving, casting = (whole.report.seconds.get(name, 0.0) for name in ("solve", "direct"))
        off = inf if half is None else size(whole.fluence - half.fluence, self.weight) / light
        return replace(
            pilot,
            # Of what is still to come too, where it was not stepped to its end.
            error=hypot(_USUAL, 0.0 if whole.report.converged else whole.report.residual),
            merging=off,
            rays=seconds - solving - casting + casting / effort(_ROUGH),
            solve=solving,
            steps=tuple(field.report.steps if field else 0 for field in (whole, half)),
        )

    def _with_finer_lattice(self, pilot):
        """The `Pilot` where its voxels are too dark for the lattice, but not those that it is
        planned for: it takes a few steps, to see how long that is."""
        start = perf_counter()
        tried = self.solved(divide=1, most_steps=_FEWEST_STEPS, rays=_ROUGH)
        solving = tried.report.seconds.get("solve", 0.0)
        rest = perf_counter() - start - solving
        steps = tried.report.steps
        pieces = pilot.pieces | {0: 1}
        return replace(
            pilot, error=_USUAL, rays=rest, solve=solving, steps=(steps, steps), pieces=pieces
        )

    def _with_photons(self, pilot, whole, few, many, counts, light):
        """The `Pilot` with what two sets of photons tell, and how wrong the lattice is.

        counts  (2,) of photons
        light   as above
        """
        # Of one photon, were it alone.
        between = size(few.fluence - many.fluence, self.weight) / light
        noise = between / sqrt(sum(1 / count for count in counts))
        short, long = (field.report.seconds["trace"] for field in (few, many))
        # There is much else that a trace takes time for.
        trace = max((long - short) / (counts[1] - counts[0]), long / counts[1] / 4)
        pilot = replace(pilot, noise=noise, trace=trace)
        if whole is None:
            return pilot
        one, other = ((whole.fluence - field.fluence).astype(float) for field in (few, many))
        squared = float(np.vdot(self.weight * one, other)) / light**2
        # What noise leaves unknown of it, where that is even over the voxels.
        seen = self.weight.sum() ** 2 / (np.vdot(self.weight, self.weight) or 1.0)
        unknown = noise**2 / sqrt(counts[0] * counts[1] * max(seen, 1.0))
        found = sqrt(max(squared, 0.0) + unknown)
        # Where that is lost in noise it is taken to be no more than usual.
        return replace(pilot, error=found if squared > 2 * unknown else min(found, pilot.error))

    def _collisions(self, field):
        """Mean number of a photon's collisions: what collides over what enters."""
        light = (field.fluence + self.single.direct).astype(float)
        colliding = self.medium.sigma_t[:, None, None, None] * self.medium.density * light
        entered = float(np.sum(field.report.energy["entered"])) or 1.0
        return float(colliding.sum()) * self.medium.voxel_size**3 / entered


def _of_usual(change):
    """The error of the usual number of rays, from what half of them change."""
    return change / hypot(1, _ROUGH**-EVENER)
