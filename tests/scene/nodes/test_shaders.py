# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees, checked against Cycles' pictures of the same trees."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.materials import Leaf, has_surface, has_volume, leaf_optics, volume_optics
from lb_lighting.scene.nodes.arithmetic import Scaled
from lb_lighting.scene.nodes.attributes import object_attributes
from lb_lighting.scene.nodes.shaders import Shader
from tests import scenery
from tests.scene.trees import (
    add_node,
    attribute,
    combine,
    computed,
    connect,
    end_group,
    make_group,
    make_material,
    surface,
    volume,
)

RED, GREEN, BLUE = (1, 0, 0), (0, 1, 0), (0.2, 0.3, 0.4)
MATH, MIX = "ShaderNodeMath", "ShaderNodeMix"


def muted(tree, kind, *values, **settings):
    socket = computed(tree, kind, *values, **settings)
    socket.node.mute = True
    return socket


def number(tree, value):
    node = tree.nodes.new("ShaderNodeValue")
    node.outputs[0].default_value = value
    return node.outputs[0]


def color(tree, value):
    node = tree.nodes.new("ShaderNodeRGB")
    node.outputs[0].default_value = (*value, 1)
    return node.outputs[0]


def reroute(tree, *sources):
    node = tree.nodes.new("NodeReroute")
    for source in sources:
        tree.links.new(source, node.inputs[0])
    return node.outputs[0]


def emission(tree, shade=(1, 1, 1), strength=1.0):
    return add_node(tree, "ShaderNodeEmission", Color=shade, Strength=strength).outputs[0]


def shine(material, attributes=None):
    """(3,): the emission of a surface as LB Lighting reads it."""
    shader = Shader(material, attributes=attributes)
    return sum(
        (
            closure.weight * shader.color(closure, "Color") * shader.number(closure, "Strength")
            for closure in shader.closures("Surface", {"EMISSION"})
        ),
        start=np.zeros(3),
    )


def rendered(material, render):
    """(3,): the colour of a cube with the material in Cycles."""
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.context.object.data.materials.append(material)
    bpy.context.scene.cycles.samples = 1
    return render()


def muted_group(tree):
    node, inside = make_group(tree, "Color", ["Color"])
    end_group(inside, color(inside, GREEN))
    tree.links.new(color(tree, BLUE), node.inputs[0])
    node.mute = True
    return node.outputs[0]


def group_around_nothing(tree):
    return make_group(tree, "Color")[0].outputs[0]


def group_with_a_default_color(tree):
    node, inside = make_group(tree, "Color")
    inside.nodes.new("NodeGroupOutput").inputs[0].default_value = (*BLUE, 1)
    return node.outputs[0]


def group_around_a_muted_node(tree):
    node, inside = make_group(tree, "Color")
    end = end_group(inside, muted(inside, "ShaderNodeRGB"))
    end.inputs[0].default_value = (*BLUE, 1)
    return node.outputs[0]


def muted_node_into_a_group(tree):
    node, inside = make_group(tree, "Color", ["Color"])
    end_group(inside, inside.nodes.new("NodeGroupInput").outputs[0])
    node.inputs[0].default_value = (*BLUE, 1)
    tree.links.new(muted(tree, "ShaderNodeRGB"), node.inputs[0])
    return node.outputs[0]


def group_with_two_outputs(tree):
    node, inside = make_group(tree, "Color")
    end_group(inside, color(inside, GREEN))
    end_group(inside, color(inside, BLUE)).is_active_output = True
    return node.outputs[0]


def color_through_a_group_of_numbers(tree):
    node, inside = make_group(tree, "Color", ["Float"])
    end_group(inside, inside.nodes.new("NodeGroupInput").outputs[0])
    tree.links.new(color(tree, BLUE), node.inputs[0])
    return node.outputs[0]


