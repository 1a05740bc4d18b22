# SPDX-License-Identifier: GPL-3.0-or-later
"""Which closures of a node tree reach the surface, as Cycles finds them: through mixes, sums,
reroutes, muted nodes and node groups."""

from ..ours import is_ours
from ..scene.nodes.shaders import Closure, may_be_positive

# Nodes that hand on the closures of others.
PASSING_NODES = {"MIX_SHADER", "ADD_SHADER", "REROUTE", "GROUP_INPUT"}
CLEAR_NODES = {"BSDF_GLASS", "BSDF_REFRACTION"}


def surface_sockets(tree):
    """The sockets Surface of the outputs that render engines use: one, or one for each engine."""
    outputs = dict.fromkeys(tree.get_output_node(engine) for engine in ("CYCLES", "EEVEE"))
    return [output.inputs["Surface"] for output in outputs if output]


def group_sockets(group):
    """The sockets of a node group's output that hand on closures."""
    output = next((n for n in group.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output), None)
    return [socket for socket in output.inputs if socket.type == "SHADER"] if output else []


def closure_links(socket):
    """The links by which closures, and groups that may hold some, come to `socket`.

    Those that reach a group's own inputs are among them: it may hand them on.
    """
    waiting, seen = [socket], set()
    while waiting:
        socket = waiting.pop()
        if socket in seen:  # mixes may share what they mix
            continue
        seen.add(socket)
        below = []
        for link in socket.links:
            # An invalid link closes a circle.
            if link.is_muted or not link.is_valid or link.from_socket.type != "SHADER":
                continue
            node = link.from_node
            if node.mute:
                below += [own.from_socket for own in node.internal_links
                          if own.to_socket == link.from_socket]  # fmt: skip
            else:
                below += node.inputs
                if node.type not in PASSING_NODES:
                    yield link
        waiting += reversed(below)


def surface_closures(material):
    """[Closure] of any type that may reach the surface of a material, or of None."""
    if material is None or material.node_tree is None:
        return []
    return list(_closures(surface_sockets(material.node_tree), ()))


def is_clear(material):
    """Whether one sees through the material, but for holes; also by nodes that are not linked."""
    return any(
        closure.node.type in CLEAR_NODES
        or (is_principled(closure) and may_be_positive(closure, "Transmission Weight"))
        for closure in _nodes(material.node_tree, ())
    )


def is_principled(closure):
    return closure.node.type == "BSDF_PRINCIPLED"


def _closures(sockets, groups):
    """[Closure] that come to `sockets`, which the group nodes `groups` are around."""
    nodes = dict.fromkeys(link.from_node for s in sockets for link in closure_links(s))
    for node in nodes:
        if node.type != "GROUP":
            yield Closure(node, 1.0, groups)
        elif node.node_tree and not is_ours(node):
            yield from _closures(group_sockets(node.node_tree), (*groups, node))


def _nodes(tree, groups):
    """All nodes of a tree, or of None, and of the groups in it, each as a `Closure`."""
    for node in tree.nodes if tree else ():
        if not node.mute:
            yield Closure(node, 1.0, groups)
            if node.type == "GROUP":
                yield from _nodes(node.node_tree, (*groups, node))
