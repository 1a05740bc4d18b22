# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of bakes share."""

import bpy

from lb_lighting.output.volume import baked_volumes
from tests import scenery


def baked():
    """The one baked Volume object of the scene."""
    (ob,) = baked_volumes(bpy.context.scene)
    return ob


def shader(ob):
    """The inputs of the node group that shows a baked volume."""
    nodes = ob.active_material.node_tree.nodes
    return next(node for node in nodes if node.type == "GROUP").inputs


def fog(folder):
    return [scenery.add_fog(folder)]
