# SPDX-License-Identifier: GPL-3.0-or-later
"""The lamps and the world of a Blender scene as lights for the solver."""

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Matrix

from ...arrays import Floats
from ...errors import LightError
from ...transport.lights.distant import Sky, Sun
from ...transport.lights.lamps import AreaLight, PointLight, SpotLight
from ...transport.lights.panorama import panorama_lights
from ..nodes.links import Groups, Node, Socket, resolve
from ..nodes.shaders import Closure, Shader, linear_pixels
from ..remarks import Remarks
from ..rendered import rendered_objects, world_matrix
from .emitters import mesh_lamps
from .light_nodes import (
    IN_VOLUMES,
    ON_SURFACES,
    LightShader,
    or_else,
)
from .receivers import SHADED, Receivers

type Lamp = Any  # bpy.types.Light, with properties that depend on its `type`
type SceneLight = Sun | Sky | PointLight | SpotLight | AreaLight

_MANY_BOUNCES = 32  # bounces of a lamp that leave too little light to matter
_NARROWEST = 1e-3  # rad, of cones: Blender allows 0, which lights nothing
_UNEVEN = 0.05  # relative difference of a spot's axes, and cosine between them

PATTERNS = "Baked with their colour and strength only, without the pattern from their nodes: {}."
NEGATIVE = "Left out, because negative light is not supported: {}."
FLAT = "Left out, because they are scaled to zero: {}."
UNEVEN = "Baked with a round cone, although their scale stretches or skews it: {}."
FEW_BOUNCES = "Max Bounces is ignored, so the light scatters more often: {}."
WORLD_VOLUME = (
    "The volume of {} is left out: it neither scatters nor absorbs light. To include it, add a box "
    "with that volume material and select it as well."
)


def scene_lights(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    notes: list[str],
    needed: bool = True,
    receivers: Receivers | None = None,
) -> list[SceneLight]:
    """[light]: all lamps that render, with their instances, emissive meshes, and the world.

    Points and spots of any radius become points, and suns of any angle become one direction.
    Lamps that are hidden in viewports only are included; of instances, only those that viewports
    show are.

    notes      list of sentences for the user; it receives notes on lights that are simplified
    needed     whether to raise LightError if there is no light
    receivers  the `Receivers` to light, or None to include lights that do not reach them and to
               leave out emissive meshes

    Raises LightError also for a world with unsupported nodes.
    """
    remarks = Remarks()
    lights = _lamps(depsgraph, receivers, remarks)
    if receivers:
        lights += mesh_lamps(depsgraph, receivers, remarks, notes)
    assert depsgraph.view_layer
    world = depsgraph.view_layer.world_override or scene.world
    if world:
        lights += _world(world, receivers, notes, remarks)
    notes.extend(remarks.sentences)
    if needed and not lights:
        reasons = "".join(f" {sentence}" for sentence in remarks.sentences)
        raise LightError(
            f"The scene has no light; add a lamp, or give the world a colour.{reasons}"
        )
    return lights


def _lamps(
    depsgraph: bpy.types.Depsgraph, receivers: Receivers | None, remarks: Remarks
) -> list[SceneLight]:
    assert depsgraph.view_layer
    rendered = rendered_objects(depsgraph.view_layer.layer_collection)
    instances: Iterable[Any] = depsgraph.object_instances
    lamps = [
        _light_of(instance.object, instance.matrix_world, receivers, remarks)
        for instance in instances
        if instance.is_instance and instance.show_self and _is_lamp(instance.object)
        if instance.parent.original in rendered and not instance.object.hide_render
    ]
    # Objects come last: to place hidden ones may evaluate the scene again.
    lamps += [
        _light_of(ob.evaluated_get(depsgraph), world_matrix(ob, depsgraph), receivers, remarks)
        for ob in rendered
        if _is_lamp(ob)
    ]
    return [lamp for lamp in lamps if lamp is not None]


def _light_of(
    ob: bpy.types.Object, matrix: Matrix, receivers: Receivers | None, remarks: Remarks
) -> SceneLight | None:
    """The light of an evaluated lamp object, or None if it lights nothing."""
    lamp: Lamp = ob.data
    strength = _strength(lamp, remarks)
    if np.any(strength < 0):
        remarks.add(NEGATIVE, ob.name)
        strength = np.maximum(strength, 0)
    if not np.any(strength):
        return None
    if receivers and not receivers.take_object(ob, remarks):
        return None
    if _is_flat(lamp, matrix):
        remarks.add(FLAT, ob.name)
        return None
    if not lamp.use_shadow:
        remarks.add(SHADED, ob.name)
    if _cycles(lamp) and lamp.cycles.max_bounces < _MANY_BOUNCES:
        remarks.add(FEW_BOUNCES, ob.name)
    if lamp.type == "SPOT" and _is_uneven(matrix):
        remarks.add(UNEVEN, ob.name)
    return _lamp(lamp, matrix, strength)


