# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical model: light in SI units, split into what is exact and what the lattice carries.

Uncollided light follows exact rays. Light that collides on them, or photons after some collisions,
is the source of a lattice that carries scattered light alone. docs/theory/physics.md derives the
equations and says what they neglect.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, isinf, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DeviceError, LightError
from . import device as devices
from .backend import backend_of
from .band_light import BandLight, dark_field
from .bands import runs_of, together
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
from .lights.base import darkness
from .lights.emission import Emission
from .medium import Medium
from .monitor import Monitor
from .multiple_scattering import scatter
from .photons.trace import trace
from .reemission import add_reemission
from .resample import Resampling, combine
from .uncollided import casting

if TYPE_CHECKING:
    from .solver import Settings

_PHOTONS_A_VOXEL = 64
_TRACING, _CASTING = 0.5, 0.3  # share of the time: about that of photons; of rays in the remainder


def solve(
    medium: Medium,
    lights: Sequence[Any],
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
    medium: Medium, lights: Sequence[Any], merge: int, context: Context, needed: int
) -> Field:
    """The `Field` in voxels that are merged, `merge` along each edge; those that are too thick for
    the lattice are divided for the solve."""
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


def _solve_bands(medium: Medium, lights: Sequence[Any], context: Context) -> Field:
    """The `Field` of the lights and the medium's emission, in the medium's voxels."""
    # Prepare: group the bands, crop empty space, trace photons up to their last collision.
    settings = context.settings
    sources = list(lights) if medium.emission is None else [*lights, Emission(medium)]
    last = 1 if context.is_single else _last_collision(medium, settings)
    bands, box = runs_of(medium, sources, apart=last == 1), matter(medium, lights)
    traced = _trace(medium, lights, last, context) if last > 1 else None
    begin = _TRACING if traced else 0.0
    remaining = 1 - begin

    field = dark_field(medium, len(lights), context.device.label)
    field.report.runs = len(bands)
    for numbers, group, are_new in together(bands, medium.sigma_t):
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
    lights: Sequence[Any],
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


def _trace(medium: Medium, lights: Sequence[Any], last: float, context: Context) -> Field:
    """The `Field` of photons up to their last collision; infinity for all."""
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


def _refuse_unfit(medium: Medium, lights: Sequence[Any]) -> None:
    for light in lights:
        shadow = getattr(light, "shadow_density", None)
        if shadow is not None and shadow.shape != medium.shape:
            raise LightError(
                f"The shadow density of a sun has shape {shadow.shape}; it must be that of the "
                f"density, {medium.shape}."
            )


def _pieces(
    medium: Medium, settings: "Settings", device: Device, lights: int, needed: int
) -> tuple[int, int]:
    """(pieces that each voxel's edge is divided in, bytes of memory of such a solve).

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
        return devices.require_memory(
            device, shape, lambda s: plan(s, settings, device, *arguments)
        )

    try:
        return wished, bytes_of(wished)
    except DeviceError as error:
        if wished == must:
            raise DeviceError(
                f"The voxels are so thick that each has to be divided in {must} along its edges, "
                f"and then there is too little memory. {error}"
            ) from error
        return must, bytes_of(must)


def plan(shape, settings, device, bands, occluded, lights=4):
    """({what: bytes} on the device, bytes on the host) of a solve of `shape` voxels."""
    if settings.merge > 1 and settings.scattering == "multiple":
        large = tuple(-(-n // settings.merge) for n in shape)
        rest = (device, bands, occluded, lights)
        buffers, host = plan(shape, replace(settings, scattering="single"), *rest)
        more, more_host = plan(large, replace(settings, merge=1), *rest)
        kept = bands * (2 + 3 + 3 + 2 * lights) * 4 * prod(shape)
        buffers = max(buffers, more, key=lambda needs: sum(needs.values()))
        return buffers, max(host, kept + more_host)
    rays, casting_bytes = casting.plan(shape, occluded)
    single = settings.scattering == "single"
    lattice = {} if single else backend_of(device).lattice_memory(shape, occluded)
    voxels = prod(shape)
    traced = 13 if settings.handover or settings.traced_collisions > 1 else 0
    fields = bands * (1 + 1 + 3 + 3 + 2 * lights + traced) * 4
    band, handed = 7 * 8 + 2 * lights * 4, bands * 8 * 8  # its light, and what is handed over
    # With the forward peak and without, of a band and of another that shares its rays.
    casts = 2 * min(bands, 2) * (11 + 7 * occluded) * 4
    # One after the other, not both at once: rays, and the lattice with its source made ready.
    needs = [
        sum(rays.values()) + casting_bytes + casts * voxels,
        sum(lattice.values()) + (4 + 4) * 8 * voxels,
    ]
    buffers = max(rays, lattice, key=lambda plan: sum(plan.values()))
    opaque = (1 + 16) * 8 * occluded  # what it is, and to find where light meets it
    always = (4 + opaque + fields + band + handed) * voxels
    return buffers, always + max(needs) - sum(buffers.values())
