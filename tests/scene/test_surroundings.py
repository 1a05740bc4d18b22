# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that are not selected, but would shade or light those that are."""

import bmesh
import bpy
import numpy as np
import pytest

from lb_lighting.scene.lights.receivers import Receivers
from lb_lighting.scene.surroundings import note_surroundings
from lb_lighting.transport.lights.distant import Sky, Sun
from lb_lighting.transport.lights.lamps import AreaLight, PointLight, SpotLight
from tests import scenery
from tests.output.rendering import surface
from tests.scenery import bake_light

FROM_ABOVE = Sun((0, 0, -1), 1.0)


def notes_of(*lights, volumes=True, skipped=()):
    """The notes for a box 2 m wide about the origin."""
    notes = []
    lit = scenery.link("lit", None)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    receivers = Receivers((lit,), (volumes,), np.full(3, -1.0), np.full(3, 1.0))
    note_surroundings(depsgraph, lights, receivers, notes, skipped)
    return notes


def add_box(name="box", size=(4, 4, 0.1), place=(0, 0, -1.2), material=None):
    shape, mesh = bmesh.new(), bpy.data.meshes.new(name)
    bmesh.ops.create_cube(shape, size=1)
    bmesh.ops.scale(shape, vec=size, verts=shape.verts)
    shape.to_mesh(mesh)
    shape.free()
    if material:
        mesh.materials.append(material)
    ob = scenery.link(name, mesh)
    ob.location = place
    return ob


def test_a_bake_names_the_floor_and_no_selected_object(scene, tmp_path):
    add_box("floor")
    fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
    (note,) = [n for n in bake_light(fog, leaves).notes if "Not selected" in n]
    assert "the selection: 'floor'; select" in note
    again = bake_light(fog, leaves, bpy.data.objects["floor"])  # nor the baked volume
    assert not [n for n in again.notes if "Not selected" in n]


def test_the_domain_is_not_named(scene, tmp_path):
    add_box("domain", (2, 2, 2), (0, 0, 0))
    assert not [
        note
        for note in bake_light(scenery.add_fog(tmp_path), domain="domain").notes
        if "Not selected" in note
    ]


def test_all_are_named_in_one_sentence_the_largest_first():
    add_box("stone", (0.3, 0.3, 0.3), (0, 0, -1.2))
    add_box("wall", (0.1, 3, 3), (2, 0, 0))
    add_box("floor")
    assert notes_of(Sky(1.0)) == [
        "Not selected, so they neither shade nor light the selection: 'floor', 'wall', 'stone'; "
        "select them too, with the role Occluder."
    ]


@pytest.mark.parametrize(
    ("place", "lights", "named"),
    [
        pytest.param((0, 0, 2.5), [], True, id="near"),
        pytest.param((0, 0, 6), [], False, id="far away"),
        pytest.param((0, 0, 6), [FROM_ABOVE], True, id="in the sun's way"),
        pytest.param((0, 0, -6), [FROM_ABOVE], False, id="in the shade of the box"),
        pytest.param((6, 0, 0), [FROM_ABOVE], False, id="beside the sun's way"),
        pytest.param((0, 0, 6), [PointLight((0, 0, 9), 1.0)], True, id="before a lamp"),
        pytest.param((0, 0, 6), [PointLight((0, 0, 5), 1.0)], False, id="behind a lamp"),
        pytest.param((0, 0, 6), [SpotLight((0, 0, 9), (0, 0, -1), 1.0, 1.0)], True, id="spot"),
        pytest.param((0, 0, 6), [AreaLight((0, 0, 9), (0, 1, 0), (1, 0, 0), 1.0)], True, id="area"),
        pytest.param((0, 0, 6), [Sky(1.0)], False, id="in the sky"),
    ],
)
def test_objects_near_or_in_front_of_a_light_are_named(place, lights, named):
    add_box("thing", (2, 2, 0.1), place)
    assert ["'thing'" in note for note in notes_of(*lights)] == [True] * named


