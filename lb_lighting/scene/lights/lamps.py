# SPDX-License-Identifier: GPL-3.0-or-later
"""The lamps and the sky of a Blender scene as transport lights."""

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
from .emitters import shining_lamps
from .light_nodes import (
    IN_VOLUMES,
    ON_SURFACES,
    LightShader,
    or_else,
)
from .receivers import SHADED, Receivers

type Lamp = Any  # bpy.types.Light: what it has depends on its `type`
type SceneLight = Sun | Sky | PointLight | SpotLight | AreaLight

_MANY_BOUNCES = 32  # of a lamp, from which on its light has faded before they are used up
_NARROWEST = 1e-3  # rad, of cones: Blender lets them be 0, which lights nothing
_UNEVEN = 0.05  # of the lengths of a spot's axes, and of the cosines between them


PATTERNS = (
    "Counted as even light, at their own colour and strength, without the pattern that their "
    "nodes make: {}."
)
NEGATIVE = "Left out, because light cannot be negative here: {}."
FLAT = "Left out, because they are scaled to nothing: {}."
UNEVEN = "Counted with a round cone, although their scale stretches or skews it: {}."
FEW_BOUNCES = "The light of {} goes on scattering, although Max Bounces ends it sooner."
WORLD_VOLUME = (
    "The volume of {} is left out: it neither scatters nor dims light. A box with that volume "
    "material, selected too, would."
)


def scene_lights(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    notes: list[str],
    needed: bool = True,
    receivers: Receivers | None = None,
) -> list[SceneLight]:
    """[light]: every lamp that renders, instanced ones too, meshes that shine (where receivers are
    known), and the world. A point or spot of any
    radius counts as a point, a sun of any angle as one direction.

    notes      list of sentences for the user, which what is read only in part is added to
    needed     whether there must be some, for nothing else shines
    receivers  the `Receivers` that are lit, or None to count also what does not reach them

    A lamp counts where it is hidden in viewports only; of instances, those that viewports show.

    Raises LightError where nothing shines, or for a world whose nodes cannot be read.
    """
    remarks = Remarks()
    lights = _lamps(depsgraph, receivers, remarks)
    if receivers:
        lights += shining_lamps(depsgraph, receivers, remarks, notes)
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
    found = [
        _lit_by(instance.object, instance.matrix_world, receivers, remarks)
        for instance in instances
        if instance.is_instance and instance.show_self and _is_lamp(instance.object)
        if instance.parent.original in rendered and not instance.object.hide_render
    ]
    # These come last, because placing them may evaluate the scene anew.
    found += [
        _lit_by(ob.evaluated_get(depsgraph), world_matrix(ob, depsgraph), receivers, remarks)
        for ob in rendered
        if _is_lamp(ob)
    ]
    return [lamp for lamp in found if lamp is not None]


def _lit_by(
    ob: bpy.types.Object, matrix: Matrix, receivers: Receivers | None, remarks: Remarks
) -> SceneLight | None:
    """The light of an evaluated lamp, or None where it lights nothing."""
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
    x, y, z = _axes(matrix)
    if lamp.type == "SUN":
        return Sun(tuple(-z), _scalar_if_grey(strength * _disk(lamp)))
    place = matrix.translation.to_tuple()
    if lamp.type == "AREA":
        return _area_light(lamp, place, x, y, z, strength)
    power = _scalar_if_grey(strength * _sphere(lamp))
    # Without the soft falloff it is a sphere, which shines about as a point does.
    radius = lamp.shadow_soft_size if lamp.use_soft_falloff else 0.0
    if lamp.type == "POINT":
        return PointLight(place, power, radius)
    # The cone is stretched with the lamp.
    wide = np.sqrt(np.linalg.norm(x) * np.linalg.norm(y)) / np.linalg.norm(z)
    angle = 2 * np.arctan(wide * np.tan(min(lamp.spot_size, np.pi - _NARROWEST) / 2))
    angle = max(float(angle), _NARROWEST)
    return SpotLight(place, tuple(-z), power, angle, lamp.spot_blend, radius)


