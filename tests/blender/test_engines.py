# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces show the light of the lattice in both engines: written on points, and of instances."""

import bpy
import numpy as np
import pytest
from scenes import camera, new_object, part, render

MEAN, FLUX = np.array([0.1, 0.2, 0.3]), np.array([0.1, -0.2, 0.3])  # W/(m^2 sr), W/m^2 along +y


def white(kind):
    """A material of that closure alone."""
    material = bpy.data.materials.new(kind)
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def shine(radiance):
    """A sky that is the same everywhere."""
    bpy.context.scene.world = bpy.data.worlds.new("sky")
    nodes = bpy.context.scene.world.node_tree.nodes
    background = next(node for node in nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (radiance,) * 3 + (1,)


def square(material):
    """An upright square of 2 m whose normal points to the camera, along -y."""
    mesh = bpy.data.meshes.new("square")
    mesh.from_pydata([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)], [], [(0, 1, 2, 3)])
    mesh.materials.append(material)
    return new_object("square", mesh)


def baked(lb, path):
    """A baked volume whose light is the same everywhere about the origin."""
    names = ("transport.medium", "transport.field", "output.vdb", "output.volume")
    medium, fields, vdb, volume = (part(lb, name) for name in names)
    domain = medium.Domain((-4.0, -4.0, -4.0), 1.0, (8, 8, 8))
    ones = np.ones((3, *domain.shape))
    fluence = 4 * np.pi * MEAN[:, None, None, None] * ones
    flux = np.zeros((3, 3, *domain.shape))
    flux[:, 1] = FLUX[:, None, None, None]
    field = fields.Field(domain, fluence, 0 * fluence, flux, fields.Report("physical", "none"))
    grids = part(lb, "output.ambient").ambient_grids(field)
    vdb.write_vdb(path, domain, 0 * ones[0], 0 * ones[:1], {}, everywhere=grids)
    return volume.show_volume(bpy.context, [new_object("source", None)], path)


def instance(ob):
    """An object of one point, where geometry nodes put the object `ob` and nothing else."""
    mesh = bpy.data.meshes.new("point")
    mesh.from_pydata([(0, 0, 0)], [], [])
    tree = bpy.data.node_groups.new("put", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeObjectInfo", "GeometryNodeInstanceOnPoints",
             "NodeGroupOutput")  # fmt: skip
    points, info, put, output = (tree.nodes.new(kind) for kind in kinds)
    info.inputs["Object"].default_value = ob
    info.inputs["As Instance"].default_value = True
    tree.links.new(points.outputs[0], put.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], put.inputs["Instance"])
    tree.links.new(put.outputs[0], output.inputs[0])
    ob.hide_render = True
    plant = new_object("plant", mesh)
    plant.modifiers.new("put", "NODES").node_group = tree
    return plant


@pytest.mark.parametrize("engine", ["BLENDER_EEVEE", "CYCLES"])
@pytest.mark.parametrize("kind", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTranslucent"])
@pytest.mark.parametrize("instanced", [False, True])
@pytest.mark.parametrize("all_light", [False, True], ids=["dark", "sky"])
def test_a_modifier_lights_each_side(lb, tmp_path, engine, kind, instanced, all_light):
    """Under a sky, too, whose own light is not added to what is all light."""
    ob = square(white(kind))
    if all_light:
        shine(0.5)
    part(lb, "output.shading_surfaces").wire_ambient(ob.active_material, all_light=all_light)
    lit = instance(ob) if instanced else ob
    part(lb, "output.modifier").add_modifier(lit, baked(lb, tmp_path / "a.vdb"), all_light)
    camera(target=(0, 0, 0), width=1)
    # The flux goes to the seen side of what reflects, and leaves that of what lets through.
    sign = 1 if kind == "ShaderNodeBsdfDiffuse" else -1
    picture = render(tmp_path / f"{engine}_{kind}_{instanced}_{all_light}.exr", engine, size=16)
    expected = MEAN + sign * FLUX / (2 * np.pi)
    assert picture[8, 8, :3] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("engine", ["BLENDER_EEVEE", "CYCLES"])
def test_what_was_gathered_is_shown_by_the_way_to_the_eye(lb, cycles_shows_grids, tmp_path, engine):
    """That is along -y; with the lobe of a sun that goes there, too, and with its own light."""
    if engine == "CYCLES" and not cycles_shows_grids:
        pytest.skip("this Blender's Cycles is built without NanoVDB: it shows no volume grids")
    names = (
        "transport.medium",
        "transport.lights.distant",
        "output.vdb",
        "output.volume",
        "output.shading_volumes",
        "output.render_settings",
    )
    medium, lights, vdb, volume, shading, settings = (part(lb, name) for name in names)
    domain = medium.Domain((-2.0, -2.0, -2.0), 0.25, (16, 16, 16))
    density = np.zeros(domain.shape, np.float32)
    density[4:12, 4:12, 4:12] = 1
    moments = np.outer(np.linspace(0.1, 0.9, 9), (1.0, 0.5, 0.2))  # of 1, x, y, z, xy, ...
    moments[[2, 7, 8]] *= -1
    grids = {vdb.moment_grid(n): moments[n] for n in range(1, 9)}
    grids |= {vdb.forward_grid(1): MEAN, vdb.direct_grid(1): MEAN / 2}
    grids = {
        name: np.broadcast_to(values[:, None, None, None], (3, *domain.shape))
        for name, values in grids.items()
    }
    light = np.broadcast_to(moments[0][:, None, None, None], (3, *domain.shape))
    vdb.write_vdb(tmp_path / "a.vdb", domain, density, light, {}, grids)
    ob = volume.show_volume(bpy.context, [new_object("source", None)], tmp_path / "a.vdb")
    sun = lights.Sun((0.0, -1.0, 0.0), 1.0)
    settings.prepare_scene(bpy.context.scene)
    thin, g, lobes = 0.01, 0.3, 0.2
    shading.shade_volume(ob, "REPLACE", thin, 0.0, g, [sun], 0.0, 1.0, lobes)
    camera(target=(0, 0, 0), width=1)
    picture = render(tmp_path / f"{engine}_moments.exr", engine, size=16)
    # To the eye y is -1, so -y counts, 3 z^2 - 1 is -1 and so is x^2 - y^2.
    shown = moments[0] - moments[2] - moments[7] - moments[8]
    shown = shown + sum(own * (1 + m) / (1 - m) ** 2 for own, m in ((MEAN, lobes), (MEAN / 2, g)))
    assert picture[8, 8, :3] == pytest.approx(shown * thin * 2, rel=0.05)
