# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical model: light in SI units, split into what is exact and what the lattice carries.

Unscattered light follows exact rays. What collides on them, or photons after some collisions, is
handed to a lattice that carries scattered light alone. docs/theory/physics.md derives the
equations and says what they neglect.
"""

from dataclasses import dataclass, replace
from math import inf, isinf, prod

import numpy as np

from ..errors import DeviceError, LightError
from . import device as devices
from .backend import backend_of
from .bands import runs_of, together
from .box import matter
from .field import Field, Report
from .lattice.convergence import converge
from .lattice.lattice_numpy import Source
from .lattice.multigrid import Level
from .lattice.streaming import stream_on
from .lattice.subdivision import divided, merged, wished_pieces
from .lights.base import by_band, darkness
from .lights.distant import Sky
from .lights.emission import Emission
from .lights.sampling import face_areas
from .monitor import Monitor
from .photons.trace import trace
from .resample import coarse, put_together
from .uncollided import casting
from .uncollided.cache import Rays, parts

_PHOTONS_A_VOXEL = 64
_TRACING, _CASTING = 0.5, 0.3  # of the time: about that of photons, and of rays in the rest
_MOST_SHIFTS = 64  # times that light is radiated again: each time it is less
_SHIFTED = 1e-6  # of the light that entered: what may be left out of what is radiated again
_MOST_MISSING = 10.0  # absorption depth of voxels up to which `_take_missing` is used


def solve(medium, lights, settings, device, clock, needed, monitor):
    """`solver.solve` by the physical model; needed is the memory that it takes, bytes."""
    lights = list(lights)
    _refuse_unfit(medium, lights)
    work = _Work(settings, device, clock, monitor)
    pieces = settings.merge
    if pieces == 1 or medium.shift is not None or settings.scattering == "single":
        field = _lit(medium, lights, work, needed)
    else:
        single = replace(
            work, settings=replace(settings, scattering="single"), monitor=monitor.silent()
        )
        unscattered = _lit(medium, lights, single, needed)
        large = [coarse(light, pieces) for light in lights]
        field = put_together(unscattered, _lit(medium.merged(pieces), large, work, needed), pieces)
    if not np.any(field.report.energy["entered"]):
        raise darkness(lights)
    # Not before: what is below zero in one voxel balances what is too much in others.
    np.maximum(field.fluence, 0, out=field.fluence)
    field.report.seconds = clock.seconds
    return field


def _lit(medium, lights, work, needed):
    """The `Field` of a medium, divided where its voxels are too thick."""
    pieces, needed = _pieces(medium, work.settings, work.device, len(lights), needed)
    if pieces > 1:
        medium = medium.divided(pieces)
        lights = [divided(light, pieces) for light in lights]
    field = work.light(medium, lights)
    if medium.shift is not None:
        _shift(field, medium, work)
    field.report.bytes = needed
    return field if pieces == 1 else merged(field, pieces)


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


def _refuse_unfit(medium, lights):
    for light in lights:
        shadow = light.shadow_density
        if shadow is not None and shadow.shape != medium.shape:
            raise LightError(
                f"The shadow density of a sun has shape {shadow.shape}; it must be that of the "
                f"density, {medium.shape}."
            )


def _pieces(medium, settings, device, lights, needed):
    """(pieces along each edge that the voxels are to be divided in, bytes that it takes then).

    MediumError where absorption is so strong that it would take too many, DeviceError where the
    pieces do not fit; those that only better the light are left out then.
    """
    if settings.scattering == "single" or isinf(settings.handover):
        return 1, needed  # rays and photons are right in voxels of any depth
    wished, must = (settings.divide,) * 2 if settings.divide else wished_pieces(medium)

    def bytes_of(pieces):
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


def _shift(field, medium, work):
    """Add to a field what the medium radiates again in other bands than it absorbed."""
    volume = medium.voxel_size**3
    energy = field.report.energy
    energy["shifted"] = np.zeros(medium.bands)
    enough = _SHIFTED * np.sum(energy["entered"])
    latest = field
    for _ in range(_MOST_SHIFTS):
        light = latest.fluence + latest.direct
        absorbed = medium.sigma_a[:, None, None, None] * medium.density * light  # W/m^3
        emission = np.maximum(np.tensordot(medium.shift, absorbed, axes=1), 0)
        received = emission.sum(axis=(1, 2, 3)) * volume
        if received.sum() <= enough:
            return
        given = medium.shift.sum(axis=0) * absorbed.sum(axis=(1, 2, 3)) * volume
        energy["shifted"] += received - given
        energy["absorbed"] -= given
        latest = work.light(medium.altered(emission=emission), [])
        _add(field, latest)
    field.report.converged = False


def _add(field, more):
    """Add light that the medium radiated again: it has not entered from anywhere."""
    for name in ("fluence", "direct", "flux", "direct_flux"):
        getattr(field, name)[...] += getattr(more, name)
    report, extra = field.report, more.report
    report.steps += extra.steps
    report.residual = max(report.residual, extra.residual)
    report.converged &= extra.converged
    for where in ("absorbed", "left"):
        report.energy[where] += extra.energy[where]


@dataclass
class _Band:
    """The light of one band: grids, by light those of `Field`, {where: W}, and how the lattice
    found it."""

    fluence: np.ndarray
    flux: np.ndarray
    direct_flux: np.ndarray
    by_light: list
    forward: list
    energy: dict
    residual: float = 0.0
    steps: int = 0
    corrections: int = 0

    @classmethod
    def dark(cls, field, band, lights, in_place):
        """For lights of some numbers: the field's own grids of them, and in place all others."""
        grids = [field.fluence[band], field.flux[band], field.direct_flux[band]]
        if not in_place:
            grids = [np.zeros(grid.shape, np.float32) for grid in grids]
        by_light, forward = (
            [_of_light(grid, number, band) for number in lights]
            for grid in (field.by_light, field.forward)
        )
        return cls(
            *grids, by_light, forward, {"entered": 0.0, "absorbed": 0.0, "left": np.zeros(6)}
        )

    def add_unscattered(self, number, cast):
        self.by_light[number] += cast.direct
        for flux, toward in zip(self.direct_flux, cast.toward, strict=True):
            flux += toward if np.ndim(toward) else float(toward) * cast.direct

    def add_forward(self, number, cast, unscattered):
        """Add what a `casting.Cast` of what goes straight on, too, has more."""
        shade = cast.shade.of
        direct, flux = cast.over(unscattered)
        shade(self.fluence)[...] += direct
        shade(self.flux)[...] += flux
        shade(self.forward[number])[...] += direct


