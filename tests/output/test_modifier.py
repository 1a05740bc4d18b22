# SPDX-License-Identifier: GPL-3.0-or-later
"""Foliage that reads the baked volume shows the light that a bake would write on it, and is lit
where it moves."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from lb_lighting.clearing import clear
from lb_lighting.output.ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    ambient_axis,
    ambient_grids,
    irradiance,
    sample,
)
from lb_lighting.output.grid_groups import GRID_GROUP
from lb_lighting.output.modifier import add_modifier, has_modifier
from lb_lighting.output.shading_surfaces import wire_ambient
from lb_lighting.output.vdb import AXES, write_vdb
from lb_lighting.output.volume import show_volume
from lb_lighting.transport.field import Field, Report
from lb_lighting.transport.medium import Domain
from tests import scenery
from tests.output.rendering import dark_scene, middle, plane, render, surface
from tests.scenery import bake_light, snapshot

NAMES = (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE)


@pytest.fixture
def scene(scene):
    scene.lb_lighting.resolution = 12
    return scene


def close(light):
    """Blender stores matrices and samples grids in float32."""
    return pytest.approx(light, rel=1e-4, abs=2e-5 * float(light.max()))


def differ(light, other):
    """Whether they differ anywhere by more than a tenth of the largest value."""
    return np.abs(light - other).max() > 0.1 * light.max()


def evaluated(ob):
    return ob.evaluated_get(bpy.context.evaluated_depsgraph_get())


def colors(attributes, name):
    """(n, 3) of the colour attribute `name`."""
    attribute = attributes[name]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]


def shown(ob):
    """(2, n, 3): the light of front and back on the points of the evaluated mesh."""
    return np.array([colors(evaluated(ob).data.attributes, name) for name in NAMES])


def world_points(ob):
    """Points and normals (n, 3) of the mesh in world space."""
    mesh, matrix = evaluated(ob).data, ob.matrix_world
    turn = matrix.to_3x3().inverted().transposed()
    normals = [(turn @ normal.vector).normalized() for normal in mesh.vertex_normals]
    return np.array([matrix @ vertex.co for vertex in mesh.vertices]), np.array(normals)


def expected(field, ob, occlusion=None):
    return np.array(irradiance(field, *world_points(ob), occlusion)) / np.pi


def inside(ob, domain):
    """Points between the domain's voxel centres: beyond, the modifier fades the light."""
    index = domain.to_index(world_points(ob)[0])
    return np.all((index >= 0) & (index <= np.subtract(domain.shape, 1)), axis=1)


def set_input(ob, name, value):
    modifier = ob.modifiers[GRID_GROUP]
    item = modifier.node_group.interface.items_tree[name]
    getattr(modifier.properties.inputs, item.identifier).value = value
    ob.update_tag()


def modified(ob, value):
    """The scene's `bake.Outcome` with the modifier on."""
    return bake_light(ob, foliage="MODIFIER", **value)


@pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
def test_it_shows_what_would_be_written(scene, tmp_path, mode):
    """With a sky too, whose uncollided light is in the volume's grids in Replace."""
    scene.world = bpy.data.worlds.new("sky")
    leaves = scenery.add_leaves(count=50)
    lid = scenery.add_ball("lid", radius=0.5, role="OCCLUDER", material=scenery.leaf_material())
    lid.location.z, lid.scale.z = 0.7, 0.3
    sources = scenery.add_fog(tmp_path), leaves, lid
    bake_light(*sources, mode=mode)
    written = shown(leaves)
    bake_light(*sources, mode=mode, foliage="MODIFIER")
    assert not set(NAMES) & set(leaves.data.attributes.keys())
    assert set(NAMES) <= set(lid.data.attributes.keys())
    assert not has_modifier(lid)
    assert written.max() > 0.1
    assert shown(leaves) == close(written)


@pytest.mark.parametrize(
    "matrix",
    [
        Matrix.Translation((0.2, -0.1, 0.3)),
        Matrix.Rotation(2.0, 4, (1, 2, 3)),
        Matrix.Diagonal((0.5, 1, -0.7, 1)),
    ],
    ids=["moved", "turned", "mirrored and stretched"],
)
def test_it_follows_the_plant_without_another_bake(scene, matrix):
    ob = scenery.add_leaves()
    field = modified(ob, {"padding": 4}).field
    before = shown(ob)
    ob.matrix_world = matrix
    bpy.context.view_layer.update()
    known = inside(ob, field.domain)
    assert known.mean() > 0.9
    assert differ(shown(ob), before)
    assert shown(ob)[:, known] == close(expected(field, ob)[:, known])


