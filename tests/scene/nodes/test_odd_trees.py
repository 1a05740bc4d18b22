# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees with circles of links, many nodes or missing parts."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.materials import Leaf, has_surface, has_volume, leaf_optics
from tests.scene.nodes.sockets import BLUE, MATH, RED, emission, number, rendered, shine
from tests.scene.trees import (
    add_node,
    combine,
    computed,
    connect,
    end_group,
    make_group,
    make_material,
    surface,
)


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
        with pytest.raises(SceneError, match="'leaf' form a loop at the node '"):
            shine(material)
        assert not has_surface(material)

    def test_of_numbers_that_are_not_used(self, render):
        material = surface("ShaderNodeEmission")
        self.circle(material.node_tree, MATH)
        assert rendered(material, render) == pytest.approx(0)
        with pytest.raises(SceneError, match="form a loop at the node 'Math"):
            shine(material)

    def test_inside_a_group(self):
        material = make_material("leaf")
        node, inside = make_group(material.node_tree, "Shader")
        end_group(inside, self.circle(inside).outputs[0])
        with pytest.raises(SceneError, match="'leaf' form a loop at the node 'Mix Shader"):
            leaf_optics(connect(material, node, "Surface"))
        assert not has_surface(material)

    def test_of_numbers_inside_a_group(self):
        material = make_material("leaf")
        node, inside = make_group(material.node_tree, "Float")
        end_group(inside, self.circle(inside, MATH).outputs[0])
        shader = emission(material.node_tree, strength=node.outputs[0])
        with pytest.raises(SceneError, match="'leaf' form a loop at the node 'Math"):
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