def _of_light(grids, number, band):
    """The grid of a light's band; one of its own for the medium's emission, which comes last."""
    return grids[number, band] if number < len(grids) else np.zeros(grids.shape[2:], np.float32)


class _Handover:
    """What is handed to the lattice of one band, added up, in the voxels of its box."""

    def __init__(self, medium, box):
        self.voxel_size, self.box = medium.voxel_size, box
        self.power, self.reflected = np.zeros((2, *box.shape))
        self.place, self.direction = np.zeros((2, 3, *box.shape))

    def add(self, moments, share, mean_cosine):
        """The share of `casting.Moments` that goes on, and the mean cosine that it turns by."""
        area = self.voxel_size**2
        self.power += moments.power * (share / area)
        self.place += moments.position * (share / (area * self.voxel_size))
        self.direction += moments.direction * (share * mean_cosine / area)

    def add_reflected(self, power):
        """(nx, ny, nz) W that opaque voxels send into each voxel of the box."""
        self.reflected += power / self.voxel_size**2

    def largest(self):
        """W/m^2 of the voxel that is handed most."""
        return float(np.maximum(np.abs(self.power).max(), self.reflected.max()))

    def source(self, transport_depth, scale):
        """The `Source`, over a scale; transport_depth is that of a voxel's edge, (nx, ny, nz)."""
        drift = transport_depth * self.place + self.direction
        return Source(self.power / scale, drift / scale, self.reflected / scale)


