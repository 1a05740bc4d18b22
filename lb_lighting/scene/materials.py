# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender materials as optical coefficients: volumes, and leaves as a turbid medium."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Floats, Vector
from ..errors import SceneError
from ..ours import TAG
from ..transport.medium import Optics
from .nodes.arithmetic import Scaled
from .nodes.attributes import Attributes
from .nodes.links import GROUPS, Node
from .nodes.shaders import Closure, Shader, may_be_positive

if TYPE_CHECKING:
    import bpy

VOLUME_NODES = {
    "PRINCIPLED_VOLUME",
    "VOLUME_SCATTER",
    "VOLUME_ABSORPTION",
    "VOLUME_COEFFICIENTS",
}
REFLECTING_NODES = {"BSDF_DIFFUSE", "BSDF_GLOSSY", "SUBSURFACE_SCATTERING"}
LEAF_NODES = REFLECTING_NODES | {"BSDF_PRINCIPLED", "BSDF_TRANSLUCENT", "BSDF_TRANSPARENT"}
# Inputs of which all of one row have to be positive for a closure to shine.
EMISSION_INPUTS: dict[str, list[tuple[str, ...]]] = {
    "EMISSION": [("Strength", "Color")],
    "PRINCIPLED_VOLUME": [
        ("Emission Strength", "Emission Color"),
        ("Blackbody Intensity", "Blackbody Tint"),
    ],
    "VOLUME_COEFFICIENTS": [("Emission Coefficients",)],
}
BAKED_VOLUME = "LB Volume Light"  # what the node group of a baked volume is tagged with
DEFAULT_REFLECTANCE = 0.8  # of a surface without a material, as Cycles renders it


@dataclass(frozen=True)
class VolumeOptics:
    """A volume material.

    optics             `Optics` where the density attribute is 1, or everywhere without one; of
                       a volume that only shines, 0
    density_attribute  name of the grid that multiplies the coefficients, or None
    limit              what counts of that grid at most
    needs_grid         whether a volume without that grid is empty, not of density 1
    """

    optics: Optics
    density_attribute: str | None
    limit: float = np.inf
    needs_grid: bool = False

    @property
    def is_clear(self) -> bool:
        """Whether light passes as if it were not there."""
        return not np.any(np.add(self.optics.sigma_s, self.optics.sigma_a))


@dataclass(frozen=True)
class Leaf:
    """A leaf's surface, for light of any direction and both sides alike.

    reflectance    (3,), share of the light that goes back
    transmittance  (3,), share of the light that goes through, scattered
    coverage       share of the surface that is there at all, the rest being transparent
    """

    reflectance: tuple[float, ...]
    transmittance: tuple[float, ...]
    coverage: float = 1.0

    @property
    def optics(self) -> Optics:
        """`Optics` for an extinction of 1 1/m: they multiply `foliage_density` times `coverage`.

        g = 4/9 (tau - rho)/(tau + rho) is the mean cosine of leaves turned every way (Ross 1981).
        """
        rho, tau = np.array(self.reflectance), np.array(self.transmittance)
        albedo = rho + tau
        g = np.divide(4 / 9 * (tau - rho), albedo, out=np.zeros(3), where=albedo > 0)
        return grey(Optics(tuple(albedo), tuple(1 - albedo), tuple(g)))


@dataclass(frozen=True)
class _VolumePart:
    """What one closure adds to a volume.

    sigma_s, sigma_a  (3,) 1/m where the density is 1
    needs_grid        whether the density is 0 without its grid, not 1
    """

    sigma_s: Floats
    sigma_a: Floats
    g: float
    density: Scaled
    needs_grid: bool


def grey(optics: Optics) -> Optics:
    """`optics` with scalars where all its bands are equal, so that one band is solved."""
    values = [np.atleast_1d(v) for v in (optics.sigma_s, optics.sigma_a, optics.g)]
    if any(np.ptp(v) for v in values):
        return optics
    return Optics(*(float(v[0]) for v in values))


