# SPDX-License-Identifier: GPL-3.0-or-later
"""The scattered light that the lattice computes from a collision source."""

import numpy as np

from ..arrays import Floats
from ..errors import LightError
from .backend import backend_of
from .band_light import BandLight
from .collision_source import BandSource
from .context import Context
from .lattice.convergence import converge
from .lattice.multigrid import Level
from .lattice.streaming import stream_on
from .medium import Medium


def scatter(
    medium: Medium, band: int, source: BandSource, lit: BandLight, context: Context
) -> None:
    """Add the scattered light of a source to the light of its band.

    Raises LightError where the source is too strong for float32.
    """
    scale = source.largest()
    if not np.isfinite(scale):
        raise LightError("The light is too strong to compute; lower its strength.")
    if scale == 0:
        return
    box = source.box
    depth = medium.depth(medium.sigma_t[band], box)
    transport_depth = depth * (1 - medium.albedo[band] * medium.g[band])

    # Run the lattice. It computes in float32, so the source is scaled to values near 1.
    level = _level(medium, band, source, depth, context)
    lattice = level.lattice
    lattice.start(source.scaled(transport_depth, scale))
    settings = context.settings
    lit.residual, lit.steps, lit.corrections = converge(
        level,
        settings.tolerance,
        settings.most_steps,
        lambda error: _report_error(error, settings.tolerance, context),
    )

    # Read the light. The lattice starts light at a voxel's centre, and the flux has to count its
    # way from there to the collision.
    fluence = lattice.fluence().astype(float)
    box.of(lit.fluence)[...] += scale * fluence
    box.of(lit.flux)[...] += scale * lattice.flux() - source.place
    left, stopped = lattice.lost()
    if not box.is_whole:
        left = stream_on(lattice, box, scale, lit.fluence, lit.flux)

    # Count the energy.
    watts = scale * medium.voxel_size**2
    lit.energy["left"] += watts * left
    absorbed = np.sum(medium.depth(medium.sigma_a[band], box) * fluence)
    lit.energy["absorbed"] += watts * (absorbed + stopped)


def _level(medium: Medium, band: int, source: BandSource, depth: Floats, context: Context) -> Level:
    """The finest level of a lattice for a band, in the box of a source."""
    occlusion, albedo = map(source.box.of, (medium.occlusion, medium.occlusion_albedo[band]))
    make = backend_of(context.device).lattice
    optics = medium.albedo[band], medium.g[band]
    return Level(make, depth, *optics, occlusion, albedo, max(medium.shape))


def _report_error(error: float, tolerance: float, context: Context) -> None:
    """Report the lattice's estimated relative error, and the progress that follows from it."""
    monitor = context.monitor
    monitor.check()
    monitor.report_residual(error)
    monitor.report("solve", np.log(max(error, tolerance)) / np.log(tolerance))
