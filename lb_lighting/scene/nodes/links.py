# SPDX-License-Identifier: GPL-3.0-or-later
"""Following links in shader nodes, as Cycles does: mutes, reroutes, groups and circles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...ours import is_ours

if TYPE_CHECKING:
    import bpy

# What nodes and sockets have depends on their `type`, by which the checker cannot tell them apart.
type Node = Any  # bpy.types.Node
type Socket = Any  # bpy.types.NodeSocket or Nothing
type Groups = tuple[Node, ...]  # the group nodes around a node, outermost first
type Place = tuple[Socket, Groups]

GROUPS = {"GROUP", "CUSTOM GROUP"}


class Circle(Exception):  # noqa: N818 - it is caught where the material's name is known
    """Links that lead back to where they come from; `node` is one of the nodes on their way."""

    def __init__(self, node: Node) -> None:
        super().__init__(node.name)
        self.node = node


@dataclass(frozen=True)
class Nothing:
    """Stands in for an input that Cycles takes for 0: nothing inside of a group feeds it."""

    node: Node
    is_output = False
    type = "VALUE"
    default_value = 0.0


class Links:
    """Follows the links of node trees.

    Each tree's are looked up once, for Blender goes through all of them to find those of a socket.
    """

    def __init__(self) -> None:
        self._sources: dict[bpy.types.NodeTree, dict[Socket, Socket]] = {}

    def resolve(self, socket: Socket, groups: Groups = ()) -> Place:
        """(socket, groups): where a value comes from, through links, reroutes and node groups.

        It is an output of a node, or an input that nothing is linked to and that holds the value:
        then a bpy socket, or `Nothing`. A muted node hands on what its internal link brings to it.
        groups  the group nodes around the socket, outermost first

        Raises `Circle` for a tree on the way whose links form one.
        """
        holder = Nothing(socket.node), groups  # what has the value, where no link brings another
        while socket is not None:
            node = socket.node
            passes = node.type == "REROUTE" or node.mute
            if not socket.is_output:
                if not passes:
                    holder = socket, groups
                socket = self._source(socket)
            elif passes:
                socket = _before(node, socket)
            elif node.type in GROUPS and is_ours(node):  # what it was put in front of, or behind
                socket = node.inputs[0]
            elif node.type in GROUPS:
                holder = Nothing(node), groups
                socket, groups = _twin(_inside(node), socket), (*groups, node)
            elif node.type == "GROUP_INPUT":
                holder = Nothing(node), groups
                socket, groups = _twin(groups[-1].inputs if groups else (), socket), groups[:-1]
            else:
                return socket, groups
        return holder

    def _source(self, socket: Socket) -> Socket | None:
        """The socket that a link brings to an input, or None."""
        tree = socket.id_data
        if tree not in self._sources:
            refuse_circle(tree)
            links = [link for link in tree.links if link.is_valid and not link.is_muted]
            self._sources[tree] = {link.to_socket: link.from_socket for link in links}
        return self._sources[tree].get(socket)


def resolve(socket: Socket, groups: Groups = ()) -> Place:
    """What `Links.resolve` returns; of a circle of links, `Nothing`."""
    try:
        return Links().resolve(socket, groups)
    except Circle as circle:
        return Nothing(circle.node), groups


def active_output(tree: bpy.types.ShaderNodeTree) -> tuple[Node | None, Groups]:
    """(output node that Cycles renders, group nodes around it), or (None, ()).

    It is in a group where there is none outside of groups.
    """
    return _active_output(tree, tree.get_output_node("CYCLES"), ())


def refuse_circle(tree: bpy.types.NodeTree | None) -> None:
    """Raise `Circle` for a tree whose links form one: Cycles renders nothing of it."""
    for link in tree.links if tree else ():
        ends: tuple[Socket, Socket] = link.from_socket, link.to_socket
        # A link of a closure to a value, or of a socket that is not in use, is invalid, too.
        is_shader = [end.type == "SHADER" for end in ends]
        if not link.is_valid and all(end.enabled for end in ends) and is_shader[0] == is_shader[1]:
            raise Circle(link.to_node)


def postorder(start: Place, below: Callable[[Place], list[Place]]) -> dict[Place, list[Place]]:
    """{key: [keys right below it]}: `start` and all below it, once, each after what is below it.

    below  function that takes a key, (socket, groups), and returns the list of those below it

    Raises `Circle` where one is below itself.
    """
    done: dict[Place, list[Place]] = {}
    under_way = {start: below(start)}
    while under_way:
        key, keys = next(reversed(under_way.items()))
        following = next((k for k in keys if k not in done), None)
        if following is None:
            done[key] = under_way.pop(key)
        elif following in under_way:
            raise Circle(following[0].node)
        else:
            under_way[following] = below(following)
    return done


def _active_output(
    tree: bpy.types.ShaderNodeTree, found: Node | None, groups: Groups
) -> tuple[Node | None, Groups]:
    if found is not None:
        return found, groups
    nodes: Iterable[Node] = tree.nodes
    for node in nodes:
        if node.type not in GROUPS or node.mute or node.node_tree is None or is_ours(node):
            continue
        inside = next((n for n in node.node_tree.nodes if _is_output(n)), None)
        found, around = _active_output(node.node_tree, inside, (*groups, node))
        if found is not None:
            return found, around
    return None, ()


def _is_output(node: Node) -> bool:
    kinds = {"OUTPUT_MATERIAL", "OUTPUT_WORLD", "OUTPUT_LIGHT"}
    return node.type in kinds and node.is_active_output and node.target in {"ALL", "CYCLES"}


def _before(node: Node, socket: Socket) -> Socket | None:
    """The input whose value a reroute or a muted node hands on to its output, or None."""
    if node.type == "REROUTE":
        return node.inputs[0]
    return next((i.from_socket for i in node.internal_links if i.to_socket == socket), None)


def _inside(group: Node) -> Iterable[Socket]:
    """The sockets of the Group Output that is in use inside of a group node."""
    nodes = group.node_tree.nodes if group.node_tree else ()
    outputs = [node for node in nodes if node.type == "GROUP_OUTPUT"]
    return next((node.inputs for node in outputs if node.is_active_output), ())


def _twin(sockets: Iterable[Socket], socket: Socket) -> Socket | None:
    """The one of `sockets` that stands for `socket` on the other side of a group's wall."""
    return next((s for s in sockets if s.identifier == socket.identifier), None)
