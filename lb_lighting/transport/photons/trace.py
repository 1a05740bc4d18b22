# SPDX-License-Identifier: GPL-3.0-or-later
"""Photon tracing on the free path samplers: the reference that the lattice is held to.

A photon carries a weight, which absorption lowers, and scatters by Henyey and Greenstein's phase
function. Its path is scored at points a fixed length apart, the first at random, so that a voxel's
score is in expectation the length of all paths in it: a track length estimator. It is unbiased in
any density, in voids too, where nothing collides; and unlike a score at each voxel's border it
costs nothing in voxels that a path just passes between two points.

Opaque voxels stop what arrives at their borders with the probability of their occlusion, and send
the share of their albedo back by the cosine (Lambert), as scattered light. What leaves a voxel is
not hindered by its own: so where all is white, a voxel holds the share 1 - occlusion of the light.
"""

from dataclasses import dataclass
from math import prod

import numpy as np

from ...errors import (
    MediumError,
    SettingsError,
    require_whole,
)
from .. import device as devices
from ..backend import backend_of
from ..field import (
    Clock,
    Field,
    Handed,
    PhotonReport,
)
from ..lights.base import darkness, multiple
from ..lights.emission import Emission
from ..medium import Domain
from ..memory import Footprint, require_memory
from ..monitor import Monitor
from . import tallies
from .free_path import (
    MOST_STEPS,
    enter,
    path_grid,
    refuse_violations,
)
from .perlin import PerlinMedium

# Of equal size; their spread gives the variance, from 32 to a quarter of itself. Fewer, where the
# photons are so few beside the voxels that going through these after each batch would take longer.
_FEWEST_BATCHES, _MOST_BATCHES, _PHOTONS_A_VOXEL = 8, 32, 1 / 128
_AT_ONCE = 2**18  # photons, at most, that a light emits, and between two looks at `cancel`
_PROBE = 1024  # photons that tell how bright a light is
_CLOSEST = 0.01  # voxels between two scores; closer ones might not move on in float32
# Paths of a photon, where direct light is not wanted: drawing it takes as long as some collisions.
_COPIES = 4
_AT_BORDER = 1e-6  # voxels from the domain's face, where light from outside begins
_TALLIED = 128  # voxels along an edge of the tallies of a medium without voxels


@dataclass(frozen=True)
class _Run:
    """One tracing: a light, a band, and the bands that are multiples of it."""

    light: object
    number: int
    band: int
    multiples: dict
    photons: int  # that the light sends in a batch
    copies: int  # paths of each photon
    power: float  # W of a path of weight 1


