# SPDX-License-Identifier: GPL-3.0-or-later
"""Photon tracing with the free path samplers: the reference for the lattice.

Each photon carries a weight, which absorption lowers, and scatters by the Henyey-Greenstein phase
function. Its path is scored at points a fixed length apart; the position of the first is random.
The expected score of a voxel is therefore the length of all paths in it: a track length estimator.
It is unbiased in any density, including vacuum. Unlike scores at each voxel's border, it costs
nothing in voxels that a path crosses between two points.

An opaque voxel stops arriving light at its border; the probability is its occlusion. It reflects a
share of it, its albedo, as scattered light with a cosine distribution (Lambert). Light that leaves
it passes freely: where everything is white, a voxel holds the share 1 - occlusion of the light.
"""

from collections.abc import Iterable, Sequence
from math import prod

import numpy as np

from ...arrays import Floats
from ...errors import MediumError, SettingsError, require_whole
from .. import device as devices
from ..backend import backend_of
from ..device import Device
from ..field import Clock, Field, PhotonReport
from ..lights.base import Light
from ..medium import Medium
from ..memory import DOUBLE, FLOAT, Footprint, require_memory
from ..monitor import Cancel, Monitor, Progress
from . import tallies
from .estimates import Estimates
from .free_path import MOST_STEPS, path_grid
from .path_grid import PathGrid, enter
from .perlin import PerlinMedium
from .schedule import AT_ONCE, COPIES, Run, batches_of, runs_of
from .tallies import Opaque, Selection

_CLOSEST = 0.01  # voxels between two scores; closer ones might not advance in float32
_AT_BORDER = 1e-6  # voxels from the domain's face, where light from outside begins
_TALLIED = 128  # default voxels along an edge of the tallies of a medium without voxels


def trace(
    medium: Medium | PerlinMedium,
    lights: Iterable[Light],
    photons: int,
    sampler: str = "supervoxel_linear",
    seed: int = 0,
    device: Device | str | None = None,
    *,
    handover: int | None = None,
    interpolation: str = "constant",
    supervoxel: int | None = None,
    tallied: int | None = None,
    spacing: float = 1.0,
    direct: bool = True,
    flux: bool = True,
    most_steps: int = MOST_STEPS,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
) -> Field:
    """Light a medium by tracing photons.

    medium         surrounded by vacuum. Its emission is one of the lights; the caller handles its
                   shift between bands
    lights         see `Light`
    photons        for each distinct band, shared among the lights by power
    sampler        one of free_path.SAMPLERS
    seed           0 to 2^32 - 1; on a given device, a seed always gives the same field
    device         None for the best, or part of the label of one of `device.devices()`
    handover       the collision at which a photon ends and becomes a collision source for a
                   lattice; None for never. Reflections by opaque voxels do not count
    interpolation  of a Medium's density: "constant" in voxels, or "linear" between their centres
    supervoxel     voxels along the edge of a super-voxel; None for the cheapest size
    tallied        voxels along an edge of the field of a PerlinMedium; None for up to 128
    spacing        voxels between two scores of a path: larger is faster and noisier
    direct         whether to tally uncollided light. Without it, each photon starts four paths
    flux           whether to tally the flux: a score then takes four additions instead of one
    most_steps     steps after which a path is abandoned
    progress       called as progress(stage, fraction) with the fraction from 0 to 1
    cancel         called without arguments; if it returns true, tracing raises `Cancelled`
    Returns a `Field` with variance, in W/m^2. Raises MediumError, LightError, SettingsError,
    DeviceError, or SolverError where the density exceeds its majorant, which would bias the result.
    Source: paper 2 for the paths; equation 1 of paper 1 for what they solve.
    """
    _refuse_unfit(medium, photons, handover, interpolation, spacing, seed, most_steps)
    selection = direct, flux, handover is not None
    tracer = _Tracer(medium, selection, tallied, device, most_steps, spacing, handover or 0, seed)
    tracer.prepare(lights, photons, sampler, interpolation, supervoxel)
    return tracer.run(Monitor(progress, cancel))