@dataclass
class _Work:
    """How to light a medium, and where to tell of it: the arguments of `solve`."""

    settings: object
    device: object
    clock: object
    monitor: Monitor
    begun: float = 0.0  # the share of all work before the band at hand
    share: float = 1.0  # and that of this band

    def light(self, medium, lights):
        """The `Field` of the lights and the medium's emission."""
        shining = lights if medium.emission is None else [*lights, Emission(medium)]
        single = self.settings.scattering == "single"
        last = 1 if single else _last_collision(medium, self.settings)
        runs, box = runs_of(medium, shining, apart=last == 1), matter(medium, lights)
        traced = self._trace(medium, lights, last) if last > 1 else None
        begun = _TRACING if traced else 0.0
        field = self._dark_field(medium, len(lights))
        field.report.runs = len(runs)
        rest = 1 - begun
        for some, bands, are_new in together(runs, medium.sigma_t):
            self.share = rest * len(bands) / len(runs)
            self.begun, begun = begun, begun + self.share
            lit = {band: _Band.dark(field, band, some, in_place=are_new) for band in bands}
            self._bands(medium, box, [shining[n] for n in some], traced, lit)
            for band, multiples in bands.items():
                for other, factor in multiples.items():
                    _take(field, lit[band], some, other, factor)
        field.report.converged = field.report.residual <= self.settings.tolerance
        if traced is not None:
            field.variance = traced.variance
        return field

    def _dark_field(self, medium, lights):
        shape, bands = medium.shape, medium.bands
        energy = {
            "entered": np.zeros(bands),
            "absorbed": np.zeros(bands),
            "left": np.zeros((bands, 6)),
        }
        return Field(
            medium.domain,
            fluence=np.zeros((bands, *shape), np.float32),
            direct=np.zeros((bands, *shape), np.float32),
            flux=np.zeros((bands, 3, *shape), np.float32),
            report=Report("physical", self.device.label, energy=energy),
            by_light=np.zeros((lights, bands, *shape), np.float32),
            forward=np.zeros((lights, bands, *shape), np.float32),
            direct_flux=np.zeros((bands, 3, *shape), np.float32),
        )

    def _trace(self, medium, lights, last):
        with self.clock("trace"):
            return trace(
                medium,
                lights,
                self.settings.photons or _PHOTONS_A_VOXEL * prod(medium.shape),
                # As little noise as any in a given time (docs/theory/free-paths.md).
                sampler="supervoxel_constant",
                spacing=0.5,
                direct=False,
                seed=self.settings.seed,
                device=self.device,
                handover=None if isinf(last) else last,
                progress=lambda _stage, fraction: self._tell("trace", _TRACING * fraction),
                cancel=self.monitor.cancel,
            )

    def _bands(self, medium, box, lights, traced, lit):
        """Light each of the `_Band`s in {band: `_Band`}."""
        begun, share = self.begun, self.share
        self._tell("direct", begun)
        with self.clock("direct"):
            if self.settings.scattering == "single":
                self._unscattered(medium, box, lights, lit)
                return
            collect = self._first_collisions if traced is None else self._last_collisions
            handovers = collect(medium, box, lights, traced, lit)
        self.share = share * (1 - _CASTING) / len(lit)
        for number, (band, handover) in enumerate(handovers.items()):
            self.begun = begun + share * _CASTING + number * self.share
            with self.clock("solve"):
                self._scatter(medium, band, handover, lit[band])
        self._tell("solve", begun + share)

    def _tell(self, stage, fraction):
        self.monitor.report(stage, fraction)

    def _unscattered(self, medium, box, lights, lit):
        """Light that has not scattered alone; what would scatter is counted, and followed no
        further."""
        for own in lit.values():
            own.energy["scattered"] = 0.0
        for number, rays in self._each(medium, box, lights):
            for band, own in lit.items():
                cast, albedo = rays.cast(band, medium.sigma_t[band]), medium.albedo[band]
                own.add_unscattered(number, cast)
                collided = cast.collided.power.sum(dtype=float)
                own.energy["entered"] += cast.entered
                own.energy["absorbed"] += cast.stopped + (1 - albedo) * collided
                own.energy["left"] += cast.left
                own.energy["scattered"] += albedo * collided + cast.sent_back

    def _first_collisions(self, medium, box, lights, _traced, lit):
        """{band: `_Handover` of first collisions}; what else they tell goes to `lit`."""
        handovers = {band: _Handover(medium, box) for band in lit}
        for number, rays in self._each(medium, box, lights):
            for band, own in lit.items():
                unscattered = rays.cast(band, medium.sigma_t[band])
                if _is_uniform(rays.light, medium, band):
                    self._take_missing(rays, band, unscattered, handovers[band], own)
                else:
                    self._take_collided(rays, band, number, unscattered, handovers[band], own)
                own.add_unscattered(number, unscattered)
        return handovers

    def _last_collisions(self, medium, box, lights, traced, lit):
        """{band: `_Handover` of photons at their last collision}; what else they tell goes to
        `lit`."""
        handovers = {
            band: _handed_over(medium, box, band, traced, own) for band, own in lit.items()
        }
        for number, rays in self._each(medium, box, lights):
            for band, own in lit.items():
                cast = rays.cast(band, medium.sigma_t[band], shadowed=False)
                own.add_unscattered(number, cast)
                if rays.light.is_beam:
                    ahead = self._cast_forward(rays, band, cast, shadowed=False)[0]
                    shade = ahead.shade.of
                    shade(own.forward[number])[...] += ahead.over(cast)[0]
        return handovers

    def _each(self, medium, box, lights):
        """(number of its light, `Rays`) of each part of the lights, one at a time, for casts take
        much memory."""
        how = self.settings.rays, self.device, self.monitor
        for number, part in parts(lights):
            yield number, Rays(medium, box, part, *how)

    def _take_collided(self, rays, band, number, unscattered, handover, lit):
        """Hand over the first collisions of a light."""
        cast, share, straight = self._cast_forward(rays, band, unscattered)
        handover.add(cast.collided, share, straight)
        if cast.reflected is not None:
            handover.add_reflected(cast.reflected)
        if cast is not unscattered:  # there is a forward peak
            lit.add_forward(number, cast, unscattered)
        collided = cast.collided.power.sum(dtype=float)
        lit.energy["entered"] += cast.entered
        lit.energy["absorbed"] += cast.stopped + (1 - share) * collided
        lit.energy["left"] += cast.left

    def _take_missing(self, rays, band, unscattered, handover, lit):
        """Hand over what absorption takes from a uniform sky, as light that is missing.

        Without absorption a uniform sky lights everything evenly, whatever scatters. What is
        missing is light that the medium would radiate if it gave back all that it absorbs of
        that; so a white medium is exact, and a bright one leaves the lattice little to carry.
        """
        medium = rays.medium
        radiance = float(by_band(rays.light.radiance, medium.bands)[band])
        # More is an error of the rays, and would be left to less scattered light than none.
        np.minimum(unscattered.direct, 4 * np.pi * radiance, out=unscattered.direct)
        cast, share, straight = self._cast_forward(rays.missing, band, None)
        handover.add(cast.collided, -share, straight)
        lit.fluence += 4 * np.pi * radiance - cast.direct - unscattered.direct
        lit.flux -= cast.flux + unscattered.flux
        collided = cast.collided.power.sum(dtype=float)
        lit.energy["absorbed"] += cast.entered - (1 - share) * collided
        through_faces = np.pi * radiance * np.repeat(face_areas(medium.domain), 2)
        lit.energy["entered"] += through_faces.sum()
        lit.energy["left"] += through_faces - cast.left

    def _cast_forward(self, rays, band, unscattered, shadowed=True):
        """(`casting.Cast`, share of its collisions that scatters, mean cosine of that).

        The forward peak counts as unscattered: of what scatters, the share f = g^2 goes straight
        on, and the rest has the mean cosine (g - f) / (1 - f) (Joseph, Wiscombe and Weinman, "The
        delta-Eddington approximation for radiative flux transfer", 1976).

        unscattered  the cast in which it does not, where there is one
        """
        medium, light = rays.medium, rays.light
        albedo, g = medium.albedo[band], medium.g[band]
        # A soft lamp dims what comes from it, not what goes on from a collision beside it.
        forward = 0.0 if light.is_soft_within(medium.domain) else max(g, 0.0) ** 2
        cast = unscattered
        if forward > 0 or cast is None:
            less = medium.sigma_t[band] - forward * medium.sigma_s[band]
            cast = rays.cast(band, less, shadowed, peaked=False)
        share = albedo * (1 - forward) / (1 - albedo * forward)
        return cast, share, (g - forward) / (1 - forward)

    def _scatter(self, medium, band, handover, lit):
        """Add to the `_Band` what the lattice makes of a `_Handover`."""
        box, scale = handover.box, handover.largest()
        if not np.isfinite(scale):
            raise LightError("The light is too strong to reckon with; lower its strength.")
        if scale == 0:
            return
        depth = medium.depth(medium.sigma_t[band], box)
        transport_depth = depth * (1 - medium.albedo[band] * medium.g[band])
        optics = (medium.albedo[band], medium.g[band])
        opaque = map(box.of, (medium.occlusion, medium.occlusion_albedo[band]))
        edge = max(medium.shape)
        level = Level(backend_of(self.device).lattice, depth, *optics, *opaque, edge)
        lattice = level.lattice
        # In float32 light may be as dim or bright as the user likes only where it is near 1.
        lattice.start(handover.source(transport_depth, scale))
        lit.residual, lit.steps, lit.corrections = converge(
            level, self.settings.tolerance, self.settings.most_steps, self._tell_error
        )
        fluence = lattice.fluence().astype(float)
        box.of(lit.fluence)[...] += scale * fluence
        # The lattice starts light at a voxel's centre, and moves it to where it collided first.
        box.of(lit.flux)[...] += scale * lattice.flux() - handover.place
        left, stopped = lattice.lost()
        if not box.is_whole:
            left = stream_on(lattice, box, scale, lit.fluence, lit.flux)
        watts = scale * medium.voxel_size**2
        lit.energy["left"] += watts * left
        absorbed = np.sum(medium.depth(medium.sigma_a[band], box) * fluence)
        lit.energy["absorbed"] += watts * (absorbed + stopped)

    def _tell_error(self, error):
        self.monitor.check()
        self.monitor.report_residual(error)
        tolerance = self.settings.tolerance
        reached = np.log(max(error, tolerance)) / np.log(tolerance)
        self._tell("solve", self.begun + self.share * reached)


