# SPDX-License-Identifier: GPL-3.0-or-later
"""Wiring of the user's materials, scene and objects, and the way back."""

import addon_utils
import bpy
import numpy as np
import pytest

from lb_lighting.errors import OutputError
from lb_lighting.ours import is_ours
from lb_lighting.output.attribute import AMBIENT_ATTRIBUTE, write_ambient
from lb_lighting.output.grid_groups import GRID_GROUP, grid_group
from lb_lighting.output.groups import MADE, VERSION
from lb_lighting.output.render_settings import prepare_scene, restore_scene
from lb_lighting.output.shading_surfaces import (
    hindrance,
    light_surface,
    unlight_surface,
    unwire_ambient,
    unwire_unused,
    wire_ambient,
)
from lb_lighting.output.shading_volumes import remove_unused, shade_volume
from lb_lighting.output.sources import hide_source, show_source
from lb_lighting.output.surface_groups import (
    AMBIENT_GROUP,
    REST_GROUP,
    ambient_group,
    rest_group,
)
from lb_lighting.output.vdb import AXES
from lb_lighting.output.volume import remove_baked, show_volume
from lb_lighting.output.volume_groups import (
    BEAM_GROUP,
    VOLUME_GROUP,
    beam_group,
    volume_group,
)
from lb_lighting.scene.materials import leaf_optics
from tests.output.rendering import plane
from tests.scenery import source


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


def mix_shader(material, first, second, factor=0.5):
    """The output socket of a Mix Shader of the output sockets `first` and `second`."""
    mix = material.node_tree.nodes.new("ShaderNodeMixShader")
    mix.inputs[0].default_value = factor
    for socket, shader in enumerate((first, second), 1):
        material.node_tree.links.new(shader, mix.inputs[socket])
    return mix.outputs[0]


def colored(material, kind, color):
    """The output socket of a new closure node."""
    node = material.node_tree.nodes.new(kind)
    node.inputs["Color"].default_value = (*color, 1)
    return node.outputs[0]


def show(material, shader):
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader, output.inputs["Surface"])
    return material


def mixed():
    material = new_material()[0]
    diffuse = colored(material, "ShaderNodeBsdfDiffuse", (0.3, 0.2, 0.1))
    translucent = colored(material, "ShaderNodeBsdfTranslucent", (0.1, 0.4, 0.2))
    return show(material, mix_shader(material, diffuse, translucent, 0.3))


def cut_out():
    """A leaf on a card: a transparent shader, and one whose alpha is a texture's, over reroutes."""
    material = principled()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader, output = nodes["Principled BSDF"], nodes["Material Output"]
    texture, reroute = nodes.new("ShaderNodeTexChecker"), nodes.new("NodeReroute")
    links.new(texture.outputs["Factor"], shader.inputs["Alpha"])
    links.new(shader.outputs[0], reroute.inputs[0])
    transparent = colored(material, "ShaderNodeBsdfTransparent", (1, 1, 1))
    mix = mix_shader(material, transparent, reroute.outputs[0])
    links.new(mix, output.inputs["Surface"])
    return material


def shared():
    """One closure in two mixes of a sum, and in a preview output that is not rendered."""
    material, nodes, links = new_material()
    diffuse = colored(material, "ShaderNodeBsdfDiffuse", (0.3, 0.2, 0.1))
    glossy = colored(material, "ShaderNodeBsdfGlossy", (1, 1, 1))
    add = nodes.new("ShaderNodeAddShader")
    links.new(mix_shader(material, diffuse, glossy, 0.2), add.inputs[0])
    links.new(mix_shader(material, glossy, diffuse, 0.1), add.inputs[1])
    show(material, add.outputs[0])
    show(material, diffuse)
    return material


def user_group(material, kind):
    """A group node of the user around one closure."""
    tree = bpy.data.node_groups.new("user", "ShaderNodeTree")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    closure, output = tree.nodes.new(kind), tree.nodes.new("NodeGroupOutput")
    tree.links.new(closure.outputs[0], output.inputs[0])
    node = material.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = tree
    return node


def muted():
    """A texture whose link is switched off."""
    material = textured()
    links = material.node_tree.links
    next(link for link in links if link.to_socket.name == "Base Color").is_muted = True
    return material


def grouped():
    material = new_material()[0]
    return show(material, user_group(material, "ShaderNodeBsdfDiffuse").outputs[0])


