# SPDX-License-Identifier: GPL-3.0-or-later
"""Small Cycles renders read back as linear radiance."""

import contextlib
import os

import bpy
import numpy as np


def dark_scene(location, rotation, width):
    """The current scene with a black world and an orthographic camera.

    location, rotation  of the camera, m and Euler angles
    width               of the picture, m
    """
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("dark")
    scene.world.node_tree.nodes.clear()
    camera = bpy.data.cameras.new("camera")
    camera.type = "ORTHO"
    camera.ortho_scale = width
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = location
    scene.camera.rotation_euler = rotation
    scene.collection.objects.link(scene.camera)
    return scene


def plane(z, width, material):
    """A square about the z axis, `width` m wide, that faces up."""
    mesh = bpy.data.meshes.new("plane")
    h = width / 2
    mesh.from_pydata([(-h, -h, z), (h, -h, z), (h, h, z), (-h, h, z)], [], [(0, 1, 2, 3)])
    mesh.materials.append(material)
    ob = bpy.data.objects.new("plane", mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def surface(kind, **inputs):
    """A material of one closure, with these values of its inputs."""
    material = bpy.data.materials.new(kind)
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def render(scene, path, size, samples, denoise=False):
    """(size, size, 3) linear radiance of a Cycles picture, row 0 at the bottom."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = denoise
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * size * size, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(size, size, 4)[..., :3].astype(float)


def middle(picture):
    """(3,) the mean of the picture's middle ninth."""
    third = len(picture) // 3
    return picture[third : 2 * third, third : 2 * third].mean(axis=(0, 1))


def centroid(picture):
    """(2,) the centre of the light, in pixels from the left and from the bottom."""
    brightness = picture.sum(axis=2)
    rows, columns = np.indices(brightness.shape)
    return np.array([(columns * brightness).sum(), (rows * brightness).sum()]) / brightness.sum()


@contextlib.contextmanager
def silent_stdout():
    """Blender prints a line a sample from C, where Python cannot catch it."""
    kept = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