COLORS = {  # what is linked to a colour input that is red
    "a muted colour": lambda tree: muted(tree, "ShaderNodeRGB"),
    "a muted mix of nothing": lambda tree: muted(tree, MIX, data_type="RGBA"),
    "a muted mix of one colour": lambda tree: muted(
        tree, MIX, 0.3, color(tree, BLUE), data_type="RGBA"
    ),
    "a muted hue and saturation": lambda tree: muted(
        tree, "ShaderNodeHueSaturation", 0.2, 1.0, 1.0, 1.0, color(tree, BLUE)
    ),
    "a mix of two colours": lambda tree: computed(
        tree, MIX, 0.25, (*BLUE, 1), color(tree, GREEN), data_type="RGBA"
    ),
    "a mix with a factor of 1": lambda tree: computed(
        tree, MIX, 1.0, color(tree, RED), color(tree, BLUE), data_type="RGBA"
    ),
    "colours multiplied": lambda tree: computed(
        tree, MIX, 0.5, (*BLUE, 1), (*BLUE, 1), data_type="RGBA", blend_type="MULTIPLY"
    ),
    "a vector scaled": lambda tree: computed(
        tree, "ShaderNodeVectorMath", BLUE, 2.0, operation="SCALE"
    ),
    "a muted group": muted_group,
    "a group without an output": group_around_nothing,
    "a group with a default colour": group_with_a_default_color,
    "a group around a muted node": group_around_a_muted_node,
    "a muted node before a group": muted_node_into_a_group,
    "a group with two outputs": group_with_two_outputs,
    "a colour through a group of numbers": color_through_a_group_of_numbers,
    "a closure": lambda tree: emission(tree),
}
STRENGTHS = {  # what is linked to a strength input that is 3
    "a muted attribute": lambda tree: muted(tree, "ShaderNodeAttribute", output=2),
    "a muted sum": lambda tree: muted(tree, MATH, 0.25, 0.5),
    "a muted sum of a linked number": lambda tree: muted(tree, MATH, 0.25, number(tree, 0.6)),
    "a reroute of nothing": lambda tree: reroute(tree),
    "a muted sum of a reroute of nothing": lambda tree: muted(tree, MATH, reroute(tree)),
    "a colour": lambda tree: color(tree, (0.8, 0.1, 0.1)),
    "a vector": lambda tree: computed(tree, "ShaderNodeVectorMath", (0.8, 0.1, 0.3)),
    "a product of two numbers": lambda tree: computed(
        tree, MATH, 3.0, number(tree, 0.2), operation="MULTIPLY"
    ),
    "a clamped product": lambda tree: computed(
        tree, MATH, 3.0, 2.0, operation="MULTIPLY", use_clamp=True
    ),
    "a difference": lambda tree: computed(tree, MATH, 3.0, 2.5, operation="SUBTRACT"),
    "a quotient": lambda tree: computed(tree, MATH, 3.0, 2.0, operation="DIVIDE"),
    "a division by zero": lambda tree: computed(tree, MATH, 3.0, 0.0, operation="DIVIDE"),
    "the smaller": lambda tree: computed(tree, MATH, 3.0, 2.5, operation="MINIMUM"),
    "the larger": lambda tree: computed(tree, MATH, 0.3, 0.5, operation="MAXIMUM"),
    "a clamp": lambda tree: computed(tree, "ShaderNodeClamp", 3.0, 0.0, 2.0),
    "a clamp with a reversed range": lambda tree: computed(
        tree, "ShaderNodeClamp", 3.0, 2.0, 1.0, clamp_type="RANGE"
    ),
    "a mix": lambda tree: computed(tree, MIX, 0.25, 1.0, 3.0),
    "a mix beyond its ends": lambda tree: computed(tree, MIX, 1.5, 1.0, 3.0),
    "a mix beyond its ends, not clamped": lambda tree: computed(
        tree, MIX, 1.5, 1.0, 3.0, clamp_factor=False
    ),
}


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


