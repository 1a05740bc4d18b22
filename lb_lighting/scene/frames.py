# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene at a frame, with the objects that a bake hid evaluated as if they were shown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import bpy


@contextmanager
def at_frame(
    context: bpy.types.Context,
    objects: Iterable[bpy.types.Object],
    frame: int | None = None,
    unread: Sequence[Any] = (),
) -> Iterator[int]:
    """Inside, the scene is at `frame`, or at the current frame for None, and shows `objects`.
    Yields the frame.

    unread  Volume objects whose files must not be read

    Blender evaluates objects only while they are shown, and their keys only when a frame is set.
    The frame is set only if necessary, because that resets changes that the user has not keyed.
    """
    scene: Any = context.scene
    view_layer: Any = context.view_layer
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
            view_layer.update()
        yield number
    finally:
        for ob in hidden:
            ob.hide_viewport = True
        for data, path in files.items():
            data.filepath = path
        if frame is not None:
            scene.frame_set(current[0], subframe=current[1])
        elif hidden:
            view_layer.update()


def is_animated(ob: bpy.types.Object) -> bool:
    """Whether keys or drivers may change an object, or anything that moves it."""
    return any(block.animation_data for block in _blocks(ob, set()))


def _blocks(ob: Any, seen: set[Any]) -> Iterator[Any]:
    """Yields the data-blocks that an object and its place depend on."""
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
