# SPDX-License-Identifier: GPL-3.0-or-later
"""Wiring of the user's materials, scene and objects, and the way back."""

import addon_utils
import bpy
import pytest

from lb_lighting.errors import OutputError
from lb_lighting.output.groups import AMBIENT_GROUP, VOLUME_GROUP
from lb_lighting.output.shading import (
    hide_source,
    light_surface,
    prepare_scene,
    remove_unused,
    restore_scene,
    shade_volume,
    show_source,
    unlight_surface,
    unwire_ambient,
    wire_ambient,
)
from lb_lighting.output.volume import remove_baked, show_volume


def new_material():
    material = bpy.data.materials.new("user")
    material.node_tree.nodes.clear()
    return material, material.node_tree.nodes, material.node_tree.links


def principled():
    material, nodes, links = new_material()
    shader, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Base Color"].default_value = (0.1, 0.5, 0.2, 1)
    links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def textured():
    material = principled()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture = nodes.new("ShaderNodeTexNoise")
    links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    material.cycles.emission_sampling = "FRONT"
    return material


def mixed():
    material, nodes, links = new_material()
    mix, output = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeOutputMaterial")
    for socket, kind in enumerate(("ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTranslucent"), 1):
        links.new(nodes.new(kind).outputs[0], mix.inputs[socket])
    links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def two_engines():
    material = principled()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes["Material Output"].target = "CYCLES"
    eevee = nodes.new("ShaderNodeOutputMaterial")
    eevee.target = "EEVEE"
    eevee.is_active_output = True
    links.new(nodes.new("ShaderNodeBsdfDiffuse").outputs[0], eevee.inputs["Surface"])
    return material


def framed():
    material = principled()
    nodes = material.node_tree.nodes
    frame = nodes.new("NodeFrame")
    frame.location = (100, 50)
    for name in ("Principled BSDF", "Material Output"):
        nodes[name].parent = frame
    return material


def unlinked_surface():
    material, nodes, links = new_material()
    output = nodes.new("ShaderNodeOutputMaterial")
    scatter = nodes.new("ShaderNodeVolumeScatter")
    links.new(scatter.outputs[0], output.inputs["Volume"])
    return material


def empty():
    return new_material()[0]


GRAPHS = [principled, textured, mixed, two_engines, framed, unlinked_surface, empty]


def plain(value):
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def properties(block):
    """The editable values of an RNA struct, by name."""
    return {
        p.identifier: plain(getattr(block, p.identifier))
        for p in block.bl_rna.properties
        if not p.is_readonly
        and p.type not in ("POINTER", "COLLECTION")
        and p.identifier != "use_nodes"  # deprecated
    }


def sockets(node):
    return {s.identifier: plain(getattr(s, "default_value", None)) for s in node.inputs}


def ends(link):
    tail, head = link.from_socket, link.to_socket
    return tail.node.name, tail.identifier, head.node.name, head.identifier, link.is_muted


def dump(material):
    """Everything in a material that wiring could change."""
    tree = material.node_tree
    nodes = {
        node.name: (node.bl_idname, properties(node), sockets(node), node.parent, list(node.keys()))
        for node in tree.nodes
    }
    active = tree.nodes.active
    links = sorted(ends(link) for link in tree.links)
    own = properties(material), properties(material.cycles), list(material.keys())
    return nodes, links, active, own


def ambient(material):
    found = [n for n in material.node_tree.nodes if n.type == "GROUP"]
    assert len(found) == 1
    return found[0]


@pytest.mark.parametrize("graph", GRAPHS)
def test_unwire_restores_the_graph_exactly(graph):
    material = graph()
    before = dump(material)
    wire_ambient(material)
    wired = dump(material)
    assert (wired == before) is (graph in (unlinked_surface, empty))
    wire_ambient(material)
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


def test_color_is_that_of_the_surface():
    material = principled()
    wire_ambient(material, (1, 1, 1))
    assert ambient(material).inputs["Color"].default_value[:3] == pytest.approx((0.1, 0.5, 0.2))


def test_color_follows_the_texture_of_the_surface():
    material = textured()
    wire_ambient(material, (1, 1, 1))
    assert ambient(material).inputs["Color"].links[0].from_node.type == "TEX_NOISE"


def test_color_is_the_albedo_where_the_surface_has_none():
    material = mixed()
    wire_ambient(material, (0.3, 0.2, 0.1))
    assert ambient(material).inputs["Color"].default_value[:3] == pytest.approx((0.3, 0.2, 0.1))