def test_a_slanted_sun_is_followed():
    add_box("thing", (1, 1, 1), (10, 0, 10))
    assert len(notes_of(Sun((-1, 0, -1), 1.0))) == 1
    assert notes_of(Sun((1, 0, -1), 1.0)) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [("hide_render", True), ("is_holdout", True), ("type", "LIGHT"), ("type", "EMPTY")],
)
def test_objects_without_effect_are_not_named(name, value):
    if name == "type":
        data = bpy.data.lights.new("lamp", "AREA") if value == "LIGHT" else None
        scenery.link("thing", data)
    else:
        setattr(add_box(), name, value)
    assert notes_of(FROM_ABOVE) == []


def test_objects_that_no_ray_meets_are_not_named():
    """A floor that casts no shadow matters only to volumes that it is visible to."""
    floor = add_box()
    floor.visible_shadow = floor.visible_diffuse = False
    assert len(notes_of(volumes=True)) == 1
    assert notes_of(volumes=False) == []


def test_tiny_and_hidden_objects_are_not_named():
    add_box("pebble", (0.05, 0.05, 0.05), (0, 0, 0))
    collection = bpy.data.collections.new("off")
    bpy.context.scene.collection.children.link(collection)
    floor = add_box()
    collection.objects.link(floor)
    bpy.context.scene.collection.objects.unlink(floor)
    assert len(notes_of()) == 1
    collection.hide_render = True
    assert notes_of() == []


@pytest.mark.parametrize(
    ("kind", "inputs", "named"),
    [
        ("ShaderNodeBsdfDiffuse", {}, True),
        ("ShaderNodeBsdfTransparent", {}, False),
        ("ShaderNodeBsdfGlass", {}, False),
        ("ShaderNodeEmission", {}, False),
        ("ShaderNodeBsdfPrincipled", {}, True),
        ("ShaderNodeBsdfPrincipled", {"Alpha": 0.0}, False),
    ],
)
def test_clear_materials_are_not_named(kind, inputs, named):
    add_box(material=surface(kind, **inputs))
    assert len(notes_of()) == named


def test_an_instancer_is_named_for_its_instances():
    collection = bpy.data.collections.new("house")
    wall = add_box("wall", (0.1, 3, 3), (0, 0, 0))
    collection.objects.link(wall)
    bpy.context.scene.collection.objects.unlink(wall)
    empty = scenery.link("house", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.location = (1.5, 0, 0)
    (note,) = notes_of()
    assert "'house'" in note
    empty.location = (9, 0, 0)
    bpy.context.view_layer.update()
    assert notes_of() == []


def test_a_room_is_named_and_a_dome_far_away_is_not():
    room = add_box("room", (4, 4, 4), (0, 0, 0))
    assert len(notes_of()) == 1
    room.scale = (20, 20, 20)
    bpy.context.view_layer.update()
    assert notes_of() == []


def test_volumes_have_a_separate_sentence(tmp_path):
    scenery.add_fog(tmp_path, name="cloud").location = (2, 0, 0)
    assert notes_of() == [
        "Not selected, so these volumes neither shade nor light the selection: 'cloud'; select "
        "them too."
    ]


def test_fire_is_named_from_further_away(tmp_path):
    fire = scenery.add_fog(tmp_path, name="fire")
    fire.location = (6, 0, 0)
    assert notes_of() == []
    inputs = fire.data.materials[0].node_tree.nodes["Principled Volume"].inputs
    inputs["Emission Strength"].default_value = 1.0
    (note,) = notes_of()
    assert "'fire'" in note


def test_broken_materials_of_other_objects_do_not_stop_a_bake(scene, tmp_path):
    material = bpy.data.materials.new("broken")
    tree = bpy.data.node_groups.new("empty", "ShaderNodeTree")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    group = material.node_tree.nodes.new("ShaderNodeGroup")
    group.node_tree = tree
    output = material.node_tree.get_output_node("CYCLES")
    for name in ("Surface", "Volume"):
        material.node_tree.links.new(group.outputs[0], output.inputs[name])
    add_box("broken", material=material)
    assert bake_light(scenery.add_fog(tmp_path)).path.exists()
