# SPDX-License-Identifier: GPL-3.0-or-later
"""The three scenes of paper 1, section 3.2, made from real inputs: a cloud, a plant, a teapot.

Each function fills the empty file and returns the names of the objects to light and the
`Options` that differ from the default.
"""

import bpy
import numpy as np
from mathutils import Vector

from . import assets

SUN = (0.65, 0.1, -0.75)  # direction of the light: from the upper left of the pictures
SUN_IRRADIANCE = 4.0  # W/m^2
SKY = (0.02, 0.035, 0.065)  # radiance, W/(m^2 sr)


def cloud():
    """A fractal cloud of 2 m."""
    path = write_noise(assets.ASSETS / "cloud.vdb", edge=128, seed=7)
    data = bpy.data.volumes.new("Cloud")
    data.filepath = str(path)
    ob = bpy.data.objects.new("Cloud", data)
    bpy.context.scene.collection.objects.link(ob)
    material = bpy.data.materials.new("Cloud")
    nodes = material.node_tree.nodes
    nodes.clear()
    output, volume = (
        nodes.new(kind) for kind in ("ShaderNodeOutputMaterial", "ShaderNodeVolumePrincipled")
    )
    # The paper's sigma_t of 0.8 is the share that collides in a voxel, here 2 m / 128.
    extinction = -np.log(1 - 0.8) / (2 / 128)
    volume.inputs["Density"].default_value = extinction
    volume.inputs["Color"].default_value = (0.99, 0.99, 0.99, 1)
    volume.inputs["Absorption Color"].default_value = (0, 0, 0, 1)
    volume.inputs["Anisotropy"].default_value = 0.9
    material.node_tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])
    data.materials.append(material)
    surroundings(target=(0, 0, 0), distance=3.9, height=-0.5)
    return ["Cloud"], {"resolution": 128}


def plant():
    """A broadleaf tree of about 7 m with green, translucent leaves, on the ground."""
    wood, leaves = assets.tree(leaves=40_000)
    bark = surface("Bark", (0.16, 0.11, 0.07))
    mesh_object("Wood", wood, bark)
    mesh_object("Leaves", leaves, leaf_material())
    ground()
    surroundings(target=(0, 0, 3.6), distance=15, height=0.5)
    return ["Leaves"], {"medium": "plant", "resolution": 72}


def teapot():
    """The teapot of red acrylic glass, on the ground."""
    ob = mesh_object("Teapot", assets.teapot(), surface("PMMA", (0.75, 0.05, 0.05), roughness=0.15))
    ob.data.shade_smooth()
    ob.lb_lighting.role = "SOLID"
    ground()
    surroundings(target=(0, 0, 0.22), distance=2.1, height=0.8)
    return ["Teapot"], {"medium": "pmma", "optical_depth": 100.0, "resolution": 80}


def write_noise(path, edge, seed):
    """Write a cumulus in [-1, 1]^3 m, overlapping puffs with fractal noise, and return its path."""
    import openvdb

    axis = (np.arange(edge) + 0.5) / edge * 2 - 1
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    rng = np.random.default_rng(seed)
    body = np.full((edge,) * 3, -np.inf)
    for _ in range(14):
        center = rng.normal(0, (0.33, 0.3, 0.16))
        radius = rng.uniform(0.26, 0.42) * (1 - 0.4 * np.linalg.norm(center[:2]))
        body = np.maximum(body, radius - np.linalg.norm(points - center, axis=-1))
    body = np.minimum(body, points[..., 2] + 0.35)  # clouds have a flat base
    density = np.clip(8 * (body + 0.11 * fractal_noise(edge, rng)), 0, 1).astype(np.float32)
    grid = openvdb.FloatGrid()
    grid.copyFromArray(density)
    grid.name, grid.gridClass = "density", openvdb.GridClass.FOG_VOLUME
    voxel = 2 / edge
    to_world = np.diag([voxel, voxel, voxel, 1.0])
    to_world[3, :3] = -1 + voxel / 2
    grid.transform = openvdb.createLinearTransform(to_world.tolist())
    path.parent.mkdir(parents=True, exist_ok=True)
    openvdb.write(str(path), [grid])
    return path


def fractal_noise(edge, rng, exponent=4.2):
    """(edge, edge, edge) noise of unit variance with a power spectrum of frequency^-exponent."""
    frequency = np.fft.fftfreq(edge) * edge
    half = np.fft.rfftfreq(edge) * edge
    k = np.sqrt(frequency[:, None, None] ** 2 + frequency[:, None] ** 2 + half**2)
    amplitude = np.where(k < 2.5, 0, np.maximum(k, 1) ** (-exponent / 2))
    noise = np.fft.irfftn(np.fft.rfftn(rng.normal(size=(edge,) * 3)) * amplitude, s=(edge,) * 3)
    return noise / noise.std()


def mesh_object(name, mesh, material):
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    data.materials.append(material)
    ob = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def surface(name, color, roughness=0.9):
    material = bpy.data.materials.new(name)
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*color, 1)
    inputs["Roughness"].default_value = roughness
    return material


def leaf_material():
    """A leaf reflects half of the light that it does not absorb, and transmits half."""
    material = bpy.data.materials.new("Leaf")
    tree = material.node_tree
    tree.nodes.clear()
    output, mix, front, back = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("OutputMaterial", "MixShader", "BsdfDiffuse", "BsdfTranslucent")
    )
    for node in (front, back):
        node.inputs["Color"].default_value = (0.16, 0.34, 0.07, 1)
    tree.links.new(front.outputs[0], mix.inputs[1])
    tree.links.new(back.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def ground():
    mesh = assets.Mesh(
        np.array([(-60, -60, 0), (60, -60, 0), (60, 60, 0), (-60, 60, 0)], float),
        np.array([(0, 1, 2, 3)]),
    )
    mesh_object("Ground", mesh, surface("Ground", (0.25, 0.24, 0.22)))


def surroundings(target, distance, height):
    """Add sun, sky and a camera `distance` m from `target`, `height` m above it."""
    scene = bpy.context.scene
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy = SUN_IRRADIANCE
    sun = bpy.data.objects.new("Sun", lamp)
    sun.rotation_euler = Vector(SUN).to_track_quat("-Z", "Y").to_euler()
    world = bpy.data.worlds.new("Sky")
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*SKY, 1)
    scene.world = world

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = Vector(target) + Vector((0, -distance, height))
    camera.rotation_euler = (Vector(target) - camera.location).to_track_quat("-Z", "Y").to_euler()
    scene.camera = camera
    for ob in (sun, camera):
        scene.collection.objects.link(ob)
