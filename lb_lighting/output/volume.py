# SPDX-License-Identifier: GPL-3.0-or-later
"""The Volume object that shows baked light, and the paths of its files."""

import contextlib
import os
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix

from ..arrays import Floats
from ..errors import OutputError
from ..ours import TAG, has_mark, is_ours
from .keys import remove_keys
from .sources import RESULT, forget, identify, sources_shown_by, tie
from .vdb import is_baked_file

MAX_NAME = 48  # letters, of up to 4 bytes; file systems allow names of 255 bytes
MAX_PATH = 1023  # bytes; the longest path that Blender stores
APPENDED = "lb_lighting_appended"  # on a baked volume: its file was baked for another .blend


def fresh_path(folder: Path | str, source_name: str) -> Path:
    """A new .vdb path in `folder` for the light of the object `source_name`.

    Blender caches what it has read from a path until it quits, even if the file is rewritten or
    deleted. So no bake may reuse the path of an earlier one.
    """
    name = bpy.path.clean_name(source_name)[:MAX_NAME]
    return Path(folder) / f"{name}_lb_{uuid.uuid4().hex[:8]}.vdb"


@dataclass(frozen=True)
class Frames:
    """The files of a sequence, one for each frame of the scene.

    folder  contains these files and nothing else
    """

    folder: Path
    first: int
    last: int

    def path(self, frame: int) -> Path:
        """The file for a frame; Blender finds the frame number at the end of its name."""
        return self.folder / f"frame_{frame:04d}.vdb"

    @staticmethod
    def files(folder: Path | str) -> list[Path]:
        """The files of all frames in a folder."""
        return sorted(Path(folder).glob("frame_*.vdb"))

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.first, self.last + 1))


def fresh_frames_folder(folder: Path | str, source_name: str) -> Path:
    """A new folder for `Frames` in `folder`, unique like a `fresh_path`."""
    return fresh_path(folder, source_name).with_suffix("")


def frames_folder(scene: bpy.types.Scene, sources: Iterable[bpy.types.Object]) -> Path | None:
    """The folder of the `Frames` that show the light of the objects `sources`, or None."""
    shown = _sequence_of(scene, sources)
    return baked_path(shown).parent if shown else None


def show_volume(
    context: bpy.types.Context,
    sources: Sequence[bpy.types.Object],
    path: Path | str,
    frames: Frames | None = None,
) -> bpy.types.Object:
    """The Volume object that shows the file at `path` as the light of the objects `sources`.

    frames  the sequence that the file belongs to, all of which is shown, or None
    Sources that already have a Volume object keep it, and each bake brings a `fresh_path`. If two
    sources had one each, both now use the first. Call `forget` for sources that only an older bake
    had.
    """
    scene = context.scene
    assert scene
    # Replace the Volume objects of earlier bakes by one.
    before = [source[RESULT] for source in sources if source.get(RESULT)]
    older = [ob for ob in baked_volumes(scene) if ob in before]
    for source in sources:
        forget(source)
    remove_unused(before)
    ob = older[0] if older else _new_volume(scene, sources[0].name)
    for other in older[1:]:
        remove_baked(other)
    for source in sources:
        tie(source, ob)
    _unshare(ob)
    ob.pop(APPENDED, None)
    # Show the file, at the world's origin.
    _show_file(_volume_data(ob), path, frames)
    ob.parent = None
    ob.matrix_world = Matrix()
    return ob


def _show_file(volume: bpy.types.Volume, path: Path | str, frames: Frames | None) -> None:
    volume.filepath = stored_path(path)
    volume.is_sequence = frames is not None
    if frames is not None:
        volume.frame_start, volume.frame_duration = frames.first, frames.last - frames.first + 1
        volume.frame_offset = frames.first - 1  # files are numbered by the frames of the scene
        volume.sequence_mode = "EXTEND"  # before and after, the nearest frame stays


def shows(scene: bpy.types.Scene, sources: Iterable[bpy.types.Object], frames: Frames) -> bool:
    """Whether exactly these `Frames` show the light of the objects `sources`."""
    shown = _sequence_of(scene, sources)
    if shown is None or baked_path(shown).parent != frames.folder:
        return False
    volume = _volume_data(shown)
    first, count = volume.frame_start, volume.frame_duration
    return (first, first + count - 1) == (frames.first, frames.last)


def _sequence_of(
    scene: bpy.types.Scene, sources: Iterable[bpy.types.Object]
) -> bpy.types.Object | None:
    """The baked Volume object that shows a sequence of the light of `sources`, or None.

    The sequence may lack some of the sources.
    """
    for ob in baked_volumes(scene):
        lit = sources_shown_by(scene, ob)
        if _volume_data(ob).is_sequence and lit and set(lit) <= set(sources):
            return ob
    return None


