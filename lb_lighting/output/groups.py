# SPDX-License-Identifier: GPL-3.0-or-later
"""What the node groups of LB Lighting share. Code builds each of them once in a file."""

from collections.abc import Callable
from typing import Any

import bpy

from ..ours import TAG, find_ours
from .nodes import Socket, add_math, add_node

MADE, VERSION = "lb_lighting_version", 6  # of the groups; raised when one of them changes

ANY = (0, 3e38)  # any value that is not negative
COSINE = (-1, 1)


def our_group(name: str, build: Callable[[Any], None], kind: str = "ShaderNodeTree") -> Any:
    """Our node group of that name; `build` fills it if the file does not have this version yet."""
    tree: Any = find_ours(bpy.data.node_groups, name)
    if tree is None:
        groups: Any = bpy.data.node_groups
        tree = groups.new(name, kind)
        tree[TAG] = name
    if tree.get(MADE) != VERSION:  # new, or from an earlier version of LB Lighting
        tree.nodes.clear()
        old = list(tree.interface.items_tree)
        for socket in old:
            socket.description = ""
        build(tree)
        for socket in [s for s in old if not s.description]:
            tree.interface.remove(socket)
        tree[MADE] = VERSION
    return tree


def add_seen(tree: Any, x: float, y: float) -> Socket:
    """A socket that is 1 for rays that the eye sees directly, and 0 for all others.

    The eye sees camera rays, and what mirrors and clear surfaces, sharp or rough, make of them.
    Rays that a diffuse surface or a volume scattered on their way do not count, because the lattice
    already contains their light: Ray Depth counts these bounces besides glossy and transmission
    bounces. A translucent surface sends on a diffuse ray. If that meets a mirror afterwards, Cycles
    can no longer tell it from a ray that came through glass.
    """
    path = add_node(tree, "ShaderNodeLightPath", x, y).outputs
    straight = add_math(tree, "MAXIMUM", path["Is Camera Ray"], path["Is Glossy Ray"], x + 200, y)
    bounces = add_math(tree, "SUBTRACT", path["Ray Depth"], path["Glossy Depth"], x + 200, y - 200)
    bounces = add_math(tree, "SUBTRACT", bounces, path["Transmission Depth"], x + 400, y - 200)
    is_direct = add_math(tree, "LESS_THAN", bounces, 0.5, x + 600, y - 200)
    return add_math(tree, "MULTIPLY", straight, is_direct, x + 800, y)