def tinted(optics: Optics, color: Vector) -> Optics:
    """`optics` that absorb all but `color`, (3,) of 0 to 1, of what they scatter."""
    scattered = np.multiply(optics.sigma_s, color)
    absorbed = np.add(optics.sigma_a, np.subtract(optics.sigma_s, scattered))
    return grey(Optics(tuple(scattered), tuple(absorbed), optics.g))


def volume_optics(
    material: bpy.types.Material | None, attributes: Attributes | None = None
) -> VolumeOptics | None:
    """The `VolumeOptics` of a material, or None where it has no volume.

    attributes  what finds the attributes of the object that shows it, see attributes.py

    Definitions as in Cycles (intern/cycles/kernel/svm/closure.h), which the tests hold it to.
    Raises SceneError for nodes that cannot be read as constants times one density attribute.
    """
    if material is None:
        return None
    if baked := _baked_optics(material):
        return baked
    shader = Shader(material, attributes=attributes)
    if not has_volume(material):
        shader.refuse_circle()
        return None
    closures = shader.closures("Volume", VOLUME_NODES, ignored={"EMISSION"})
    parts = [_volume_closure(shader, closure) for closure in closures]
    # What is of no density does not matter, whatever grid it has.
    parts = [part for part in parts if part.density.scale > 0]
    sigma_s, sigma_a, moment = np.zeros((3, 3))
    for part in parts:
        sigma_s += part.sigma_s * part.density.scale
        sigma_a += part.sigma_a * part.density.scale
        moment += part.sigma_s * part.density.scale * part.g
    grids = {(part.density.attribute, part.density.limit) for part in parts}
    if len(grids) > 1:
        raise SceneError(
            f"The volume nodes of '{material.name}' use different density attributes; "
            "give all of them the same."
        )
    attribute, limit = grids.pop() if grids else (None, np.inf)
    g: Floats = np.divide(moment, sigma_s, out=np.zeros(3), where=sigma_s > 0)
    optics = grey(Optics(tuple(sigma_s), tuple(sigma_a), tuple(g)))
    return VolumeOptics(optics, attribute, limit, any(part.needs_grid for part in parts))


def has_surface(material: bpy.types.Material | None) -> bool:
    """Whether a surface is rendered; without a material there is a plain one."""
    if material is None:
        return True
    return bool(Shader(material).reaching("Surface"))


def has_volume(material: bpy.types.Material | None) -> bool:
    """Whether a volume is rendered, be it one that `volume_optics` can read or not."""
    return material is not None and any(
        closure.node.type != "EMISSION" or _shines(closure)
        for closure in Shader(material).reaching("Volume")
    )


def first_volume(
    materials: Sequence[bpy.types.Material | None],
) -> bpy.types.Material | None:
    """The one of the `materials` of a grid's slots that Cycles renders it with, or None.

    It is the first that has a volume, or just the first where none has; for an empty slot Cycles
    has a material of its own.
    """
    first = materials[0] if materials else None
    return next((m for m in materials if m is None or has_volume(m)), first)


def volume_shines(material: bpy.types.Material | None) -> bool:
    """Whether the volume of a material makes light itself."""
    return material is not None and any(map(_shines, Shader(material).reaching("Volume")))


def _shines(closure: Closure) -> bool:
    return any(
        all(may_be_positive(closure, name) for name in factors)
        for factors in EMISSION_INPUTS.get(closure.node.type, ())
    )


def leaf_optics(material: bpy.types.Material | None, attributes: Attributes | None = None) -> Leaf:
    """The `Leaf` that a surface material makes; a plain grey one for None.

    attributes  what finds the attributes of the object that shows it, see attributes.py

    Raises SceneError for nodes that cannot be read, or that make light.
    """
    if material is None:
        return Leaf((DEFAULT_REFLECTANCE,) * 3, (0.0,) * 3)
    shader = Shader(material, attributes=attributes)
    rho, tau, clear = np.zeros(3), np.zeros(3), 0.0
    for closure in shader.closures("Surface", LEAF_NODES, ignored={"EMISSION"}):
        reflected, transmitted, transparent = _leaf_closure(shader, closure)
        rho += closure.weight * reflected
        tau += closure.weight * transmitted
        clear += closure.weight * transparent
    coverage = max(0.0, 1 - clear)
    if np.any(rho + tau > coverage + 1e-6):
        raise SceneError(
            f"'{material.name}' sends out more light than falls on it; mix its shaders "
            "instead of adding them."
        )
    share = coverage or 1.0
    return Leaf(tuple(rho / share), tuple(tau / share), coverage)


