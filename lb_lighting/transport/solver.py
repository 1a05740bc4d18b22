# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice solve: a medium and its lights go in, a field of light comes out."""

from dataclasses import dataclass
from math import prod

import numpy as np

from ..errors import Cancelled, LightError, MediumError, SettingsError, require_known
from . import device as devices
from .field import Clock, Field, Report
from .lattice import UNIT, WEIGHTS, collision_matrix
from .lights import Sky, Sun, by_band
from .medium import SMALLEST_EDGE
from .reference import ReferenceLattice

MODELS = ("paper",)
KERNELS = ("naive", "final", "coalesced")
_REPORT_EVERY = 8  # steps between two looks at `cancel`: prompt, and free


@dataclass(frozen=True)
class Settings:
    """How to solve.

    model          "paper": the lattice of paper 1. Lengths are in voxels and a density of 1
                   scatters fully, whatever the voxel size; `paper_units` brings a medium there
    steps          lattice steps; None for the paper's, twice the longest edge
    keep_absorbed  keep what was absorbed and emit it again (the paper's direction 0), or drop
                   it at each step, which shows the loss
    kernel         "naive", "final" or "coalesced": the paper's three, all with the same result
    """

    model: str = "paper"
    steps: int | None = None
    keep_absorbed: bool = False
    kernel: str = "final"

    def __post_init__(self):
        for value, known, what in (
            (self.model, MODELS, "model"),
            (self.kernel, KERNELS, "kernel"),
        ):
            require_known(value, known, what)
        if self.steps is not None and self.steps < 1:
            raise SettingsError(f"The number of steps must be 1 or more; it is {self.steps}.")


def solve(medium, lights, settings=None, device=None, progress=None, cancel=None):
    """Light a medium.

    medium    a `Medium` of at least 3 voxels along each edge; the outermost voxels are the
              boundary, where light enters
    lights    `Sun` and `Sky`, at least one
    settings  `Settings`, default if None
    device    None for the best, or part of the label of one of `device.devices()`
    progress  called as progress(stage, fraction) with fraction from 0 to 1
    cancel    called without arguments; the solve ends with `Cancelled` where it returns true
    Returns a `Field` in W/m^2. Raises MediumError, LightError, SettingsError or DeviceError.
    Source: paper 1, section 3.
    """
    settings = settings or Settings()
    _refuse_unfit(medium)
    inflow = boundary_inflow(lights, medium.bands)
    clock = Clock()

    with clock("prepare"):
        used = devices.choose(device)
        occluded = medium.occlusion is not None
        needed = require_memory(medium.shape, settings, used, medium.bands, occluded)
        lattice = _lattice(medium, settings, used)
    runs = _distinct_runs(medium, inflow)
    steps = settings.steps or 2 * max(medium.shape)
    light = np.empty((medium.bands, *medium.shape), np.float32)
    flux = np.empty((medium.bands, 3, *medium.shape), np.float32)
    residual = 0.0
    for number, (band, multiples) in enumerate(runs):
        with clock("solve"):
            omega = collision_matrix(medium.sigma_s[band], medium.sigma_a[band], medium.g[band])
            lattice.start(inflow[band], omega)
            _advance(lattice, steps, number, len(runs), progress, cancel)
        with clock("read"):
            change = _read(lattice, light[band], flux[band])
            residual = max(residual, change)
            for other, scale in multiples.items():
                np.multiply(light[band], scale, out=light[other])
                np.multiply(flux[band], scale, out=flux[other])

    report = Report(
        model=settings.model,
        device=used.label,
        steps=steps,
        residual=residual,
        seconds=clock.seconds,
        bytes=needed,
        runs=len(runs),
    )
    return Field(medium.domain, light, np.zeros_like(light), flux, report)


def require_memory(shape, settings=None, device=None, bands=3, occluded=True):
    """Refuse a domain of `shape` voxels that is too large for the device, before it is made.

    settings and device are those of `solve`. Before the medium is known it is taken to have the
    most that a scene can bring: three bands, and opaque voxels.
    Returns the bytes needed; DeviceError says the largest resolution that fits.
    """
    chosen = devices.choose(device)
    buffers = _buffers(settings or Settings(), chosen)

    def plan(shape):
        return buffers(shape, occluded), _host_bytes(shape, bands, occluded)

    return devices.require_memory(chosen, shape, plan)


