# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects renders show, and where those are that viewports do not."""

import bpy

from .frames import is_animated


def rendered_objects(layer):
    """{original object: None}, in order, of all in a layer collection that renders show."""
    if layer.collection.hide_render:
        return {}
    shown = [] if layer.exclude else [ob for ob in layer.collection.objects if not ob.hide_render]
    found = dict.fromkeys(shown)
    for child in layer.children:
        found |= rendered_objects(child)
    return found


def world_matrix(ob, depsgraph):
    """The world matrix of `ob` at the current frame, whether viewports show it or not."""
    evaluated = ob.evaluated_get(depsgraph)
    if evaluated.is_evaluated:
        return evaluated.matrix_world.copy()
    # Blender places nothing that is hidden; a copy that is shown for a moment tells where it is.
    twin = ob.copy()
    twin.hide_viewport = False
    scene = depsgraph.scene
    scene.collection.objects.link(twin)
    if is_animated(ob):  # keys count only where a frame is set
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    depsgraph.update()
    matrix = twin.evaluated_get(depsgraph).matrix_world.copy()
    bpy.data.objects.remove(twin)
    depsgraph.update()
    return matrix
