# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings the light of an unsaved file along when the file is saved."""

from pathlib import Path

import bpy

from .vdb import link_or_copy
from .volume import Frames, stored_path, unsaved_folder, volume_path

EXTENSION_FOLDER = "baked"  # in the extension's folder, where earlier versions kept unsaved light

# {session_uid of a Volume data-block: its path before the save in progress}
_paths_before: dict[int, str] = {}


def before_save(target: str) -> list[str]:
    """Copy light that is in no place of the user's beside the file that is saved at `target`.

    From then on the volumes show the copies. The originals stay, for undo and for files that
    Blender saves automatically. Where the disk supports links, both are the same file.
    Returns notes on light that could not be copied and is still shown from its old place.
    """
    _paths_before.clear()
    if not target:  # Blender's startup file
        return []
    folder, notes = Path(target).parent, []
    for volume in bpy.data.volumes:
        path = volume_path(volume)
        home = next((home for home in _unsaved_folders() if home in path.parents), None)
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
        _paths_before[volume.session_uid] = volume.filepath
        volume.filepath = _path_in(folder, within)
    return notes


def after_save(target: str) -> None:
    """Make the paths relative to the file saved at `target`, or restore them if it was a copy."""
    if bpy.data.filepath != target:
        restore_paths()
        return
    for volume in _changed_volumes():
        volume.filepath = stored_path(volume_path(volume))
    _paths_before.clear()


def restore_paths() -> None:
    """After a failed save, or that of a copy: let volumes show what they did before the save."""
    for volume in _changed_volumes():
        volume.filepath = _paths_before[volume.session_uid]
    _paths_before.clear()


def _unsaved_folders() -> list[Path]:
    """The folders for results of unsaved files."""
    folders = [unsaved_folder()]
    if __package__.startswith("bl_ext."):
        extension = ".".join(__package__.split(".")[:3])
        folders.append(Path(bpy.utils.extension_path_user(extension, path=EXTENSION_FOLDER)))
    return folders


def _changed_volumes() -> list[bpy.types.Volume]:
    return [volume for volume in bpy.data.volumes if volume.session_uid in _paths_before]


def _path_in(folder: Path, within: Path) -> str:
    """The path `within` the `folder` of the file in the save, as its volumes store it."""
    opened = bpy.data.filepath
    if not opened or Path(opened).parent == folder:
        return f"//{within}"
    return str(folder / within)  # Blender makes it relative if the user wants that


def _copy_all(old: Path, new: Path) -> int:
    """Copy a file, or the frames in a folder; their number. Raises OSError."""
    if old.is_file():
        _copy(old, new)
        return 1
    frames = Frames.files(old)
    if frames:
        new.mkdir(exist_ok=True)
    for path in frames:
        _copy(path, new / path.name)
    return len(frames)


def _copy(old: Path, new: Path) -> None:
    """Copy a file unless it exists already: our files never change."""
    if new.exists() and new.stat().st_size == old.stat().st_size:
        return
    link_or_copy(old, new)
