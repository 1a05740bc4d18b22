# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects that renders show, and the places of those that viewports hide."""

from typing import Any

import bpy
from mathutils import Matrix

from .frames import is_animated


def rendered_objects(layer: Any) -> dict[bpy.types.Object, None]:
    """{original object: None}, in order: all objects in a layer collection that renders show."""
    if layer.collection.hide_render:
        return {}
    shown = [] if layer.exclude else [ob for ob in layer.collection.objects if not ob.hide_render]
    objects: dict[bpy.types.Object, None] = dict.fromkeys(shown)
    for child in layer.children:
        objects |= rendered_objects(child)
    return objects


def world_matrix(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Matrix:
    """The world matrix of `ob` at the current frame, whether viewports show it or not."""
    evaluated = ob.evaluated_get(depsgraph)
    if evaluated.is_evaluated:
        return evaluated.matrix_world.copy()
    # Blender does not evaluate hidden objects, so show a copy for a moment to get its place.
    twin = ob.copy()
    twin.hide_viewport = False
    scene: Any = depsgraph.scene
    scene.collection.objects.link(twin)
    if is_animated(ob):  # keys are evaluated only when a frame is set
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    depsgraph.update()
    matrix = twin.evaluated_get(depsgraph).matrix_world.copy()
    bpy.data.objects.remove(twin)
    depsgraph.update()
    return matrix
