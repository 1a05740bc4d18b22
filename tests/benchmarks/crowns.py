# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of `make bench-foliage`: crowns of leaves, a real tree, their lights and cameras."""

from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Matrix, Vector

from tests.demo import assets
from tests.demo.assets import Mesh, unit

LEAF_AREA = 25.0  # m^2 in a crown of radius 1 m
# Leaves of three colours in one material, one in each band of the picture: (reflectance,
# transmittance) of red, green and white ones.
COLORS = {"red": (0.05, 0.03), "green": (0.10, 0.09), "white": (0.45, 0.45)}
BARK, SOIL = (0.16, 0.11, 0.07), (0.30, 0.25, 0.20)
SUN = np.array((0.5, 0.3, -0.81))  # direction in which the light travels
IRRADIANCE = 3.0  # W/m^2, of the sun
RADIANCE = 0.3  # W/(m^2 sr), of the sky
VIEWS = {"lit": (-0.9, -0.4, 0.25), "far": (0.8, 0.55, 0.12)}  # from the crown to the camera


class Case(NamedTuple):
    """A crown or a tree to be lit.

    leaves      function that makes their `Mesh`
    resolution  voxels along the longest edge: 1 to 1.5 leaf lengths each
    width       of the picture, m
    middle      (3,) m, the point that the camera looks at
    tree        whether this is the tree, which has wood
    ground      whether there is a ground
    """

    leaves: object
    resolution: int
    width: float = 2.3
    middle: tuple = (0, 0, 0)
    tree: bool = False
    ground: bool = False


def in_ball(count, rng):
    """(count, 3) m: uniformly distributed points in the ball of radius 1 m."""
    return unit(rng.normal(size=(count, 3))) * rng.uniform(size=(count, 1)) ** (1 / 3)


def in_clumps(count, rng, clumps=40, spread=0.13):
    """(count, 3) m: points in round clumps with uniformly distributed centres."""
    middles = 0.85 * in_ball(clumps, rng)
    return middles[rng.integers(clumps, size=count)] + rng.normal(0, spread, (count, 3))


def crown(length, places=in_ball, flatness=0.0):
    """A crown of square leaves of edge `length`, m.

    places    function of a count and a generator that returns the positions of leaves
    flatness  0 for random orientations; large for nearly horizontal leaves
    """
    rng = np.random.default_rng(0)
    count = round(LEAF_AREA / length**2)
    normal = unit(rng.normal((0, 0, flatness), size=(count, 3)))
    side = unit(np.cross(normal, rng.normal(size=(count, 3))))
    a, b = length / 2 * side, length / 2 * np.cross(normal, side)
    corners = np.stack([-a - b, a - b, a + b, b - a], axis=1) + places(count, rng)[:, None]
    return Mesh(corners.reshape(-1, 3), np.arange(4 * count).reshape(-1, 4))


TREE = {"width": 8.2, "middle": (0, 0, 3.9), "tree": True}
CASES = {
    "5 cm leaves": Case(lambda: crown(0.05), 40),
    "clumped": Case(lambda: crown(0.05, in_clumps), 44, 2.7),
    "2.5 cm leaves": Case(lambda: crown(0.025), 64),
    "10 cm leaves": Case(lambda: crown(0.10), 24),
    "near-horizontal": Case(lambda: crown(0.05, flatness=4.0), 40),
    "tree": Case(lambda: assets.tree(leaves=20_000)[1], 48, **TREE),
    "tree on the ground": Case(lambda: assets.tree(leaves=20_000)[1], 60, **TREE, ground=True),
}


def build(case, colors=None):
    """Fill the empty file with a `Case` and return its objects, the leaves first.

    colors  ((reflectance, transmittance) of the leaves in each band), or None for COLORS
    """
    leaf = leaf_material(colors or tuple(COLORS.values()))
    objects = [add("Leaves", case.leaves(), leaf)]
    if case.tree:
        objects.append(add("Wood", assets.tree(leaves=20_000)[0], diffuse("Bark", BARK)))
        objects[-1].lb_lighting.role = "OCCLUDER"
    if case.ground:
        objects.append(add("Ground", grid(4.5, 64), diffuse("Soil", SOIL)))
        objects[-1].lb_lighting.role = "OCCLUDER"
    return objects


def grid(half, parts):
    """A square on the ground about the origin, from -half to half m, in parts x parts faces."""
    axis = np.linspace(-half, half, parts + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    first = np.arange(parts * (parts + 1)).reshape(parts, -1)[:, :-1].ravel()
    faces = np.stack([first, first + parts + 1, first + parts + 2, first + 1], axis=1)
    return Mesh(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1), faces)


def add(name, mesh, material):
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    data.materials.append(material)
    ob = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def leaf_material(colors):
    """A diffuse and a translucent shader; colors: ((reflectance, transmittance) of each band)."""
    reflectance, transmittance = np.transpose(colors)
    material = diffuse("Leaf", reflectance)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    through, both = nodes.new("ShaderNodeBsdfTranslucent"), nodes.new("ShaderNodeAddShader")
    through.inputs["Color"].default_value = (*transmittance, 1)
    links.new(nodes["Diffuse BSDF"].outputs[0], both.inputs[0])
    links.new(through.outputs[0], both.inputs[1])
    links.new(both.outputs[0], nodes["Material Output"].inputs["Surface"])
    return material


def diffuse(name, color):
    material = bpy.data.materials.new(name)
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (*color, 1)
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def light(sun, sky):
    """A sun, a sky of one radiance, or both; the camera sees neither."""
    scene = bpy.context.scene
    if sun:
        lamp = bpy.data.lights.new("Sun", "SUN")
        lamp.energy, lamp.angle = IRRADIANCE, 0.0
        ob = bpy.data.objects.new("Sun", lamp)
        ob.rotation_euler = Vector(SUN).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(ob)
    scene.world = bpy.data.worlds.new("World")
    background = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    background.inputs["Strength"].default_value = RADIANCE if sky else 0.0
    scene.render.film_transparent = True


def look(case, view, turn=0.0):
    """An orthographic camera at the side `view`, rotated about the trunk by an angle in rad."""
    scene = bpy.context.scene
    towards = Matrix.Rotation(turn, 3, "Z") @ Vector(VIEWS[view]).normalized()
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = "ORTHO", case.width
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.camera.location = Vector(case.middle) + 20 * towards
    scene.camera.rotation_euler = (-towards).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(scene.camera)
