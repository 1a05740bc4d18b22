# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's model: all light on the lattice of paper 1, section 3, for its number of steps."""

from collections.abc import Sequence
from math import prod
from typing import TYPE_CHECKING

import numpy as np

from ...arrays import Floats
from ...errors import LightError, MediumError
from ..backend import PaperLattice, backend_of
from ..device import Device
from ..field import Clock, Field, Report
from ..lattice.d3q19 import UNIT, WEIGHTS
from ..lights.base import Light, by_band
from ..lights.distant import Sky, Sun
from ..medium import SMALLEST_EDGE, Medium
from ..memory import DOUBLE, FLOAT, Footprint
from ..monitor import Monitor
from .collision import collision_matrix

if TYPE_CHECKING:
    from ..solver import Settings

_REPORT_EVERY = 8  # steps between two checks of `cancel`: prompt, at no cost


def solve(
    medium: Medium,
    lights: Sequence[Light],
    settings: "Settings",
    device: Device,
    clock: Clock,
    needed: int,
    monitor: Monitor,
) -> Field:
    """`solver.solve` with the paper's model. `needed` is the memory of the solve, bytes."""
    _refuse_unfit(medium)
    inflow = boundary_inflow(lights, medium.bands)
    with clock("prepare"):
        lattice = backend_of(device).paper_lattice(medium, settings.keep_absorbed, settings.kernel)
    distinct = _distinct_bands(medium, inflow)
    steps = settings.steps or 2 * max(medium.shape)
    light = np.empty((medium.bands, *medium.shape), np.float32)
    flux = np.empty((medium.bands, 3, *medium.shape), np.float32)
    residual = 0.0
    for number, (band, multiples) in enumerate(distinct):
        with clock("solve"):
            omega = collision_matrix(medium.sigma_s[band], medium.sigma_a[band], medium.g[band])
            lattice.start(inflow[band], omega)
            _advance(lattice, steps, number, len(distinct), monitor)
        with clock("read"):
            change = _read(lattice, light[band], flux[band])
            residual = max(residual, change)
            for other, scale in multiples.items():
                np.multiply(light[band], scale, out=light[other])
                np.multiply(flux[band], scale, out=flux[other])

    report = Report(
        model=settings.model,
        device=device.label,
        steps=steps,
        residual=residual,
        seconds=clock.seconds,
        bytes=needed,
        runs=len(distinct),
    )
    return Field(medium.domain, light, np.zeros_like(light), flux, report)


def footprint(
    shape: Sequence[int],
    settings: "Settings",
    device: Device,
    bands: int,
    occluded: bool,
    lights: int = 4,
) -> Footprint:
    """The memory of a solve of `shape` voxels; the lights need none."""
    per_voxel = {
        "density": FLOAT,
        "opaque voxels": FLOAT * occluded,
        "field": bands * (1 + 1 + 3) * FLOAT,  # fluence, direct, flux
        "last steps": 3 * DOUBLE,  # the light of the last two, and their difference
    }
    arrays = {what: size * prod(shape) for what, size in per_voxel.items()}
    return Footprint(backend_of(device).paper_memory(shape, settings.kernel, occluded), arrays)


def boundary_inflow(lights: Sequence[Light], bands: int) -> Floats:
    """(bands, 19) W/m^2: the light that a boundary node holds in each direction.

    That of a sun is proportional to the positive part of n_m . direction (paper 1, section 3); its
    sum over directions is the irradiance, which is the fluence of a free beam. That of a sky is its
    radiance times 4 pi w_m, so that a uniform sky gives 4 pi L everywhere.
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


def _refuse_unfit(medium: Medium) -> None:
    """Refuse media that the paper's model cannot represent."""
    if min(medium.shape) < SMALLEST_EDGE:
        raise MediumError(
            f"The lattice needs {SMALLEST_EDGE} voxels or more along each edge; "
            f"the medium has {' x '.join(map(str, medium.shape))}."
        )
    if medium.emission is not None and medium.emission.any():
        raise MediumError("The paper's model has no emission inside the medium; leave it out.")
    thickest = float(medium.sigma_t.max()) * float(medium.density.max())
    if thickest > 2:  # equation 4: the diffusion coefficient is negative, and the light diverges
        raise MediumError(
            f"sigma_t x density reaches {thickest:g} per voxel, and the paper's model is unstable "
            "above 2; lower the density, or bring the medium to the paper's units."
        )


def _distinct_bands(medium: Medium, inflow: Floats) -> list[tuple[int, dict[int, float]]]:
    """[(band to solve, {band: its multiple})]: bands that differ by a factor are solved once.

    The lattice is linear in the light, so a coloured sun in a grey medium needs one solution.
    """
    distinct: list[tuple[int, dict[int, float]]] = []
    for band in range(medium.bands):
        for solved, multiples in distinct:
            factor = _factor(inflow[band], inflow[solved])
            if factor is not None and all(
                values[band] == values[solved]
                for values in (medium.sigma_s, medium.sigma_a, medium.g)
            ):
                multiples[band] = factor
                break
        else:
            distinct.append((band, {band: 1.0}))
    return distinct


def _factor(inflow: Floats, base: Floats) -> float | None:
    """inflow / base where they are multiples of each other, else None."""
    if not base.any():
        return None if inflow.any() else 0.0
    factor = float(inflow.sum() / base.sum())
    return factor if np.allclose(inflow, factor * base, rtol=1e-12, atol=0) else None


def _advance(lattice: PaperLattice, steps: int, number: int, count: int, monitor: Monitor) -> None:
    for done in range(0, steps, _REPORT_EVERY):
        monitor.check()
        lattice.advance(min(_REPORT_EVERY, steps - done))
        monitor.report("solve", (number + min(1, (done + _REPORT_EVERY) / steps)) / count)


def _read(lattice: PaperLattice, fluence: Floats, flux: Floats) -> float:
    """Fill fluence (nx, ny, nz) and flux (3, nx, ny, nz); the relative change of the last step.

    No view of the lattice's light may outlive this function.
    """
    with lattice.read(previous=True) as f:
        before = f.sum(axis=0)
    with lattice.read() as f:
        now = f.sum(axis=0)
        np.einsum("ma,m...->a...", UNIT, f, out=flux, casting="same_kind")
    fluence[...] = now
    return _relative_change(now, before)


def _relative_change(now: Floats, before: Floats) -> float:
    norm = float(np.linalg.norm(now))
    return float(np.linalg.norm(now - before)) / norm if norm else 0.0