def _lamp(lamp: Lamp, matrix: Matrix, strength: Floats) -> SceneLight:
    """The light of a lamp with the object matrix `matrix`."""
    x, y, z = _axes(matrix)
    if lamp.type == "SUN":
        return Sun(tuple(-z), _scalar_if_grey(strength * _disk(lamp)))
    place = matrix.translation.to_tuple()
    if lamp.type == "AREA":
        return _area_light(lamp, place, x, y, z, strength)
    power = _scalar_if_grey(strength * _sphere(lamp))
    # Without Soft Falloff, the lamp is a sphere, which gives nearly the light of a point.
    radius = lamp.shadow_soft_size if lamp.use_soft_falloff else 0.0
    if lamp.type == "POINT":
        return PointLight(place, power, radius)
    # Scale widens or narrows the cone.
    widening = np.sqrt(np.linalg.norm(x) * np.linalg.norm(y)) / np.linalg.norm(z)
    angle = 2 * np.arctan(widening * np.tan(min(lamp.spot_size, np.pi - _NARROWEST) / 2))
    angle = max(float(angle), _NARROWEST)
    return SpotLight(place, tuple(-z), power, angle, lamp.spot_blend, radius)


def _axes(matrix: Matrix) -> Floats:
    """(3, 3): the x, y and z axes of an object with that matrix, as long as its scale."""
    return np.array(matrix.to_3x3().transposed(), float)


def _is_flat(lamp: Lamp, matrix: Matrix) -> bool:
    """Whether a lamp with that matrix is scaled so that it has no direction."""
    x, y, z = _axes(matrix)
    directions = {"SUN": z, "SPOT": z, "AREA": np.cross(x, y)}
    return lamp.type in directions and not np.any(directions[lamp.type])


def _is_uneven(matrix: Matrix) -> bool:
    """Whether a spot with that matrix has a cone that is not round about its axis."""
    axes = np.array(matrix.to_3x3(), float)
    lengths = np.linalg.norm(axes, axis=0)
    skewed = np.abs(axes.T @ axes - np.diag(lengths**2)) > _UNEVEN * np.outer(lengths, lengths)
    return bool(abs(lengths[0] - lengths[1]) > _UNEVEN * lengths[:2].max() or skewed.any())


def _area_light(
    lamp: bpy.types.AreaLight,
    place: tuple[float, ...],
    x: Floats,
    y: Floats,
    z: Floats,
    strength: Floats,
) -> AreaLight:
    """x, y and z are the lamp's axes, as long as its scale."""
    ellipse = lamp.shape in ("DISK", "ELLIPSE")
    u = x * lamp.size
    v = y * (lamp.size if lamp.shape in ("SQUARE", "DISK") else lamp.size_y)
    if not lamp.normalize:
        # Without Normalize, the strength is the power of each m^2.
        strength = strength * np.linalg.norm(np.cross(u, v)) * (np.pi / 4 if ellipse else 1)
    spread = max(lamp.spread, _NARROWEST)
    # The lamp emits along -z: the direction of y x x, or of x x y if its scale mirrors it.
    sides = (tuple(v), tuple(u)) if np.cross(y, x) @ z <= 0 else (tuple(u), tuple(v))
    return AreaLight(place, *sides, _scalar_if_grey(strength), ellipse, spread)


def _is_lamp(ob: bpy.types.Object) -> bool:
    """Whether an object is a lamp that emits light; portals only guide rays to the world."""
    if ob.type != "LIGHT":
        return False
    lamp: Lamp = ob.data
    return not (lamp.type == "AREA" and _cycles(lamp) and lamp.cycles.is_portal)


def _cycles(lamp: Lamp) -> Any:
    """Cycles' settings of a lamp, or None if that add-on is disabled."""
    return getattr(lamp, "cycles", None)


def _disk(lamp: bpy.types.SunLight) -> float:
    """W/m^2 on a surface that faces the sun, for a strength of 1, as in Cycles."""
    if lamp.normalize or lamp.angle == 0:
        return 1.0
    # Without Normalize, the strength is the radiance of the sun's disk.
    return float(np.pi * np.sin(lamp.angle / 2) ** 2)


def _sphere(lamp: bpy.types.PointLight | bpy.types.SpotLight) -> float:
    """W of a point or spot lamp in all, for a strength of 1, as in Cycles."""
    if lamp.normalize:
        return 1.0
    # Without Normalize, the strength is the power of each m^2 of the sphere; a point counts as 4.
    radius = lamp.shadow_soft_size
    return 4 * (np.pi * radius**2 if radius > 0 else 1)


def _strength(lamp: Lamp, remarks: Remarks) -> Floats:
    """(3,): the strength of a lamp, from its settings and its nodes."""
    strength: Floats = lamp.energy * 2**lamp.exposure * np.array(lamp.color)
    if lamp.use_temperature:
        strength *= lamp.temperature_color
    shader = LightShader(lamp, tolerant=True)
    emission = or_else(None, _emission, shader)
    if emission is None:
        emission = np.ones(3)
        shader.patterns["broken nodes"] = None
    if np.any(strength * emission):
        for label in shader.patterns:
            remarks.add(PATTERNS, f"'{lamp.name}' ({label})")
    return strength * emission


