# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes out: the Volume object that shows the light in a file, and where files go."""

import tempfile
import uuid
from dataclasses import dataclass
from pathlib import Path

import bpy
from mathutils import Matrix

from ..errors import OutputError
from ..ours import TAG, is_ours
from .keys import remove_keys
from .vdb import is_baked_file

RESULT = "lb_lighting_result"  # on a source: the baked Volume object that shows its light


def fresh_path(folder, source_name):
    """A .vdb path in `folder` for the light of the object `source_name`, new at every call.

    Blender keeps what it once read from a path until it quits, even when the file is
    rewritten or deleted; so no bake may use the path of an earlier one.
    """
    return Path(folder) / f"{bpy.path.clean_name(source_name)}_lb_{uuid.uuid4().hex[:8]}.vdb"


@dataclass(frozen=True)
class Frames:
    """The files of a sequence: one for each frame of the scene.

    folder  that holds them and nothing else
    """

    folder: Path
    first: int
    last: int

    def path(self, frame):
        """Of the file for a frame; Blender finds the number at its end."""
        return self.folder / f"frame_{frame:04d}.vdb"

    def __iter__(self):
        return iter(range(self.first, self.last + 1))


def fresh_frames_folder(folder, source_name):
    """A folder for `Frames` in `folder`, new at every call, as `fresh_path` is."""
    return fresh_path(folder, source_name).with_suffix("")


def frames_folder(scene, sources):
    """The folder of the `Frames` that show the light of the objects `sources`, or None."""
    shown = _sequence_of(scene, sources)
    return baked_path(shown).parent if shown else None


def show_volume(context, sources, path, frames=None):
    """The Volume object that shows the file at `path` as the light of the objects `sources`.

    frames  the `Frames` that the file is one of, which are all shown, or None
    Sources that had one keep it, and each later bake brings a `fresh_path`; two that had one
    each now share the first. Call `forget` for those that an older bake had and this has not.
    """
    scene = context.scene
    older = [ob for ob in baked_volumes(scene) if any(s.get(RESULT) == ob for s in sources)]
    ob = older[0] if older else _new_volume(scene, sources[0].name)
    for other in older[1:]:
        remove_baked(other)
    for source in sources:
        source[RESULT] = ob
    ob.data.filepath = _stored_path(path)
    ob.data.is_sequence = frames is not None
    if frames is not None:
        ob.data.frame_start, ob.data.frame_duration = frames.first, frames.last - frames.first + 1
        ob.data.frame_offset = frames.first - 1  # the number of a file is that of its frame
        ob.data.sequence_mode = "EXTEND"  # before and after, the nearest frame stays
    ob.parent = None
    ob.matrix_world = Matrix()
    return ob


def shows(scene, sources, frames):
    """Whether the light of the objects `sources` is shown by just these `Frames`."""
    shown = _sequence_of(scene, sources)
    if shown is None or baked_path(shown).parent != frames.folder:
        return False
    first, count = shown.data.frame_start, shown.data.frame_duration
    return (first, first + count - 1) == (frames.first, frames.last)


def _sequence_of(scene, sources):
    """The baked Volume object that shows a sequence of the light of just `sources`, or None."""
    for ob in baked_volumes(scene):
        if ob.data.is_sequence and set(sources_of(scene, ob)) == set(sources):
            return ob
    return None


def follow(ob, source, place):
    """Let a baked volume `ob` go where its `source` goes, which was at `place` when it was lit.

    place  (4, 4), to world space
    """
    place = Matrix(place)
    if place.determinant():
        ob.parent = source
        ob.matrix_parent_inverse = place.inverted()


def baked_volumes(scene):
    """The Volume objects in `scene` that `show_volume` made."""
    return [ob for ob in scene.objects if ob.type == "VOLUME" and is_ours(ob)]


def sources_of(scene, baked):
    """The objects in `scene` whose light the Volume object `baked` shows."""
    return [ob for ob in scene.objects if ob.get(RESULT) == baked]


def lost_sources(scene):
    """The objects in `scene` that were lit, and whose light has since been removed."""
    return [ob for ob in scene.objects if RESULT in ob and ob[RESULT] is None]


def forget(source):
    """The object `source` has no light any more."""
    if RESULT in source:
        del source[RESULT]


def baked_path(ob):
    """The path of the file that the baked Volume object shows."""
    return Path(bpy.path.abspath(ob.data.filepath))


def remove_baked(ob):
    """Remove a Volume object that `show_volume` made, with its datablock and our materials."""
    volume = ob.data
    materials = [material for material in volume.materials if material and is_ours(material)]
    for material in materials:
        remove_keys(material.node_tree)
    bpy.data.objects.remove(ob)
    # The user may have put our data to use elsewhere; then it stays.
    for block in (volume, *materials):
        if not block.users:
            bpy.data.batch_remove([block])


def delete_baked_file(path):
    """Delete the file at `path` if `write_vdb` wrote it; OutputError if that cannot be done."""
    if not is_baked_file(path):
        return
    try:
        Path(path).unlink()
    except OSError as error:
        raise OutputError(f"{path} could not be deleted; make its folder writable.") from error


def default_folder():
    """The folder for results: the .blend's, or the extension's own while the file is unsaved."""
    if bpy.data.filepath:
        return Path(bpy.data.filepath).parent
    if __package__.startswith("bl_ext."):
        extension = ".".join(__package__.split(".")[:3])
        return Path(bpy.utils.extension_path_user(extension, path="baked", create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path="lb_lighting", create=True))


def require_writable(folder):
    """OutputError, before any work, for a folder that is not there or takes no files."""
    if not Path(folder).is_dir():
        raise OutputError(f"The folder {folder} does not exist; choose another or make it.")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"Nothing can be written to {folder}; choose a folder that is writable."
        ) from error


def _stored_path(path):
    """`path` as the .blend keeps it: relative to it, unless it is unsaved or on another drive."""
    try:
        return bpy.path.relpath(str(path)) if bpy.data.filepath else str(path)
    except ValueError:
        return str(path)


def _new_volume(scene, source_name):
    volume = bpy.data.volumes.new(f"LB {source_name}")
    ob = bpy.data.objects.new(volume.name, volume)
    volume[TAG] = ob[TAG] = "baked volume"
    scene.collection.objects.link(ob)
    return ob
