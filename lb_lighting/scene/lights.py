# SPDX-License-Identifier: GPL-3.0-or-later
"""The suns, the points and the sky of a Blender scene as transport lights."""

import bpy
import numpy as np

from ..errors import LightError
from ..transport.lights import PointLight, Sky, Sun
from .shaders import Shader


def scene_lights(scene, depsgraph):
    """[Sun | PointLight | Sky]: every sun and point lamp that renders, instanced ones too, and the
    world's mean colour. A lamp of any size counts as a point, a sun of any as one direction.

    A lamp counts where it is hidden in viewports only; of instances, those that viewports show.

    Raises LightError where nothing shines, or for a world or lamp whose nodes cannot be read.
    """
    lights = [*_lamps(depsgraph), *_skies(scene.world)]
    if not lights:
        raise LightError(
            "The scene has no light; add a sun or a point lamp, or give the world a colour."
        )
    return lights


def unread_lamps(depsgraph):
    """[sentence]: one that names the lamps that `scene_lights` leaves out, where there are any."""
    rendered = _rendered_objects(depsgraph.view_layer.layer_collection)
    names = [f"'{ob.name}'" for ob in rendered if ob.type == "LIGHT" and not _is_lamp(ob)]
    if not names:
        return []
    return [f"Spots and areas are not read: {', '.join(names)}; use suns and points instead."]


def _lamps(depsgraph):
    rendered = _rendered_objects(depsgraph.view_layer.layer_collection)
    instanced = [
        _lamp(instance.object.data, instance.matrix_world)
        for instance in depsgraph.object_instances
        if instance.is_instance and instance.show_self and _is_lamp(instance.object)
        if instance.parent.original in rendered and not instance.object.hide_render
    ]
    # These come last, because placing them may evaluate the scene anew.
    plain = [
        _lamp(ob.evaluated_get(depsgraph).data, _world_matrix(ob, depsgraph))
        for ob in rendered
        if _is_lamp(ob)
    ]
    return [lamp for lamp in instanced + plain if np.any(lamp.spectrum)]


def _lamp(lamp, matrix):
    if lamp.type == "SUN":
        return Sun(tuple(-matrix.to_3x3().col[2]), _scalar_if_grey(_irradiance(lamp)))
    return PointLight(tuple(matrix.translation), _scalar_if_grey(_power(lamp)))


def _is_lamp(ob):
    return ob.type == "LIGHT" and ob.data.type in ("SUN", "POINT")


def _rendered_objects(layer):
    """{original object: None}, in order, of all in a layer collection that renders show."""
    if layer.collection.hide_render:
        return {}
    shown = [] if layer.exclude else [ob for ob in layer.collection.objects if not ob.hide_render]
    found = dict.fromkeys(shown)
    for child in layer.children:
        found |= _rendered_objects(child)
    return found


def _world_matrix(ob, depsgraph):
    """The world matrix of `ob` at the current frame, whether viewports show it or not."""
    evaluated = ob.evaluated_get(depsgraph)
    if evaluated.is_evaluated:
        return evaluated.matrix_world.copy()
    # Blender places nothing that is hidden; a copy that is shown for a moment tells where it is.
    twin = ob.copy()
    twin.hide_viewport = False
    depsgraph.scene.collection.objects.link(twin)
    depsgraph.update()
    matrix = twin.evaluated_get(depsgraph).matrix_world.copy()
    bpy.data.objects.remove(twin)
    depsgraph.update()
    return matrix


def _irradiance(lamp):
    """(3,) W/m^2 on a surface that faces the sun, as Cycles has it."""
    irradiance = _strength(lamp)
    if not lamp.normalize and lamp.angle > 0:
        # Without normalization the strength is the radiance of the sun's disk.
        irradiance *= np.pi * np.sin(lamp.angle / 2) ** 2
    return irradiance


def _power(lamp):
    """(3,) W that a point lamp sends out in all, as Cycles has it."""
    power = _strength(lamp)
    if not lamp.normalize:
        # Without normalization it is what each m^2 of the lamp's sphere sends out; 4 for a point.
        radius = lamp.shadow_soft_size
        power *= 4 * (np.pi * radius**2 if radius > 0 else 1)
    return power


def _strength(lamp):
    """(3,): what a lamp's own settings and its nodes make of its energy."""
    strength = lamp.energy * 2**lamp.exposure * np.array(lamp.color)
    if lamp.use_temperature:
        strength *= lamp.temperature_color
    return strength * _glow(lamp, "EMISSION")


def _skies(world):
    radiance = _glow(world, "BACKGROUND") if world else np.zeros(3)
    if np.any(radiance):
        yield Sky(_scalar_if_grey(radiance))


def _glow(owner, kind):
    """(3,): colour times strength of all the nodes of type `kind` that reach the output."""
    shader = Shader(owner, LightError)
    return sum(
        (
            c.weight * shader.color(c, "Color") * shader.number(c, "Strength")
            for c in shader.closures("Surface", {kind})
        ),
        start=np.zeros(3),
    )


def _scalar_if_grey(color):
    return tuple(map(float, color)) if np.ptp(color) else float(color[0])