class _Tracer:
    """One call of `trace`: prepares it and traces all runs."""

    def __init__(
        self,
        medium: Medium | PerlinMedium,
        selection: Selection,
        tallied: int | None,
        device: Device | str | None,
        most_steps: int,
        spacing: float,
        last: int,
        seed: int,
    ) -> None:
        self.clock = Clock()
        self.medium, self.selection, self.seed = medium, selection, seed
        self.most_steps, self.spacing, self.last = most_steps, spacing, last
        self.shape = _tally_shape(medium, tallied)
        self.device = devices.choose(device)

    def prepare(
        self,
        lights: Iterable[Light],
        photons: int,
        sampler: str,
        interpolation: str,
        supervoxel: int | None,
    ) -> None:
        """Make the majorants and the schedule. DeviceError if there is too little memory."""
        medium, shape = self.medium, self.shape
        with self.clock("prepare"):
            # Check twice: the device makes the majorants, and their size is known only afterwards.
            self._require_memory(None)
            self.grid = path_grid(medium, sampler, interpolation, supervoxel, self.device)
            self.bytes = self._require_memory(self.grid)
            self.batches = batches_of(photons, prod(shape))
            copies = 1 if self.selection[0] else COPIES
            self.runs = runs_of(medium, lights, photons, self.batches, copies, self.seed)
            fine = self.grid.fine
            self.per_cell = shape[0] / (fine.upper[0] - fine.lower)
            self.paths = backend_of(self.device).paths(self.grid)
            self.estimates = Estimates(medium, shape, self.selection, self.batches)

    def run(self, monitor: Monitor) -> Field:
        """Trace all runs and return their `Field`."""
        spacing = self.spacing / self.per_cell * self.medium.voxel_size
        for number, run in enumerate(self.runs):
            of_run = monitor.part(number / len(self.runs), 1 / len(self.runs))
            with self.clock("trace"):
                at_border = self._trace(run, of_run)
            with self.clock("read"):
                self.estimates.add(run, self.paths.read_tallies(), at_border, spacing)
        report = PhotonReport(
            model="photons",
            device=self.device.label,
            seconds=self.clock.seconds,
            bytes=self.bytes,
            runs=len(self.runs),
            **self.estimates.facts(),
        )
        return self.estimates.field(report)

    def _require_memory(self, grid: PathGrid | None) -> int:
        def footprint(shape: Sequence[int]) -> Footprint:
            return _footprint(shape, self.medium, self.selection, grid)

        return require_memory(self.device, self.shape, footprint)

    def _trace(self, run: Run, monitor: Monitor) -> Floats:
        """Trace a run batch by batch.

        Returns (SUMS,): the light that opaque voxels at the domain's faces stop before tracing.
        """
        opaque = _opaque(self.medium, run.band)
        fine = self.grid.fine
        self.paths.start_tallies(self.shape, fine.lower, self.per_cell, self.selection, opaque)
        at_border = np.zeros(tallies.SUMS)
        for batch in range(self.batches):
            at_border += self._trace_batch(run, batch, opaque, monitor)
            self.paths.take_batch(batch + 1)
            monitor.report("trace", (batch + 1) / self.batches)
        return at_border

    def _trace_batch(self, run: Run, batch: int, opaque: Opaque | None, monitor: Monitor) -> Floats:
        """Trace the photons of one batch. Returns the same as `_trace`."""
        photons = self._emit(run, batch)
        # Voxels at the domain's faces stop their share of the light from outside.
        sums = np.zeros(tallies.SUMS) if opaque is None else _stop_at_border(photons, *opaque)
        photons = _lighter(photons[:, photons[6] > 0]).astype(np.float32)
        stream = np.random.SeedSequence([self.seed, run.number, batch]).generate_state(1)[0]
        at_once = AT_ONCE // run.copies
        for first in range(0, photons.shape[1], at_once):
            monitor.check()
            self.paths.trace_photons(
                np.ascontiguousarray(photons[:, first : first + at_once]),
                run.copies,
                first * run.copies,
                self.grid.per_depth(run.band),
                stream,
                self.most_steps,
                (self.medium.albedo[run.band], self.medium.g[run.band]),
                self.spacing / self.per_cell,
                self.last,
            )
        return run.copies * sums

    def _emit(self, run: Run, batch: int) -> Floats:
        """(7, n) photons: points of entry in fine cells, directions, weights."""
        rng = np.random.default_rng([self.seed, 1, run.number, batch])
        origins, directions, power = run.light.emit(run.photons, self.medium, rng, run.band)
        _, points, hit = enter(self.grid, origins, directions)
        hit &= power > 0
        weight = power / (run.copies * run.power)
        return np.concatenate([points.T, directions.T, weight[None]])[:, hit]


