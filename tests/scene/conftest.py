# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles as the judge of what Blender's numbers mean."""

import bpy
import numpy as np
import pytest

from tests.scene.against import look


@pytest.fixture
def render(tmp_path):
    """A function that renders the scene from above, 0.5 m wide, to its mean linear colour (3,).

    The scene has a world that is black, and a camera.
    """
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 64, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(tmp_path / "render.exr")
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 0.5
    scene.camera.location = (0, 0, 5)
    scene.collection.objects.link(scene.camera)

    def mean_color():
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(-1, 4)[:, :3].mean(axis=0)

    return mean_color


@pytest.fixture
def quick_look(tmp_path):
    """Settings that bake within a second, and a camera; see `against`."""
    settings = bpy.context.scene.lb_lighting
    settings.resolution, settings.quality, settings.folder = 16, "CUSTOM", str(tmp_path)
    look()
