# SPDX-License-Identifier: GPL-3.0-or-later
"""What is done whenever Blender changes, loads or saves a file; see `ties` and `saving`."""

import bpy
from bpy.app.handlers import persistent

from ..output import saving, ties
from . import running


@persistent
def _mend(*_arguments):
    if not bpy.app.is_job_running("RENDER"):  # which reads the file in a thread of its own
        ties.mend()


@persistent
def _mend_after_update(_scene, depsgraph):
    """Objects come and go in collections; what else changes, and often, breaks no tie."""
    if depsgraph.id_type_updated("COLLECTION"):
        _mend()


@persistent
def _mend_appended(context):
    appended = {item.id for item in context.import_items if item.append_action != "LINK"}
    ties.mend_appended([ob for ob in bpy.data.objects if ob in appended])


@persistent
def _before_save(path, _none):
    _mend()
    for note in saving.before_save(path):
        running.tell(note)


@persistent
def _after_save(path, _none):
    saving.after_save(path)


@persistent
def _after_failed_save(_path, _none):
    saving.restore_paths()


_HANDLERS = {
    "depsgraph_update_post": _mend_after_update,
    "undo_post": _mend,
    "redo_post": _mend,
    "load_post": _mend,
    "blend_import_post": _mend_appended,
    "save_pre": _before_save,
    "save_post": _after_save,
    "save_post_fail": _after_failed_save,
}


def register():
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)


def unregister():
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
