# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaders in node groups show light as they do in the material itself, and are restored."""

import bpy
import numpy as np
import pytest

from lb_lighting.clearing import clear
from lb_lighting.output.attribute import write_ambient
from lb_lighting.output.shading_surfaces import hindrance, unwire_ambient, wire_ambient
from lb_lighting.scene.materials import leaf_optics
from tests import scenery
from tests.output.rendering import dark_scene, plane, render
from tests.scenery import bake_light, snapshot

LIGHT = (2.0, 1.0, 0.5)


def new_group(name):
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    tree.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    return tree, tree.nodes.new("NodeGroupOutput")


def put(tree, group):
    """A node of the node group `group` in `tree`."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    return node


def material_of(group, name="leaf"):
    """A material that shows only a node group of the user."""
    material = bpy.data.materials.new(name)
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    tree.links.new(put(tree, group).outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return material


def dark_leaf(tree):
    """The socket of a dark closure with holes in a checker pattern."""
    shader, checker = (
        tree.nodes.new("ShaderNodeBsdfPrincipled"),
        tree.nodes.new("ShaderNodeTexChecker"),
    )
    shader.inputs["Base Color"].default_value = (0.1, 0.25, 0.05, 1)
    shader.inputs["Specular IOR Level"].default_value = 0
    checker.inputs["Scale"].default_value = 4
    tree.links.new(checker.outputs["Factor"], shader.inputs["Alpha"])
    return shader.outputs[0]


def mixed_leaf(tree):
    """The socket of two closures, which differ in colour and side."""
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.inputs[0].default_value = 0.3
    for kind, color, target in (
        ("ShaderNodeBsdfDiffuse", (0.3, 0.2, 0.1, 1), mix.inputs[1]),
        ("ShaderNodeBsdfTranslucent", (0.1, 0.4, 0.2, 1), mix.inputs[2]),
    ):
        node = tree.nodes.new(kind)
        node.inputs["Color"].default_value = color
        tree.links.new(node.outputs[0], target)
    return mix.outputs[0]


def muted_mix(tree):
    """The socket of a muted mix, which passes on its first closure."""
    socket = mixed_leaf(tree)
    socket.node.mute = True
    return socket


def muted_closure(tree):
    """The socket of a mix of a closure and a muted one."""
    socket = mixed_leaf(tree)
    socket.node.inputs[2].links[0].from_node.mute = True
    return socket


def direct(leaf):
    """The material of a leaf without any group."""
    material = bpy.data.materials.new("direct")
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    tree.links.new(leaf(tree), tree.nodes["Material Output"].inputs["Surface"])
    return material


def grouped(leaf):
    group, output = new_group("Leaf")
    group.links.new(leaf(group), output.inputs[0])
    return material_of(group)


def nested(leaf):
    """A group in a group, with a second, inactive output."""
    inner, output = new_group("Inner")
    inner.links.new(leaf(inner), output.inputs[0])
    outer, output = new_group("Outer")
    other = outer.nodes.new("NodeGroupOutput")
    output.is_active_output = True
    outer.links.new(outer.nodes.new("ShaderNodeBsdfGlossy").outputs[0], other.inputs[0])
    outer.links.new(put(outer, inner).outputs[0], output.inputs[0])
    return material_of(outer)


def through(leaf):
    """A group without closures, which passes on its input."""
    group, output = new_group("Through")
    group.interface.new_socket("Shader", in_out="INPUT", socket_type="NodeSocketShader")
    inside = group.nodes.new("NodeGroupInput")
    group.links.new(inside.outputs[0], output.inputs[0])
    material = material_of(group)
    tree = material.node_tree
    tree.links.new(leaf(tree), tree.nodes["Group"].inputs[0])
    return material


def switched_off(leaf):
    """A group with a muted white closure, which passes on its input."""
    group, output = new_group("White")
    group.interface.new_socket("Shader", in_out="INPUT", socket_type="NodeSocketShader")
    group.links.new(group.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], output.inputs[0])
    material = material_of(group)
    tree = material.node_tree
    tree.links.new(leaf(tree), tree.nodes["Group"].inputs[0])
    tree.nodes["Group"].mute = True
    return material


def picture(tmp_path, material, all_light=False):
    """The radiance of a plane with `material`, LIGHT on its front and half of it on its back.

    all_light  whether that is all light; then there is also a white sky"""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = dark_scene((0, 0, 10), (0, 0, 0), width=1)
    if all_light:
        scene.world = bpy.data.worlds.new("sky")
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    ob = plane(0, 2, material())
    values = np.ones((2, 4, 4), np.float32)
    values[..., :3] = LIGHT
    values[1, :, :3] /= 2
    write_ambient([ob], values[None], all_light)
    wire_ambient(ob.active_material, all_light=all_light)
    return render(scene, tmp_path / "a.exr", 48, 16)


LEAVES = [dark_leaf, mixed_leaf, muted_mix, muted_closure]
WAYS = [grouped, nested, through, switched_off]


@pytest.mark.parametrize("leaf", LEAVES)
def test_a_group_looks_as_its_closures_do(tmp_path, leaf):
    expected = picture(tmp_path, lambda: direct(leaf))
    assert expected.max() > 0.05
    for way in WAYS:
        shown = picture(tmp_path, lambda way=way: way(leaf))
        assert shown == pytest.approx(expected, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("way", WAYS)
def test_where_a_group_shows_all_light_it_shows_none_of_the_skys_again(tmp_path, way):
    expected = picture(tmp_path, lambda: direct(mixed_leaf))
    assert picture(tmp_path, lambda: way(mixed_leaf), all_light=True) == pytest.approx(expected)


def test_holes_in_a_leaf_of_a_group_stay_holes(tmp_path):
    shown = picture(tmp_path, lambda: grouped(dark_leaf))
    assert shown.max(axis=(0, 1)) == pytest.approx(np.multiply((0.1, 0.25, 0.05), LIGHT), rel=0.01)
    assert np.mean(shown.max(axis=2) < 1e-4) == pytest.approx(0.5, abs=0.05)


def test_what_is_muted_shows_nothing(tmp_path):
    def off():
        material = direct(mixed_leaf)
        for kind in ("Diffuse BSDF", "Translucent BSDF"):
            material.node_tree.nodes[kind].mute = True
        return material

    assert picture(tmp_path, off).max() == 0


def colored_group():
    """A group that takes its colour from its input."""
    group, output = new_group("Colored")
    group.interface.new_socket("Color", in_out="INPUT", socket_type="NodeSocketColor")
    inside, shader = group.nodes.new("NodeGroupInput"), group.nodes.new("ShaderNodeBsdfDiffuse")
    group.links.new(inside.outputs[0], shader.inputs["Color"])
    group.links.new(shader.outputs[0], output.inputs[0])
    return group


def test_materials_share_one_copy_and_keep_their_own_colours(tmp_path):
    def first():
        group = colored_group()
        materials = [material_of(group, name) for name in ("red", "green")]
        for material, color in zip(materials, ((1, 0, 0, 1), (0, 1, 0, 1)), strict=True):
            material.node_tree.nodes["Group"].inputs["Color"].default_value = color
        for material in reversed(materials):
            wire_ambient(material)
        copies = {m.node_tree.nodes["Group"].node_tree for m in materials}
        assert len(copies) == 1
        assert group not in copies
        return materials[0]

    shown = picture(tmp_path, first).mean(axis=(0, 1))
    assert shown == pytest.approx((LIGHT[0], 0, 0), rel=0.01)


def test_each_strength_has_its_own_copy(tmp_path):
    def first():
        group = colored_group()
        materials = [material_of(group, name) for name in ("a", "b")]
        for material in materials:
            material.node_tree.nodes["Group"].inputs["Color"].default_value = (1, 1, 1, 1)
        wire_ambient(materials[1], strength=3)
        return materials[0]

    assert picture(tmp_path, first).mean(axis=(0, 1)) == pytest.approx(LIGHT, rel=0.01)


@pytest.mark.parametrize("all_light", [False, True])
@pytest.mark.parametrize("way", WAYS)
def test_a_lit_group_is_still_read_as_the_same_leaf(way, all_light):
    material = way(mixed_leaf)
    before = leaf_optics(material)
    wire_ambient(material, all_light=all_light)
    assert leaf_optics(material) == before
    assert hindrance([material]) is None


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_metal_in_a_group_hinders_that_all_light_is_shown(metallic):
    group, output = new_group("Metal")
    group.interface.new_socket("Metallic", in_out="INPUT", socket_type="NodeSocketFloat")
    inside, shader = group.nodes.new("NodeGroupInput"), group.nodes.new("ShaderNodeBsdfPrincipled")
    group.links.new(inside.outputs[0], shader.inputs["Metallic"])
    group.links.new(shader.outputs[0], output.inputs[0])
    material = material_of(group)
    material.node_tree.nodes["Group"].inputs["Metallic"].default_value = metallic
    assert bool(hindrance([material])) == bool(metallic)


@pytest.fixture
def plants(scene):
    """Two plants whose materials share nested groups; the scene is set up for a quick bake."""
    scene.lb_lighting.resolution = 10
    nested(mixed_leaf).name = "first"
    outer = bpy.data.node_groups["Outer"]
    outer.use_fake_user = True
    plants = []
    for name, material in (("a", bpy.data.materials["first"]), ("b", material_of(outer))):
        plants.append(scenery.add_leaves(name, count=20, material=False))
        plants[-1].data.materials.append(material)
    plants[1].location.x = 0.5
    bpy.context.view_layer.update()
    return plants


def copies():
    return [group for group in bpy.data.node_groups if group.name.endswith("(LB)")]


def test_clear_gives_the_groups_back(plants):
    before = snapshot()
    for lit, strength in ((plants, 1.0), (plants, 2.0), (plants[1:], 2.0)):
        bake_light(*lit, strength=strength)
        assert len(copies()) == 2
    clear(bpy.context)
    assert snapshot() == before


def test_the_users_groups_stay_as_they_are(plants):
    def groups():
        """Everything about them except their number of users."""
        return [
            {name: fact for name, fact in facts.items() if name != "users"}
            for key, facts in snapshot().items()
            if key[1] in ("Inner", "Outer")
        ]

    before = groups()
    bake_light(*plants)
    assert groups() == before


def test_a_second_bake_shows_what_the_group_is_now(plants):
    """In all materials that show the group, although only one plant is baked again."""
    bake_light(*plants)
    inner = bpy.data.node_groups["Inner"]
    inner.nodes["Diffuse BSDF"].inputs["Color"].default_value = (0.5, 0.4, 0.3, 1)
    inner.interface.new_socket("New", in_out="INPUT", socket_type="NodeSocketFloat")
    bake_light(plants[1])
    assert len(copies()) == 2
    for plant in plants:
        outer = plant.active_material.node_tree.nodes["Group"].node_tree
        (link,) = outer.nodes["Group"].node_tree.nodes["Diffuse BSDF"].outputs[0].links
        assert link.to_node.inputs["Color"].default_value[:3] == pytest.approx((0.5, 0.4, 0.3))


def test_saved_and_loaded_they_are_still_given_back(plants, tmp_path):
    before = snapshot()
    bake_light(*plants)
    path = str(tmp_path / "lit.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert len(copies()) == 2
    clear(bpy.context)
    after = snapshot()
    nodes = {key: value.get("nodes") for key, value in after.items() if "nodes" in value}
    assert {key: before[key]["nodes"] for key in nodes} == nodes
    names = {key[1] for key in after if key[0] == "node_groups"}
    assert names == {"Inner", "Outer"}
    assert bpy.data.materials["first"].node_tree.nodes["Group"].node_tree.name == "Outer"


def test_a_linked_group_is_lit_and_given_back(tmp_path):
    nested(dark_leaf)
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {bpy.data.node_groups["Outer"]})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.node_groups = ["Outer"]
    group = linked.node_groups[0]
    material = material_of(group)
    wire_ambient(material)
    shown = material.node_tree.nodes["Group"].node_tree
    assert shown.library is None
    assert shown.nodes["Group"].node_tree.library is None
    assert shown.nodes["Group"].node_tree.nodes["LB Ambient"]
    unwire_ambient(material)
    assert material.node_tree.nodes["Group"].node_tree == group
    assert not copies()


def test_where_the_users_group_is_gone_the_copy_becomes_the_users():
    material = nested(dark_leaf)
    wire_ambient(material, all_light=True)
    for name in ("Inner", "Outer"):
        bpy.data.node_groups.remove(bpy.data.node_groups[name])
    unwire_ambient(material)
    group = material.node_tree.nodes["Group"].node_tree
    assert not group.keys()
    inner = group.nodes["Group"].node_tree
    assert not inner.keys()
    assert {node.bl_idname for node in inner.nodes} == {
        "NodeGroupOutput",
        "ShaderNodeBsdfPrincipled",
        "ShaderNodeTexChecker",
    }
