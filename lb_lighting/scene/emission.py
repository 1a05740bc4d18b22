# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that volumes make themselves: flames, black bodies, and what glows evenly.

Materials are read in Blender; `shining` needs none, and is done in the solver's process.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import SceneError
from .shaders import Shader
from .volumes import resample_array

SHINING_NODES = {"EMISSION", "PRINCIPLED_VOLUME", "VOLUME_COEFFICIENTS"}
DARK_NODES = {"VOLUME_SCATTER", "VOLUME_ABSORPTION"}
# Stefan's and Boltzmann's constant over pi, W/(m^2 sr K^4), and Cycles' scale of it.
_BLACK = 5.670373e-8 / np.pi * 1e-6
_COLDEST, _HOTTEST = 800.0, 12000.0  # K, between which Blender knows colours


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
    colors            (n, 4): temperatures, K, and the colours that Blender gives them
    """

    tint: tuple
    intensity: float
    temperature: float
    intensity_grid: str | None
    temperature_grid: str | None
    colors: np.ndarray

    @property
    def grids(self):
        return [name for name in (self.intensity_grid, self.temperature_grid) if name]

    def radiance(self, values):
        """(..., 3) W/(m^3 sr) where the grids have the `values`, {name: (...)}."""
        share = self.intensity * values.get(self.intensity_grid, 1.0)
        kelvin = self.temperature * np.maximum(values.get(self.temperature_grid, 1.0), 0.0)
        strength = np.where(share > 0, _BLACK * np.maximum(1 + share * (kelvin**4 - 1), 0), 0)
        color = [np.interp(kelvin, self.colors[:, 0], band) for band in self.colors[:, 1:].T]
        return strength[..., None] * np.stack(color, axis=-1) * self.tint


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
    colors = _black_body_colors()
    grid = named or linked
    return [BlackBody(tuple(tint), intensity, temperature, intensity_grid, grid, colors)]


def _black_body_colors():
    """(n, 4): temperatures, K, and linear colours of a luminance of 1, as Blender has them."""
    import bpy  # only now: `shining` runs where there is no Blender

    lamp = bpy.data.lights.new("temperatures", "POINT")
    lamp.use_temperature = True
    table = []
    for kelvin in np.geomspace(_COLDEST, _HOTTEST, 200):
        lamp.temperature = kelvin
        table.append((kelvin, *lamp.temperature_color))
    bpy.data.lights.remove(lamp)
    return np.array(table)


def shining(glows, cells, inside, domain):
    """(3, nx, ny, nz) W/(m^3 sr): what `glows` emit, averaged over the voxels of `domain`.

    Between voxels what they shine with is interpolated, not their temperatures, as in Cycles.

    cells   {name: `Cells`} of the grids that there are: others are 0, but as temperatures 1
    inside  `Cells` over 0 where what has no grid shines
    """
    total = np.zeros((3, *domain.shape), np.float32)
    for glow in glows:
        known = [name for name in glow.grids if name in cells]
        if isinstance(glow, Glow) and len(known) < len(glow.grids):
            continue
        place = cells[known[0]] if known else inside
        radiance = glow.radiance({name: cells[name].at(place) for name in known})
        if not known:
            radiance = (place.values > 0)[..., None] * radiance
        total += [resample_array(band, place.index_to_world, domain) for band in
                  np.moveaxis(np.asarray(radiance, np.float32), -1, 0)]  # fmt: skip
    return total
