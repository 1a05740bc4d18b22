# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes, links and sockets of groups and materials that are made by code."""

import bpy

from ..ours import TAG


def add_input(tree, name, kind, description, default=None, limits=None, hidden=False):
    """A socket of the group `tree` that users set: its tooltip, default, and (least, largest).

    hidden  no value is offered where nothing is linked
    """
    socket = _add_socket(tree, name, "INPUT", kind, description)
    if limits is not None:
        socket.min_value, socket.max_value = limits
    if default is not None:
        socket.default_value = default
    socket.hide_value = hidden


def add_output(tree, name, kind, description):
    """A socket that the group `tree` hands on, with its tooltip."""
    _add_socket(tree, name, "OUTPUT", kind, description)


def _add_socket(tree, name, in_out, kind, description):
    """One that is there already keeps what is linked to it; those of an older version, which have
    no description, come last."""
    interface, kind = tree.interface, f"NodeSocket{kind}"
    before = list(interface.items_tree)
    facts = name, in_out, kind
    same = (s for s in before if (s.name, s.in_out, s.bl_socket_idname) == facts)
    socket = next(same, None) or interface.new_socket(name, in_out=in_out, socket_type=kind)
    interface.move(socket, sum(bool(other.description) for other in before))
    socket.description = description
    return socket


def add_node(tree, kind, x, y):
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node


def add_attribute(tree, name, x, y, of="GEOMETRY"):
    """An Attribute node for the attribute or grid `name`, of "GEOMETRY" or the "INSTANCER"."""
    node = add_node(tree, "ShaderNodeAttribute", x, y)
    node.attribute_name, node.attribute_type = name, of
    return node


def add_math(tree, operation, a, b, x, y):
    """A Math node on `a` and `b`, sockets or values; returns its output socket."""
    node = add_node(tree, "ShaderNodeMath", x, y)
    node.operation = operation
    _feed(tree, node.inputs[0], a)
    _feed(tree, node.inputs[1], b)
    return node.outputs["Value"]


def add_mix(tree, factor, a, b, x, y):
    """A Mix node of vectors, from the socket `a` to `b` by `factor`; returns its output socket."""
    node = add_node(tree, "ShaderNodeMix", x, y)
    node.data_type = "VECTOR"
    # The sockets of all data types are there, under names that repeat.
    inputs = {socket.identifier: socket for socket in node.inputs}
    for source, name in ((factor, "Factor_Float"), (a, "A_Vector"), (b, "B_Vector")):
        tree.links.new(source, inputs[name])
    return next(s for s in node.outputs if s.identifier == "Result_Vector")


def add_vector(tree, operation, a, b, x, y):
    """A Vector Math node on `a` and `b`, sockets or values; returns its output socket."""
    node = add_node(tree, "ShaderNodeVectorMath", x, y)
    node.operation = operation
    second = node.inputs["Scale"] if operation == "SCALE" else node.inputs[1]
    _feed(tree, node.inputs[0], a)
    _feed(tree, second, b)
    return node.outputs["Value" if operation == "LENGTH" else "Vector"]


def _feed(tree, target, value):
    """Link `value`, a socket, to the input `target`, or set it where it is a plain value."""
    if isinstance(value, bpy.types.NodeSocket):
        tree.links.new(value, target)
    else:
        target.default_value = value


def new_material(name, tag):
    """A material of ours without any nodes."""
    material = bpy.data.materials.new(name)
    material[TAG] = tag
    material.node_tree.nodes.clear()
    return material
