# SPDX-License-Identifier: GPL-3.0-or-later
"""Sockets and groups for the tests of node trees, and the emission of a material."""

import bpy
import numpy as np

from lb_lighting.scene.nodes.shaders import Shader
from tests.scene.trees import add_node, computed, end_group, make_group

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
