# SPDX-License-Identifier: GPL-3.0-or-later
"""Inputs, attributes and closures of node trees, checked against Cycles' pictures of the trees."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.materials import has_volume, leaf_optics, volume_optics
from lb_lighting.scene.nodes.attributes import object_attributes
from tests.scene.nodes.sockets import (
    BLUE,
    COLORS,
    RED,
    STRENGTHS,
    color,
    emission,
    number,
    rendered,
    shine,
)
from tests.scene.trees import (
    add_node,
    attribute,
    combine,
    computed,
    connect,
    make_group,
    make_material,
    surface,
    volume,
)


@pytest.mark.parametrize("build", COLORS.values(), ids=COLORS)
def test_colors_are_those_of_cycles(build, render):
    material = make_material()
    tree = material.node_tree
    shader = add_node(tree, "ShaderNodeEmission", Color=RED)
    tree.links.new(build(tree), shader.inputs["Color"])
    connect(material, shader, "Surface")
    assert shine(material) == pytest.approx(rendered(material, render), abs=1e-6)


@pytest.mark.parametrize("build", STRENGTHS.values(), ids=STRENGTHS)
def test_numbers_are_those_of_cycles(build, render):
    material = make_material()
    tree = material.node_tree
    shader = add_node(tree, "ShaderNodeEmission", Color=(1, 1, 1), Strength=3.0)
    tree.links.new(build(tree), shader.inputs["Strength"])
    connect(material, shader, "Surface")
    assert shine(material) == pytest.approx(rendered(material, render), abs=1e-4)


def test_the_color_of_a_black_body_is_that_of_cycles(render):
    material = make_material()
    tree = material.node_tree
    shade = computed(tree, "ShaderNodeBlackbody", number(tree, 1800.0))
    connect(material, emission(tree, shade).node, "Surface")
    # The fit to Blender's colours is within 0.002.
    assert shine(material) == pytest.approx(rendered(material, render), abs=2e-3)


def test_muted_links_are_ignored(render):
    material = surface("ShaderNodeEmission", Color=RED)
    tree = material.node_tree
    link = tree.links.new(color(tree, BLUE), tree.nodes["Emission"].inputs["Color"])
    link.is_muted = True
    assert shine(material) == pytest.approx(RED)
    assert rendered(material, render) == pytest.approx(RED)


class TestAttributes:
    """Attributes of objects, instancers and view layers are constants."""

    def compared(self, kind, name, output, prepare, render):
        material = make_material()
        shader = emission(material.node_tree, attribute(material.node_tree, name, output, kind))
        connect(material, shader.node, "Surface")
        bpy.ops.mesh.primitive_cube_add(size=1)
        ob = bpy.context.object
        ob.data.materials.append(material)
        prepare(ob)
        bpy.context.scene.cycles.samples = 1
        attributes = object_attributes(ob, bpy.context.evaluated_depsgraph_get())
        assert shine(material, attributes) == pytest.approx(render(), abs=1e-6)
        return shine(material, attributes)

    @pytest.mark.parametrize(
        ("value", "output", "expected"),
        [
            (0.7, "Color", 0.7),
            (2, "Factor", 2),
            (True, "Vector", 1),
            ((0.1, 0.2, 0.3), "Color", (0.1, 0.2, 0.3)),
            ((0.1, 0.2, 0.6, 0.4), "Factor", 0.3),
            ((0.1, 0.2, 0.6, 0.4), "Alpha", 0.4),
            ((0.1, 0.2), "Color", (0.1, 0.2, 0)),
            ("red", "Color", 0),
        ],
    )
    def test_custom_properties(self, value, output, expected, render):
        def prepare(ob):
            ob["heat"] = value

        emission = self.compared("OBJECT", "heat", output, prepare, render)
        assert emission == pytest.approx(np.broadcast_to(expected, 3))

    @pytest.mark.parametrize(
        ("kind", "name", "output", "expected"),
        [
            ("OBJECT", "color", "Color", (0.1, 0.2, 0.3)),
            ("OBJECT", "color", "Alpha", 0.5),
            ("OBJECT", '["heat"]', "Factor", 3),
            ("OBJECT", "location[0]", "Factor", 0),
            ("OBJECT", "of the mesh", "Factor", 4),
            ("OBJECT", "nothing", "Color", 0),
            ("OBJECT", "", "Color", 0),
            ("INSTANCER", "heat", "Factor", 3),
            ("VIEW_LAYER", "heat", "Factor", 0),
            ("VIEW_LAYER", "of the scene", "Factor", 5),
            ("VIEW_LAYER", "frame_current", "Factor", 7),
        ],
    )
    def test_places(self, kind, name, output, expected, render):
        def prepare(ob):
            ob.color, ob["heat"], ob.data["of the mesh"] = (0.1, 0.2, 0.3, 0.5), 3.0, 4.0
            ob.location.x = 0.01
            bpy.context.scene["of the scene"] = 5.0
            bpy.context.scene.frame_set(7)

        emission = self.compared(kind, name, output, prepare, render)
        assert emission == pytest.approx(np.broadcast_to(expected, 3))

    def test_attributes_of_an_unknown_object_are_refused(self):
        material = make_material("leaf")
        tree = material.node_tree
        leaf = add_node(tree, "ShaderNodeBsdfDiffuse", Color=attribute(tree, "a", kind="OBJECT"))
        with pytest.raises(SceneError, match="'leaf' takes a value from the node 'Attribute'"):
            leaf_optics(connect(material, leaf, "Surface"))


def two_outputs(material):
    tree = material.node_tree
    tree.links.new(emission(tree, RED), tree.nodes["Material Output"].inputs[0])
    other = tree.nodes.new("ShaderNodeOutputMaterial")
    other.target = "CYCLES"
    tree.links.new(emission(tree, BLUE), other.inputs[0])


def output_for_eevee(material):
    connect(material, emission(material.node_tree).node, "Surface")
    material.node_tree.nodes["Material Output"].target = "EEVEE"


def output_in_a_group(material):
    tree = material.node_tree
    tree.nodes.clear()
    _node, inside = make_group(tree, "Color")
    inside.links.new(emission(inside, BLUE), inside.nodes.new("ShaderNodeOutputMaterial").inputs[0])


def muted_emission(material):
    shader = emission(material.node_tree).node
    connect(material, shader, "Surface").node_tree.nodes[shader.name].mute = True


def sum_with_a_muted_emission(material):
    tree = material.node_tree
    one, other = emission(tree, BLUE).node, emission(tree, RED).node
    other.mute = True
    connect(material, combine(tree, one, other), "Surface")


def muted_mix_of(*linked):
    def build(material):
        tree = material.node_tree
        mix = tree.nodes.new("ShaderNodeMixShader")
        for index, shade in linked:
            tree.links.new(emission(tree, shade), mix.inputs[index])
        mix.mute = True
        connect(material, mix, "Surface")

    return build


def mix_with_a_factor_of_0(material):
    tree = material.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise").outputs[1]
    both = combine(tree, emission(tree, BLUE).node, emission(tree, noise).node, 0.0)
    connect(material, both, "Surface")


def empty_group(material):
    connect(material, make_group(material.node_tree, "Shader")[0], "Surface")


CLOSURES = {
    "two outputs": two_outputs,
    "an output for EEVEE": output_for_eevee,
    "an output in a group": output_in_a_group,
    "a muted emission": muted_emission,
    "a sum with a muted emission": sum_with_a_muted_emission,
    "a muted mix of both": muted_mix_of((1, BLUE), (2, RED)),
    "a muted mix of the second": muted_mix_of((2, BLUE)),
    "a mix with a factor of 0": mix_with_a_factor_of_0,
    "an empty group": empty_group,
}


@pytest.mark.parametrize("build", CLOSURES.values(), ids=CLOSURES)
def test_closures_are_those_of_cycles(build, render):
    material = make_material()
    build(material)
    assert shine(material) == pytest.approx(rendered(material, render), abs=1e-6)


def test_a_muted_volume_is_no_volume():
    material = volume("ShaderNodeVolumePrincipled")
    assert has_volume(material)
    material.node_tree.nodes["Principled Volume"].mute = True
    assert not has_volume(material)
    assert volume_optics(material) is None


def test_an_emission_of_strength_0_is_no_volume():
    assert not has_volume(volume("ShaderNodeEmission", Strength=0.0))
    assert has_volume(volume("ShaderNodeEmission", Strength=0.1))
