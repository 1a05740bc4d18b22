# SPDX-License-Identifier: GPL-3.0-or-later
"""The grids of light that a baked volume shows, from a `Field`. Needs no Blender."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import Array, Floats, Spectrum
from ..transport.box import Box
from ..transport.field import Field
from ..transport.lights.base import Light
from ..transport.lights.distant import Sun
from ..transport.medium import Domain
from ..transport.ordinates.moments import beside_beams, of_lobes, way_of
from ..transport.ordinates.quadrature import FACTORS
from .vdb import AXES, direct_grid, flux_grid, forward_grid, moment_grid

_SPHERE = np.float32(4 * np.pi)  # sr

type Grids = dict[str, Array]  # {name: (bands, nx, ny, nz)}
type Shown = tuple[Array, Grids, Array]  # light, others, forward light by beam


def volume_light(
    field: Field, lights: Sequence[Light], mode: str, g: Spectrum = 0.0
) -> tuple[Array, Grids, list[Any]]:
    """The light in the `Field` of `lights` as a baked volume shows it: (light, others, beams).

    g       mean cosine of the medium's phase function, scalar or (bands,)
    light   (bands, nx, ny, nz) W/(m^2 sr), mean radiance of light from many directions
    others  {name of a grid: (bands, nx, ny, nz)}
            lb_flux_x, … are the components of that light's net flux over its fluence, from 0 to 1.
            lb_direct_1, … are the mean radiance of each beam's uncollided light, and
            lb_forward_1, … that of its light that has since scattered only by small angles: in
            W/(m^2 sr) for a sun; in W/sr, over the lamp's falloff with a core of a voxel, for a
            point or spot
    beams   the Sun, PointLight or SpotLight of each lb_direct

    If the scattered light comes from a source iteration, lb_light and lb_moment_1, … are the
    moments of the light that scatters, in W/(m^2 sr), one for each of `quadrature.polynomials`.
    Then there is no net flux, and lb_forward_1, … are the light of its lobes.
    Over its source ("ADD") a volume shows only scattered light; Cycles scatters the rest there.
    All light of the paper's model is shown as if it came evenly from all sides.
    """
    if field.by_light is None:
        return (field.fluence + field.direct) / _SPHERE, {}, []
    numbers = [n for n, light in enumerate(lights) if light.is_beam]
    beams = [lights[n] for n in numbers]
    grids = []
    if mode == "REPLACE":
        grids.append((direct_grid, field.by_light[numbers]))
    show = _lobe_of_flux if field.scattered is None else _moments
    light, others, forward = show(field, numbers, beams, mode, g)
    if forward.any():
        grids.append((forward_grid, forward))
    for name, by_beam in grids:
        for number, (beam, values) in enumerate(zip(beams, by_beam, strict=True), 1):
            # Near a lamp, light falls off too steeply to be interpolated; the quotient is smooth.
            steep = 1 if isinstance(beam, Sun) else _falloff(beam, field.domain)
            others[name(number)] = values / (_SPHERE * steep)
    return light, others, beams if grids else []


def _lobe_of_flux(
    field: Field, numbers: list[int], beams: list[Any], mode: str, g: Spectrum
) -> Shown:
    """Forward light by beam, and the other light as one lobe about its flux."""
    assert field.by_light is not None
    assert field.flux is not None
    fluence, flux = field.fluence, field.flux
    # Add the uncollided light that does not come from a beam.
    if mode == "REPLACE":
        direct = field.direct - field.by_light[numbers].sum(axis=0)
        # Rounding can make it negative where all light is in beams.
        fluence = fluence + np.maximum(direct, 0)
        if field.direct_flux is not None:
            flux = flux + field.direct_flux
            for beam, light in zip(beams, field.by_light[numbers], strict=True):
                flux = flux - way_of(beam, field.domain) * light[:, None]
    # Subtract the forward light of the beams.
    forward: Array = np.zeros((0,))
    if field.forward is not None:
        forward = np.minimum(field.forward[numbers], field.fluence)
    # Light that has scattered forwards once has the mean cosine g; the lattice counts it as 1.
    straight = (1 + np.reshape(g, (-1, 1, 1, 1))) / 2
    for beam, light in zip(beams, forward, strict=True) if forward.any() else ():
        fluence = fluence - light
        # If it stayed in the flux, it would hide light that comes back the other way.
        flux = flux - way_of(beam, field.domain) * (straight * light)[:, None]
    fluence = np.maximum(fluence, 0)  # the forward light of several beams may exceed it
    # Show the rest with its mean direction.
    drift = _drift(fluence, flux)
    others = {flux_grid(axis): drift[:, number] for number, axis in enumerate(AXES)}
    return fluence / _SPHERE, others, forward


def _moments(field: Field, numbers: list[int], beams: list[Any], mode: str, g: Spectrum) -> Shown:
    """The moments and the lobes of the source iteration."""
    assert field.scattered is not None
    moments = field.scattered.moments
    if mode == "REPLACE":
        box, ways = Box.all(field.domain.shape), [way_of(beam, field.domain) for beam in beams]
        by_band = np.broadcast_to(g, len(moments))
        direct = []
        for band, cosine in enumerate(by_band):
            fluence, flux = beside_beams(field, band, numbers, ways, box)
            direct.append(of_lobes(fluence, flux, cosine))
        moments = moments + np.array(direct, np.float32)
    moments = moments * FACTORS.astype(np.float32).reshape(-1, 1, 1, 1)
    others = {moment_grid(n): moments[:, n] for n in range(1, len(FACTORS))}
    return moments[:, 0], others, field.scattered.lobes


def _falloff(lamp: Any, domain: Domain) -> Array:
    falloff: Floats = lamp.mean_falloff(domain, core=domain.voxel_size)
    return falloff.astype(np.float32)


def _drift(fluence: Floats, flux: Floats) -> Floats:
    """(bands, 3, nx, ny, nz), of length 1 at most: the flux over the fluence."""
    total = fluence[:, None]
    drift = np.divide(flux, total, out=np.zeros_like(flux), where=total > 0)
    return drift / np.maximum(np.linalg.norm(drift, axis=1, keepdims=True), 1)
