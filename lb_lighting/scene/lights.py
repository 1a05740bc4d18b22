# SPDX-License-Identifier: GPL-3.0-or-later
"""The suns and the sky of a Blender scene as transport lights."""

import numpy as np

from ..errors import LightError
from ..transport.lights import Sky, Sun
from .shaders import Shader


def scene_lights(scene, depsgraph):
    """[Sun | Sky]: every sun lamp that renders, instanced ones too, and the world's mean colour.

    Raises LightError where nothing shines, or for a world or lamp whose nodes cannot be read.
    """
    lights = [*_suns(scene, depsgraph), *_skies(scene.world)]
    if not lights:
        raise LightError("The scene has no light; add a sun, or give the world a colour.")
    return lights


def _suns(scene, depsgraph):
    rendered = _rendered_objects(scene.collection)
    for instance in depsgraph.object_instances:
        ob = instance.object
        base = (instance.parent if instance.is_instance else ob).original
        if ob.type != "LIGHT" or ob.data.type != "SUN" or not instance.show_self:
            continue
        irradiance = _irradiance(ob.data)
        if base in rendered and not ob.hide_render and np.any(irradiance):
            yield Sun(tuple(-instance.matrix_world.to_3x3().col[2]), _scalar_if_grey(irradiance))


def _rendered_objects(collection):
    """The original objects in `collection` that are not hidden in renders."""
    if collection.hide_render:
        return set()
    own = {ob for ob in collection.objects if not ob.hide_render}
    return own.union(*map(_rendered_objects, collection.children))


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
