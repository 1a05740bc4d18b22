# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a scene and of its objects as Blender properties, which the .blend keeps."""

import functools
from collections.abc import Callable
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .. import job
from ..errors import LightingError
from ..options import OPTIONS, OVERWRITE, ROLE, Option

_PROPERTIES: dict[type, Callable[..., Any]] = {
    bool: BoolProperty,
    int: IntProperty,
    float: FloatProperty,
    str: StringProperty,
    tuple: FloatVectorProperty,
}


@functools.cache
def _device_labels() -> list[str]:
    return [line.rsplit(": ", 1)[0] for line in job.device_lines()]


def _search_devices(_properties: Any, _context: bpy.types.Context | None, text: str) -> list[str]:
    try:
        return [label for label in _device_labels() if text.casefold() in label.casefold()]
    except LightingError:  # the text field must work without a working driver
        return []


# What only Blender needs to know of an option.
_DETAILS: dict[str, dict[str, Any]] = {
    "device": {"search": _search_devices, "search_options": {"SUGGESTION"}},
    "folder": {"subtype": "DIR_PATH", "options": {"ANIMATABLE", "PATH_SUPPORTS_BLEND_RELATIVE"}},
}


def _property(option: Option) -> Any:
    """The Blender property of an option."""
    details: dict[str, Any] = {"name": option.label, "description": option.description}
    if option.name == "domain":
        return PointerProperty(**details, type=bpy.types.Object)
    if option.choices:
        items = [(*choice,) for choice in option.choices]
        return EnumProperty(**details, items=items, default=option.default)
    limits = {
        "min": option.lowest,
        "max": option.highest,
        "soft_min": option.usual[0],
        "soft_max": option.usual[1],
        "precision": option.digits,
    }
    details |= {name: limit for name, limit in limits.items() if limit is not None}
    details |= _DETAILS.get(option.name, {})
    return _PROPERTIES[type(option.default)](default=option.default, **details)


class SceneProperties(bpy.types.PropertyGroup):
    __annotations__ = {option.name: _property(option) for option in (*OPTIONS, OVERWRITE)}


class ObjectProperties(bpy.types.PropertyGroup):
    __annotations__ = {ROLE.name: _property(ROLE)}


_OWNERS: tuple[tuple[Any, Any], ...] = (
    (SceneProperties, bpy.types.Scene),
    (ObjectProperties, bpy.types.Object),
)


def register() -> None:
    for group, owner in _OWNERS:
        bpy.utils.register_class(group)
        owner.lb_lighting = PointerProperty(type=group)


def unregister() -> None:
    for group, owner in _OWNERS:
        del owner.lb_lighting
        bpy.utils.unregister_class(group)
