# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that volumes make themselves: flames, black bodies, and what glows evenly.

Materials are read in Blender; `shining` needs none, and is done in the solver's process.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..errors import SceneError
from .resample import averaged
from .shaders import Shader

SHINING_NODES = {"EMISSION", "PRINCIPLED_VOLUME", "VOLUME_COEFFICIENTS"}
DARK_NODES = {"VOLUME_SCATTER", "VOLUME_ABSORPTION"}
# Stefan's and Boltzmann's constant over pi, W/(m^2 sr K^4), and Cycles' scale of it.
_BLACK = 5.670373e-8 / np.pi * 1e-6
_COLDEST, _HOTTEST = 800.0, 12000.0  # K, between which Blender knows colours
# Of the colours that Blender gives black bodies: polynomials in the logarithm of the temperature in
# 1000 K, by band, the highest power first. Fitted to them; they are within 0.002 (the tests).
_BLACK_COLORS = (
    (-0.0205316, 0.189166, -0.676005, 0.985976, 0.440387, -3.59694, 4.6013),
    (0.00460183, -0.04879, 0.198716, -0.31755, -0.141376, 1.07191, 0.0389298),
    (-0.00754266, 0.119195, -0.638263, 1.38747, -0.954002, 0.469202, -0.179434),
)


@dataclass(frozen=True)
class Glow:
    """Emission of one colour.

    color     (3,) W/(m^3 sr), at a strength of 1
    strength  name of the grid that it is multiplied by, or None
    """

    color: tuple
    strength: str | None = None

    @property
    def grids(self):
        return [self.strength] if self.strength else []

    def radiance(self, values):
        """(..., 3) W/(m^3 sr) where the grids have the `values`, {name: (...)}."""
        strength = values[self.strength] if self.strength else 1.0
        return np.multiply.outer(strength, self.color)


@dataclass(frozen=True)
class BlackBody:
    """Emission by temperature, as a Principled Volume has it.

    tint              (3,), a factor
    intensity         share, 0 to 1 or more, that Stefan's and Boltzmann's law has in the strength
    temperature       K
    intensity_grid, temperature_grid  names of grids that these are multiplied by, or None
    """

    tint: tuple
    intensity: float
    temperature: float
    intensity_grid: str | None
    temperature_grid: str | None

    @property
    def grids(self):
        return [name for name in (self.intensity_grid, self.temperature_grid) if name]

    def radiance(self, values):
        """(..., 3) W/(m^3 sr) where the grids have the `values`, {name: (...)}."""
        share = self.intensity * values.get(self.intensity_grid, 1.0)
        kelvin = self.temperature * np.maximum(values.get(self.temperature_grid, 1.0), 0.0)
        strength = np.where(share > 0, _BLACK * np.maximum(1 + share * (kelvin**4 - 1), 0), 0)
        return strength[..., None] * black_body_color(kelvin) * self.tint


def black_body_color(kelvin):
    """(..., 3): the linear colour (Rec. 709), of a luminance of 1, that Blender gives a black body.

    kelvin  (...) K, its temperature
    """
    logarithm = np.log(np.clip(kelvin, _COLDEST, _HOTTEST) / 1000)
    return np.maximum(np.stack([np.polyval(c, logarithm) for c in _BLACK_COLORS], axis=-1), 0)


def volume_glows(material):
    """[Glow | BlackBody] of the volume of a material.

    Definitions as in Cycles, which the tests hold it to: emission does not follow the density.
    Raises SceneError for nodes that cannot be read.
    """
    if material is None:
        return []
    shader = Shader(material)
    found = shader.closures("Volume", SHINING_NODES, ignored=DARK_NODES)
    return [glow for closure in found for glow in _glows(shader, closure)]


def _glows(shader, closure):
    kind = closure.node.type
    if kind == "VOLUME_COEFFICIENTS":
        color = closure.weight * shader.color(closure, "Emission Coefficients")
        return [Glow(tuple(color))] if color.any() else []
    names = ("Color", "Strength") if kind == "EMISSION" else ("Emission Color", "Emission Strength")
    strength, grid = shader.scaled_attribute(closure, names[1])
    glows = []
    if strength > 0:
        color = closure.weight * strength * shader.color(closure, names[0])
        glows = [Glow(tuple(color), grid)] if color.any() else []
    if kind == "PRINCIPLED_VOLUME":
        glows += _black_body(shader, closure)
    return glows


def _black_body(shader, closure):
    intensity, intensity_grid = shader.scaled_attribute(closure, "Blackbody Intensity")
    tint = closure.weight * shader.color(closure, "Blackbody Tint")
    if intensity <= 0 or not tint.any():
        return []
    temperature, linked = shader.scaled_attribute(closure, "Temperature")
    named = shader.text(closure, "Temperature Attribute") or None
    if named and linked:
        raise SceneError(
            f"'{shader.owner.name}' multiplies the temperatures '{named}' and '{linked}'; clear "
            "one of them."
        )
    return [BlackBody(tuple(tint), intensity, temperature, intensity_grid, named or linked)]


def shining(glows, cells, inside, domain):
    """(3, nx, ny, nz) W/(m^3 sr): what `glows` emit, averaged over the voxels of `domain`.

    Between voxels what they shine with is interpolated, not their temperatures, as in Cycles.

    cells   {name: `Readable`} of the grids that there are: others are 0, but as temperatures 1
    inside  `Readable` over 0 where what has no grid shines
    """
    total = np.zeros((3, *domain.shape), np.float32)
    for glow in glows:
        known = [name for name in glow.grids if name in cells]
        if isinstance(glow, Glow) and len(known) < len(glow.grids):
            continue
        place = cells[known[0]] if known else inside
        total += averaged(place, domain, partial(_radiance, glow, known, cells, place), (3,))
    return total


def _radiance(glow, known, cells, place, first, values):
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


def _scalar(values, shape):
    """Of a vector in each voxel the mean of its components, as Cycles takes it."""
    if values.ndim == 3:
        return values
    return values.mean(axis=0 if values.shape[1:] == shape else -1)