def test_a_second_call_updates():
    material = textured()
    wire_ambient(material, (1, 1, 1), 1)
    node = ambient(material)
    links = material.node_tree.links
    links.remove(node.inputs["Color"].links[0])
    shader = material.node_tree.nodes["Principled BSDF"]
    links.remove(shader.inputs["Base Color"].links[0])
    shader.inputs["Base Color"].default_value = (0.7, 0.6, 0.5, 1)
    wire_ambient(material, (1, 1, 1), 2)
    assert ambient(material) == node
    assert node.inputs["Strength"].default_value == 2
    assert not node.inputs["Color"].is_linked
    assert node.inputs["Color"].default_value[:3] == pytest.approx((0.7, 0.6, 0.5))


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


@pytest.mark.parametrize("slots", [[], [None], [None, "user"]])
def test_objects_without_material_are_lit_and_given_back(slots):
    user = principled()
    mesh = bpy.data.meshes.new("mesh")
    for slot in slots:
        mesh.materials.append(user if slot else None)
    ob = bpy.data.objects.new("ob", mesh)
    light_surface(ob, lambda _material: (0.8, 0.8, 0.8))
    assert ob.material_slots
    for slot in ob.material_slots:
        assert ambient(slot.material).node_tree.name == AMBIENT_GROUP
    unlight_surface(ob)
    remove_unused()
    assert [m and m.name for m in mesh.materials] == slots
    assert list(mesh.keys()) == []
    assert bpy.data.materials.keys() == ["user"]
    assert not bpy.data.node_groups


def test_user_material_in_our_slot_stays():
    mesh = bpy.data.meshes.new("mesh")
    ob = bpy.data.objects.new("ob", mesh)
    light_surface(ob, lambda _material: (0.8, 0.8, 0.8))
    user = ob.material_slots[0].material = principled()
    unlight_surface(ob)
    assert list(mesh.materials) == [user]


@pytest.mark.parametrize("biased", [True, False])
def test_scene_is_given_back(biased):
    scene = bpy.context.scene
    scene.cycles.volume_biased = biased
    keys = list(scene.keys())
    prepare_scene(scene)
    prepare_scene(scene)
    assert scene.cycles.volume_biased
    restore_scene(scene)
    assert scene.cycles.volume_biased is biased
    assert list(scene.keys()) == keys
    restore_scene(scene)


@pytest.mark.parametrize("hidden", [(False, False), (True, False), (False, True)])
def test_source_is_given_back(hidden):
    ob = bpy.data.objects.new("source", None)
    ob.hide_viewport, ob.hide_render = hidden
    hide_source(ob)
    hide_source(ob)
    assert (ob.hide_viewport, ob.hide_render) == (True, True)
    show_source(ob)
    assert (ob.hide_viewport, ob.hide_render) == hidden
    assert list(ob.keys()) == []


def test_baked_volume_has_one_material_and_takes_it_along(tmp_path):
    ob = show_volume(bpy.context, "cloud", tmp_path / "a.vdb")
    shade_volume(ob, "REPLACE", 2.0, 0.5)
    shade_volume(ob, "ADD", (1, 2, 3), (4, 5, 6), 0.5)
    (material,) = ob.data.materials
    inputs = ambient(material).inputs
    assert tuple(inputs["Sigma S"].default_value) == (1, 2, 3)
    assert tuple(inputs["Sigma A"].default_value) == (4, 5, 6)
    assert inputs["Strength"].default_value == 0.5
    assert not inputs["Replace"].default_value
    assert bpy.data.node_groups.keys() == [VOLUME_GROUP]
    remove_baked(ob, delete_file=False)
    remove_unused()
    assert not bpy.data.materials
    assert not bpy.data.node_groups


def test_groups_explain_their_inputs(tmp_path):
    shade_volume(show_volume(bpy.context, "cloud", tmp_path / "a.vdb"), "REPLACE", 1, 1)
    wire_ambient(principled())
    assert sorted(bpy.data.node_groups.keys()) == [AMBIENT_GROUP, VOLUME_GROUP]
    for group in bpy.data.node_groups:
        assert all(item.description for item in group.interface.items_tree)


def test_a_group_of_the_user_with_our_name_is_not_taken_for_ours():
    mine = bpy.data.node_groups.new(AMBIENT_GROUP, "ShaderNodeTree")
    material = principled()
    wire_ambient(material)
    assert ambient(material).node_tree != mine
    unwire_ambient(material)
    remove_unused()
    assert list(bpy.data.node_groups) == [mine]
