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
# A closure emits light if all inputs of one of its rows are positive.
EMISSION_INPUTS: dict[str, list[tuple[str, ...]]] = {
    "EMISSION": [("Strength", "Color")],
    "PRINCIPLED_VOLUME": [
        ("Emission Strength", "Emission Color"),
        ("Blackbody Intensity", "Blackbody Tint"),
    ],
    "VOLUME_COEFFICIENTS": [("Emission Coefficients",)],
}
BAKED_VOLUME = "LB Volume Light"  # tag of the node group of a baked volume
DEFAULT_REFLECTANCE = 0.8  # of a surface without a material, as in Cycles


@dataclass(frozen=True)
class VolumeOptics:
    """A volume material.

    optics             `Optics` at a value of 1 of the density attribute; 0 for a volume that only
                       emits light
    density_attribute  name of the grid that multiplies the coefficients, or None
    limit              upper limit on the values of that grid
    needs_grid         whether the volume is empty if it lacks that grid; otherwise its density is 1
    """

    optics: Optics
    density_attribute: str | None
    limit: float = np.inf
    needs_grid: bool = False

    @property
    def is_clear(self) -> bool:
        """Whether light passes without being scattered or absorbed."""
        return not np.any(np.add(self.optics.sigma_s, self.optics.sigma_a))


@dataclass(frozen=True)
class Leaf:
    """The surface of a leaf, the same on both sides and for all directions of light.

    reflectance    (3,), share of the light that is reflected
    transmittance  (3,), share of the light that is scattered through the leaf
    coverage       share of the surface that is not transparent
    """

    reflectance: tuple[float, ...]
    transmittance: tuple[float, ...]
    coverage: float = 1.0

    @property
    def optics(self) -> Optics:
        """`Optics` at an extinction of 1 1/m, to multiply by `foliage_density` and `coverage`.

        The mean cosine of randomly oriented leaves is g = 4/9 (tau - rho)/(tau + rho) (Ross 1981).
        """
        rho, tau = np.array(self.reflectance), np.array(self.transmittance)
        albedo = rho + tau
        g = np.divide(4 / 9 * (tau - rho), albedo, out=np.zeros(3), where=albedo > 0)
        return grey(Optics(tuple(albedo), tuple(1 - albedo), tuple(g)))


@dataclass(frozen=True)
class _VolumePart:
    """The contribution of one closure to a volume.

    sigma_s, sigma_a  (3,) 1/m at a density of 1
    needs_grid        whether the density is 0 if its grid is missing; otherwise it is 1
    """

    sigma_s: Floats
    sigma_a: Floats
    g: float
    density: Scaled
    needs_grid: bool


def grey(optics: Optics) -> Optics:
    """`optics` as scalars if all bands are equal, so that only one band is solved."""
    values = [np.atleast_1d(v) for v in (optics.sigma_s, optics.sigma_a, optics.g)]
    if any(np.ptp(v) for v in values):
        return optics
    return Optics(*(float(v[0]) for v in values))


def tinted(optics: Optics, color: Vector) -> Optics:
    """`optics` that scatter only the share `color`, (3,) from 0 to 1, and absorb the other part."""
    scattered = np.multiply(optics.sigma_s, color)
    absorbed = np.add(optics.sigma_a, np.subtract(optics.sigma_s, scattered))
    return grey(Optics(tuple(scattered), tuple(absorbed), optics.g))


