# SPDX-License-Identifier: GPL-3.0-or-later
"""Small things to light, bakes of them, and what there is to compare afterwards."""

import os
from contextlib import contextmanager

import bmesh
import bpy
import numpy as np
import openvdb

from lb_lighting import bake
from lb_lighting.options import Options
from lb_lighting.output.attribute import AMBIENT_ATTRIBUTE
from lb_lighting.output.vdb import LIGHT_GRID

EDGE = 8  # voxels of a fog
# What tells of the session, not of the file.
NOT_OF_THE_FILE = {
    "all_ids",
    "screens",
    "session_uid",
    "velocity_grid",  # filled in where Blender has read the .vdb
    "window_managers",
    "workspaces",
}


def link(name, data):
    ob = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def add_sun(color=(1, 1, 1)):
    """A sun that shines straight down, with 3 W/m^2."""
    lamp = bpy.data.lights.new("sun", "SUN")
    lamp.energy, lamp.color = 3, color
    return link("sun", lamp)


def ball():
    """(EDGE, EDGE, EDGE): density of a ball that fills the grid."""
    axis = np.linspace(-1, 1, EDGE)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.clip(1.3 - np.sqrt(x**2 + y**2 + z**2), 0, 1)


def write_fog(path, values):
    """A .vdb with `values` as the grid "density", 2 m wide about the origin."""
    grid = openvdb.FloatGrid()
    grid.copyFromArray(np.ascontiguousarray(values, np.float32))
    grid.name = "density"
    grid.transform = openvdb.createLinearTransform(2 / EDGE)
    grid.transform.postTranslate((1 / EDGE - 1,) * 3)
    for voxel in np.argwhere(np.isnan(values)):  # which copyFromArray drops
        grid.getAccessor().setValueOn(voxel, np.nan)
    openvdb.write(str(path), [grid])


def add_fog(folder, values=None, name="fog", material=True):
    """A Volume object 2 m wide about the origin, backed by a file."""
    path = folder / f"{name}.vdb"
    write_fog(path, ball() if values is None else values)
    data = bpy.data.volumes.new(name)
    data.filepath = str(path)
    if material:
        data.materials.append(volume_material())
    return link(name, data)


def volume_material(density=4.0, color=(0.9, 0.9, 0.9), anisotropy=0.3):
    """A Principled Volume and nothing else."""
    material = bpy.data.materials.new("fog")
    nodes = material.node_tree.nodes
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    volume = nodes.new("ShaderNodeVolumePrincipled")
    volume.inputs["Density"].default_value = density
    volume.inputs["Color"].default_value = (*color, 1)
    volume.inputs["Anisotropy"].default_value = anisotropy
    material.node_tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])
    return material


def leaf_material(color=(0.1, 0.5, 0.1)):
    material = bpy.data.materials.new("leaf")
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*color, 1)
    return material


def add_leaves(name="leaves", count=200, material=True):
    """Small triangles turned every way, in a cube of 2 m about the origin."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-0.9, 0.9, (count, 1, 3)) + rng.uniform(-0.1, 0.1, (count, 3, 3))
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners.reshape(-1, 3).tolist(), [], np.arange(3 * count).reshape(-1, 3))
    if material:
        mesh.materials.append(leaf_material())
    return link(name, mesh)


def add_ball(name="ball", radius=0.8, role="AUTO", material=None):
    """A closed mesh about the origin."""
    mesh = bpy.data.meshes.new(name)
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=3, radius=radius)
    shape.to_mesh(mesh)
    shape.free()
    if material:
        mesh.materials.append(material)
    ob = link(name, mesh)
    ob.lb_lighting.role = role
    return ob


def bake_light(*objects, progress=None, **changes):
    """The `bake.Outcome` of the scene's own settings with `changes`."""
    options = Options.of(bpy.context.scene, **changes)
    return bake.bake(bpy.context, objects, options, progress)


def select(*objects):
    for ob in bpy.context.scene.objects:
        ob.select_set(ob in objects)


