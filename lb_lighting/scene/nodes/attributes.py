# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of objects and view layers, which are constants to a shader."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import bpy

type Rgba = tuple[float, ...]  # (4,)
type Attributes = Callable[[str, str], Rgba]  # takes an attribute's type and name

MISSING = (0.0, 0.0, 0.0, 0.0)


def object_attributes(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Attributes:
    """A function that returns what an Attribute node reads from the original object `ob`.

    It takes the node's attribute_type ("OBJECT", "INSTANCER" or "VIEW_LAYER") and name, and returns
    red, green, blue and alpha. Like Cycles, it looks up custom properties first, then Blender's
    properties by their path.
    """
    evaluated = ob.evaluated_get(depsgraph)
    scene = depsgraph.scene_eval
    assert scene
    layer_blocks = depsgraph.view_layer_eval, scene, scene.world

    def look_up(kind: str, name: str) -> Rgba:
        object_blocks = evaluated, evaluated.data
        blocks = layer_blocks if kind == "VIEW_LAYER" else object_blocks
        colors = (_read(block, name) for block in blocks if block is not None)
        return next((rgba for rgba in colors if rgba is not None), MISSING)

    return look_up


def _read(block: bpy.types.bpy_struct, name: str) -> Rgba | None:
    """(4,) for the property `name` of a data-block, or None if it has no such number or colour."""
    if name in block.keys():  # noqa: SIM118 - a data-block is not a dictionary
        return _rgba(block[name])
    # Cycles does not read single elements of an array.
    if name.endswith("]") and not name.endswith(('"]', "']")):
        return None
    try:
        return _rgba(block.path_resolve(name))
    except ValueError:
        return None


def _rgba(value: Any) -> Rgba | None:
    # Blender's arrays, vectors and colours have no base class in common.
    is_array = hasattr(value, "__len__") and not isinstance(value, str)
    numbers = list(value) if is_array else [value]
    if not 1 <= len(numbers) <= 4 or not all(isinstance(n, (bool, int, float)) for n in numbers):
        return None
    if len(numbers) == 1:
        numbers *= 3
    return tuple(np.array([*numbers, *MISSING[len(numbers) : 3], 1.0][:4], float))