def _emission(shader: LightShader) -> Floats:
    """(3,): the sum of colour times strength over the Emission nodes of a lamp."""
    return sum(
        (
            c.weight * shader.color(c, "Color") * shader.number(c, "Strength")
            for c in shader.contributing("Surface", {"EMISSION"})
        ),
        start=np.zeros(3),
    )


def _world(
    world: bpy.types.World, receivers: Receivers | None, notes: list[str], remarks: Remarks
) -> list[Sun | Sky]:
    """The lights of a world, or none if it is not visible to the receivers."""
    if Shader(world).reaching("Volume"):
        remarks.add(WORLD_VOLUME, world.name)
    lights = _skies(world, _light_path(receivers), notes, remarks)
    visibility: Any = getattr(world, "cycles_visibility", None)  # None if Cycles is disabled
    if not lights or not receivers or visibility is None:
        return lights
    surfaces, volumes = visibility.diffuse, visibility.scatter
    return lights if receivers.take(world.name, surfaces, volumes, None, remarks) else []


def _light_path(receivers: Receivers | None) -> dict[str, float]:
    """{output of Light Path: value} for light that goes from the world to the receivers."""
    surfaces = ON_SURFACES if receivers is None or receivers.has_surfaces else {}
    volumes = IN_VOLUMES if receivers is None or receivers.has_volumes else {}
    return surfaces | volumes


def _skies(
    world: bpy.types.World, path: dict[str, float], notes: list[str], remarks: Remarks
) -> list[Sun | Sky]:
    """The lights of a world: its images by direction, and its other colours as one even sky."""
    shader = LightShader(world, path)
    even, lights = np.zeros(3), []
    for closure in shader.contributing("Surface", {"BACKGROUND"}):
        strength = closure.weight * shader.number(closure, "Strength")
        mean = strength * shader.color(closure, "Color")  # raises for unsupported nodes
        environment = _environment(shader, closure, notes) if np.any(mean) else None
        if environment is None:
            even += mean
        elif strength < 0:
            remarks.add(NEGATIVE, world.name)
        else:
            pixels, rotation = environment
            lights += panorama_lights(strength * _one_band_if_grey(pixels[..., :3]), rotation)
    if np.any(even < 0):
        remarks.add(NEGATIVE, world.name)
        even = np.maximum(even, 0)
    return lights + ([Sky(_scalar_if_grey(even))] if np.any(even) else [])


def _environment(
    shader: LightShader, closure: Closure, notes: list[str]
) -> tuple[Floats, Floats] | None:
    """(pixels (height, width, 4), rotation (3, 3) from world directions to the image) of a
    background, or None if it has no image, or one that only its mean colour can stand for."""
    socket, groups = resolve(closure.node.inputs["Color"], closure.groups)
    if not socket.is_output or socket.node.type != "TEX_ENVIRONMENT":
        return None
    rotation = _rotation(*resolve(socket.node.inputs["Vector"], groups))
    if rotation is None:
        notes.append(
            f"The image of '{shader.owner.name}' is baked as its mean colour; to light by "
            "direction, change its mapping only by the rotation of a Mapping node."
        )
        return None
    return linear_pixels(socket.node.image), rotation


def _rotation(socket: Socket, groups: Groups) -> Floats | None:
    """(3, 3): how nodes rotate world directions, or None if they change them in another way."""
    node = socket.node
    if not socket.is_output:  # an unlinked texture uses the direction, another node a constant
        return np.eye(3) if node.type == "TEX_ENVIRONMENT" else None
    if node.type == "TEX_COORD":
        return np.eye(3) if socket.name == "Generated" else None
    if node.type != "MAPPING":
        return None
    before = _rotation(*resolve(node.inputs["Vector"], groups))
    mapping = _mapping(node, groups)
    return None if before is None or mapping is None else mapping @ before


def _mapping(node: Node, groups: Groups) -> Floats | None:
    """(3, 3) of a Mapping node, or None if it moves the image, scales it unevenly, or varies."""
    values = {}
    for name in ("Location", "Rotation", "Scale"):
        if name in node.inputs and node.inputs[name].enabled:
            socket, _ = resolve(node.inputs[name], groups)
            if socket.is_output:
                return None
            values[name] = socket.default_value
    scale = np.array(values["Scale"], float)
    if np.any(values.get("Location", 0.0)) or not np.all(scale) or np.ptp(np.abs(scale)) > 1e-6:
        return None
    rotation = np.array(Euler(values["Rotation"]).to_matrix(), float)
    signs: Floats = np.sign(scale)
    return signs[:, None] * rotation.T if node.vector_type == "TEXTURE" else rotation * signs


def _one_band_if_grey(pixels: Floats) -> Floats:
    """(height, width, 3), or (height, width) if all is grey, so that only one band is solved."""
    return pixels if np.any(np.ptp(pixels, axis=2)) else pixels[..., 0]


def _scalar_if_grey(color: Floats) -> float | tuple[float, ...]:
    return tuple(map(float, color)) if np.ptp(color) else float(color[0])
