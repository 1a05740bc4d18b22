# SPDX-License-Identifier: GPL-3.0-or-later
"""Follows links between shader nodes as Cycles does: muted nodes, reroutes, groups and circles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...ours import is_ours

if TYPE_CHECKING:
    import bpy

# The properties of nodes and sockets depend on their `type`, which the checker cannot follow.
type Node = Any  # bpy.types.Node
type Socket = Any  # bpy.types.NodeSocket or NoValue
type Groups = tuple[Node, ...]  # the group nodes around a node, outermost first
type Place = tuple[Socket, Groups]

GROUPS = {"GROUP", "CUSTOM GROUP"}


class Circle(Exception):  # noqa: N818 - always caught where the material is known
    """A circle of links; `node` is one of the nodes on it."""

    def __init__(self, node: Node) -> None:
        super().__init__(node.name)
        self.node = node


@dataclass(frozen=True)
class NoValue:
    """Stands for an input that Cycles sets to 0, because nothing inside a group feeds it."""

    node: Node
    is_output = False
    type = "VALUE"
    default_value = 0.0


class Links:
    """Follows the links of node trees.

    It looks up the links of each tree once: Blender searches all of them for each socket.
    """

    def __init__(self) -> None:
        self._sources: dict[bpy.types.NodeTree, dict[Socket, Socket]] = {}

    def resolve(self, socket: Socket, groups: Groups = ()) -> Place:
        """(socket, groups) that a value comes from, through links, reroutes and node groups.

        The result is an output, or an unlinked input that holds the value: a bpy socket or
        `NoValue`. A muted node passes on the input that its internal link connects.

        groups  the group nodes around the socket, outermost first

        Raises `Circle` if the links of a tree on the way form a circle.
        """
        holder = NoValue(socket.node), groups  # holds the value if the next link leads nowhere
        while socket is not None:
            node = socket.node
            passes = node.type == "REROUTE" or node.mute
            if not socket.is_output:
                if not passes:
                    holder = socket, groups
                socket = self._source(socket)
            elif passes:
                socket = _passed_on(node, socket)
            elif node.type in GROUPS and is_ours(node):  # passes on what it was inserted behind
                socket = node.inputs[0]
            elif node.type in GROUPS:
                # Enter the group.
                holder = NoValue(node), groups
                socket, groups = _counterpart(_group_outputs(node), socket), (*groups, node)
            elif node.type == "GROUP_INPUT":
                # Leave the group.
                holder = NoValue(node), groups
                socket = _counterpart(groups[-1].inputs if groups else (), socket)
                groups = groups[:-1]
            else:
                return socket, groups
        return holder

    def _source(self, socket: Socket) -> Socket | None:
        """The output that is linked to an input, or None."""
        tree = socket.id_data
        if tree not in self._sources:
            refuse_circle(tree)
            links = [link for link in tree.links if link.is_valid and not link.is_muted]
            self._sources[tree] = {link.to_socket: link.from_socket for link in links}
        return self._sources[tree].get(socket)


def resolve(socket: Socket, groups: Groups = ()) -> Place:
    """As `Links.resolve`, but `NoValue` for a circle of links."""
    try:
        return Links().resolve(socket, groups)
    except Circle as circle:
        return NoValue(circle.node), groups


def active_output(tree: bpy.types.ShaderNodeTree) -> tuple[Node | None, Groups]:
    """(the output node that Cycles renders, the group nodes around it), or (None, ()).

    The output is inside a group only if there is none outside.
    """
    return _active_output(tree, tree.get_output_node("CYCLES"), ())


def refuse_circle(tree: bpy.types.NodeTree | None) -> None:
    """Raise `Circle` if the links of a tree form one: Cycles renders nothing of such a tree."""
    for link in tree.links if tree else ():
        ends: tuple[Socket, Socket] = link.from_socket, link.to_socket
        # Links from a closure to a value, and links of unused sockets, are invalid as well.
        is_shader = [end.type == "SHADER" for end in ends]
        if not link.is_valid and all(end.enabled for end in ends) and is_shader[0] == is_shader[1]:
            raise Circle(link.to_node)


def postorder(start: Place, below: Callable[[Place], list[Place]]) -> dict[Place, list[Place]]:
    """{place: [places right below it]} for `start` and everything below it, in postorder.

    below  returns the places right below a place

    Raises `Circle` if a place is below itself.
    """
    finished: dict[Place, list[Place]] = {}
    pending = {start: below(start)}
    while pending:
        place, children = next(reversed(pending.items()))
        child = next((c for c in children if c not in finished), None)
        if child is None:
            finished[place] = pending.pop(place)
        elif child in pending:
            raise Circle(child[0].node)
        else:
            pending[child] = below(child)
    return finished


def _active_output(
    tree: bpy.types.ShaderNodeTree, output: Node | None, groups: Groups
) -> tuple[Node | None, Groups]:
    """As `active_output`; `output` is the output node right in `tree`, or None."""
    if output is not None:
        return output, groups
    nodes: Iterable[Node] = tree.nodes
    for node in nodes:
        if node.type not in GROUPS or node.mute or node.node_tree is None or is_ours(node):
            continue
        inner = next((n for n in node.node_tree.nodes if _is_output(n)), None)
        output, outer_groups = _active_output(node.node_tree, inner, (*groups, node))
        if output is not None:
            return output, outer_groups
    return None, ()


def _is_output(node: Node) -> bool:
    kinds = {"OUTPUT_MATERIAL", "OUTPUT_WORLD", "OUTPUT_LIGHT"}
    return node.type in kinds and node.is_active_output and node.target in {"ALL", "CYCLES"}


def _passed_on(node: Node, socket: Socket) -> Socket | None:
    """The input that a reroute or a muted node passes on to its output `socket`, or None."""
    if node.type == "REROUTE":
        return node.inputs[0]
    return next((i.from_socket for i in node.internal_links if i.to_socket == socket), None)


def _group_outputs(group: Node) -> Iterable[Socket]:
    """The sockets of the active Group Output inside a group node."""
    nodes = group.node_tree.nodes if group.node_tree else ()
    outputs = [node for node in nodes if node.type == "GROUP_OUTPUT"]
    return next((node.inputs for node in outputs if node.is_active_output), ())


def _counterpart(sockets: Iterable[Socket], socket: Socket) -> Socket | None:
    """The one of `sockets` that is `socket` seen from the other side of a group's boundary."""
    return next((s for s in sockets if s.identifier == socket.identifier), None)