def _axes(matrix: Matrix) -> Floats:
    """(3, 3): the x, y and z axis of an object with that matrix, of the length of its scale."""
    return np.array(matrix.to_3x3().transposed(), float)


def _is_flat(lamp: Lamp, matrix: Matrix) -> bool:
    """Whether a lamp with that matrix has no direction to shine in."""
    x, y, z = _axes(matrix)
    needed = {"SUN": z, "SPOT": z, "AREA": np.cross(x, y)}
    return lamp.type in needed and not np.any(needed[lamp.type])


def _is_uneven(matrix: Matrix) -> bool:
    """Whether the cone of a spot with that matrix is not a round one about its own axis."""
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
    """x, y and z are the lamp's axes, of the length that it is scaled to."""
    ellipse = lamp.shape in ("DISK", "ELLIPSE")
    u = x * lamp.size
    v = y * (lamp.size if lamp.shape in ("SQUARE", "DISK") else lamp.size_y)
    if not lamp.normalize:
        # Without normalization the strength is what each m^2 sends out.
        strength = strength * np.linalg.norm(np.cross(u, v)) * (np.pi / 4 if ellipse else 1)
    spread = max(lamp.spread, _NARROWEST)
    # It shines along -z: on the side that y x x points to, or x x y where its scale mirrors it.
    sides = (tuple(v), tuple(u)) if np.cross(y, x) @ z <= 0 else (tuple(u), tuple(v))
    return AreaLight(place, *sides, _scalar_if_grey(strength), ellipse, spread)


def _is_lamp(ob: bpy.types.Object) -> bool:
    """Whether an object is a lamp that shines; a portal shows only where the world does."""
    if ob.type != "LIGHT":
        return False
    lamp: Lamp = ob.data
    return not (lamp.type == "AREA" and _cycles(lamp) and lamp.cycles.is_portal)


def _cycles(lamp: Lamp) -> Any:
    """Cycles' settings of a lamp, or None where that add-on is off."""
    return getattr(lamp, "cycles", None)


def _disk(lamp: bpy.types.SunLight) -> float:
    """W/m^2 on a surface that faces the sun, by its strength, as Cycles has it."""
    if lamp.normalize or lamp.angle == 0:
        return 1.0
    # Without normalization the strength is the radiance of the sun's disk.
    return float(np.pi * np.sin(lamp.angle / 2) ** 2)


def _sphere(lamp: bpy.types.PointLight | bpy.types.SpotLight) -> float:
    """W that a point lamp sends out in all, by its strength, as Cycles has it."""
    if lamp.normalize:
        return 1.0
    # Without normalization it is what each m^2 of the lamp's sphere sends out; 4 for a point.
    radius = lamp.shadow_soft_size
    return 4 * (np.pi * radius**2 if radius > 0 else 1)


def _strength(lamp: Lamp, remarks: Remarks) -> Floats:
    """(3,): what a lamp's own settings and its nodes make of its energy."""
    strength: Floats = lamp.energy * 2**lamp.exposure * np.array(lamp.color)
    if lamp.use_temperature:
        strength *= lamp.temperature_color
    shader = LightShader(lamp, tolerant=True)
    made = or_else(None, _made, shader)
    if made is None:
        made = np.ones(3)
        shader.patterns["broken nodes"] = None
    if np.any(strength * made):
        for label in shader.patterns:
            remarks.add(PATTERNS, f"'{lamp.name}' ({label})")
    return strength * made


def _made(shader: LightShader) -> Floats:
    """(3,): the colour times the strength of all nodes by which a lamp shines."""
    return sum(
        (
            c.weight * shader.color(c, "Color") * shader.number(c, "Strength")
            for c in shader.shining("Surface", {"EMISSION"})
        ),
        start=np.zeros(3),
    )


