# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical model: light in SI units, split into what is exact and what the lattice carries.

Uncollided light follows exact rays. Light that collides on them, or photons after some collisions,
is the source of a lattice that carries scattered light alone. docs/theory/physics.md derives the
equations and says what they neglect.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, isinf, prod
from typing import TYPE_CHECKING

import numpy as np

from ..errors import DeviceError, LightError
from .backend import backend_of
from .band_light import BandLight, dark_field
from .bands import bands_to_solve, group_by_extinction
from .box import Box, matter
from .collision_source import (
    count_first_collisions,
    first_collisions,
    last_collisions,
)
from .context import Context
from .device import Device
from .field import Clock, Field
from .lattice.subdivision import wished_pieces
from .lights.base import Light, darkness
from .lights.emission import Emission
from .medium import Medium
from .memory import DOUBLE, FLOAT, Footprint, require_memory
from .monitor import Monitor
from .multiple_scattering import scatter
from .photons.trace import trace
from .reemission import add_reemission
from .resample import Resampling, combine
from .uncollided import casting

if TYPE_CHECKING:
    from .solver import Settings

_PHOTONS_A_VOXEL = 64
_FIELD = 1 + 1 + 3 + 3  # numbers a voxel and band: fluence, direct light, both fluxes
# Likewise of photons: fluence, direct light, flux, variance, collision source.
_TRACED = 1 + 1 + 3 + 1 + (1 + 3 + 3)
_TRACING, _CASTING = 0.5, 0.3  # shares of the progress: of photons; of rays in what follows


def solve(
    medium: Medium,
    lights: Sequence[Light],
    settings: "Settings",
    device: Device,
    clock: Clock,
    needed: int,
    monitor: Monitor,
) -> Field:
    """`solver.solve` by the physical model; needed is the memory of the solve in bytes."""
    _refuse_unfit(medium, lights)
    context = Context(settings, device, clock, monitor)

    # Scattered light may be solved in larger voxels; uncollided light keeps the medium's own.
    if settings.merge == 1 or medium.shift is not None or context.is_single:
        field = _solve_resampled(medium, lights, 1, context, needed)
    else:
        uncollided = _solve_resampled(medium, lights, 1, context.uncollided_only(), needed)
        scattered = _solve_resampled(medium, lights, settings.merge, context, needed)
        field = combine(uncollided, scattered, settings.merge)

    if not np.any(field.report.energy["entered"]):
        raise darkness(lights)
    # Not earlier: values below zero in one voxel balance values that are too large in others.
    np.maximum(field.fluence, 0, out=field.fluence)
    field.report.seconds = clock.seconds
    return field


def _solve_resampled(
    medium: Medium, lights: Sequence[Light], merge: int, context: Context, needed: int
) -> Field:
    """The `Field` in voxels of which `merge` along each edge are merged; voxels that are too thick
    for the lattice are divided for the solve."""
    merging = Resampling(merge=merge)
    medium, lights = merging.medium(medium), merging.lights(lights)
    pieces, needed = _pieces(medium, context.settings, context.device, len(lights), needed)
    division = Resampling(divide=pieces)
    medium, lights = division.medium(medium), division.lights(lights)
    field = _solve_bands(medium, lights, context)
    if medium.shift is not None:
        add_reemission(field, medium, lambda emitting: _solve_bands(emitting, [], context))
    field.report.bytes = needed
    return division.restored(field)


def _solve_bands(medium: Medium, lights: Sequence[Light], context: Context) -> Field:
    """The `Field` of the lights and the medium's emission, in the medium's voxels."""
    # Prepare: group the bands, crop empty space, trace photons up to their last collision.
    settings = context.settings
    sources = list(lights) if medium.emission is None else [*lights, Emission(medium)]
    last = 1 if context.is_single else _last_collision(medium, settings)
    bands, box = bands_to_solve(medium, sources, apart=last == 1), matter(medium, lights)
    traced = _trace(medium, lights, last, context) if last > 1 else None
    begin = _TRACING if traced else 0.0
    remaining = 1 - begin

    field = dark_field(medium, len(lights), context.device.label)
    field.report.runs = len(bands)
    for numbers, group, are_new in group_by_extinction(bands, medium.sigma_t):
        share = remaining * len(group) / len(bands)
        lit = {band: BandLight.dark(field, band, numbers, in_place=are_new) for band in group}
        shining = [sources[number] for number in numbers]
        _solve_group(medium, box, shining, traced, lit, context.part(begin, share))
        begin += share
        # Assemble: bands that are multiples of a solved one take its light.
        for band, multiples in group.items():
            for multiple, factor in multiples.items():
                lit[band].add_to(field, numbers, multiple, factor)
    field.report.converged = field.report.residual <= settings.tolerance
    if traced is not None:
        field.variance = traced.variance
    return field


def _solve_group(
    medium: Medium,
    box: Box,
    lights: Sequence[Light],
    traced: Field | None,
    lit: dict[int, BandLight],
    context: Context,
) -> None:
    """Light bands that share their rays, {band: `BandLight`}."""
    # Cast uncollided light, and collect the source of scattered light.
    monitor = context.monitor
    monitor.report("direct", 0.0)
    with context.clock("direct"):
        if context.is_single:
            count_first_collisions(medium, box, lights, lit, context)
            return
        if traced is None:
            sources = first_collisions(medium, box, lights, lit, context)
        else:
            sources = last_collisions(medium, box, lights, traced, lit, context)

    # Scatter it on the lattice, band by band.
    share = (1 - _CASTING) / len(lit)
    for number, (band, source) in enumerate(sources.items()):
        with context.clock("solve"):
            part = context.part(_CASTING + number * share, share)
            scatter(medium, band, source, lit[band], part)
    monitor.report("solve", 1.0)


