# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake by the operator, and Cycles' own picture of the same scene to hold it to."""

import bpy
import numpy as np
from mathutils import Vector

from tests import scenery
from tests.output.rendering import render, silent_stdout

SIZE = 16  # pixels along an edge
SAMPLES = 24


def look(direction=(0.3, -1, 0.4), width=2.4):
    """Make the scene's camera: orthographic, and `direction` is where it stands."""
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", width
    scene.camera = scenery.link("camera", camera)
    scene.camera.location = 5 * Vector(direction).normalized()
    scene.camera.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()


def even_world(strength):
    """A grey world that cameras do not see."""
    world = bpy.context.scene.world = bpy.data.worlds.new("world")
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
    world.cycles_visibility.camera = False
    return world


def over_cycles(folder, *objects, bounces=16, samples=SAMPLES):
    """The mean of the picture with our light over that of Cycles with many bounces.

    The scene has a camera; it is baked by the operator, with its own settings.
    """
    scene = bpy.context.scene
    cycles = scene.cycles
    cycles.max_bounces = 32
    cycles.diffuse_bounces = cycles.transmission_bounces = cycles.volume_bounces = bounces
    cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0
    with silent_stdout():
        reference = render(scene, folder / "cycles.exr", SIZE, samples)
    scenery.select(*objects)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.lb_lighting.bake()
    bpy.ops.lb_lighting.use()
    with silent_stdout():
        ours = render(scene, folder / "ours.exr", SIZE, samples)
    return float(np.mean(ours) / np.mean(reference))
