# SPDX-License-Identifier: GPL-3.0-or-later
"""Repairs the ties between sources and their light after the user changed either.

Users delete, copy and append objects, and undo all that; Blender copies our marks along with the
objects. `mend` reads the file as it is now, however it got there, so it can be called at any time.
It changes nothing where nothing is wrong.

A source whose light was deleted is marked, not forgotten, because of undo: Blender neither keeps
nor undoes what changes between two undo steps. When the light is back, the source is hidden again.
"""

from collections.abc import Iterable

import bpy

from ..ours import TAG, has_mark, is_overridden
from .sources import (
    IDENTITY,
    RESULT,
    RETURNED,
    forget,
    hide_source,
    identify,
    is_lost,
    is_source,
    scene_objects,
    show_source,
)
from .volume import APPENDED, is_baked


def mend() -> None:
    """Show sources whose light is gone, hide them when it is back, and leave copies to the user.

    A copy of a baked volume becomes a Volume object like any other; a copy of a source becomes what
    the source was before its bake. If both were copied together, they become a pair of their own.
    """
    tied = [ob for ob in bpy.data.objects if _is_tied(ob) and ob.is_editable]
    _leave_copies(tied)
    sources = [ob for ob in tied if is_source(ob)]
    scenes = scene_objects() if sources else []
    for source in sources:
        lost = is_lost(source, scenes)
        if lost and is_overridden(source, "hide_render"):
            show_source(source)
            source[RETURNED] = True
        elif not lost and has_mark(source, RETURNED):
            del source[RETURNED]
            hide_source(source)


def mend_appended(objects: Iterable[bpy.types.Object]) -> None:
    """`mend` after `objects` were appended: the files of their light belong to another .blend.

    A baked volume that came without its sources becomes a Volume object like any other.
    """
    appended = [ob for ob in objects if is_baked(ob) and ob.is_editable]
    tied = _results(bpy.data.objects)
    for ob in appended:
        if ob in tied:
            ob[APPENDED] = True
        else:
            _leave(ob)
    mend()


def _is_tied(ob: bpy.types.Object) -> bool:
    return is_source(ob) or is_baked(ob)


def _results(objects: Iterable[bpy.types.Object]) -> set[bpy.types.Object]:
    """The baked volumes that `objects` point to."""
    return {ob[RESULT] for ob in objects if ob.get(RESULT)}


def _leave_copies(tied: list[bpy.types.Object]) -> None:
    """Remove our marks from copies of the objects `tied`, except where a source and its light were
    copied together."""
    originals: dict[str, bpy.types.Object] = {}
    results = _results(tied)
    for ob in sorted(tied, key=lambda ob: ob.session_uid):  # originals before their copies
        identify(ob)  # files of older versions lack identities
        original = originals.setdefault(ob[IDENTITY], ob)
        if original == ob:
            continue
        if ob in results or ob.get(RESULT) not in (None, original.get(RESULT)):
            identify(ob, anew=True)
        else:
            _leave(ob)


def _leave(copy: bpy.types.Object) -> None:
    """Make the object `copy` the user's: remove our marks, and show it."""
    if is_source(copy):
        show_source(copy)
    copy.pop(TAG, None)
    copy.pop(APPENDED, None)
    forget(copy)
