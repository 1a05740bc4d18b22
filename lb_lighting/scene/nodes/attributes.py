# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of objects and view layers, which shaders read as constants."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import bpy

type Rgba = tuple[float, ...]  # (4,)
type Attributes = Callable[[str, str], Rgba]  # of the type and the name of an attribute

MISSING = (0.0, 0.0, 0.0, 0.0)


def object_attributes(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Attributes:
    """The function that finds what an Attribute node reads for the original object `ob`.

    It takes the node's attribute_type ("OBJECT", "INSTANCER" or "VIEW_LAYER") and name, and returns
    red, green, blue, alpha as Cycles finds them: from custom properties, or else from Blender's own
    by their path.
    """
    evaluated = ob.evaluated_get(depsgraph)
    scene = depsgraph.scene_eval
    assert scene
    places: dict[str, tuple[bpy.types.bpy_struct | None, ...]] = {
        "VIEW_LAYER": (depsgraph.view_layer_eval, scene, scene.world)
    }

    def find(kind: str, name: str) -> Rgba:
        blocks = places.get(kind, (evaluated, evaluated.data))
        found = (_read(block, name) for block in blocks if block is not None)
        return next((rgba for rgba in found if rgba is not None), MISSING)

    return find


def _read(block: bpy.types.bpy_struct, name: str) -> Rgba | None:
    """(4,) of the property `name` of a data-block, or None where it has no such number."""
    if name in block.keys():  # noqa: SIM118 - a data-block is no dictionary
        return _rgba(block[name])
    # Cycles does not look into the elements of an array.
    if name.endswith("]") and not name.endswith(('"]', "']")):
        return None
    try:
        return _rgba(block.path_resolve(name))
    except ValueError:
        return None


def _rgba(value: Any) -> Rgba | None:
    numbers = list(value) if hasattr(value, "__len__") and not isinstance(value, str) else [value]
    if not 1 <= len(numbers) <= 4 or not all(isinstance(n, (bool, int, float)) for n in numbers):
        return None
    if len(numbers) == 1:
        numbers *= 3
    return tuple(np.array([*numbers, *MISSING[len(numbers) : 3], 1.0][:4], float))