def follow(ob: bpy.types.Object, source: bpy.types.Object, place: Floats) -> None:
    """Make a baked volume `ob` move with its `source`.

    place  (4, 4), the source's space to world space when it was lit
    """
    matrix = Matrix(place.tolist())
    if matrix.determinant():
        ob.parent = source
        ob.matrix_parent_inverse = matrix.inverted()


def is_baked(ob: bpy.types.Object) -> bool:
    """True for a Volume object that `show_volume` made."""
    return ob.type == "VOLUME" and is_ours(ob)


def baked_volumes(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The Volume objects in `scene` that `show_volume` made."""
    return [ob for ob in scene.objects if is_baked(ob)]


def is_sequence(ob: bpy.types.Object) -> bool:
    """Whether a baked Volume object shows a sequence of files."""
    return _volume_data(ob).is_sequence


def baked_path(ob: bpy.types.Object) -> Path:
    """The path of the file that a baked Volume object shows."""
    return volume_path(_volume_data(ob))


def volume_path(volume: bpy.types.Volume) -> Path:
    """The path of the file that the data-block `volume` shows; of a sequence, of one frame."""
    return Path(os.path.normpath(bpy.path.abspath(volume.filepath, library=volume.library)))


def _volume_data(ob: bpy.types.Object) -> bpy.types.Volume:
    assert isinstance(ob.data, bpy.types.Volume)
    return ob.data


def is_foreign(ob: bpy.types.Object) -> bool:
    """True for a baked volume whose file belongs to another .blend, which alone may delete it."""
    return has_mark(ob, APPENDED) or not _volume_data(ob).is_editable


def remove_baked(ob: bpy.types.Object) -> None:
    """Remove a Volume object that `show_volume` made, with its data-block and our materials."""
    volume = _volume_data(ob)
    materials = [material for material in volume.materials if material and is_ours(material)]
    for material in materials:
        if material.node_tree:
            remove_keys(material.node_tree)
    bpy.data.objects.remove(ob)
    # The user may use our data elsewhere; then it stays.
    blocks: list[bpy.types.ID] = [volume, *materials]
    for block in blocks:
        if not block.users:
            bpy.data.batch_remove([block])


def remove_unused(baked: Iterable[bpy.types.Object]) -> None:
    """Remove those of the Volume objects `baked` that nothing uses, not even a source."""
    for ob in dict.fromkeys(baked):
        if is_ours(ob) and not ob.users:
            remove_baked(ob)


def _unshare(ob: bpy.types.Object) -> None:
    """Give the baked Volume object `ob` data and materials of its own where they are shared with
    copies, or linked from another file.

    Copies belong to the user, and keep showing what they show now.
    """
    if _is_shared(_volume_data(ob)):
        ob.data = _volume_data(ob).copy()
    materials: Any = _volume_data(ob).materials
    for index, material in enumerate(materials):
        if material and is_ours(material) and _is_shared(material):
            materials[index] = material.copy()


def _is_shared(block: bpy.types.ID) -> bool:
    return block.users - block.use_fake_user > 1 or not block.is_editable


def delete_baked_file(path: Path) -> None:
    """Delete the file at `path` if `write_vdb` wrote it. Raises OutputError if that fails."""
    if not is_baked_file(path):
        return
    try:
        Path(path).unlink()
    except OSError as error:
        raise OutputError(f"{path} could not be deleted; make its folder writable.") from error


def default_folder() -> Path:
    """The folder for results: the .blend's, or `unsaved_folder` while the file is unsaved."""
    if bpy.data.filepath:
        return Path(bpy.data.filepath).parent
    with contextlib.suppress(OSError):  # `require_writable` reports it
        unsaved_folder().mkdir(parents=True, exist_ok=True)
    return unsaved_folder()


def unsaved_folder() -> Path:
    """The folder for results of unsaved files, which remains if the extension is removed."""
    return Path(bpy.utils.user_resource("DATAFILES", path="lb_lighting"))


def require_writable(folder: Path | str) -> None:
    """Raise OutputError, before any work, for a folder that is missing or takes no files."""
    if len(os.fsencode(fresh_path(folder, MAX_NAME * "x"))) > MAX_PATH:
        raise OutputError(
            f"The folder {str(folder)[:40]}... has too long a path for Blender; choose another."
        )
    if not os.path.isdir(folder):
        raise OutputError(f"The folder {folder} does not exist; choose another or create it.")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"The folder {folder} is not writable; choose another.") from error


def stored_path(path: Path | str) -> str:
    """`path` as the .blend stores it: relative, unless the file is unsaved or on another drive."""
    try:
        return bpy.path.relpath(str(path)) if bpy.data.filepath else str(path)
    except ValueError:
        return str(path)


def _new_volume(scene: bpy.types.Scene, source_name: str) -> bpy.types.Object:
    volume = bpy.data.volumes.new(f"LB {source_name}")
    ob = bpy.data.objects.new(volume.name, volume)
    volume[TAG] = ob[TAG] = "baked volume"
    identify(ob)
    scene.collection.objects.link(ob)
    return ob