class TestCircles:
    """Cycles renders nothing of a tree with a circle of links anywhere."""

    def circle(self, tree, kind="ShaderNodeMixShader"):
        first, second = tree.nodes.new(kind), tree.nodes.new(kind)
        closing = 0 if kind == MATH else -1  # most operations do not use the last input
        tree.links.new(first.outputs[0], second.inputs[closing])
        tree.links.new(second.outputs[0], first.inputs[closing])
        return second

    @pytest.mark.parametrize("kind", ["ShaderNodeMixShader", "NodeReroute"])
    def test_of_closures(self, kind, render):
        material = make_material("leaf")
        connect(material, self.circle(material.node_tree, kind), "Surface")
        assert rendered(material, render) == pytest.approx(0)
        with pytest.raises(SceneError, match="'leaf' lead in a circle at the node '"):
            shine(material)
        assert not has_surface(material)

    def test_of_numbers_that_are_not_used(self, render):
        material = surface("ShaderNodeEmission")
        self.circle(material.node_tree, MATH)
        assert rendered(material, render) == pytest.approx(0)
        with pytest.raises(SceneError, match="in a circle at the node 'Math"):
            shine(material)

    def test_inside_a_group(self):
        material = make_material("leaf")
        node, inside = make_group(material.node_tree, "Shader")
        end_group(inside, self.circle(inside).outputs[0])
        with pytest.raises(SceneError, match="'leaf' lead in a circle at the node 'Mix Shader"):
            leaf_optics(connect(material, node, "Surface"))
        assert not has_surface(material)

    def test_of_numbers_inside_a_group(self):
        material = make_material("leaf")
        node, inside = make_group(material.node_tree, "Float")
        end_group(inside, self.circle(inside, MATH).outputs[0])
        shader = emission(material.node_tree, strength=node.outputs[0])
        with pytest.raises(SceneError, match="'leaf' lead in a circle at the node 'Math"):
            shine(connect(material, shader.node, "Surface"))


class TestSize:
    """An algorithm whose time doubles with each node would not finish."""

    def test_mixes_that_share_what_they_mix(self):
        material = make_material()
        tree = material.node_tree
        last = add_node(tree, "ShaderNodeBsdfDiffuse", Color=BLUE)
        for _ in range(60):
            last = combine(tree, last, last, 0.5)
        connect(material, last, "Surface")
        assert leaf_optics(material).reflectance == pytest.approx(BLUE)
        assert not has_volume(material)

    def test_sums_that_share_what_they_add(self):
        material = make_material()
        tree = material.node_tree
        last = number(tree, 2.0**-60)
        for _ in range(60):
            last = computed(tree, MATH, last, last, operation="ADD")
        shader = connect(material, emission(tree, strength=last).node, "Surface")
        assert shine(shader) == pytest.approx(np.ones(3))

    def test_long_chains(self):
        material = make_material()
        tree = material.node_tree
        last = add_node(tree, "ShaderNodeBsdfDiffuse", Color=BLUE)
        dark = add_node(tree, "ShaderNodeBsdfDiffuse", Color=(0, 0, 0))
        for _ in range(250):
            last = combine(tree, last, dark, 0.0)
        strength = number(tree, 3.0)
        for _ in range(250):
            strength = computed(tree, MATH, strength, 1.0, operation="MULTIPLY")
        both = combine(tree, last, dark, strength)
        assert leaf_optics(connect(material, both, "Surface")) == Leaf((0, 0, 0), (0, 0, 0))

    def test_groups_in_groups(self):
        material, outer = make_material(), None
        for depth in range(80):
            tree = bpy.data.node_groups.new("group", "ShaderNodeTree")
            tree.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketShader")
            tree.interface.new_socket("Color", in_out="INPUT", socket_type="NodeSocketColor")
            start = tree.nodes.new("NodeGroupInput")
            if depth:
                shader = tree.nodes.new("ShaderNodeGroup")
                shader.node_tree = outer
            else:
                shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
            tree.links.new(start.outputs[0], shader.inputs[0])
            end_group(tree, shader.outputs[0])
            outer = tree
        node = material.node_tree.nodes.new("ShaderNodeGroup")
        node.node_tree = outer
        node.inputs[0].default_value = (*BLUE, 1)
        leaf = leaf_optics(connect(material, node, "Surface"))
        assert leaf.reflectance == pytest.approx(BLUE)


