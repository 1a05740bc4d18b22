# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes, links and sockets of the node groups and materials that code builds.

The type stubs know a node by its class, and the code makes nodes by the names of their classes. So
nodes are `Any` here, and so are sockets, whose values the stubs know only by the sockets' classes.
"""

from collections.abc import Sequence
from typing import Any

import bpy

from ..ours import TAG

type Node = Any
type Socket = Any
type Operand = bpy.types.NodeSocket | float | tuple[float, ...]  # a socket, or a plain value


def add_input(
    tree: Any,
    name: str,
    kind: str,
    description: str,
    default: object = None,
    limits: tuple[float, float] | None = None,
    hidden: bool = False,
) -> None:
    """Add an input socket to the group `tree`.

    description  its tooltip
    limits       (least, largest) value, or None
    hidden       whether it shows no value where nothing is linked
    """
    socket = _add_socket(tree, name, "INPUT", kind, description)
    if limits is not None:
        socket.min_value, socket.max_value = limits
    if default is not None:
        socket.default_value = default
    socket.hide_value = hidden


def add_output(tree: Any, name: str, kind: str, description: str) -> None:
    """Add an output socket with a tooltip to the group `tree`."""
    _add_socket(tree, name, "OUTPUT", kind, description)


def _add_socket(tree: Any, name: str, in_out: str, kind: str, description: str) -> Socket:
    """A socket of the group `tree`: the existing one, with its links, or a new one.

    Sockets of an older version, which have no description, come last.
    """
    interface, kind = tree.interface, f"NodeSocket{kind}"
    before = list(interface.items_tree)
    identity = name, in_out, kind
    same = (s for s in before if (s.name, s.in_out, s.bl_socket_idname) == identity)
    socket = next(same, None) or interface.new_socket(name, in_out=in_out, socket_type=kind)
    interface.move(socket, sum(bool(other.description) for other in before))
    socket.description = description
    return socket


def add_node(tree: Any, kind: str, x: float, y: float) -> Node:
    """Add a node of the class `kind` at (x, y)."""
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node


def add_attribute(tree: Any, name: str, x: float, y: float, of: str = "GEOMETRY") -> Node:
    """Add an Attribute node for the attribute or grid `name`, of "GEOMETRY" or the "INSTANCER"."""
    node = add_node(tree, "ShaderNodeAttribute", x, y)
    node.attribute_name, node.attribute_type = name, of
    return node


def add_math(tree: Any, operation: str, a: Operand, b: Operand, x: float, y: float) -> Socket:
    """Add a Math node on `a` and `b`; returns its output socket."""
    node = add_node(tree, "ShaderNodeMath", x, y)
    node.operation = operation
    _feed(tree, node.inputs[0], a)
    _feed(tree, node.inputs[1], b)
    return node.outputs["Value"]


def add_mix(tree: Any, factor: Socket, a: Socket, b: Socket, x: float, y: float) -> Socket:
    """Add a Mix node of vectors, from the socket `a` to `b` by `factor`; returns its output."""
    node = add_node(tree, "ShaderNodeMix", x, y)
    node.data_type = "VECTOR"
    # The node has the sockets of all data types, whose names repeat.
    inputs = {socket.identifier: socket for socket in node.inputs}
    for source, name in ((factor, "Factor_Float"), (a, "A_Vector"), (b, "B_Vector")):
        tree.links.new(source, inputs[name])
    return next(s for s in node.outputs if s.identifier == "Result_Vector")


def add_vector(tree: Any, operation: str, a: Operand, b: Operand, x: float, y: float) -> Socket:
    """Add a Vector Math node on `a` and `b`; returns its output socket."""
    node = add_node(tree, "ShaderNodeVectorMath", x, y)
    node.operation = operation
    second = node.inputs["Scale"] if operation == "SCALE" else node.inputs[1]
    _feed(tree, node.inputs[0], a)
    _feed(tree, second, b)
    return node.outputs["Value" if operation == "LENGTH" else "Vector"]


def separate(tree: Any, vector: Socket, x: float, y: float) -> Sequence[Socket]:
    """Add a node that splits `vector`; returns its outputs X, Y and Z."""
    node = add_node(tree, "ShaderNodeSeparateXYZ", x, y)
    tree.links.new(vector, node.inputs[0])
    outputs: Sequence[Socket] = node.outputs
    return outputs


def _feed(tree: Any, target: Socket, value: Operand) -> None:
    """Link `value` to the input `target` if it is a socket, else set it as the value."""
    if isinstance(value, bpy.types.NodeSocket):
        tree.links.new(value, target)
    else:
        target.default_value = value


def new_material(name: str, tag: str) -> bpy.types.Material:
    """A material of ours without any nodes."""
    material = bpy.data.materials.new(name)
    material[TAG] = tag
    assert material.node_tree
    material.node_tree.nodes.clear()
    return material
