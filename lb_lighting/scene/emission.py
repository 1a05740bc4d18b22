# SPDX-License-Identifier: GPL-3.0-or-later
"""Emission of volumes: flames, black bodies and even glow.

Materials are read in Blender. `shining` needs no Blender and runs in the solver's process.
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
# The Stefan-Boltzmann constant over pi, W/(m^2 sr K^4), times the factor that Cycles applies.
_BLACK = 5.670373e-8 / np.pi * 1e-6


@dataclass(frozen=True)
class Glow:
    """Emission of one colour.

    color     (3,) W/(m^3 sr), at a strength of 1
    strength  name of the grid that multiplies it, or None
    limit     upper limit on the values of that grid
    """

    color: tuple[float, ...]
    strength: str | None = None
    limit: float = np.inf

    @property
    def grids(self) -> list[str]:
        return [self.strength] if self.strength else []

    needed = grids  # without any of these, there is no light

    def radiance(self, values: Mapping[str, Floats]) -> Floats:
        """(..., 3) W/(m^3 sr) for grids with the `values` {name: (...)}."""
        strength = Scaled(1.0, self.strength, self.limit).of(values)
        return np.multiply.outer(strength, self.color)


@dataclass(frozen=True)
class BlackBody:
    """Emission by temperature, as in a Principled Volume.

    tint         (3,), a factor
    intensity    weight of the Stefan-Boltzmann law in the strength, 0 to 1 or more
    temperature  K
    named        whether the node names the temperature's grid; it then counts as 1 if missing
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
        """(..., 3) W/(m^3 sr) for grids with the `values` {name: (...)}."""
        share = self.intensity.of(values)
        kelvin = np.maximum(self.temperature.of(values), 0.0)
        strength = np.where(share > 0, _BLACK * np.maximum(1 + share * (kelvin**4 - 1), 0), 0)
        return strength[..., None] * black_body_color(kelvin) * self.tint


def volume_glows(
    material: bpy.types.Material | None, attributes: Attributes | None = None
) -> list[Glow | BlackBody]:
    """[Glow | BlackBody] of the volume of a material.

    attributes  from `object_attributes` of the object that has the material

    Definitions are those of Cycles, as tests check: emission does not depend on the density.
    Raises SceneError for unsupported nodes.
    """
    if material is None:
        return []
    shader = Shader(material, attributes=attributes)
    closures = shader.closures("Volume", SHINING_NODES, ignored=DARK_NODES)
    return [glow for closure in closures for glow in _glows(shader, closure)]


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
    name = shader.text(closure, "Temperature Attribute")
    if name and temperature.attribute:
        raise SceneError(
            f"'{shader.owner.name}' multiplies the temperature attributes '{name}' and "
            f"'{temperature.attribute}'; clear one of them."
        )
    if name:
        temperature = replace(temperature, attribute=name)
    return [BlackBody(tuple(tint), intensity, temperature, named=bool(name))]


def shining(
    glows: Sequence[Glow | BlackBody],
    cells: Mapping[str, Readable],
    inside: Readable,
    domain: Domain,
) -> Floats:
    """(3, nx, ny, nz) W/(m^3 sr): the emission of `glows`, averaged over the voxels of `domain`.

    As in Cycles, emission is interpolated between the voxels of a grid, not temperature.

    cells   {name: `Readable`} of the grids; missing grids are 0, missing named temperatures 1
    inside  `Readable` that is above 0 where glows without a grid emit
    """
    total = np.zeros((3, *domain.shape), np.float32)
    for glow in glows:
        names = [name for name in glow.grids if name in cells]
        if not set(glow.needed) <= set(names):
            continue
        grid = cells[names[0]] if names else inside
        total += averaged(grid, domain, partial(_radiance, glow, names, cells, grid), (3,))
    return total


def _radiance(
    glow: Glow | BlackBody,
    names: Collection[str],
    cells: Mapping[str, Readable],
    grid: Readable,
    first: Integers,
    values: Floats,
) -> Floats:
    """(3, ...) float32: the emission of a glow in a block of `grid`.

    names   of the grids in `cells` that the glow uses
    first   (3,), the first voxel of the block
    values  of `grid` in the block
    """
    shape = values.shape[-3:]
    blocks = {
        name: values if cells[name] is grid else cells[name].at(grid.index_to_world, first, shape)
        for name in names
    }
    radiance = glow.radiance({name: _scalar(block, shape) for name, block in blocks.items()})
    if not names:
        radiance = (_scalar(values, shape) > 0)[..., None] * radiance
    return np.moveaxis(np.asarray(radiance, np.float32), -1, 0)


def _scalar(values: Floats, shape: tuple[int, ...]) -> Floats:
    """`values` of a block; for vectors, the mean of their components, as in Cycles."""
    if values.ndim == 3:
        return values
    return values.mean(axis=0 if values.shape[1:] == shape else -1)
