# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of sources share."""

import bpy

from lb_lighting.scene.medium_choice import FROM_MATERIAL
from lb_lighting.scene.opening import open_sources
from lb_lighting.scene.reader import Reader
from lb_lighting.transport.medium import Domain

DOMAIN = Domain.around((-1, -1, -1), (1, 1, 1), 20)


def read(*objects, medium=FROM_MATERIAL, optical_depth=30.0, grid=""):
    """(sources, notes)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    reader = Reader(depsgraph, medium, optical_depth, grid)
    return open_sources(objects, reader), reader.notes


def share(ob, **choices):
    """The only share of an object."""
    ((source,), _notes) = read(ob, **choices)
    (only,) = source.shares(DOMAIN)
    return only