def _baked_optics(material: bpy.types.Material) -> VolumeOptics | None:
    """The `VolumeOptics` that a baked volume was lit with, copies of which are baked, too; None for
    any other material."""
    nodes: Iterable[Node] = material.node_tree.nodes if material.node_tree else ()
    for node in nodes:
        tree = node.node_tree if node.type in GROUPS else None
        if tree and tree.get(TAG) == BAKED_VOLUME:
            values = (
                tuple(node.inputs[name].default_value) for name in ("Sigma S", "Sigma A", "G")
            )
            return VolumeOptics(grey(Optics(*values)), "density")
    return None


def _volume_closure(shader: Shader, closure: Closure) -> _VolumePart:
    kind = closure.node.type
    if kind == "VOLUME_COEFFICIENTS":
        scattering = shader.color(closure, "Scatter Coefficients")
        absorption = shader.color(closure, "Absorption Coefficients")
        g = _mean_cosine(shader, closure)
        return _VolumePart(scattering, absorption, g, Scaled(closure.weight), False)
    density = shader.scaled_attribute(closure, "Density")
    density = replace(density, scale=closure.weight * max(0.0, density.scale))
    linked = density.attribute is not None
    color = shader.color(closure, "Color")
    if kind == "VOLUME_SCATTER":
        return _VolumePart(color, np.zeros(3), _mean_cosine(shader, closure), density, linked)
    if kind == "VOLUME_ABSORPTION":
        return _VolumePart(np.zeros(3), np.maximum(0, 1 - color), 0.0, density, linked)
    _refuse_color_attribute(shader, closure)
    named = shader.text(closure, "Density Attribute")
    if named and linked:
        raise SceneError(
            f"'{shader.owner.name}' multiplies the density attributes '{named}' and "
            f"'{density.attribute}'; clear one of them."
        )
    if named:
        density = replace(density, attribute=named)
    tint = np.sqrt(np.maximum(0, shader.color(closure, "Absorption Color")))
    absorption = np.maximum(0, 1 - color) * np.maximum(0, 1 - tint)
    g = shader.number(closure, "Anisotropy")
    return _VolumePart(color, absorption, g, density, linked)


def _refuse_color_attribute(shader: Shader, closure: Closure) -> None:
    attribute = shader.text(closure, "Color Attribute")
    if attribute:
        raise SceneError(
            f"The colour of '{shader.owner.name}' follows the attribute '{attribute}', but one "
            "colour is needed for the whole volume; clear Color Attribute."
        )


def _mean_cosine(shader: Shader, closure: Closure) -> float:
    phase = closure.node.phase
    if phase == "RAYLEIGH":
        return 0.0
    if phase != "HENYEY_GREENSTEIN":
        raise SceneError(
            f"'{shader.owner.name}' scatters by the phase function '{phase.title()}'; "
            "choose Henyey-Greenstein or Rayleigh."
        )
    return shader.number(closure, "Anisotropy")


def _leaf_closure(shader: Shader, closure: Closure) -> tuple[Floats, Floats, float]:
    """(reflectance (3,), transmittance (3,), transparency) of one closure."""
    kind = closure.node.type
    dark = np.zeros(3)
    if kind == "BSDF_PRINCIPLED":
        color = shader.color(closure, "Base Color")
        alpha = shader.number(closure, "Alpha")
        through = shader.number(closure, "Transmission Weight")
        # A metal reflects and lets nothing through, whatever its transmission.
        through *= 1 - shader.number(closure, "Metallic")
        return alpha * (1 - through) * color, alpha * through * color, 1 - alpha
    color = shader.color(closure, "Color")
    if kind == "BSDF_TRANSPARENT":
        return dark, dark, float(color.mean())
    return (color, dark, 0.0) if kind in REFLECTING_NODES else (dark, color, 0.0)
