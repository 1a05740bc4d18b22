# SPDX-License-Identifier: GPL-3.0-or-later
"""The suns and the sky of a Blender scene as transport lights."""

import bpy
import numpy as np

from ..errors import LightError
from ..transport.lights import Sky, Sun
from .shaders import Shader


def scene_lights(scene, depsgraph):
    """[Sun | Sky]: every sun lamp that renders, instanced ones too, and the world's mean colour.

    A sun counts where it is hidden in viewports only; of instances, those that viewports show.

    Raises LightError where nothing shines, or for a world or lamp whose nodes cannot be read.
    """
    lights = [*_suns(depsgraph), *_skies(scene.world)]
    if not lights:
        raise LightError("The scene has no light; add a sun, or give the world a colour.")
    return lights


def _suns(depsgraph):
    rendered = _rendered_objects(depsgraph.view_layer.layer_collection)
    instanced = [
        _sun(instance.object.data, instance.matrix_world)
        for instance in depsgraph.object_instances
        if instance.is_instance and instance.show_self and _is_sun(instance.object)
        if instance.parent.original in rendered and not instance.object.hide_render
    ]
    # These come last, because placing them may evaluate the scene anew.
    plain = [
        _sun(ob.evaluated_get(depsgraph).data, _world_matrix(ob, depsgraph))
        for ob in rendered
        if _is_sun(ob)
    ]
    return [sun for sun in instanced + plain if np.any(sun.irradiance)]


def _sun(lamp, matrix):
    return Sun(tuple(-matrix.to_3x3().col[2]), _scalar_if_grey(_irradiance(lamp)))


def _is_sun(ob):
    return ob.type == "LIGHT" and ob.data.type == "SUN"


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
    irradiance = lamp.energy * 2**lamp.exposure * np.array(lamp.color)
    if lamp.use_temperature:
        irradiance *= lamp.temperature_color
    if not lamp.normalize and lamp.angle > 0:
        # Without normalization the strength is the radiance of the sun's disk.
        irradiance *= np.pi * np.sin(lamp.angle / 2) ** 2
    return irradiance * _glow(lamp, "EMISSION")


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