def _world(
    world: bpy.types.World, receivers: Receivers | None, notes: list[str], remarks: Remarks
) -> list[Sun | Sky]:
    """The lights of a world, those that are visible to the receivers."""
    if Shader(world).reaching("Volume"):
        remarks.add(WORLD_VOLUME, world.name)
    lights = _skies(world, _light_path(receivers), notes, remarks)
    seen: Any = getattr(world, "cycles_visibility", None)  # which the Cycles add-on brings
    if not lights or not receivers or seen is None:
        return lights
    return lights if receivers.take(world.name, seen.diffuse, seen.scatter, None, remarks) else []


def _light_path(receivers: Receivers | None) -> dict[str, float]:
    """{output of Light Path: its value} for light from the world on its way to the receivers."""
    surfaces = ON_SURFACES if receivers is None or receivers.has_surfaces else {}
    volumes = IN_VOLUMES if receivers is None or receivers.has_volumes else {}
    return surfaces | volumes


def _skies(
    world: bpy.types.World, path: dict[str, float], notes: list[str], remarks: Remarks
) -> list[Sun | Sky]:
    """The lights of a world's pictures, by direction, and its other colours as one even sky."""
    shader = LightShader(world, path)
    even, lights = np.zeros(3), []
    for closure in shader.shining("Surface", {"BACKGROUND"}):
        strength = closure.weight * shader.number(closure, "Strength")
        mean = strength * shader.color(closure, "Color")  # refuses what cannot be read
        picture = _picture(shader, closure, notes) if np.any(mean) else None
        if picture is None:
            even += mean
        elif strength < 0:
            remarks.add(NEGATIVE, world.name)
        else:
            pixels, turn = picture
            lights += panorama_lights(strength * _grey_if_it_is(pixels[..., :3]), turn)
    if np.any(even < 0):
        remarks.add(NEGATIVE, world.name)
        even = np.maximum(even, 0)
    return lights + ([Sky(_scalar_if_grey(even))] if np.any(even) else [])


def _picture(
    shader: LightShader, closure: Closure, notes: list[str]
) -> tuple[Floats, Floats] | None:
    """(pixels (height, width, 4), (3, 3) the turn from directions to it) of a background that
    shows an environment, or None where it has a plain colour, or one of which that must do."""
    socket, groups = resolve(closure.node.inputs["Color"], closure.groups)
    if not socket.is_output or socket.node.type != "TEX_ENVIRONMENT":
        return None
    turn = _turn(*resolve(socket.node.inputs["Vector"], groups))
    if turn is None:
        notes.append(
            f"The picture of '{shader.owner.name}' counts as its mean colour; turn it by nothing "
            "but the rotation of a Mapping to light by direction."
        )
        return None
    return linear_pixels(socket.node.image), turn


def _turn(socket: Socket, groups: Groups) -> Floats | None:
    """(3, 3) of the world's directions, as nodes change them; None for what is no rotation."""
    node = socket.node
    if not socket.is_output:  # a texture without a link takes the direction, another node nothing
        return np.eye(3) if node.type == "TEX_ENVIRONMENT" else None
    if node.type == "TEX_COORD":
        return np.eye(3) if socket.name == "Generated" else None
    if node.type != "MAPPING":
        return None
    inner = _turn(*resolve(node.inputs["Vector"], groups))
    own = _mapping(node, groups)
    return None if inner is None or own is None else own @ inner


def _mapping(node: Node, groups: Groups) -> Floats | None:
    """(3, 3) of a Mapping node, or None where it moves, or scales unevenly."""
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
    turn = np.array(Euler(values["Rotation"]).to_matrix(), float)
    signs: Floats = np.sign(scale)
    return signs[:, None] * turn.T if node.vector_type == "TEXTURE" else turn * signs


def _grey_if_it_is(pixels: Floats) -> Floats:
    """(height, width, 3) as (height, width) where all is grey, so that one band is solved."""
    return pixels if np.any(np.ptp(pixels, axis=2)) else pixels[..., 0]


def _scalar_if_grey(color: Floats) -> float | tuple[float, ...]:
    return tuple(map(float, color)) if np.ptp(color) else float(color[0])
