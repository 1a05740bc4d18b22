# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks on data-blocks: what LB Lighting made, and which of the user's settings it must restore."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import bpy

TAG = "lb_lighting_made"
KEPT = "lb_lighting_kept"


def has_mark(block: bpy.types.bpy_struct, mark: str) -> bool:
    """True if `block` has the custom property `mark`, even one that points to nothing."""
    properties: Any = block  # the type stubs do not know `in`
    return mark in properties


def is_ours(block: bpy.types.bpy_struct) -> bool:
    """True if LB Lighting made `block`, a data-block or a node."""
    return has_mark(block, TAG)


def find_ours[Block: bpy.types.ID](blocks: Iterable[Block], tag: str) -> Block | None:
    """The local data-block in `blocks` that carries `tag`, or None."""
    return next((b for b in blocks if b.get(TAG) == tag and b.library is None), None)


def override(block: bpy.types.ID, path: str, value: object) -> None:
    """Set the property at the RNA `path` of `block`, and keep the user's value for `give_back`."""
    kept = block[KEPT].to_dict() if has_mark(block, KEPT) else {}
    # A second bake must not mistake our value for the user's.
    kept.setdefault(path, block.path_resolve(path))
    block[KEPT] = kept
    _set(block, path, value)


def is_overridden(block: bpy.types.ID, path: str) -> bool:
    """True while `override` holds the property at the RNA `path` of `block`."""
    return has_mark(block, KEPT) and path in block[KEPT]


def give_back(block: bpy.types.ID) -> None:
    """Restore the user's value of every property that `override` changed."""
    if not has_mark(block, KEPT):
        return
    for path, value in block[KEPT].to_dict().items():
        _set(block, path, value)
    del block[KEPT]


def _set(block: bpy.types.ID, path: str, value: object) -> None:
    owner, _, name = path.rpartition(".")
    setattr(block.path_resolve(owner) if owner else block, name, value)
