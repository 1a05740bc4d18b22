# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes to light, and what is common to looking at the result."""

import importlib
from pathlib import Path

import bpy
import numpy as np
import openvdb
from mathutils import Vector

EXTENSION = "bl_ext.user_default.lb_lighting"
SCREENS = Path(__file__).resolve().parents[2] / "build" / "screens"


def part(lb, name):
    """The module `name` of the installed package `lb`."""
    return importlib.import_module(f"{lb.__name__}.{name}")


def new_object(name, data):
    ob = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def point_along(ob, direction):
    """Turn a lamp or a camera so that it looks along `direction`."""
    ob.rotation_euler = Vector(direction).to_track_quat("-Z", "Y").to_euler()


def sun(direction, irradiance=4.0):
    """A sun whose light travels along `direction`; irradiance in W/m^2."""
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy = irradiance
    point_along(new_object("Sun", lamp), direction)


def world(radiance):
    """A grey world; radiance in W/(m^2 sr)."""
    bpy.context.scene.world = bpy.data.worlds.new("World")
    nodes = bpy.context.scene.world.node_tree.nodes
    nodes["Background"].inputs["Color"].default_value = (radiance, radiance, radiance, 1)


def camera(target, width):
    """An orthographic camera that looks along +y at a square of `width` m around `target`.

    Its picture has x to the right and z up.
    """
    data = bpy.data.cameras.new("Camera")
    data.type, data.ortho_scale = "ORTHO", width
    bpy.context.scene.camera = ob = new_object("Camera", data)
    ob.location = Vector(target) - Vector((0, 10, 0))
    point_along(ob, (0, 1, 0))


def volume_material(density=1.0, emission=0.0):
    """Principled Volume: scatters, with a coefficient of `density` 1/m where the grid is 1."""
    material = bpy.data.materials.new("Volume")
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Volume"])
    shader.inputs["Density"].default_value = density
    shader.inputs["Color"].default_value = (0.95, 0.95, 0.95, 1)
    shader.inputs["Emission Strength"].default_value = emission
    return material


def write_ball(path, center, radius=0.5, voxel=0.05):
    """A .vdb with a ball of density 1; center and radius in m, as voxel."""
    points = np.stack(np.indices((40, 40, 40)), axis=-1) * voxel - 1
    inside = np.linalg.norm(points - center, axis=-1) < radius
    grid = openvdb.FloatGrid()
    grid.copyFromArray(inside.astype(np.float32))
    grid.name, grid.gridClass = "density", openvdb.GridClass.FOG_VOLUME
    grid.transform = openvdb.createLinearTransform(voxel)
    grid.transform.postTranslate((-1, -1, -1))
    openvdb.write(str(path), [grid])


def volume_object(path, material):
    """A Volume object, selected, that shows the .vdb at `path`."""
    data = bpy.data.volumes.new("Cloud")
    data.filepath = str(path)
    data.materials.append(material)
    ob = new_object("Cloud", data)
    ob.select_set(True)
    return ob


def smoke(folder, flow_type="SMOKE", frames=6, color=(1.0, 0.5, 0.25), **settings):
    """A turned and stretched domain with a smoking ball in it, after some frames.

    Returns the domain, selected. The ball is of radius 0.3 m around (1.4, 2.1, 2) m.
    """
    bpy.ops.mesh.primitive_cube_add(size=2, location=(1, 2, 3), rotation=(0, 0, 0.5))
    domain = bpy.context.object
    domain.scale = (1, 1, 1.5)
    modifier = domain.modifiers.new("smoke", "FLUID")
    modifier.fluid_type = "DOMAIN"
    options = modifier.domain_settings
    options.domain_type, options.resolution_max = "GAS", 32
    options.cache_directory = str(folder)
    for name, value in settings.items():
        setattr(options, name, value)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.3, location=(1.4, 2.1, 2.0))
    ball = bpy.context.object
    modifier = ball.modifiers.new("smoke", "FLUID")
    modifier.fluid_type = "FLOW"
    modifier.flow_settings.flow_type = flow_type
    modifier.flow_settings.flow_behavior = "INFLOW"
    modifier.flow_settings.smoke_color = color
    ball.hide_render = True
    ball.select_set(False)
    domain.select_set(True)
    for frame in range(1, frames + 1):
        bpy.context.scene.frame_set(frame)
        bpy.context.evaluated_depsgraph_get()
    return domain


def baked(name):
    """What the bake of the object `name` wrote: density (nx, ny, nz), light (nx, ny, nz, 3) in
    W/(m^2 sr), and the positions of both (nx, ny, nz, 3) in m."""
    path = bpy.path.abspath(bpy.data.objects[f"LB {name}"].data.filepath)
    grid = openvdb.read(path, "density")
    lower, upper = grid.evalActiveVoxelBoundingBox()
    density = np.empty(np.subtract(upper, lower) + 1, np.float32)
    light = np.empty((*density.shape, 3), np.float32)
    grid.copyToArray(density, lower)
    openvdb.read(path, "lb_light").copyToArray(light, lower)
    indices = np.moveaxis(np.indices(density.shape), 0, -1) + lower
    positions = indices * grid.transform.voxelSize() + grid.transform.indexToWorld((0, 0, 0))
    return density, light, positions


def center_of_mass(density, positions):
    """(3,) m: density (nx, ny, nz), positions (nx, ny, nz, 3)."""
    return np.einsum("xyz,xyzi->i", density, positions) / density.sum()


def render(path, engine, size=128, samples=8):
    """(size, size, 4) linear radiance and alpha, row 0 at the bottom; a .png of it is kept."""
    scene = bpy.context.scene
    scene.render.engine = engine
    scene.cycles.samples = scene.eevee.taa_render_samples = samples
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.view_settings.view_transform = "Standard"
    file = scene.render.image_settings
    file.media_type, file.file_format = "IMAGE", "OPEN_EXR"
    file.color_mode, file.color_depth = "RGBA", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * size * size, np.float32)
    image.pixels.foreach_get(pixels)
    file.file_format, file.color_depth = "PNG", "8"
    image.save_render(str(SCREENS / f"{path.stem}.png"))
    bpy.data.images.remove(image)
    return pixels.reshape(size, size, 4)
