# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials made of nodes, in few words."""

import bpy


def make_material(name="matter"):
    material = bpy.data.materials.new(name)
    material.node_tree.nodes.clear()
    material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    return material


def add_node(tree, kind, /, _phase=None, **inputs):
    """A node with inputs set by name, spaces as underscores: numbers, or sockets to link."""
    node = tree.nodes.new(kind)
    if _phase:
        node.phase = _phase
    for name, value in inputs.items():
        socket = node.inputs[name.replace("_", " ")]
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        elif socket.type == "RGBA":
            socket.default_value = (*value, 1)
        else:
            socket.default_value = value
    return node


def combine(tree, first, second, factor=None):
    """Add Shader, or Mix Shader with a factor, of two nodes."""
    node = tree.nodes.new("ShaderNodeAddShader" if factor is None else "ShaderNodeMixShader")
    if isinstance(factor, bpy.types.NodeSocket):
        tree.links.new(factor, node.inputs[0])
    elif factor is not None:
        node.inputs[0].default_value = factor
    for source, socket in zip((first, second), node.inputs[-2:], strict=True):
        tree.links.new(source.outputs[0], socket)
    return node


def connect(material, node, output):
    end = material.node_tree.get_output_node("ALL")
    material.node_tree.links.new(node.outputs[0], end.inputs[output])
    return material


def volume(kind, /, **inputs):
    material = make_material()
    return connect(material, add_node(material.node_tree, kind, **inputs), "Volume")


def surface(kind, /, **inputs):
    material = make_material()
    return connect(material, add_node(material.node_tree, kind, **inputs), "Surface")


def make_group(tree, kind, inputs=()):
    """(group node in `tree`, the tree inside) with an output, and inputs, of socket types."""
    inside = bpy.data.node_groups.new("group", "ShaderNodeTree")
    for name in inputs:
        inside.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{name}")
    inside.interface.new_socket("Out", in_out="OUTPUT", socket_type=f"NodeSocket{kind}")
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = inside
    return node, inside


def end_group(inside, socket):
    """A Group Output that hands out what the `socket` has."""
    end = inside.nodes.new("NodeGroupOutput")
    inside.links.new(socket, end.inputs[0])
    return end


def attribute(tree, name, output="Factor", kind="GEOMETRY"):
    """An output of an Attribute node."""
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name, node.attribute_type = name, kind
    return node.outputs[output]


def computed(tree, kind, /, *values, output=0, **settings):
    """An output of a node with `settings`, whose inputs in use have these values, or links."""
    node = tree.nodes.new(kind)
    for name, setting in settings.items():
        setattr(node, name, setting)
    for socket, value in zip([s for s in node.inputs if s.enabled], values, strict=False):
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return [s for s in node.outputs if s.enabled][output]
