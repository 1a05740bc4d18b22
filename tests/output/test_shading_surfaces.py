# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's materials show ambient light, and are restored."""

import addon_utils
import bpy
import numpy as np
import pytest

from lb_lighting.errors import OutputError
from lb_lighting.ours import is_ours
from lb_lighting.output.attribute import write_ambient
from lb_lighting.output.grid_groups import grid_group
from lb_lighting.output.groups import MADE, VERSION
from lb_lighting.output.render_settings import prepare_scene, restore_scene
from lb_lighting.output.shading_surfaces import (
    hindrance,
    unwire_ambient,
    wire_ambient,
)
from lb_lighting.output.surface_groups import (
    AMBIENT_GROUP,
    REST_GROUP,
    ambient_group,
    rest_group,
)
from lb_lighting.output.volume_groups import (
    beam_group,
    volume_group,
)
from lb_lighting.scene.materials import leaf_optics
from tests.output.graphs import (
    LEFT_ALONE,
    WIRED,
    ambient,
    ambients,
    behind,
    colored,
    cut_out,
    dump,
    framed,
    mix_shader,
    mixed,
    new_material,
    principled,
    shared,
    show,
    textured,
    two_engines,
)
from tests.output.rendering import plane


@pytest.mark.parametrize("all_light", [False, True])
@pytest.mark.parametrize("graph", WIRED + LEFT_ALONE)
def test_unwire_restores_the_graph_exactly(graph, all_light):
    material = graph()
    before = dump(material)
    wire_ambient(material, all_light=all_light)
    wired = dump(material)
    assert (wired == before) is (graph in LEFT_ALONE)
    wire_ambient(material, all_light=all_light)
    assert dump(material) == wired
    unwire_ambient(material)
    assert dump(material) == before
    unwire_ambient(material)
    assert dump(material) == before


def test_each_engine_gets_its_ambient_light():
    material = two_engines()
    wire_ambient(material)
    outputs = [n for n in material.node_tree.nodes if n.type == "OUTPUT_MATERIAL"]
    feeding = {output.inputs["Surface"].links[0].from_node for output in outputs}
    assert [node.node_tree.name for node in feeding] == [AMBIENT_GROUP] * 2


def test_color_is_that_of_each_closure():
    material = mixed()
    wire_ambient(material)
    assert len(ambients(material)) == 2
    for closure, color in (
        ("Diffuse BSDF", (0.3, 0.2, 0.1)),
        ("Translucent BSDF", (0.1, 0.4, 0.2)),
    ):
        inputs = behind(material, closure).inputs
        assert inputs["Color"].default_value[:3] == pytest.approx(color)
        assert inputs["Alpha"].default_value == 1


def test_color_and_alpha_of_a_principled():
    material = principled()
    material.node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.25
    wire_ambient(material)
    assert ambient(material).inputs["Color"].default_value[:3] == pytest.approx((0.1, 0.5, 0.2))
    assert ambient(material).inputs["Alpha"].default_value == 0.25


def test_color_and_alpha_follow_the_textures_of_the_surface():
    material = textured()
    wire_ambient(material)
    assert ambient(material).inputs["Color"].links[0].from_node.type == "TEX_NOISE"
    material = cut_out()
    wire_ambient(material)
    assert ambient(material).inputs["Alpha"].links[0].from_node.type == "TEX_CHECKER"


def test_a_shared_closure_gets_one_node_and_other_uses_of_it_none():
    material = shared()
    wire_ambient(material)
    fed = {link.to_node.name for link in ambient(material).outputs[0].links}
    assert fed == {"Mix Shader", "Mix Shader.001"}
    preview = material.node_tree.nodes["Material Output.001"]
    assert preview.inputs["Surface"].links[0].from_node.type == "BSDF_DIFFUSE"


def test_mixes_that_share_what_they_mix_are_walked_once_each():
    """Forty mixes of a shader with itself, which have 2^40 paths."""
    material = new_material()[0]
    shader = diffuse = colored(material, "ShaderNodeBsdfDiffuse", (0.3, 0.2, 0.1))
    for _ in range(40):
        shader = mix_shader(material, shader, shader)
    wire_ambient(show(material, shader))
    [node] = [node for node in material.node_tree.nodes if is_ours(node)]
    assert node.inputs["Shader"].links[0].from_socket == diffuse
    assert len(node.outputs["Shader"].links) == 2


def test_a_second_call_updates():
    material = textured()
    wire_ambient(material)
    links = material.node_tree.links
    shader = material.node_tree.nodes["Principled BSDF"]
    links.remove(shader.inputs["Base Color"].links[0])
    shader.inputs["Base Color"].default_value = (0.7, 0.6, 0.5, 1)
    wire_ambient(material, 2)
    inputs = ambient(material).inputs
    assert inputs["Strength"].default_value == 2
    assert not inputs["Color"].is_linked
    assert inputs["Color"].default_value[:3] == pytest.approx((0.7, 0.6, 0.5))


