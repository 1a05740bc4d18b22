# SPDX-License-Identifier: GPL-3.0-or-later
"""What ties sources to their light, mended after all that users do to either.

Users delete, copy, append, and undo that, and Blender copies our marks along with what bears them.
`mend` looks at the file as it is now, whatever led there, so it may be called at any time; where
nothing is to be mended it changes nothing.

Undo is why a source whose light was deleted is marked and not forgotten: what changes between two
undo steps is neither kept nor undone by Blender. When the light is back, the source hides again.
"""

import bpy

from .ours import TAG, is_ours, is_overridden
from .output import shading_volumes
from .output.volume import (
    APPENDED,
    IDENTITY,
    RESULT,
    RETURNED,
    forget,
    identify,
    is_lost,
    scene_objects,
)


def mend():
    """Show sources whose light is gone, hide them when it is back, and leave copies to the user.

    A copy of a baked volume is a Volume object like any other from then on; a copy of a source is
    as the source was before its bake. Where both were copied together, they are a pair of their
    own.
    """
    tied = [ob for ob in bpy.data.objects if _is_tied(ob) and ob.is_editable]
    _leave_copies(tied)
    sources = [ob for ob in tied if RESULT in ob]
    scenes = scene_objects() if sources else []
    for source in sources:
        lost = is_lost(source, scenes)
        if lost and is_overridden(source, "hide_render"):
            shading_volumes.show_source(source)
            source[RETURNED] = True
        elif not lost and RETURNED in source:
            del source[RETURNED]
            shading_volumes.hide_source(source)


def mend_appended(objects):
    """`mend`, where `objects` came from another file: their light is on files of that one.

    A baked volume that came without its sources is a Volume object like any other.
    """
    appended = [ob for ob in objects if _is_baked(ob) and ob.is_editable]
    tied = _results(bpy.data.objects)
    for ob in appended:
        if ob in tied:
            ob[APPENDED] = True
        else:
            _leave(ob)
    mend()


def _is_tied(ob):
    return RESULT in ob or _is_baked(ob)


def _is_baked(ob):
    return ob.type == "VOLUME" and is_ours(ob)


def _results(objects):
    """The baked volumes that `objects` point to."""
    return {ob[RESULT] for ob in objects if ob.get(RESULT)}


def _leave_copies(tied):
    """Take our marks off copies of the objects `tied`, unless a source and its light are one."""
    originals, results = {}, _results(tied)
    for ob in sorted(tied, key=lambda ob: ob.session_uid):  # the older ones come first
        identify(ob)  # older files have none
        original = originals.setdefault(ob[IDENTITY], ob)
        if original == ob:
            continue
        if ob in results or ob.get(RESULT) not in (None, original.get(RESULT)):
            identify(ob, anew=True)
        else:
            _leave(ob)


def _leave(copy):
    """The object `copy` is the user's."""
    if RESULT in copy:
        shading_volumes.show_source(copy)
    copy.pop(TAG, None)
    copy.pop(APPENDED, None)
    forget(copy)