def trace(
    medium,
    lights,
    photons,
    sampler="supervoxel_linear",
    seed=0,
    device=None,
    *,
    handover=None,
    interpolation="constant",
    supervoxel=None,
    tallied=None,
    spacing=1.0,
    direct=True,
    flux=True,
    most_steps=MOST_STEPS,
    progress=None,
    cancel=None,
):
    """Light a medium by tracing photons.

    medium         `Medium` or `PerlinMedium`; outside is vacuum. Its emission is a light, too.
                   Its shift between bands is left to who knows all bands' absorbed light
    lights         lights of `lights.py`, or anything with their `spectrum` and `emit`
    photons        how many to trace for each band that differs from the others, shared out
                   among the lights by power
    sampler        one of free_path.SAMPLERS
    seed           0 to 2^32 - 1; on a given device, a seed always gives the same field
    device         None for the best, or part of the label of one of `device.devices()`
    handover       the collision at which a photon is not scattered but handed over, with the
                   place and direction that a lattice needs to go on with it; None for never.
                   Reflections by opaque voxels do not count
    interpolation  of a Medium's density: "constant" in voxels, or "linear" between their centres
    supervoxel     voxels along the edge of a super-voxel; None for the size that is cheapest
    tallied        voxels along an edge of the field of a PerlinMedium; None for 128 at most.
                   That of a Medium has the medium's voxels
    spacing        voxels of the field between two scores of a path: larger is faster, noisier
    direct         whether to find light that has neither collided nor been reflected, too. If not,
                   each photon begins four paths, which saves much of the time of short ones
    flux           whether to find the field's flux, too: a score is four additions then, not one
    most_steps     of a path, before it is given up
    progress       called as progress(stage, fraction) with fraction from 0 to 1
    cancel         called without arguments; tracing ends with `Cancelled` where it returns true
    Returns a `Field` with variance, in W/m^2; `handed` is set where there is a hand-over.
    Raises MediumError, LightError, SettingsError, DeviceError, or SolverError for a bound that
    does not hold, which would be a bias.
    Source: paper 2 for the paths; equation 1 of paper 1 for what they solve.
    """
    _refuse_unfit(medium, photons, handover, interpolation, spacing, seed, most_steps)
    clock, monitor = Clock(), Monitor(progress, cancel)
    with clock("prepare"):
        used = devices.choose(device)
        shape = _tally_shape(medium, tallied)
        wanted = direct, flux, handover is not None
        # Twice: the device works for the bound already, and how large that is shows only then.
        require_memory(used, shape, lambda s: _plan(s, medium, wanted))
        grid = path_grid(medium, sampler, interpolation, supervoxel, used)
        needed = require_memory(used, shape, lambda s: _plan(s, medium, wanted, grid))
        batches = _batches(photons, prod(shape))
        runs = _runs(medium, lights, photons, batches, 1 if direct else _COPIES, seed)
        per_cell = shape[0] / (grid.fine.upper[0] - grid.fine.lower)
        paths = backend_of(used).paths(grid)
        result = _Result(medium, shape, wanted, batches)

    for number, run in enumerate(runs):
        with clock("trace"):
            opaque = _opaque(medium, run.band)
            paths.start_tallies(shape, grid.fine.lower, per_cell, wanted, opaque)
            at_border = np.zeros(tallies.SUMS)
            for batch in range(batches):
                options = (most_steps, spacing / per_cell, handover or 0)
                at_border += _trace_batch(paths, run, batch, seed, options, monitor)
                paths.take_batch(batch + 1)
                monitor.report("trace", (number + (batch + 1) / batches) / len(runs))
        with clock("read"):
            *found, sums = paths.read_tallies()
            result.add(run, *found, sums + at_border, spacing / per_cell * medium.voxel_size)

    report = PhotonReport(
        model="photons",
        device=used.label,
        seconds=clock.seconds,
        bytes=needed,
        runs=len(runs),
        **result.facts(),
    )
    return result.field(report)


def _refuse_unfit(medium, photons, handover, interpolation, spacing, seed, most_steps):
    require_whole(photons, "number of photons", 1, 2**40)
    require_whole(seed, "seed", 0, 2**32 - 1)
    if handover is not None:
        require_whole(handover, "collision at which photons are handed over", 1, 2**31 - 1)
    require_whole(most_steps, "number of steps", 1, 2**31 - 1)
    if not _CLOSEST <= spacing < np.inf:
        raise SettingsError(
            f"The spacing of scores must be {_CLOSEST} voxels or more; it is {spacing}."
        )
    if _has_opaque(medium) and interpolation != "constant":
        raise MediumError(
            "Opaque voxels stop light at their borders, where an interpolated density has none; "
            'use the interpolation "constant", or leave the occlusion out.'
        )


def _has_opaque(medium):
    return getattr(medium, "occlusion", None) is not None


def _opaque(medium, band):
    """(occlusion, its albedo in a band), (nx, ny, nz) float32 each; None where there is none."""
    if not _has_opaque(medium):
        return None
    albedo = np.broadcast_to(medium.occlusion_albedo[band], medium.shape)
    return medium.occlusion, np.ascontiguousarray(albedo)


def _tally_shape(medium, tallied):
    if not isinstance(medium, PerlinMedium):
        return medium.shape
    edge = min(_TALLIED, medium.resolution) if tallied is None else tallied
    require_whole(edge, "field's number of voxels along an edge", 1, medium.resolution)
    return (edge,) * 3