def glassy():
    """Nothing that scatters diffusely, and one that does but is switched off."""
    material, nodes, _links = new_material()
    muted = colored(material, "ShaderNodeBsdfDiffuse", (1, 1, 1))
    muted.node.mute = True
    shader = mix_shader(material, nodes.new("ShaderNodeEmission").outputs[0], muted)
    for kind in ("Holdout", "BsdfTransparent", "BsdfGlass", "BsdfGlossy", "BsdfRefraction"):
        shader = mix_shader(material, shader, nodes.new("ShaderNode" + kind).outputs[0])
    return show(material, shader)


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


def circular():
    """A mix that is its own input, which Blender marks as invalid."""
    material = mixed()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    mix = nodes["Mix Shader"]
    add = nodes.new("ShaderNodeAddShader")
    links.new(mix.outputs[0], add.inputs[0])
    links.new(nodes["Diffuse BSDF"].outputs[0], add.inputs[1])
    links.new(add.outputs[0], mix.inputs[1])
    return material


LEFT_ALONE = [glassy, unlinked_surface, empty]
WIRED = [
    principled,
    textured,
    muted,
    mixed,
    cut_out,
    shared,
    grouped,
    two_engines,
    framed,
    circular,
]


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
    (node,) = ambients(material)
    return node


def ambients(material):
    """The group nodes `LB Ambient` of a material."""
    nodes = material.node_tree.nodes
    return [n for n in nodes if n.type == "GROUP" and n.node_tree.name.startswith(AMBIENT_GROUP)]


def behind(material, closure):
    """The group node that the closure node named `closure` feeds."""
    return next(
        n for n in ambients(material) if n.inputs["Shader"].links[0].from_node.name == closure
    )


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
    """Forty mixes of a shader with itself: walked by their paths, they are 2^40."""
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
    """What a user may put between a closure and our node."""
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
    """Two objects share a material; one shows all light, the other is lit anew without the sky."""
    material = principled()
    objects = [plane(z, 1, material) for z in (0, 1)]
    light = np.ones((2, 4, 4), np.float32)
    write_ambient(objects[:1], [light], all_light=needed)
    wire_ambient(material, all_light=True)
    write_ambient(objects[1:], [light])
    wire_ambient(material)
    assert any(n.name.startswith(REST_GROUP) for n in material.node_tree.nodes) is needed


def test_groups_of_an_older_version_stay_linked():
    """Also in materials that are not wired anew, and in the group that holds another."""
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


def lit_object(scene, *materials):
    """A mesh object in `scene` as a bake leaves it."""
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata([(0, 0, 0)], [], [])
    for material in materials:
        mesh.materials.append(material)
    ob = bpy.data.objects.new("ob", mesh)
    scene.collection.objects.link(ob)
    mesh.attributes.new(AMBIENT_ATTRIBUTE, "FLOAT_COLOR", "POINT")
    light_surface(ob)
    return ob


def delete(ob):
    bpy.data.objects.remove(ob)


def take_out_of_the_scene(ob):
    bpy.context.scene.collection.objects.unlink(ob)


def remove_light(ob):
    ob.data.attributes.remove(ob.data.attributes[AMBIENT_ATTRIBUTE])


def swap_material(ob):
    ob.data.materials[0] = bpy.data.materials.new("other")


def override_material(ob):
    ob.material_slots[0].link = "OBJECT"
    ob.material_slots[0].material = bpy.data.materials.new("other")
    ob.data.materials[0] = None


CHANGES = [delete, take_out_of_the_scene, remove_light, swap_material, override_material]


@pytest.mark.parametrize("slots", [[], [None], [None, "user"]])
def test_objects_without_material_are_lit_and_given_back(slots):
    user = principled()
    ob = lit_object(bpy.context.scene, *(user if slot else None for slot in slots))
    assert ob.material_slots
    for slot in ob.material_slots:
        assert ambient(slot.material).node_tree.name == AMBIENT_GROUP
    assert not is_ours(ob.data)
    remove_light(ob)
    unlight_surface(ob)
    unwire_unused()
    remove_unused()
    assert [m and m.name for m in ob.data.materials] == slots
    assert list(ob.data.keys()) == []
    assert bpy.data.materials.keys() == ["user"]
    assert not bpy.data.node_groups


def test_user_material_in_our_slot_stays():
    ob = lit_object(bpy.context.scene)
    user = ob.material_slots[0].material = principled()
    unlight_surface(ob)
    assert list(ob.data.materials) == [user]


def test_user_material_of_the_object_in_our_slot_stays():
    ob = lit_object(bpy.context.scene)
    ob.material_slots[0].link = "OBJECT"
    user = ob.material_slots[0].material = principled()
    unlight_surface(ob)
    assert ob.material_slots[0].material == user
    assert list(ob.data.materials) == [None]