def test_it_follows_a_plant_that_sways(scene):
    ob = scenery.add_leaves()
    field = modified(ob, {"padding": 4}).field
    ob.shape_key_add(name="rest")
    key = ob.shape_key_add(name="sway")
    for point in key.data:
        point.co.x += 0.2 * point.co.z
    for frame, value in ((1, 0.0), (10, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    lights = []
    for frame in (1, 10):
        scene.frame_set(frame)
        known = inside(ob, field.domain)
        lights.append(shown(ob))
        assert lights[-1][:, known] == close(expected(field, ob)[:, known])
    assert differ(*lights)


def test_outside_of_the_lattice_there_is_no_light(scene):
    ob = scenery.add_leaves()
    modified(ob, {})
    ob.location.x = 10
    assert shown(ob).max() == 0


def test_strength(scene):
    ob = scenery.add_leaves()
    modified(ob, {})
    before = shown(ob)
    set_input(ob, "Strength", 2.5)
    assert shown(ob) == close(2.5 * before)
    modified(ob, {})
    assert shown(ob) == close(2.5 * before)  # a value of the user's stays


def scatter_group(leaf, turned=6):
    """Geometry nodes that put the object `leaf`, randomly rotated, on the points of a mesh."""
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    tree.is_modifier = True
    for in_out in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    names = {
        "input": "NodeGroupInput",
        "info": "GeometryNodeObjectInfo",
        "turn": "FunctionNodeRandomValue",
        "put": "GeometryNodeInstanceOnPoints",
        "output": "NodeGroupOutput",
    }
    node = {name: tree.nodes.new(kind) for name, kind in names.items()}
    node["info"].inputs["Object"].default_value = leaf
    node["info"].inputs["As Instance"].default_value = True
    node["turn"].data_type = "FLOAT_VECTOR"
    node["turn"].inputs["Max"].default_value = (turned,) * 3
    link = tree.links.new
    link(node["input"].outputs[0], node["put"].inputs["Points"])
    link(node["info"].outputs["Geometry"], node["put"].inputs["Instance"])
    link(node["turn"].outputs["Value"], node["put"].inputs["Rotation"])
    link(node["put"].outputs[0], node["output"].inputs[0])
    return tree


@pytest.fixture
def plant(scene):
    """An object that consists of instances, 300 square leaves, 0.1 m wide; and their field."""
    leaf = bpy.data.meshes.new("leaf")
    corners = [(x / 20, y / 20, 0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    leaf.from_pydata(corners, [], [(0, 1, 2, 3)])
    leaf.materials.append(scenery.leaf_material())
    leaf = scenery.link("leaf", leaf)
    leaf.hide_render = leaf.hide_viewport = True
    points = np.random.default_rng(3).uniform(-0.9, 0.9, (300, 3))
    mesh = bpy.data.meshes.new("plant")
    mesh.from_pydata(points.tolist(), [], [])
    ob = scenery.link("plant", mesh)
    ob.modifiers.new("scatter", "NODES").node_group = scatter_group(leaf)
    ob.location, ob.rotation_euler = (3, 1, 2), (0.2, 0.4, 0.6)
    bpy.context.view_layer.update()
    return ob


def test_instances_stay_and_have_the_light_where_they_are(plant):
    outcome = modified(plant, {})
    assert not any("instances" in note for note in outcome.notes)
    geometry = evaluated(plant).evaluated_geometry()
    cloud = geometry.instances_pointcloud()
    points = np.array([plant.matrix_world @ vertex.co for vertex in plant.data.vertices])
    grids, domain = ambient_grids(outcome.field), outcome.field.domain
    for name in (AMBIENT_ATTRIBUTE, *map(ambient_axis, AXES)):
        light = np.broadcast_to(sample(domain, grids[name], points), (300, 3))
        assert colors(cloud.attributes, name) == close(light)


def test_made_real_each_point_is_lit(plant):
    field = modified(plant, {"padding": 3}).field
    set_input(plant, "Realize Instances", True)
    assert len(evaluated(plant).data.vertices) == 1200
    assert shown(plant) == close(expected(field, plant))


def test_clear_gives_everything_back(plant, tmp_path):
    fog = scenery.add_fog(tmp_path)
    before = snapshot()
    for foliage in ("ATTRIBUTE", "MODIFIER", "MODIFIER"):
        bake_light(fog, plant, foliage=foliage)
    assert len([m for m in plant.modifiers if m.node_group.name == GRID_GROUP]) == 1
    assert clear(bpy.context).count == 2
    assert snapshot() == before


MEAN, FLUX = np.array([1.0, 2.0, 3.0]), np.array([0.4, -0.5, 0.6])  # W/(m^2 sr), W/m^2 upwards


def upward_field():
    """Light of the same mean radiance and flux upwards in all voxels about the origin."""
    domain = Domain((-4.0, -4.0, -4.0), 1.0, (8, 8, 8))
    everywhere = np.ones((3, *domain.shape))
    flux = np.zeros((3, 3, *domain.shape))
    flux[:, 2] = FLUX[:, None, None, None] * everywhere
    fluence = 4 * np.pi * MEAN[:, None, None, None] * everywhere
    return Field(domain, fluence, 0 * fluence, flux, Report("physical", "none"))


@pytest.mark.parametrize("tilt", [0.0, 0.9, np.pi])
@pytest.mark.parametrize("kind", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTranslucent"])
@pytest.mark.parametrize("realize", [False, True])
def test_each_side_of_an_instance_shows_the_light_that_it_gets(tmp_path, tilt, kind, realize):
    scene = dark_scene((0, 0, 10), (0, 0, 0), width=1)
    path = tmp_path / "a.vdb"
    field = upward_field()
    nothing = np.zeros(field.domain.shape)
    write_vdb(path, field.domain, nothing, nothing[None], {}, everywhere=ambient_grids(field))
    baked = show_volume(bpy.context, [scenery.source("plant")], path)
    leaf = plane(0, 2, surface(kind, Color=(1, 1, 1, 1)))
    wire_ambient(leaf.active_material)
    leaf.hide_render = True
    mesh = bpy.data.meshes.new("point")
    mesh.from_pydata([(0, 0, 0)], [], [])
    plant = scenery.link("a plant", mesh)
    plant.rotation_euler.y = tilt
    plant.modifiers.new("scatter", "NODES").node_group = scatter_group(leaf, turned=0)
    add_modifier(plant, baked)
    set_input(plant, "Realize Instances", realize)
    up = abs(np.cos(tilt)) * (-1 if kind == "ShaderNodeBsdfDiffuse" else 1)
    picture = render(scene, tmp_path / "a.exr", 16, 4)
    assert middle(picture) == pytest.approx(MEAN + up * FLUX / (2 * np.pi), rel=0.01)
