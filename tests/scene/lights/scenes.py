# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, worlds and a white ground for the tests of lights."""

from math import pi

import bpy
import numpy as np

from lb_lighting.scene.lights.lamps import scene_lights
from lb_lighting.transport.lights.distant import Sun
from lb_lighting.transport.lights.sampling import even_directions


def add_sun(collection=None, rotation=(0, 0, 0), **settings):
    lamp = bpy.data.lights.new("sun", "SUN")
    for name, value in settings.items():
        setattr(lamp, name, value)
    ob = bpy.data.objects.new("sun", lamp)
    ob.rotation_euler = rotation
    (collection or bpy.context.collection).objects.link(ob)
    return ob


def add_lamp(kind, location=(0, 0, 0), **settings):
    lamp = bpy.data.lights.new(kind.lower(), kind)
    for name, value in settings.items():
        setattr(lamp, name, value)
    ob = bpy.data.objects.new(lamp.name, lamp)
    ob.location = location
    bpy.context.collection.objects.link(ob)
    return ob


def add_world(color=(1, 1, 1), strength=1.0):
    world = bpy.context.scene.world = bpy.data.worlds.new("world")
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*color, 1)
    background.inputs["Strength"].default_value = strength
    return world


def add_environment(world, pixels):
    node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    height, width, _four = pixels.shape
    node.image = bpy.data.images.new("sky", width, height, float_buffer=True)
    node.image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    world.node_tree.links.new(node.outputs[0], world.node_tree.nodes["Background"].inputs["Color"])
    return node


def add_mapping(environment, kind, rotation):
    tree = environment.id_data
    mapping, place = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.vector_type = kind
    mapping.inputs["Rotation"].default_value = rotation
    tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], environment.inputs["Vector"])
    return mapping


def add_white_ground():
    bpy.ops.mesh.primitive_plane_add(size=4)
    material = bpy.data.materials.new("white")
    nodes = material.node_tree.nodes
    nodes["Principled BSDF"].inputs["Base Color"].default_value = (1, 1, 1, 1)
    nodes["Principled BSDF"].inputs["Specular IOR Level"].default_value = 0
    bpy.context.object.data.materials.append(material)


def lights(notes=None):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return scene_lights(bpy.context.scene, depsgraph, [] if notes is None else notes)


def irradiance(lights, normal):
    """(3,) W/m^2 on a surface, from suns, and from 100 000 directions of skies."""
    total = np.zeros(3)
    for light in lights:
        if isinstance(light, Sun):
            total += np.multiply(light.irradiance, max(0, -np.dot(light.direction, normal)))
        else:
            towards = even_directions(np.arange(100_000), 100_000)
            weights = 4 * pi * np.maximum(towards @ normal, 0) / len(towards)
            radiance = light.towards(towards)
            if np.ndim(radiance) < 2 and callable(light.radiance):
                radiance = radiance[:, None]
            total += weights @ np.broadcast_to(radiance, (len(towards), 3))
    return total