def _last_collision(medium, settings):
    """The collision at which light is handed to the lattice: 1 for the first, infinity for none.

    By then mean light has gone `handover` transport optical depths from its first collision.
    """
    if isinf(settings.handover):
        return inf
    collisions = settings.handover / (1 - medium.albedo * medium.g)
    return max(settings.traced_collisions, 1 + round(float(collisions.max())))


def _handed_over(medium, box, band, traced, lit):
    """The `_Handover` of photons at their last collision; what they lit before goes to `lit`."""
    lit.fluence += traced.fluence[band]
    lit.flux += traced.flux[band]
    energy = traced.report.energy
    for where in lit.energy:
        lit.energy[where] += energy[where][band]
    lit.energy["absorbed"] += energy["lost"][band]
    handover, handed = _Handover(medium, box), traced.handed
    if handed is not None:
        moments = (handed.power[band], handed.position[band], handed.direction[band])
        handover.add(casting.Moments(*map(box.of, moments)), 1.0, medium.g[band])
    return handover


def _is_uniform(light, medium, band):
    """Whether a light is the same from everywhere, and less of it is absorbed than scattered."""
    uniform = isinstance(light, Sky) and not callable(light.radiance) and medium.occlusion is None
    if not uniform or medium.sigma_a[band] > medium.sigma_s[band]:
        return False
    # Of light that is missing far more times over than there is, too few digits would be left.
    return medium.depth(medium.sigma_a[band]).max() <= _MOST_MISSING


def _take(field, lit, numbers, band, factor):
    """Take the light of a run, times a factor, into its band of the field; numbers are its lights'.

    What was lit in the field's own grids is there already.
    """

    def take(grid, values):
        if not np.may_share_memory(grid, values):
            grid += values if factor == 1 else factor * values

    for number, light, ahead in zip(numbers, lit.by_light, lit.forward, strict=True):
        take(field.direct[band], light)
        if number < len(field.by_light):
            take(field.by_light[number, band], light)
            take(field.forward[number, band], ahead)
    for grid, values in (
        (field.direct_flux, lit.direct_flux),
        (field.fluence, lit.fluence),
        (field.flux, lit.flux),
    ):
        take(grid[band], values)
    report = field.report
    for where, power in lit.energy.items():
        report.energy.setdefault(where, np.zeros(len(field.fluence)))[band] += factor * power
    report.steps = max(report.steps, lit.steps)
    report.corrections = max(report.corrections, lit.corrections)
    report.residual = max(report.residual, lit.residual)
