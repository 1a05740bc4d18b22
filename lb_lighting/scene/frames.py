# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene at one of its frames, with what a bake hid evaluated as if it were shown."""

from contextlib import contextmanager


@contextmanager
def at_frame(context, objects, frame=None, unread=()):
    """Inside, the scene is at `frame`, or at the current one where that is None, and `objects` are
    shown. Yields the frame.

    unread  Volume objects whose files are not to be read there

    Blender evaluates objects only while they are shown, and their keys only where a frame is set
    then. None is set without need, for that takes back what the user changed and did not key.
    """
    scene = context.scene
    current = scene.frame_current, scene.frame_subframe
    number, subframe = current if frame is None else (frame, 0.0)
    hidden = [ob for ob in objects if ob.hide_viewport]
    files = {ob.data: ob.data.filepath for ob in unread}
    for ob in hidden:
        ob.hide_viewport = False
    for data in files:
        data.filepath = ""
    try:
        if frame is not None or any(map(is_animated, hidden)):
            scene.frame_set(number, subframe=subframe)
        elif hidden:
            context.view_layer.update()
        yield number
    finally:
        for ob in hidden:
            ob.hide_viewport = True
        for data, path in files.items():
            data.filepath = path
        if frame is not None:
            scene.frame_set(current[0], subframe=current[1])
        elif hidden:
            context.view_layer.update()


def is_animated(ob):
    """Whether keys or drivers may change an object from frame to frame, or what moves it."""
    return any(block.animation_data for block in _blocks(ob, set()))


def _blocks(ob, seen):
    """The data-blocks that say where an object is, and what."""
    seen.add(ob)
    yield ob
    trees = [getattr(modifier, "node_group", None) for modifier in ob.modifiers]
    for slot in ob.material_slots:
        trees += [slot.material, slot.material and slot.material.node_tree]
    for block in (ob.data, getattr(ob.data, "shape_keys", None), *trees):
        if hasattr(block, "animation_data"):
            yield block
    instanced = ob.instance_collection.all_objects if ob.instance_collection else ()
    for other in (ob.parent, *instanced, *(getattr(c, "target", None) for c in ob.constraints)):
        if other is not None and other not in seen:
            yield from _blocks(other, seen)