def _trace(medium: Medium, lights: Sequence[Light], last: float, context: Context) -> Field:
    """The `Field` of photons up to collision number `last`; infinity for all collisions."""
    monitor = context.monitor.part(0.0, _TRACING)
    with context.clock("trace"):
        return trace(
            medium,
            lights,
            context.settings.photons or _PHOTONS_A_VOXEL * prod(medium.shape),
            # The least noise in a given time (docs/theory/free-paths.md).
            sampler="supervoxel_constant",
            spacing=0.5,
            direct=False,
            seed=context.settings.seed,
            device=context.device,
            handover=None if isinf(last) else int(last),
            progress=lambda _stage, fraction: monitor.report("trace", fraction),
            cancel=monitor.cancel,
        )


def _last_collision(medium: Medium, settings: "Settings") -> float:
    """The collision at which the lattice takes over: 1 for the first, infinity for never.

    There the mean light has gone `handover` transport optical depths from its first collision.
    """
    if isinf(settings.handover):
        return inf
    collisions = settings.handover / (1 - medium.albedo * medium.g)
    return max(settings.traced_collisions, 1 + round(float(collisions.max())))


def _refuse_unfit(medium: Medium, lights: Sequence[Light]) -> None:
    for light in lights:
        shadow = light.shadow_density
        if shadow is not None and shadow.shape != medium.shape:
            raise LightError(
                f"The shadow density of a sun has shape {shadow.shape}; it must be that of the "
                f"density, {medium.shape}."
            )


def _pieces(
    medium: Medium, settings: "Settings", device: Device, lights: int, needed: int
) -> tuple[int, int]:
    """(pieces that each voxel's edge is divided into, bytes of memory of such a solve).

    Raises MediumError where absorption is so strong that it would need too many pieces, and
    DeviceError where they do not fit. Pieces that only improve the light are left out then.
    """
    if settings.scattering == "single" or isinf(settings.handover):
        return 1, needed  # rays and photons are exact in voxels of any depth
    wished, must = (settings.divide,) * 2 if settings.divide else wished_pieces(medium)

    def bytes_of(pieces: int) -> int:
        if pieces == 1:
            return needed
        shape = tuple(pieces * n for n in medium.shape)
        arguments = (medium.bands, medium.occlusion is not None, lights)
        return require_memory(device, shape, lambda s: footprint(s, settings, device, *arguments))

    try:
        return wished, bytes_of(wished)
    except DeviceError as error:
        if wished == must:
            raise DeviceError(
                f"The voxels are so thick that each has to be divided in {must} along its edges, "
                f"and then there is too little memory. {error}"
            ) from error
        return must, bytes_of(must)


def footprint(
    shape: Sequence[int],
    settings: "Settings",
    device: Device,
    bands: int,
    occluded: bool,
    lights: int = 4,
) -> Footprint:
    """The memory of a solve of `shape` voxels for a number of lights.

    occluded  whether the medium has opaque voxels
    """
    if settings.merge > 1 and settings.scattering == "multiple":
        return _footprint_of_merged(shape, settings, device, bands, occluded, lights)
    voxels = prod(shape)
    # Rays are cast first, then the lattice runs: they share the memory.
    casts = casting.footprint(shape, occluded)
    kept_casts = 2 * min(bands, 2)  # with and without forward peak; of a band and one like it
    cast = 11 + 7 * occluded  # direct, its direction, moments of collisions; reflected light
    casts = replace(casts, host=casts.host | {"casts": kept_casts * cast * FLOAT * voxels})
    lattice = Footprint({})
    if settings.scattering != "single":
        lattice = Footprint(backend_of(device).lattice_memory(shape, occluded))
    source = 1 + 3  # power, drift
    lattice = replace(lattice, host={"lattice source": 2 * source * DOUBLE * voxels})
    buffers = casts.or_larger(lattice).device
    work = max(casts.total, lattice.total) - sum(buffers.values())

    has_photons = settings.handover or settings.traced_collisions > 1
    field = _FIELD + 2 * lights  # with uncollided light and forward peak, by light
    per_voxel = {
        "density": FLOAT,
        "opaque voxels": DOUBLE * occluded,
        "borders of opaque voxels": 16 * DOUBLE * occluded,
        "field": bands * field * FLOAT,
        "photons' light": bands * (_TRACED if has_photons else 0) * FLOAT,
        "light of a band": (1 + 3 + 3) * DOUBLE + 2 * lights * FLOAT,
        "collision sources": bands * (1 + 1 + 3 + 3) * DOUBLE,
    }
    arrays = {what: size * voxels for what, size in per_voxel.items()}
    return Footprint(buffers, arrays | {"casts or lattice": work})


def _footprint_of_merged(
    shape: Sequence[int],
    settings: "Settings",
    device: Device,
    bands: int,
    occluded: bool,
    lights: int,
) -> Footprint:
    """The memory of a solve of uncollided light, then of scattered light in merged voxels."""
    single, multiple = replace(settings, scattering="single"), replace(settings, merge=1)
    uncollided = footprint(shape, single, device, bands, occluded, lights)
    merged = tuple(-(-n // settings.merge) for n in shape)
    scattered = footprint(merged, multiple, device, bands, occluded, lights)
    kept = bands * (_FIELD + 2 * lights) * FLOAT * prod(shape)
    scattered = replace(scattered, host=scattered.host | {"field of uncollided light": kept})
    return uncollided.or_larger(scattered)