@pytest.mark.parametrize("change", CHANGES)
def test_materials_without_a_lit_mesh_are_unwired(change):
    user = principled()
    before = dump(user)
    ob = lit_object(bpy.context.scene, user)
    unwire_unused()
    assert ambient(user)
    change(ob)
    unwire_unused()
    assert dump(user) == before


def test_an_object_whose_light_was_removed_by_hand_gets_its_slots_back():
    ob = lit_object(bpy.context.scene)
    remove_light(ob)
    unwire_unused()
    remove_unused()
    assert not ob.data.materials
    assert not bpy.data.materials
    assert list(ob.data.keys()) == []


def test_materials_of_lit_meshes_in_other_scenes_stay_wired():
    user = principled()
    here = lit_object(bpy.context.scene, user)
    there = lit_object(bpy.data.scenes.new("other"), user)
    plain = lit_object(bpy.data.scenes["other"])
    remove_light(here)
    unlight_surface(here)
    unwire_unused()
    assert ambient(user)
    assert ambient(plain.material_slots[0].material)
    remove_light(there)
    unwire_unused()
    assert not ambients(user)


def test_a_duplicate_out_of_the_scene_does_not_take_the_material_of_the_mesh():
    ob = lit_object(bpy.context.scene)
    bpy.data.objects.new("duplicate", ob.data)
    unwire_unused()
    assert ambient(ob.material_slots[0].material)


def test_materials_of_a_library_are_left_alone(tmp_path):
    user = principled()
    wire_ambient(user)
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {user})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.materials = ["user"]
    unwire_unused()
    assert ambient(linked.materials[0])


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
    ob = show_volume(bpy.context, [source("cloud")], tmp_path / "a.vdb")
    shade_volume(ob, "REPLACE", 2.0, 0.5)
    shade_volume(ob, "ADD", (1, 2, 3), (4, 5, 6), (0.5, 0, -0.5), strength=0.5)
    (material,) = ob.data.materials
    inputs = next(n for n in material.node_tree.nodes if n.type == "GROUP").inputs
    assert tuple(inputs["Sigma S"].default_value) == (1, 2, 3)
    assert tuple(inputs["Sigma A"].default_value) == (4, 5, 6)
    assert tuple(inputs["G"].default_value) == (0.5, 0, -0.5)
    assert inputs["Strength"].default_value == 0.5
    assert not inputs["Replace"].default_value
    assert sorted(bpy.data.node_groups.keys()) == [BEAM_GROUP, VOLUME_GROUP]
    remove_baked(ob)
    remove_unused()
    assert not bpy.data.materials
    assert not bpy.data.node_groups


def test_groups_explain_their_inputs(tmp_path):
    shade_volume(show_volume(bpy.context, [source("cloud")], tmp_path / "a.vdb"), "REPLACE", 1, 1)
    wire_ambient(principled())
    assert sorted(bpy.data.node_groups.keys()) == [AMBIENT_GROUP, BEAM_GROUP, VOLUME_GROUP]
    grid_group()
    for group in bpy.data.node_groups:
        assert all(item.description for item in group.interface.items_tree)


def test_groups_bound_their_inputs():
    """What no value can stand for is given by a link, or a colour, a switch, an object."""
    made = {group.name: group.interface.items_tree for group in (volume_group(), ambient_group())}
    made[BEAM_GROUP] = bpy.data.node_groups[BEAM_GROUP].interface.items_tree
    made[GRID_GROUP] = grid_group().interface.items_tree
    limits = {}
    for group, items in made.items():
        for item in items:
            if item.in_out == "INPUT" and hasattr(item, "min_value"):
                values = np.atleast_1d(item.default_value)
                assert np.all((values >= item.min_value) & (values <= item.max_value))
                limits[group, item.name] = item.min_value, item.max_value
    assert limits[VOLUME_GROUP, "G"] == limits[BEAM_GROUP, "G"] == (-1, 1)
    assert limits[AMBIENT_GROUP, "Alpha"] == (0, 1)
    assert {low for name, (low, _) in limits.items() if name[1] not in ("G", *AXES)} == {0}
    hidden = {item.name for items in made.values() for item in items if item.hide_value}
    assert hidden == {"Direct", "Others", "Light"}


def test_a_group_of_the_user_with_our_name_is_not_taken_for_ours():
    mine = bpy.data.node_groups.new(AMBIENT_GROUP, "ShaderNodeTree")
    material = principled()
    wire_ambient(material)
    assert ambient(material).node_tree != mine
    unwire_ambient(material)
    remove_unused()
    assert list(bpy.data.node_groups) == [mine]
