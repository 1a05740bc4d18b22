# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of ours on node inputs: values that differ from frame to frame."""

import bpy
import numpy as np

from ..ours import TAG, is_ours

GROUP = "LB Lighting"  # of the F-curves; others are the user's


def set_values(tree, socket, values):
    """Give the input `socket` of a node in `tree` its value in each frame: {frame: value}.

    Keys are set where values differ, and hold until the next one.
    """
    frames = sorted(values)
    table = np.array([np.atleast_1d(values[frame]) for frame in frames], float)
    socket.default_value = values[frames[-1]]
    path = socket.path_from_id("default_value")
    for index, column in enumerate(table.T):
        if np.ptp(column):
            _key(tree, path, index, frames, column)


def remove_keys(tree):
    """Take all our keys out of `tree`, and the action that holds them where it has no others."""
    action = tree.animation_data and tree.animation_data.action
    if not action:
        return
    bags = _bags(action)
    for bag in bags:
        for curve in [c for c in bag.fcurves if c.group and c.group.name == GROUP]:
            bag.fcurves.remove(curve)
    if is_ours(action) and not any(len(bag.fcurves) for bag in bags):
        tree.animation_data.action = None
        bpy.data.actions.remove(action)


def are_keyed(block, *paths):
    """Whether there are keys on any of the properties `paths` of a data-block."""
    action = block.animation_data and block.animation_data.action
    curves = (curve for bag in _bags(action) for curve in bag.fcurves) if action else ()
    return any(curve.data_path in paths for curve in curves)


def _bags(action):
    """Those that hold the F-curves of `action`."""
    return [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]


def _key(tree, path, index, frames, values):
    action = _action(tree)
    curve = action.fcurve_ensure_for_datablock(tree, path, index=index, group_name=GROUP)
    points = curve.keyframe_points
    points.add(len(frames))
    points.foreach_set("co", np.stack([frames, values], axis=1).ravel())
    for point in points:
        point.interpolation = "CONSTANT"
    curve.update()


def _action(tree):
    """That of `tree`, made where it has none."""
    data = tree.animation_data_create()
    if data.action is None:
        data.action = bpy.data.actions.new(f"{tree.id_data.name} Light")
        data.action[TAG] = GROUP
    return data.action
