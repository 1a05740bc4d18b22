# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies that modifiers, shared meshes and instances make are lit where they are, or a note reports
them."""

import subprocess
import sys

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from lb_lighting import bake
from lb_lighting.clearing import clear
from lb_lighting.options import Options
from lb_lighting.output.ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    Vertices,
    irradiance,
    sample,
)
from lb_lighting.output.attribute import has_ambient
from lb_lighting.output.grid_groups import GRID_GROUP
from lb_lighting.output.modifier import has_modifier
from lb_lighting.reading import read_scene
from lb_lighting.scene.read_meshes import read_mesh
from lb_lighting.sequence import Sequence
from tests import scenery
from tests.scenery import bake_light, snapshot


@pytest.fixture
def scene(scene):
    scene.lb_lighting.resolution, scene.lb_lighting.padding = 12, 3
    return scene


def evaluated(ob):
    return ob.evaluated_get(bpy.context.evaluated_depsgraph_get())


def shown(ob, name=AMBIENT_ATTRIBUTE):
    """(n, 3): the light on the points of the evaluated mesh, of the front or of `name`."""
    attribute = evaluated(ob).data.attributes[name]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]


def expected(field, ob):
    """(n, 3): the light of the field that falls on the front of each point."""
    mesh, matrix = evaluated(ob).data, ob.matrix_world
    turn = matrix.to_3x3().inverted().transposed()
    normals = [(turn @ normal.vector).normalized() for normal in mesh.vertex_normals]
    points = [matrix @ vertex.co for vertex in mesh.vertices]
    return irradiance(field, np.array(points), np.array(normals))[0] / np.pi


def is_right(ob, field):
    light = expected(field, ob)
    return shown(ob) == pytest.approx(light, rel=1e-3, abs=1e-4 * float(light.max()))


def about(notes, name):
    return [note for note in notes if f"'{name}'" in note]


def mirror(ob):
    """The mirrored half is far from the light."""
    for vertex in ob.data.vertices:
        vertex.co.z = 0.5 * vertex.co.z + 0.6
    ob.modifiers.new("mirror", "MIRROR").use_axis = (False, False, True)


def array(ob):
    modifier = ob.modifiers.new("array", "ARRAY")
    modifier.use_relative_offset, modifier.use_constant_offset = False, True
    modifier.constant_offset_displace = (0, 0, -1)


def solidify(ob):
    ob.modifiers.new("solidify", "SOLIDIFY").thickness = 0.3


def bent_and_subdivided(ob):
    ob.modifiers.new("bend", "SIMPLE_DEFORM").deform_method = "BEND"
    ob.modifiers.new("subdivide", "SUBSURF").levels = 1


REPEATS = [mirror, array, solidify, bent_and_subdivided]


@pytest.mark.parametrize("repeat", REPEATS)
def test_what_modifiers_make_is_lit_where_it_is(scene, repeat):
    ob = scenery.add_leaves(count=40)
    repeat(ob)
    before = snapshot()
    outcome = bake_light(ob)
    assert len(evaluated(ob).data.vertices) != len(ob.data.vertices)
    assert is_right(ob, outcome.field)
    assert not has_ambient(ob)
    assert ob.modifiers[-1].node_group.name == GRID_GROUP
    (note,) = about(outcome.notes, ob.name)
    assert "modifiers" in note
    assert GRID_GROUP in note
    clear(bpy.context)
    assert snapshot() == before


def test_modifiers_that_only_move_vertices_need_none(scene):
    ob = scenery.add_leaves(count=40)
    ob.modifiers.new("bend", "SIMPLE_DEFORM").deform_method = "BEND"
    outcome = bake_light(ob)
    assert has_ambient(ob)
    assert not has_modifier(ob)
    assert not about(outcome.notes, ob.name)
    assert is_right(ob, outcome.field)


@pytest.fixture
def twins(scene):
    """Two plants with one mesh, one in the sun, the other far below and upside down."""
    first = scenery.add_leaves("first", count=60)
    second = scenery.link("second", first.data)
    second.matrix_world = Matrix.Translation((0.1, 0, -2)) @ Matrix.Rotation(np.pi, 4, "X")
    bpy.context.view_layer.update()
    return first, second


def test_each_of_those_that_share_a_mesh_has_its_own_light(twins):
    before = snapshot()
    outcome = bake_light(*twins)
    for twin in twins:
        assert is_right(twin, outcome.field)
        (note,) = about(outcome.notes, twin.name)
        assert "mesh is shared" in note
    assert has_ambient(twins[0])
    means = [shown(twin).mean() for twin in twins]
    assert max(means) > 1.1 * min(means)
    clear(bpy.context)
    assert snapshot() == before


def test_one_that_is_not_rendered_is_no_sharer(twins):
    twins[1].hide_render = True
    outcome = bake_light(twins[0])
    assert has_ambient(twins[0])
    assert not about(outcome.notes, "first")


def test_the_vertices_are_used_again_once_they_are_its_own(twins):
    bake_light(*twins)
    twins[0].data = twins[0].data.copy()
    bake_light(*twins)
    for twin in twins:
        assert has_ambient(twin)
        assert not has_modifier(twin)


@pytest.mark.parametrize("role", ["SOLID", "OCCLUDER"])
def test_bodies_and_walls_are_lit_where_they_are(scene, role):
    """Each side as in `Vertices`: in front of walls, and what leaves bodies."""
    scene.lb_lighting.resolution = 20
    material = scenery.leaf_material((0.6, 0.5, 0.4))
    names = "one", "two", "row"
    one, two, row = (scenery.add_ball(name, 0.5, role, material) for name in names)
    two.data = one.data
    two.location, row.location = (0.4, 0, -1.4), (0, 2, 0)
    array(row)
    leaves = scenery.add_leaves(count=20)
    bpy.context.view_layer.update()
    before = snapshot()
    outcome = bake_light(one, two, row, leaves)
    occlusion = outcome.baking.task.problem().medium.occlusion
    for ob, reason in ((one, "shared"), (two, "shared"), (row, "modifiers")):
        assert has_ambient(ob) == (reason == "shared")
        vertices = Vertices(
            read_mesh(evaluated(ob).data),
            np.array(ob.matrix_world),
            is_body=role == "SOLID",
            is_wall=role == "OCCLUDER",
        )
        sides = vertices.light(outcome.field, occlusion)[..., :3]
        assert sides.max() > 0.01
        for name, side in zip((AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE), sides, strict=True):
            assert shown(ob, name) == pytest.approx(side, rel=2e-3, abs=2e-4 * float(sides.max()))
        assert any(reason in note for note in about(outcome.notes, ob.name))
    clear(bpy.context)
    bpy.context.view_layer.update()
    assert snapshot() == before


def test_a_wall_of_large_faces_shows_none(scene):
    """It cannot store light on its points, repeated or not."""
    leaves = scenery.add_leaves(count=20)
    bpy.ops.mesh.primitive_plane_add(size=4, location=(0, 0, -1.2))
    ground = bpy.context.object
    ground.lb_lighting.role = "OCCLUDER"
    array(ground)
    notes = bake_light(leaves, ground).notes
    assert not has_modifier(ground)
    assert any("shows none of the light" in note for note in about(notes, ground.name))


def scattered(leaf):
    """Geometry nodes that put the object `leaf` on each vertex, without the mesh."""
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    tree.is_modifier = True
    for in_out in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    start, info, put, end = (
        tree.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "GeometryNodeObjectInfo",
            "GeometryNodeInstanceOnPoints",
            "NodeGroupOutput",
        )
    )
    info.inputs["Object"].default_value = leaf
    info.inputs["As Instance"].default_value = True
    for source, target in (
        (start.outputs[0], put.inputs["Points"]),
        (info.outputs["Geometry"], put.inputs["Instance"]),
        (put.outputs[0], end.inputs[0]),
    ):
        tree.links.new(source, target)
    return tree


def test_instances_are_lit_without_being_asked_for(scene):
    leaf = scenery.add_leaves("leaf", count=1)
    leaf.scale = (0.2,) * 3
    leaf.hide_render = leaf.hide_viewport = True
    ob = scenery.add_leaves("plant", count=30, material=False)
    ob.modifiers.new("scatter", "NODES").node_group = scattered(leaf)
    outcome = bake_light(ob)
    assert has_modifier(ob)
    (note,) = about(outcome.notes, "plant")
    assert "instances" in note
    geometry = evaluated(ob).evaluated_geometry()
    cloud = geometry.instances_pointcloud()
    light = np.empty(4 * 90, np.float32)
    cloud.attributes[AMBIENT_ATTRIBUTE].data.foreach_get("color", light)
    points = np.array([vertex.co for vertex in ob.data.vertices])
    mean = sample(outcome.field.domain, outcome.field.fluence, points) / (4 * np.pi)
    assert mean.max() > 0
    assert light.reshape(-1, 4)[:, :3] == pytest.approx(mean, rel=1e-3)


def test_a_note_names_some_of_many(scene):
    scene.lb_lighting.resolution = 8
    first = scenery.add_leaves("tree", count=20)
    trees = [first, *(scenery.link(f"tree {number}", first.data) for number in range(9))]
    task = read_scene(bpy.context, trees, Options.of(scene))
    (note,) = about(task.medium_choice.notes, "tree")
    assert note.startswith("'tree', 'tree 0', 'tree 1', 'tree 2', 'tree 3' and 5 more: the mesh")


@pytest.mark.parametrize("selected", [False, True])
def test_a_note_names_what_others_instance(scene, selected):
    """A collection instance; a selected one has a note of its own."""
    ob = scenery.add_leaves(count=20)
    crown = bpy.data.collections.new("crown")
    crown.objects.link(ob)
    empty = scenery.link("copy", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", crown
    empty.location.z = -30  # too far to affect the selection
    chosen = [ob, empty] if selected else [ob]
    task = read_scene(bpy.context, chosen, Options.of(scene))
    (note,) = about(task.medium_choice.notes, "copy")
    assert ("leaves" in note) is not selected


def test_all_frames_of_a_plant_that_grows_have_its_light(scene, tmp_path):
    """Once it is grown, it has all vertices of the original, and could store its light."""
    ob = scenery.add_leaves(count=30)
    build = ob.modifiers.new("build", "BUILD")
    build.frame_start, build.frame_duration = 1, 2
    options = Options.of(scene, folder=str(tmp_path))
    outcome = bake.run(Sequence(bpy.context, [ob], options, 2, 3), bpy.context)
    assert len(about(outcome.notes, ob.name)) == 1
    assert has_modifier(ob)
    for frame in (2, 3):
        scene.frame_set(frame)
        assert shown(ob).max() > 0
    assert len(shown(ob)) == len(ob.data.vertices)


WITHOUT_US = """
import os, sys, bpy, numpy as np
bpy.utils.expose_bundled_modules()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
mesh = bpy.data.objects["leaves"].evaluated_get(bpy.context.evaluated_depsgraph_get()).data
light = np.empty(4 * len(mesh.vertices), "f4")
mesh.attributes["lb_ambient"].data.foreach_get("color", light)
print("light", light.sum())
sys.stdout.flush()
os._exit(0)
"""


def test_a_file_needs_no_extension_to_show_it(scene, tmp_path):
    ob = scenery.add_leaves(count=40)
    array(ob)
    bake_light(ob, folder=str(tmp_path))
    path = str(tmp_path / "lit.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    call = [sys.executable, "-c", WITHOUT_US, path]
    said = subprocess.run(call, capture_output=True, text=True, check=True).stdout
    light = float(said.split("light")[-1])
    alpha = len(shown(ob))
    assert light - alpha == pytest.approx(float(shown(ob).sum()), rel=1e-3)
