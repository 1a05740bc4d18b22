# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyframes on node inputs whose values differ from frame to frame."""

from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np

from ..arrays import Floats
from ..ours import TAG, is_ours

GROUP = "LB Lighting"  # of our F-curves; others are the user's


def set_values(
    tree: bpy.types.NodeTree, socket: Any, values: Mapping[int, float | Sequence[float]]
) -> None:
    """Give the input `socket` of a node in `tree` its value in each frame.

    values  {frame: value}; it gets keyframes where they differ, each of which holds until the next
    """
    frames = sorted(values)
    table = np.array([np.atleast_1d(values[frame]) for frame in frames], float)
    socket.default_value = values[frames[-1]]
    path = socket.path_from_id("default_value")
    for index, column in enumerate(table.T):
        if np.ptp(column):
            _insert_keyframes(tree, path, index, frames, column)


def remove_keys(tree: bpy.types.NodeTree) -> None:
    """Remove all our keyframes from `tree`, and our action if it has no others."""
    animation = tree.animation_data
    action = animation and animation.action
    if not animation or not action:
        return
    bags = _channelbags(action)
    for bag in bags:
        for curve in [c for c in bag.fcurves if c.group and c.group.name == GROUP]:
            bag.fcurves.remove(curve)
    if is_ours(action) and not any(len(bag.fcurves) for bag in bags):
        animation.action = None
        bpy.data.actions.remove(action)


def are_keyed(block: Any, *paths: str) -> bool:
    """Whether any of the properties `paths` of a data-block has keyframes."""
    action = block.animation_data and block.animation_data.action
    curves = (curve for bag in _channelbags(action) for curve in bag.fcurves) if action else ()
    return any(curve.data_path in paths for curve in curves)


def _channelbags(action: bpy.types.Action) -> list[Any]:
    """The channel bags that hold the F-curves of `action`."""
    strips: list[Any] = [strip for layer in action.layers for strip in layer.strips]
    return [bag for strip in strips for bag in strip.channelbags]


def _insert_keyframes(
    tree: bpy.types.NodeTree, path: str, index: int, frames: list[int], values: Floats
) -> None:
    curve = _action(tree).fcurve_ensure_for_datablock(tree, path, index=index, group_name=GROUP)
    points = curve.keyframe_points
    points.add(len(frames))
    points.foreach_set("co", np.stack([frames, values], axis=1).ravel())
    for point in points:
        point.interpolation = "CONSTANT"
    curve.update()


def _action(tree: Any) -> Any:
    """The action of `tree`, a new one of ours if it has none."""
    animation = tree.animation_data_create()
    if animation.action is None:
        animation.action = bpy.data.actions.new(f"{tree.id_data.name} Light")
        animation.action[TAG] = GROUP
    return animation.action
