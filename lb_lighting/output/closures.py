# SPDX-License-Identifier: GPL-3.0-or-later
"""The closures that reach the surface output of a node tree, as Cycles finds them: through mixes,
sums, reroutes, muted nodes and node groups."""

from collections.abc import Iterable, Iterator
from typing import Any

import bpy

from ..ours import is_ours
from ..scene.nodes.shaders import Closure, may_be_positive

# Nodes that pass on the closures of others.
PASSING_NODES = {"MIX_SHADER", "ADD_SHADER", "REROUTE", "GROUP_INPUT"}
CLEAR_NODES = {"BSDF_GLASS", "BSDF_REFRACTION"}


def surface_sockets(tree: Any) -> list[Any]:
    """The Surface sockets of the outputs that render engines use: one, or one for each engine."""
    outputs = dict.fromkeys(tree.get_output_node(engine) for engine in ("CYCLES", "EEVEE"))
    return [output.inputs["Surface"] for output in outputs if output]


def group_sockets(group: Any) -> list[Any]:
    """The sockets of a node group's output that pass on closures."""
    output = next((n for n in group.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output), None)
    return [socket for socket in output.inputs if socket.type == "SHADER"] if output else []


def closure_links(socket: Any) -> Iterator[Any]:
    """The links that bring closures to `socket`, directly or through the nodes that pass them on.

    They start at closures and at node groups. Those that reach a group's own inputs are included,
    because the group may pass them on.
    """
    waiting, visited = [socket], set()
    while waiting:
        socket = waiting.pop()
        if socket in visited:  # mixes can share what they mix
            continue
        visited.add(socket)
        feeding = []
        for link in socket.links:
            # An invalid link closes a cycle.
            if link.is_muted or not link.is_valid or link.from_socket.type != "SHADER":
                continue
            node = link.from_node
            if node.mute:
                feeding += [inner.from_socket for inner in node.internal_links
                            if inner.to_socket == link.from_socket]  # fmt: skip
            else:
                feeding += node.inputs
                if node.type not in PASSING_NODES:
                    yield link
        waiting += reversed(feeding)


def surface_closures(material: bpy.types.Material | None) -> list[Closure]:
    """The closures of any type that may reach the surface of a material, or of None."""
    if material is None or material.node_tree is None:
        return []
    return list(_closures(surface_sockets(material.node_tree), ()))


def is_clear(material: bpy.types.Material) -> bool:
    """Whether the material is transparent like glass, not by holes; unlinked nodes count too."""
    return any(
        closure.node.type in CLEAR_NODES
        or (is_principled(closure) and may_be_positive(closure, "Transmission Weight"))
        for closure in _all_nodes(material.node_tree, ())
    )


def is_principled(closure: Closure) -> bool:
    """Whether the closure is a Principled BSDF."""
    return bool(closure.node.type == "BSDF_PRINCIPLED")


def _closures(sockets: Iterable[Any], groups: tuple[Any, ...]) -> Iterator[Closure]:
    """The closures that reach `sockets`, which are inside the group nodes `groups`."""
    nodes = dict.fromkeys(link.from_node for s in sockets for link in closure_links(s))
    for node in nodes:
        if node.type != "GROUP":
            yield Closure(node, 1.0, groups)
        elif node.node_tree and not is_ours(node):
            yield from _closures(group_sockets(node.node_tree), (*groups, node))


def _all_nodes(tree: Any, groups: tuple[Any, ...]) -> Iterator[Closure]:
    """All nodes of a tree, or of None, and of the groups in it, each as a `Closure`."""
    for node in tree.nodes if tree else ():
        if not node.mute:
            yield Closure(node, 1.0, groups)
            if node.type == "GROUP":
                yield from _all_nodes(node.node_tree, (*groups, node))