def metal():
    material = principled()
    material.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 0.5
    return material


def mix_behind(material):
    """Nodes that a user may put between a closure and our node."""
    for node in ambients(material)[:1]:
        glossy = colored(material, "ShaderNodeBsdfGlossy", (1, 1, 1))
        mix = mix_shader(material, node.inputs["Shader"].links[0].from_socket, glossy)
        material.node_tree.links.new(mix, node.inputs["Shader"])


def delete_behind(material):
    node = ambients(material)[0]
    material.node_tree.nodes.remove(node.inputs["Shader"].links[0].from_node)


@pytest.mark.parametrize("change", [None, lambda _material: None, mix_behind])
def test_what_hinders_a_material_to_show_all_light(change):
    hindered = set()
    for graph in (*WIRED, *LEFT_ALONE, metal):
        material = graph()
        if change and graph not in LEFT_ALONE:
            wire_ambient(material)
            change(material)
        if hindrance([None, principled(), material]):
            hindered.add(graph)
    assert hindered == {metal}


def test_what_has_lost_its_closure_hinders_nothing():
    material = principled()
    wire_ambient(material)
    delete_behind(material)
    assert hindrance([material]) is None


def test_a_colour_that_was_changed_meanwhile_stays():
    material = principled()
    wire_ambient(material, all_light=True)
    color = material.node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    color.links[0].from_node.inputs["Color"].default_value = (1, 0, 0, 1)
    unwire_ambient(material)
    assert color.default_value[:] == (1, 0, 0, 1)


@pytest.mark.parametrize("needed", [True, False])
def test_what_another_object_shows_keeps_its_way(needed):
    """Two objects share a material: one shows all light, one is baked again without the sky."""
    material = principled()
    objects = [plane(z, 1, material) for z in (0, 1)]
    light = np.ones((2, 4, 4), np.float32)
    write_ambient(objects[:1], [light], all_light=needed)
    wire_ambient(material, all_light=True)
    write_ambient(objects[1:], [light])
    wire_ambient(material)
    assert any(n.name.startswith(REST_GROUP) for n in material.node_tree.nodes) is needed


def test_groups_of_an_older_version_stay_linked():
    """Also in materials that are not wired again, and in a group that contains another."""
    materials = principled(), mixed()
    for material in materials:
        wire_ambient(material, all_light=True)
    makers = ambient_group, beam_group, rest_group, volume_group, grid_group
    groups = [make() for make in makers]

    def seen():
        sockets = [[(s.name, s.in_out) for s in g.interface.items_tree] for g in groups]
        return sockets, [len(g.links) for g in groups], [dump(material) for material in materials]

    before = seen()
    for group in groups:
        group[MADE] = VERSION - 1
        group.interface.new_socket("Gone", in_out="INPUT", socket_type="NodeSocketFloat")
    for make in makers:
        make()
    assert seen() == before


@pytest.mark.parametrize("all_light", [False, True])
@pytest.mark.parametrize("graph", [principled, mixed, framed])
def test_a_lit_leaf_is_still_read_as_the_same_leaf(graph, all_light):
    material = graph()
    before = leaf_optics(material)
    wire_ambient(material, all_light=all_light)
    assert leaf_optics(material) == before


def test_a_lit_cut_out_is_still_read_as_the_same_leaf():
    material = cut_out()
    mask = bpy.data.images.new("mask", 1, 1)
    mask.pixels = (1, 1, 1, 0.5)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = mask
    links.new(texture.outputs["Alpha"], nodes["Principled BSDF"].inputs["Alpha"])
    before = leaf_optics(material)
    assert before.coverage == pytest.approx(0.25, rel=0.01)
    wire_ambient(material)
    assert leaf_optics(material) == before


def test_surfaces_do_not_become_lamps():
    material = textured()
    wire_ambient(material)
    assert material.cycles.emission_sampling == "NONE"
    unwire_ambient(material)
    assert material.cycles.emission_sampling == "FRONT"


def test_linked_material_is_refused(tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {principled()})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.materials = ["user"]
    with pytest.raises(OutputError, match="make it local"):
        wire_ambient(linked.materials[0])


def test_without_cycles_there_is_nothing_of_its_to_set():
    addon_utils.disable("cycles")
    try:
        prepare_scene(bpy.context.scene)
        material = principled()
        wire_ambient(material)
        assert ambient(material)
        unwire_ambient(material)
        restore_scene(bpy.context.scene)
    finally:
        addon_utils.enable("cycles")
    assert bpy.context.scene.cycles.volume_biased is False