def _batches(photons, voxels):
    worth_it = int(photons / (_PHOTONS_A_VOXEL * voxels))
    batches = min(photons, max(_FEWEST_BATCHES, min(worth_it, _MOST_BATCHES)))
    return max(batches, -(-photons // _AT_ONCE))


def _plan(shape, medium, wanted, grid=None):
    """The `Footprint` of a trace into `shape` voxels."""
    voxels, kinds = prod(shape), tallies.kinds(*wanted)
    names = ("direct", "scattered", "handed")
    plan = {f"{name} light": 8 * n * voxels for name, n in zip(names, kinds, strict=True)}
    plan["scattered light before"], plan["variance"] = 8 * voxels, 4 * voxels
    if _has_opaque(medium):
        plan["opaque voxels"] = 8 * voxels
    if grid is not None and not grid.procedural:
        plan["density"] = grid.fine.values.nbytes
    if grid is not None and grid.bound is not None:
        plan["bound"] = grid.bound.values.nbytes
    arrays = {
        "field": medium.bands * (sum(kinds) + 1) * 4 * voxels,
        "work": (sum(kinds) + 2 * max(kinds)) * 4 * voxels,
        "photons": 4 * 7 * 8 * _AT_ONCE,
    }
    return Footprint(plan, arrays)


def _runs(medium, lights, photons, batches, copies, seed):
    """The `_Run`s that a medium and its lights need: those that differ, and are not dark."""
    lights = list(lights)
    if getattr(medium, "emission", None) is not None:
        lights.append(Emission(medium))
    runs = []
    for band, multiples in _distinct(medium, lights):
        probes = [_probe(light, medium, band, seed) for light in lights]
        whole = sum(probe.sum() for probe in probes)
        for number, (light, probe) in enumerate(zip(lights, probes, strict=True)):
            if probe.any():
                count = max(1, round(photons * probe.sum() / whole / (batches * copies)))
                power = float(probe.max()) * _PROBE / (count * copies)
            elif callable(light.spectrum):  # all that is bright may lie between the probe's photons
                count = max(1, photons // (len(lights) * batches * copies))
                power = 1 / (count * copies)
            else:
                continue
            runs.append(_Run(light, number, band, multiples[number], count, copies, power))
    if not runs:
        raise darkness(lights)
    return runs


def _distinct(medium, lights):
    """[(band, [{band: its multiple} of each light])]: bands that are alike are traced once."""
    distinct = []
    for band in range(medium.bands):
        for base, multiples in distinct:
            optics = [medium.sigma_s, medium.sigma_a, medium.g]
            if _has_opaque(medium):
                optics.append(medium.occlusion_albedo)
            alike = all(np.array_equal(v[band], v[base]) for v in optics)
            factors = [multiple([light], medium, band, base) for light in lights]
            if alike and None not in factors:
                for bands, factor in zip(multiples, factors, strict=True):
                    bands[band] = factor
                break
        else:
            distinct.append((band, [{band: 1.0} for _ in lights]))
    return distinct


def _probe(light, medium, band, seed):
    """(_PROBE,) W of as many photons of a light: how bright it is."""
    return light.emit(_PROBE, medium, np.random.default_rng([seed, 0]), band)[2]


def _trace_batch(paths, run, batch, seed, options, monitor):
    """Trace the photons of one batch; options are the last arguments of the paths' own method.

    Returns (SUMS,) of what opaque voxels at the domain's faces let nobody trace.
    """
    grid, medium = paths.grid, paths.grid.medium
    rng = np.random.default_rng([seed, 1, run.number, batch])
    origins, directions, power = run.light.emit(run.photons, medium, rng, run.band)
    _, points, hit = enter(grid, origins, directions)
    hit &= power > 0
    weight = power / (run.copies * run.power)
    photons = np.concatenate([points.T, directions.T, weight[None]])[:, hit]
    opaque = _opaque(medium, run.band)
    sums = np.zeros(tallies.SUMS) if opaque is None else _stop_at_border(photons, *opaque)
    photons = _lighter(photons[:, photons[6] > 0]).astype(np.float32)
    stream = np.random.SeedSequence([seed, run.number, batch]).generate_state(1)[0]
    at_once = _AT_ONCE // run.copies
    for first in range(0, photons.shape[1], at_once):
        monitor.check()
        most_steps, spacing, last = options
        paths.trace_photons(
            np.ascontiguousarray(photons[:, first : first + at_once]),
            run.copies,
            first * run.copies,
            grid.per_depth(run.band),
            stream,
            most_steps,
            (medium.albedo[run.band], medium.g[run.band]),
            spacing,
            last,
        )
    return run.copies * sums


def _stop_at_border(photons, occlusion, albedo):
    """Take from photons (7, n) that come from outside what the first voxel stops; (SUMS,) of it.

    What is reflected there leaves at once, so that nothing is drawn: all lose their share.
    """
    points, directions, weight = photons[:3], photons[3:6], photons[6]
    shape = np.reshape(occlusion.shape, (3, 1))
    forward = directions >= 0
    distance = np.where(forward, points, shape - points)
    axis = distance.argmin(axis=0)
    outside = distance.min(axis=0) < _AT_BORDER
    voxel = tuple(np.clip(points.astype(int), 0, shape - 1))
    stopped = np.where(outside, weight * occlusion[voxel], 0)
    photons[6] -= stopped
    reflected = stopped * albedo[voxel]
    face = 2 * axis + ~forward[axis, np.arange(len(axis))]
    sums = np.zeros(tallies.SUMS)
    sums[tallies.ABSORBED] = (stopped - reflected).sum()
    sums[tallies.LEFT_THROUGH : tallies.LEFT_THROUGH + 6] = np.bincount(face, reflected, 6)
    return sums


def _lighter(photons):
    """Photons (7, n) with those that are too heavy for the tallies divided into several."""
    pieces = np.maximum(1, np.ceil(photons[6] / tallies.HEAVIEST)).astype(int)
    if pieces.max(initial=1) == 1:
        return photons
    photons[6] /= pieces
    return np.repeat(photons, pieces, axis=1)


class _Result:
    """Adds up what the runs of a trace found."""

    def __init__(self, medium, shape, wanted, batches):
        _, flux, handed = wanted
        edge = medium.voxel_size * medium.shape[0] / shape[0]
        self.domain = Domain(medium.origin, edge, shape)
        self.batches = batches
        bands = medium.bands
        self.fluence, self.direct, self.variance = (
            np.zeros((bands, *shape), np.float32) for _ in range(3)
        )
        self.flux = np.zeros((bands, 3, *shape), np.float32) if flux else None
        self.handed = Handed.empty(bands, shape) if handed else None
        self.energy = np.zeros((bands, tallies.LOST_PHOTONS))  # W
        self.collisions = np.zeros(bands, int)
        self.photons = self.lost = 0

    def add(self, run, direct, scattered, handed, deviation, sums, spacing):
        """What a run scored, as the paths' read_tallies returns it; spacing in m."""
        refuse_violations(int(sums[tallies.VIOLATIONS]))
        self.photons += run.photons * run.copies * self.batches
        self.lost += int(sums[tallies.LOST_PHOTONS])
        edge, shape = self.domain.voxel_size, self.domain.shape
        direct, scattered, handed = (v.T.reshape(-1, *shape) for v in (direct, scattered, handed))
        # Of the mean of the batches; one batch says nothing of it.
        spread = self.batches / (self.batches - 1) if self.batches > 1 else np.inf
        for band, factor in run.multiples.items():
            power = factor * run.power / self.batches
            self.energy[band] += power * sums[: tallies.LOST_PHOTONS]
            self.collisions[band] += int(sums[tallies.COLLISIONS])
            scale = np.float32(power * spacing / edge**3)  # length of paths in 1 m^3
            self.direct[band] += scale * direct.sum(axis=0)  # 0 where it is not wanted
            self.fluence[band] += scale * scattered[tallies.WEIGHT]
            with np.errstate(invalid="ignore"):  # of one batch alone
                self.variance[band] += scale**2 * spread * deviation.reshape(shape)
            if self.flux is not None:
                self.flux[band] += scale * _signed(scattered, tallies.FLUX, tallies.WEIGHT)
            if self.handed is not None:
                self._add_handed(band, power, handed)

    def _add_handed(self, band, power, tally):
        self.handed.power[band] += power * tally[tallies.POWER]
        place = _signed(tally, tallies.POSITION, tallies.POWER)
        self.handed.position[band] += power * self.domain.voxel_size * place
        self.handed.direction[band] += power * _signed(tally, tallies.DIRECTION, tallies.POWER)

    def facts(self):
        """What the report has of it."""
        energy = {
            "absorbed": self.energy[:, tallies.ABSORBED],
            "left": self.energy[:, tallies.LEFT_THROUGH : tallies.LEFT_THROUGH + 6],
            "handed": self.energy[:, tallies.HANDED],
            "lost": self.energy[:, tallies.LOST],
        }
        return {
            "photons": self.photons,
            "lost": self.lost,
            "collisions": self.collisions,
            "energy": {"entered": self.energy.sum(axis=1), **energy},
        }

    def field(self, report):
        if self.batches == 1:
            self.variance[:] = np.inf
        return Field(
            self.domain, self.fluence, self.direct, self.flux, report, self.variance, self.handed
        )


def _signed(tally, first, weight):
    """(3, ...) of three tallies that hold weight times (1 + q) / 2: weight times q."""
    return 2 * tally[first : first + 3] - tally[weight]