def boundary_inflow(lights, bands):
    """(bands, 19) W/m^2: the light that a boundary node holds in each direction.

    A sun's is proportional to the positive part of n_m . direction (paper 1, section 3), scaled
    so that the sum over directions is its irradiance, which is the fluence of a free beam. A
    sky's is its radiance times 4 pi w_m, so that a closed uniform sky gives 4 pi L everywhere.
    """
    inflow = np.zeros((bands, 19))
    for light in lights:
        if isinstance(light, Sun):
            toward = np.asarray(light.direction, float) / np.linalg.norm(light.direction)
            share = np.maximum(0, UNIT @ toward)
            inflow += np.outer(by_band(light.irradiance, bands), share / share.sum())
        elif isinstance(light, Sky):
            for m in range(1, 19):
                radiance = by_band(light.towards(-UNIT[m]), bands)
                inflow[:, m] += 4 * np.pi * WEIGHTS[m] * radiance
        else:
            raise LightError(
                "The paper's model takes light from far outside only; "
                f"replace the {type(light).__name__} by a Sun or a Sky."
            )
    if not inflow.any():
        raise LightError(
            "There is no light; add a sun, or a world with a colour that is not black."
        )
    return inflow


def _refuse_unfit(medium):
    """The media that the paper's model has no place for."""
    if min(medium.shape) < SMALLEST_EDGE:
        raise MediumError(
            f"The lattice needs {SMALLEST_EDGE} voxels or more along each edge; "
            f"the medium has {' x '.join(map(str, medium.shape))}."
        )
    if medium.emission is not None and medium.emission.any():
        raise MediumError("The paper's model has no emission inside the medium; leave it out.")
    thickest = float(medium.sigma_t.max()) * float(medium.density.max())
    if thickest > 2:  # equation 4: the diffusion coefficient is negative, and the light explodes
        raise MediumError(
            f"sigma_t x density reaches {thickest:g} per voxel, and the paper's model is unstable "
            "above 2; lower the density, or bring the medium to the paper's units."
        )


def _lattice(medium, settings, device):
    if device.kind == "NumPy":
        return ReferenceLattice(medium, settings.keep_absorbed)
    from .paper import PaperLattice  # only now: it needs pyopencl

    return PaperLattice(medium, settings.keep_absorbed, device, settings.kernel)


def _buffers(settings, device):
    """Function of a shape, and of whether it has opaque voxels: {what: bytes} of its lattice."""
    if device.kind == "NumPy":
        return ReferenceLattice.buffers
    from .paper import PaperLattice

    return lambda shape, occluded: PaperLattice.buffers(shape, settings.kernel, occluded)


def _host_bytes(shape, bands, occluded):
    """Bytes of the host's arrays beside the lattice: the medium, the field, and work on it."""
    medium = 4 + (4 if occluded else 0)
    field = bands * (1 + 1 + 3) * 4  # fluence, direct, flux
    work = 3 * 8  # the light now, the light before, their difference
    return (medium + field + work) * prod(shape)


def _distinct_runs(medium, inflow):
    """[(band to solve, {band: its multiple})]: bands that differ by a factor are solved once.

    The lattice is linear in the light, so in a grey medium a coloured sun needs one run.
    """
    runs = []
    for band in range(medium.bands):
        for solved, multiples in runs:
            factor = _factor(inflow[band], inflow[solved])
            if factor is not None and all(
                values[band] == values[solved]
                for values in (medium.sigma_s, medium.sigma_a, medium.g)
            ):
                multiples[band] = factor
                break
        else:
            runs.append((band, {band: 1.0}))
    return runs


def _factor(inflow, base):
    """inflow / base where they are multiples of each other, else None."""
    if not base.any():
        return None if inflow.any() else 0.0
    factor = inflow.sum() / base.sum()
    return factor if np.allclose(inflow, factor * base, rtol=1e-12, atol=0) else None


def _advance(lattice, steps, run, runs, progress, cancel):
    for done in range(0, steps, _REPORT_EVERY):
        if cancel is not None and cancel():
            raise Cancelled("Cancelled; nothing was changed.")
        lattice.advance(min(_REPORT_EVERY, steps - done))
        if progress is not None:
            progress("solve", (run + min(1, (done + _REPORT_EVERY) / steps)) / runs)


def _read(lattice, fluence, flux):
    """Fill fluence (nx, ny, nz) and flux (3, nx, ny, nz); the relative change of the last step.

    A function of its own so that no view of the lattice's light outlives it.
    """
    with lattice.read(previous=True) as f:
        before = f.sum(axis=0)
    with lattice.read() as f:
        now = f.sum(axis=0)
        np.einsum("ma,m...->a...", UNIT, f, out=flux, casting="same_kind")
    fluence[...] = now
    return _relative_change(now, before)


def _relative_change(now, before):
    norm = float(np.linalg.norm(now))
    return float(np.linalg.norm(now - before)) / norm if norm else 0.0
