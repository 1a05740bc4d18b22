# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that volumes make themselves: flames, black bodies, and what glows evenly.

Materials are read in Blender; `shining` needs none, and is done in the solver's process.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Floats, Integers
from ..errors import SceneError
from ..transport.medium import Domain
from .grids.resample import Readable, averaged
from .nodes.arithmetic import Scaled
from .nodes.attributes import Attributes
from .nodes.black_body import black_body_color
from .nodes.shaders import Closure, Shader

if TYPE_CHECKING:
    import bpy

SHINING_NODES = {"EMISSION", "PRINCIPLED_VOLUME", "VOLUME_COEFFICIENTS"}
DARK_NODES = {"VOLUME_SCATTER", "VOLUME_ABSORPTION"}
# Stefan's and Boltzmann's constant over pi, W/(m^2 sr K^4), and Cycles' scale of it.
_BLACK = 5.670373e-8 / np.pi * 1e-6


@dataclass(frozen=True)
class Glow:
    """Emission of one colour.

    color     (3,) W/(m^3 sr), at a strength of 1
    strength  name of the grid that it is multiplied by, or None
    limit     what counts of that grid at most
    """

    color: tuple[float, ...]
    strength: str | None = None
    limit: float = np.inf

    @property
    def grids(self) -> list[str]:
        return [self.strength] if self.strength else []

    needed = grids  # those without which there is no light

    def radiance(self, values: Mapping[str, Floats]) -> Floats:
        """(..., 3) W/(m^3 sr) where the grids have the `values`, {name: (...)}."""
        strength = Scaled(1.0, self.strength, self.limit).of(values)
        return np.multiply.outer(strength, self.color)


@dataclass(frozen=True)
class BlackBody:
    """Emission by temperature, as a Principled Volume has it.

    tint         (3,), a factor
    intensity    share, 0 to 1 or more, that Stefan's and Boltzmann's law has in the strength
    temperature  K; both are `Scaled`
    named        whether the temperature's grid is only named, so that it counts as 1 without it
    """

    tint: tuple[float, ...]
    intensity: Scaled
    temperature: Scaled
    named: bool = True

    @property
    def grids(self) -> list[str]:
        return [s.attribute for s in (self.intensity, self.temperature) if s.attribute]

    @property
    def needed(self) -> list[str]:
        return [n for n in self.grids if not self.named or n != self.temperature.attribute]

    def radiance(self, values: Mapping[str, Floats]) -> Floats:
        """(..., 3) W/(m^3 sr) where the grids have the `values`, {name: (...)}."""
        share = self.intensity.of(values)
        kelvin = np.maximum(self.temperature.of(values), 0.0)
        strength = np.where(share > 0, _BLACK * np.maximum(1 + share * (kelvin**4 - 1), 0), 0)
        return strength[..., None] * black_body_color(kelvin) * self.tint


def volume_glows(
    material: bpy.types.Material | None, attributes: Attributes | None = None
) -> list[Glow | BlackBody]:
    """[Glow | BlackBody] of the volume of a material.

    attributes  what finds the attributes of the object that shows it, see attributes.py

    Definitions as in Cycles, which the tests hold it to: emission does not follow the density.
    Raises SceneError for nodes that cannot be read.
    """
    if material is None:
        return []
    shader = Shader(material, attributes=attributes)
    found = shader.closures("Volume", SHINING_NODES, ignored=DARK_NODES)
    return [glow for closure in found for glow in _glows(shader, closure)]


def _glows(shader: Shader, closure: Closure) -> list[Glow | BlackBody]:
    kind = closure.node.type
    if kind == "VOLUME_COEFFICIENTS":
        color = closure.weight * shader.color(closure, "Emission Coefficients")
        return [Glow(tuple(color))] if color.any() else []
    names = ("Color", "Strength") if kind == "EMISSION" else ("Emission Color", "Emission Strength")
    strength = shader.scaled_attribute(closure, names[1])
    glows: list[Glow | BlackBody] = []
    if strength.scale > 0:
        color = closure.weight * strength.scale * shader.color(closure, names[0])
        glow = Glow(tuple(color), strength.attribute, strength.limit)
        glows = [glow] if color.any() else []
    if kind == "PRINCIPLED_VOLUME":
        glows += _black_body(shader, closure)
    return glows


def _black_body(shader: Shader, closure: Closure) -> list[BlackBody]:
    intensity = shader.scaled_attribute(closure, "Blackbody Intensity")
    tint = closure.weight * shader.color(closure, "Blackbody Tint")
    if intensity.scale <= 0 or not tint.any():
        return []
    temperature = shader.scaled_attribute(closure, "Temperature")
    named = shader.text(closure, "Temperature Attribute")
    if named and temperature.attribute:
        raise SceneError(
            f"'{shader.owner.name}' multiplies the temperatures '{named}' and "
            f"'{temperature.attribute}'; clear one of them."
        )
    if named:
        temperature = replace(temperature, attribute=named)
    return [BlackBody(tuple(tint), intensity, temperature, named=bool(named))]


def shining(
    glows: Sequence[Glow | BlackBody],
    cells: Mapping[str, Readable],
    inside: Readable,
    domain: Domain,
) -> Floats:
    """(3, nx, ny, nz) W/(m^3 sr): what `glows` emit, averaged over the voxels of `domain`.

    Between voxels what they shine with is interpolated, not their temperatures, as in Cycles.

    cells   {name: `Readable`} of the grids that there are: others are 0, named temperatures 1
    inside  `Readable` over 0 where what has no grid shines
    """
    total = np.zeros((3, *domain.shape), np.float32)
    for glow in glows:
        known = [name for name in glow.grids if name in cells]
        if not set(glow.needed) <= set(known):
            continue
        place = cells[known[0]] if known else inside
        total += averaged(place, domain, partial(_radiance, glow, known, cells, place), (3,))
    return total


def _radiance(
    glow: Glow | BlackBody,
    known: Collection[str],
    cells: Mapping[str, Readable],
    place: Readable,
    first: Integers,
    values: Floats,
) -> Floats:
    """(3, ...) float32: what a glow emits in a block of `place`, with the `known` grids."""
    shape = values.shape[-3:]
    given = {
        name: values if cells[name] is place else cells[name].at(place.index_to_world, first, shape)
        for name in known
    }
    radiance = glow.radiance({name: _scalar(block, shape) for name, block in given.items()})
    if not known:
        radiance = (_scalar(values, shape) > 0)[..., None] * radiance
    return np.moveaxis(np.asarray(radiance, np.float32), -1, 0)


def _scalar(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Of a vector in each voxel the mean of its components, as Cycles takes it."""
    if values.ndim == 3:
        return values
    return values.mean(axis=0 if values.shape[1:] == shape else -1)