def read_grid(path, name=LIGHT_GRID):
    """(values on the box of its active voxels, the box's first voxel)."""
    grid = openvdb.read(str(path), name)
    first, last = grid.evalActiveVoxelBoundingBox()
    values = np.empty((*np.subtract(last, first) + 1, 3)[: 3 if name == "density" else 4], "f4")
    grid.copyToArray(values, first)
    return values, first


def ambient(ob):
    """(vertices, 3): the light on the mesh of `ob`, W/(m^2 sr)."""
    colors = np.empty(4 * len(ob.data.vertices), np.float32)
    ob.data.attributes[AMBIENT_ATTRIBUTE].data.foreach_get("color", colors)
    return colors.reshape(-1, 4)[:, :3]


@contextmanager
def read_only(folder):
    """Inside, this process may not write to `folder`."""
    user = os.geteuid()
    folder.chmod(0o555)
    try:
        if user == 0:  # to root, no folder is read-only
            os.seteuid(65534)
        yield
    finally:
        os.seteuid(user)
        folder.chmod(0o755)


def snapshot():
    """{(kind, name): facts} of everything in the file, to compare before and after."""
    kinds = [p.identifier for p in bpy.data.bl_rna.properties if p.type == "COLLECTION"]
    return {
        (kind, block.name): _facts(block)
        for kind in kinds
        if kind not in NOT_OF_THE_FILE
        for block in getattr(bpy.data, kind)
    }


def _facts(block):
    facts = _values(block) | {key: _own(block[key]) for key in block.keys()}  # noqa: SIM118
    for name in ("cycles", "lb_lighting", "render", "view_settings"):
        if hasattr(part := getattr(block, name, None), "bl_rna"):
            facts[name] = _values(part)
    if isinstance(block, bpy.types.Object):
        facts["slots"] = [
            (slot.link, slot.material and slot.material.name) for slot in block.material_slots
        ]
        facts["selected"] = block.select_get()
    if isinstance(block, bpy.types.Scene):
        facts["objects"] = block.objects.keys()
    if isinstance(block, bpy.types.Mesh):
        colors = block.color_attributes
        facts["colors"] = colors.active_color_name, colors.default_color_name
        facts["attributes"] = [_values(attribute) for attribute in block.attributes]
    if hasattr(block, "materials"):
        facts["materials"] = [material and material.name for material in block.materials]
    if tree := getattr(block, "node_tree", None):
        facts["nodes"] = {node.name: _node_facts(node) for node in tree.nodes}
        facts["links"] = {(link.from_socket.path_from_id(), link.to_socket.path_from_id())
                          for link in tree.links}  # fmt: skip
    return facts


def _own(value):
    """A custom property as it reads, whatever its address."""
    if isinstance(value, bpy.types.ID):
        return value.name
    return str(value.to_dict() if hasattr(value, "to_dict") else value)


def _node_facts(node):
    return _values(node) | {"inputs": [_values(socket) for socket in node.inputs]}


def _values(struct):
    """{property: value} of numbers and texts, and the names of data-blocks."""
    values = {}
    for prop in struct.bl_rna.properties:
        if prop.type == "COLLECTION" or prop.is_deprecated or prop.identifier in NOT_OF_THE_FILE:
            continue
        value = getattr(struct, prop.identifier)
        if prop.type != "POINTER":
            values[prop.identifier] = value if np.isscalar(value) else str(_plain(value))
        elif isinstance(value, bpy.types.ID):
            values[prop.identifier] = value.name
    return values


def _plain(value):
    if isinstance(value, set):
        return sorted(value)
    return [_plain(v) for v in value] if hasattr(value, "__iter__") else value


def source(name):
    """An object of that name in the scene, to show light for; made at the first call."""
    scene = bpy.context.scene
    if name not in scene.objects:
        scene.collection.objects.link(bpy.data.objects.new(name, None))
    return scene.objects[name]