def _refuse_unfit(
    medium: Medium | PerlinMedium,
    photons: int,
    handover: int | None,
    interpolation: str,
    spacing: float,
    seed: int,
    most_steps: int,
) -> None:
    require_whole(photons, "number of photons", 1, 2**40)
    require_whole(seed, "seed", 0, 2**32 - 1)
    if handover is not None:
        require_whole(handover, "collision of the handover", 1, 2**31 - 1)
    require_whole(most_steps, "number of steps", 1, 2**31 - 1)
    if not _CLOSEST <= spacing < np.inf:
        raise SettingsError(
            f"The spacing of scores must be {_CLOSEST} voxels or more; it is {spacing}."
        )
    if medium.occlusion is not None and interpolation != "constant":
        raise MediumError(
            "Opaque voxels stop light at their borders, where an interpolated density has none; "
            'use the interpolation "constant", or leave the occlusion out.'
        )


def _opaque(medium: Medium | PerlinMedium, band: int) -> Opaque | None:
    """(occlusion, its albedo in a band), (nx, ny, nz) float32 each; None without opaque voxels."""
    if medium.occlusion is None or medium.occlusion_albedo is None:
        return None
    albedo = np.broadcast_to(medium.occlusion_albedo[band], medium.shape)
    return medium.occlusion, np.ascontiguousarray(albedo)


def _tally_shape(medium: Medium | PerlinMedium, tallied: int | None) -> tuple[int, ...]:
    if not isinstance(medium, PerlinMedium):
        return medium.shape
    edge = min(_TALLIED, medium.resolution) if tallied is None else tallied
    require_whole(edge, "field's number of voxels along an edge", 1, medium.resolution)
    return (edge,) * 3


def _footprint(
    shape: Sequence[int],
    medium: Medium | PerlinMedium,
    selection: Selection,
    grid: PathGrid | None = None,
) -> Footprint:
    """The memory of a trace into `shape` voxels, with that of the grid if there is one."""
    voxels, kinds = prod(shape), tallies.kinds(*selection)
    names = ("uncollided light", "scattered light", "collision source")
    buffers = {name: DOUBLE * n * voxels for name, n in zip(names, kinds, strict=True)}
    buffers["scattered light before"], buffers["variance"] = DOUBLE * voxels, FLOAT * voxels
    if medium.occlusion is not None:
        buffers["opaque voxels"] = 8 * voxels
    if grid is not None and not grid.procedural:
        buffers["density"] = grid.fine.values.nbytes
    if grid is not None and grid.majorants is not None:
        buffers["majorants"] = grid.majorants.values.nbytes
    arrays = {
        "field": medium.bands * (sum(kinds) + 1) * FLOAT * voxels,
        "work": (sum(kinds) + 2 * max(kinds)) * FLOAT * voxels,
        "photons": 4 * 7 * DOUBLE * AT_ONCE,
    }
    return Footprint(buffers, arrays)


def _stop_at_border(photons: Floats, occlusion: Floats, albedo: Floats) -> Floats:
    """Subtract from photons (7, n) from outside the weight that their first voxel stops.

    Reflected light leaves the domain at once, so nothing is sampled: each photon loses its share.
    Returns (SUMS,) of the stopped light.
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


def _lighter(photons: Floats) -> Floats:
    """Photons (7, n), with those too heavy for the tallies split into several."""
    pieces = np.maximum(1, np.ceil(photons[6] / tallies.HEAVIEST)).astype(int)
    if pieces.max(initial=1) == 1:
        return photons
    photons[6] /= pieces
    return np.repeat(photons, pieces, axis=1)