def volume_optics(
    material: bpy.types.Material | None, attributes: Attributes | None = None
) -> VolumeOptics | None:
    """The `VolumeOptics` of a material, or None if it has no volume.

    attributes  from `object_attributes` of the object that has the material

    Definitions are those of Cycles (intern/cycles/kernel/svm/closure.h), as tests check.
    Raises SceneError for nodes other than constants times one density attribute.
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
    # Drop closures without density: their grids do not matter.
    parts = [part for part in parts if part.density.scale > 0]
    # Sum the coefficients, and average the mean cosine by scattering.
    sigma_s, sigma_a, moment = np.zeros((3, 3))
    for part in parts:
        sigma_s += part.sigma_s * part.density.scale
        sigma_a += part.sigma_a * part.density.scale
        moment += part.sigma_s * part.density.scale * part.g
    grids = {(part.density.attribute, part.density.limit) for part in parts}
    if len(grids) > 1:
        raise SceneError(
            f"The volume nodes of '{material.name}' use different density attributes; "
            "use the same one for all of them."
        )
    attribute, limit = grids.pop() if grids else (None, np.inf)
    g: Floats = np.divide(moment, sigma_s, out=np.zeros(3), where=sigma_s > 0)
    optics = grey(Optics(tuple(sigma_s), tuple(sigma_a), tuple(g)))
    return VolumeOptics(optics, attribute, limit, any(part.needs_grid for part in parts))


def has_surface(material: bpy.types.Material | None) -> bool:
    """Whether the material renders a surface; None renders a plain one."""
    if material is None:
        return True
    return bool(Shader(material).reaching("Surface"))


def has_volume(material: bpy.types.Material | None) -> bool:
    """Whether the material renders a volume, supported by `volume_optics` or not."""
    return material is not None and any(
        closure.node.type != "EMISSION" or _emits(closure)
        for closure in Shader(material).reaching("Volume")
    )


def first_volume(
    materials: Sequence[bpy.types.Material | None],
) -> bpy.types.Material | None:
    """The one of the `materials` in a volume object's slots that Cycles renders, or None.

    It is the first that has a volume, or else the first of all. Cycles renders an empty slot with a
    default volume material.
    """
    first = materials[0] if materials else None
    return next((m for m in materials if m is None or has_volume(m)), first)


def volume_shines(material: bpy.types.Material | None) -> bool:
    """Whether the volume of a material emits light."""
    return material is not None and any(map(_emits, Shader(material).reaching("Volume")))


def _emits(closure: Closure) -> bool:
    return any(
        all(may_be_positive(closure, name) for name in names)
        for names in EMISSION_INPUTS.get(closure.node.type, ())
    )


def leaf_optics(material: bpy.types.Material | None, attributes: Attributes | None = None) -> Leaf:
    """The `Leaf` of a surface material; a plain grey one for None.

    attributes  from `object_attributes` of the object that has the material

    Raises SceneError for unsupported nodes, or for shaders that reflect and transmit more light
    than they receive.
    """
    if material is None:
        return Leaf((DEFAULT_REFLECTANCE,) * 3, (0.0,) * 3)
    shader = Shader(material, attributes=attributes)
    rho, tau, transparency = np.zeros(3), np.zeros(3), 0.0
    for closure in shader.closures("Surface", LEAF_NODES, ignored={"EMISSION"}):
        reflected, transmitted, transparent = _leaf_closure(shader, closure)
        rho += closure.weight * reflected
        tau += closure.weight * transmitted
        transparency += closure.weight * transparent
    coverage = max(0.0, 1 - transparency)
    if np.any(rho + tau > coverage + 1e-6):
        raise SceneError(
            f"'{material.name}' reflects and transmits more light than it receives; mix its "
            "shaders instead of adding them."
        )
    share = coverage or 1.0
    return Leaf(tuple(rho / share), tuple(tau / share), coverage)


def _baked_optics(material: bpy.types.Material) -> VolumeOptics | None:
    """The `VolumeOptics` that a baked volume was lit with, or None for any other material.

    Copies of a baked volume can be baked again.
    """
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
    has_grid = density.attribute is not None
    color = shader.color(closure, "Color")
    if kind == "VOLUME_SCATTER":
        return _VolumePart(color, np.zeros(3), _mean_cosine(shader, closure), density, has_grid)
    if kind == "VOLUME_ABSORPTION":
        return _VolumePart(np.zeros(3), np.maximum(0, 1 - color), 0.0, density, has_grid)
    # A Principled Volume: it can also name the attribute of its density.
    _refuse_color_attribute(shader, closure)
    name = shader.text(closure, "Density Attribute")
    if name and has_grid:
        raise SceneError(
            f"'{shader.owner.name}' multiplies the density attributes '{name}' and "
            f"'{density.attribute}'; clear one of them."
        )
    if name:
        density = replace(density, attribute=name)
    tint = np.sqrt(np.maximum(0, shader.color(closure, "Absorption Color")))
    absorption = np.maximum(0, 1 - color) * np.maximum(0, 1 - tint)
    g = shader.number(closure, "Anisotropy")
    return _VolumePart(color, absorption, g, density, has_grid)


def _refuse_color_attribute(shader: Shader, closure: Closure) -> None:
    attribute = shader.text(closure, "Color Attribute")
    if attribute:
        raise SceneError(
            f"The colour of '{shader.owner.name}' follows the attribute '{attribute}', but a bake "
            "needs one colour for the whole volume; clear Color Attribute."
        )


def _mean_cosine(shader: Shader, closure: Closure) -> float:
    phase = closure.node.phase
    if phase == "RAYLEIGH":
        return 0.0
    if phase != "HENYEY_GREENSTEIN":
        raise SceneError(
            f"'{shader.owner.name}' uses the phase function '{phase.title()}', which is not "
            "supported; choose Henyey-Greenstein or Rayleigh."
        )
    return shader.number(closure, "Anisotropy")


def _leaf_closure(shader: Shader, closure: Closure) -> tuple[Floats, Floats, float]:
    """(reflectance (3,), transmittance (3,), transparency) of one closure."""
    kind = closure.node.type
    black = np.zeros(3)
    if kind == "BSDF_PRINCIPLED":
        color = shader.color(closure, "Base Color")
        alpha = shader.number(closure, "Alpha")
        transmission = shader.number(closure, "Transmission Weight")
        # The metallic share transmits nothing.
        transmission *= 1 - shader.number(closure, "Metallic")
        return alpha * (1 - transmission) * color, alpha * transmission * color, 1 - alpha
    color = shader.color(closure, "Color")
    if kind == "BSDF_TRANSPARENT":
        return black, black, float(color.mean())
    return (color, black, 0.0) if kind in REFLECTING_NODES else (black, color, 0.0)
