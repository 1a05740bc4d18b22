# SPDX-License-Identifier: GPL-3.0-or-later
"""Saves the .blend for the command line. Only a complete file replaces an existing one."""

import os
from pathlib import Path
from typing import Any

import bpy

from .errors import OutputError


def save(path: Path | str) -> None:
    """Save the scene as the .blend at `path`, completely or not at all.

    On a full disk Blender writes a part of the file and reports success. So the file is written
    under another name and checked before it replaces the existing one, of which Blender's number of
    older versions is kept. Raises OutputError; then the existing file is unchanged.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.blend")
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True)
        _require_complete(temporary)
        _keep_version(path)
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise OutputError(
            f"{path} could not be written, and nothing was replaced; free space on its disk, or "
            "choose another --output."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _require_complete(path: Path) -> None:
    """Raise OSError for a .blend that lacks a scene, or that is cut off."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())
    libraries: Any = bpy.data.libraries
    with libraries.load(str(path)) as (saved, _loaded):
        if set(saved.scenes) != {scene.name for scene in bpy.data.scenes if not scene.library}:
            raise OSError(f"{path} is incomplete: a scene is missing")


def _keep_version(path: Path) -> None:
    """Keep the .blend at `path` as .blend1, and older ones as .blend2, …, as Blender does."""
    preferences = bpy.context.preferences
    number = preferences.filepaths.save_version if preferences else 0
    if not path.exists() or not number:
        return
    versions = [path, *(path.with_name(f"{path.name}{n}") for n in range(1, number + 1))]
    for n in range(number - 1, 0, -1):
        if versions[n].exists():
            os.replace(versions[n], versions[n + 1])
    versions[1].unlink(missing_ok=True)
    try:
        os.link(path, versions[1])
    except OSError:  # a disk without links
        os.replace(path, versions[1])