class TestMissingParts:
    """Nodes with missing parts cause no traceback."""

    def test_node_of_a_missing_add_on(self):
        class Rust(bpy.types.ShaderNodeCustomGroup):
            bl_idname, bl_label = "ShaderNodeRust", "Rust"

            def init(self, _context):
                inside = bpy.data.node_groups.new("rust", "ShaderNodeTree")
                for kind in ("Shader", "Color"):
                    inside.interface.new_socket(
                        kind, in_out="OUTPUT", socket_type=f"NodeSocket{kind}"
                    )
                end_group(inside, add_node(inside, "ShaderNodeBsdfDiffuse", Color=RED).outputs[0])
                self.node_tree = inside

        bpy.utils.register_class(Rust)
        material, other = make_material("metal"), make_material("paint")
        node = material.node_tree.nodes.new("ShaderNodeRust")
        connect(material, node, "Surface")
        rust = other.node_tree.nodes.new("ShaderNodeRust")
        leaf = add_node(other.node_tree, "ShaderNodeBsdfDiffuse", Color=rust.outputs["Color"])
        connect(other, leaf, "Surface")
        assert leaf_optics(material).reflectance == RED
        bpy.utils.unregister_class(Rust)
        with pytest.raises(SceneError, match="'metal' uses the node 'Rust', which is not"):
            leaf_optics(material)
        with pytest.raises(SceneError, match="'paint' takes a value from the node 'Rust'"):
            leaf_optics(other)

    def test_missing_group(self):
        material = make_material()
        node, inside = make_group(material.node_tree, "Shader")
        connect(material, node, "Surface")
        bpy.data.node_groups.remove(inside)
        assert leaf_optics(material) == Leaf((0, 0, 0), (0, 0, 0))

    def test_group_input_outside_a_group(self):
        material = make_material()
        tree = material.node_tree
        _node, inside = make_group(tree, "Color", ["Color"])
        assert inside.nodes.new("NodeGroupInput").outputs[0].name == "Color"
        material.node_tree.nodes.new("NodeGroupInput")
        leaf = add_node(tree, "ShaderNodeBsdfDiffuse", Color=BLUE)
        assert leaf_optics(connect(material, leaf, "Surface")).reflectance == pytest.approx(BLUE)


class TestDensities:
    """Numbers times an attribute, written with different nodes."""

    def density(self, build):
        material = make_material("fog")
        tree = material.node_tree
        scatter = add_node(tree, "ShaderNodeVolumeScatter", Density=build(tree))
        shader = Shader(connect(material, scatter, "Volume"))
        (closure,) = shader.closures("Volume", {"VOLUME_SCATTER"})
        return shader.scaled_attribute(closure, "Density")

    @pytest.mark.parametrize(
        ("values", "settings", "expected"),
        [
            ((1.0, 2.0), {"operation": "ADD"}, "'Math'"),
            ((2.0, 0.0), {"operation": "POWER"}, "'Math'"),
            ((-1.0, 2.0), {"operation": "MAXIMUM"}, "'Math'"),
            ((0.0, 0.0), {"operation": "ADD"}, Scaled(1.0, "smoke")),
        ],
    )
    def test_of_sums_and_powers(self, values, settings, expected):
        def build(tree):
            return computed(tree, MATH, attribute(tree, "smoke"), values[0] or 0.0, **settings)

        if isinstance(expected, Scaled):
            assert self.density(build) == expected
        elif settings["operation"] == "MAXIMUM":
            assert self.density(build) == Scaled(1.0, "smoke")
        else:
            with pytest.raises(SceneError, match=f"its density with the node {expected}"):
                self.density(build)

    def test_two_grids_are_refused(self):
        def build(tree):
            factors = attribute(tree, "smoke"), attribute(tree, "heat")
            return computed(tree, MATH, *factors, operation="MULTIPLY")

        with pytest.raises(SceneError, match="'fog' computes its density with the node 'Math'"):
            self.density(build)

    def test_an_attribute_without_a_name_is_refused(self):
        with pytest.raises(SceneError, match="its density with the node 'Attribute'"):
            self.density(lambda tree: attribute(tree, ""))

    def test_alpha_and_the_color_of_volume_info_are_refused(self):
        with pytest.raises(SceneError, match="its density with the node 'Attribute'"):
            self.density(lambda tree: attribute(tree, "smoke", "Alpha"))
        with pytest.raises(SceneError, match="its density with the node 'Volume Info'"):
            self.density(lambda tree: tree.nodes.new("ShaderNodeVolumeInfo").outputs["Color"])


