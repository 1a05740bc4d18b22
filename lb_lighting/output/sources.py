# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources and their light: which baked volume shows the light of an object, and how it hides it."""

import uuid

import bpy

from ..ours import give_back, has_mark, override

RESULT = "lb_lighting_result"  # on a source: the baked Volume object that shows its light
IDENTITY = "lb_lighting_identity"  # on both: a unique text, by which copies are recognized
RETURNED = "lb_lighting_returned"  # on a source: shown again while its light is in no scene


def tie(source: bpy.types.Object, baked: bpy.types.Object) -> None:
    """Record that the Volume object `baked` shows the light of the object `source`."""
    source[RESULT] = baked
    identify(source)


def identify(ob: bpy.types.Object, anew: bool = False) -> None:
    """Give a source or a baked volume an identity if it has none, or a new one if `anew`."""
    if anew or not has_mark(ob, IDENTITY):
        ob[IDENTITY] = uuid.uuid4().hex


def forget(source: bpy.types.Object) -> None:
    """Remove the record of its light from the object `source`."""
    for mark in (RESULT, IDENTITY, RETURNED):
        source.pop(mark, None)


def is_source(ob: bpy.types.Object) -> bool:
    """True for an object that was lit, even if its light has been removed since."""
    return has_mark(ob, RESULT)


def hide_source(ob: bpy.types.Object) -> None:
    """Hide an object that a baked volume replaces, in the viewport and in renders."""
    override(ob, "hide_viewport", True)
    override(ob, "hide_render", True)


def show_source(ob: bpy.types.Object) -> None:
    """Restore the visibility that the object had before `hide_source`."""
    give_back(ob)


def sources_shown_by(scene: bpy.types.Scene, baked: bpy.types.Object) -> list[bpy.types.Object]:
    """The objects in `scene` whose light the Volume object `baked` shows."""
    return [ob for ob in scene.objects if ob.get(RESULT) == baked]


def lost_sources(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects in `scene` that were lit, and whose light has been removed since."""
    scenes = scene_objects()
    return [ob for ob in scene.objects if is_source(ob) and is_lost(ob, scenes)]


def scene_objects() -> list[set[bpy.types.Object]]:
    """The objects of each scene of the file."""
    return [set(scene.objects) for scene in bpy.data.scenes]


def is_lost(source: bpy.types.Object, scenes: list[set[bpy.types.Object]]) -> bool:
    """True for a source that is in one of `scenes`, but in none together with its baked volume.

    scenes  as `scene_objects` returns them
    Blender keeps a deleted object in the file as long as a source points to it.
    """
    its_scenes = [objects for objects in scenes if source in objects]
    return bool(its_scenes) and not any(source[RESULT] in objects for objects in its_scenes)
