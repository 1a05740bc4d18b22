# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens when Blender changes, loads or saves a file; see `ties` and `saving`."""

from typing import Any

import bpy

from ..output import saving, ties
from . import running


@running.persistent
def _mend(*_arguments: Any) -> None:
    if not bpy.app.is_job_running("RENDER"):  # the render reads the file in its own thread
        ties.mend()


@running.persistent
def _mend_after_update(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Only changes of collections, in which objects come and go, break ties."""
    if depsgraph.id_type_updated("COLLECTION"):
        _mend()


@running.persistent
def _mend_appended(context: Any) -> None:
    appended = {item.id for item in context.import_items if item.append_action != "LINK"}
    ties.mend_appended([ob for ob in bpy.data.objects if ob in appended])


@running.persistent
def _before_save(path: str, _none: Any) -> None:
    _mend()
    for note in saving.before_save(path):
        running.add_line(note)


@running.persistent
def _after_save(path: str, _none: Any) -> None:
    saving.after_save(path)


@running.persistent
def _after_failed_save(_path: str, _none: Any) -> None:
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


def register() -> None:
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
