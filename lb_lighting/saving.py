# SPDX-License-Identifier: GPL-3.0-or-later
"""What is saved is whole: light of a file that was not saved before comes along beside it, and the
command line replaces a .blend only by one that can be read."""

import os
from pathlib import Path

import bpy

from .errors import OutputError
from .output.vdb import link_or_copy
from .output.volume import (
    Frames,
    stored_path,
    unsaved_folder,
    volume_path,
)

EXTENSION_FOLDER = "baked"  # in the extension's own: where earlier versions kept unsaved light

_before = {}  # {session_uid of a Volume datablock: its path before the save that is under way}


def bring_along(target):
    """Before the file is saved at `target`: bring light beside it that lies in no place of its own.

    The volumes show it from there on. What was there stays too, for undo and for files that
    Blender saves by itself; where the disk can, both are one file with two names.
    Returns [sentence] about what could not be brought, and is shown from where it was.
    """
    _before.clear()
    if not target:  # Blender's startup file
        return []
    folder, notes = Path(target).parent, []
    for volume in bpy.data.volumes:
        path = volume_path(volume)
        home = next((home for home in _homes() if home in path.parents), None)
        if home is None or not volume.is_editable:
            continue
        within = path.relative_to(home)
        try:
            if not _copy_all(home / within.parts[0], folder / within.parts[0]):
                continue
        except OSError:
            notes.append(
                f"{path} could not be copied beside the .blend and stays where it is; "
                "free space on the disk and save again."
            )
            continue
        _before[volume.session_uid] = volume.filepath
        volume.filepath = _path_in(folder, within)
    return notes


def settle(target):
    """After the file was saved at `target`: paths are relative to it, unless it was a copy."""
    if bpy.data.filepath != target:
        take_back()
        return
    for volume in _brought():
        volume.filepath = stored_path(volume_path(volume))
    _before.clear()


def take_back():
    """Nothing was saved, or a copy: the volumes show what they showed before `bring_along`."""
    for volume in _brought():
        volume.filepath = _before[volume.session_uid]
    _before.clear()


def save(path):
    """Save the scene as the .blend at `path`, whole or not at all.

    On a full disk Blender writes a part of the file, and takes it for the whole. So it is written
    aside, and read, before it replaces the one that is there, which Blender's number of older
    versions is kept of. Raises OutputError; then the file there is as it was.
    """
    path = Path(path)
    aside = path.with_name(f".{path.stem}.{os.getpid()}.blend")
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(aside), copy=True)
        _require_whole(aside)
        _keep_version(path)
        os.replace(aside, path)
    except (OSError, RuntimeError) as error:
        raise OutputError(
            f"{path} could not be written, and nothing was replaced; free space on its disk, or "
            "choose another --output."
        ) from error
    finally:
        aside.unlink(missing_ok=True)


def _homes():
    """The folders for results of files that were not saved yet."""
    homes = [unsaved_folder()]
    if __package__.startswith("bl_ext."):
        extension = ".".join(__package__.split(".")[:3])
        homes.append(Path(bpy.utils.extension_path_user(extension, path=EXTENSION_FOLDER)))
    return homes


def _brought():
    return [volume for volume in bpy.data.volumes if volume.session_uid in _before]


def _path_in(folder, within):
    """The path `within` the `folder` of the file that is being saved, as its volumes keep it."""
    opened = bpy.data.filepath
    if not opened or Path(opened).parent == folder:
        return f"//{within}"
    return str(folder / within)  # Blender makes it relative, where the user wants that


def _copy_all(old, new):
    """Copy a file, or the frames in a folder; the number of them. Raises OSError."""
    if old.is_file():
        _copy(old, new)
        return 1
    frames = Frames.files(old)
    if frames:
        new.mkdir(exist_ok=True)
    for path in frames:
        _copy(path, new / path.name)
    return len(frames)


def _copy(old, new):
    """Copy a file, unless it is there already: files of ours are never changed."""
    if new.exists() and new.stat().st_size == old.stat().st_size:
        return
    link_or_copy(old, new)


def _require_whole(path):
    """OSError for a .blend that does not have all scenes, or that ends before its end."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())
    with bpy.data.libraries.load(str(path)) as (there, _here):
        if set(there.scenes) != {scene.name for scene in bpy.data.scenes if not scene.library}:
            raise OSError(f"{path} lacks a scene")


def _keep_version(path):
    """Keep the .blend at `path` as .blend1, and older ones as .blend2 ..., as Blender does."""
    number = bpy.context.preferences.filepaths.save_version
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