def times(tree, source, factor, **settings):
    return computed(tree, MATH, source, factor, operation="MULTIPLY", **settings)


def smoke(tree, output="Factor"):
    return attribute(tree, "density", output)


DENSITIES = {  # with a grid of density 0.5
    "a product, clamped": lambda tree: times(tree, smoke(tree), 6.0, use_clamp=True),
    "a product below the clamp": lambda tree: times(tree, smoke(tree), 1.5, use_clamp=True),
    "clamped, then scaled": lambda tree: times(
        tree, times(tree, smoke(tree), 6.0, use_clamp=True), 0.7
    ),
    "scaled on both sides": lambda tree: times(
        tree, times(tree, times(tree, smoke(tree), 3.0), 2.0), number(tree, 0.3)
    ),
    "clamped twice": lambda tree: times(
        tree, times(tree, smoke(tree), 6.0, use_clamp=True), 3.0, use_clamp=True
    ),
    "a negative number": lambda tree: times(tree, smoke(tree), -2.0),
    "a negative number twice": lambda tree: times(tree, times(tree, smoke(tree), -2.0), -1.5),
    "a negative number, clamped": lambda tree: times(
        tree, times(tree, smoke(tree), -2.0, use_clamp=True), -1.5
    ),
    "a quotient": lambda tree: computed(tree, MATH, smoke(tree), 0.4, operation="DIVIDE"),
    "the smaller": lambda tree: computed(tree, MATH, smoke(tree), 0.2, operation="MINIMUM"),
    "a clamp": lambda tree: computed(tree, "ShaderNodeClamp", smoke(tree), 0.0, 0.3),
    "a mix with a factor of 1": lambda tree: computed(tree, MIX, 1.0, 9.0, smoke(tree)),
    "a mix with zero": lambda tree: computed(tree, MIX, 0.25, smoke(tree), 0.0),
    "a color, scaled": lambda tree: computed(
        tree, "ShaderNodeVectorMath", smoke(tree, "Color"), 3.0, operation="SCALE"
    ),
    "a vector, times a grey": lambda tree: computed(
        tree, "ShaderNodeVectorMath", smoke(tree, "Vector"), (2, 2, 2), operation="MULTIPLY"
    ),
    "a muted product": lambda tree: muted(tree, MATH, smoke(tree), 6.0, operation="MULTIPLY"),
}


@pytest.mark.parametrize("build", DENSITIES.values(), ids=DENSITIES)
def test_densities_are_those_of_cycles(build, tmp_path, render):
    """Through a fog without light, the world has a brightness of e^-tau."""
    material = make_material()
    absorption = add_node(material.node_tree, "ShaderNodeVolumeAbsorption", Color=(0.8, 0.8, 0.8))
    socket = build(material.node_tree)
    material.node_tree.links.new(socket, absorption.inputs["Density"])
    ob = scenery.add_fog(tmp_path, np.full((40, 40, 40), 0.5), material=False)
    ob.data.materials.append(connect(material, absorption, "Volume"))
    scene = bpy.context.scene
    scene.camera.location = (4, 4, 20)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1
    scene.cycles.samples, scene.cycles.volume_biased = 1, True
    depth = -np.log(render()[0])
    fog = volume_optics(material)
    density = Scaled(1.0, fog.density_attribute, fog.limit).of({"density": 0.5})
    # The fog is 10 m deep, and its border is blurred by half a voxel.
    assert 10 * density * fog.optics.sigma_a == pytest.approx(depth, rel=0.03, abs=1e-3)
