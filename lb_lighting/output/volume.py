# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes out: the Volume object that shows the light in a file, and where files go."""

import contextlib
import os
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

LONGEST_NAME = 48  # letters, of up to 4 bytes; file systems take names of 255 bytes
LONGEST_PATH = 1023  # bytes that Blender keeps of a path
RESULT = "lb_lighting_result"  # on a source: the baked Volume object that shows its light
IDENTITY = "lb_lighting_identity"  # on either: a text of its own, which tells it from its copies
RETURNED = "lb_lighting_returned"  # on a source: it shows again while its light is in no scene
APPENDED = "lb_lighting_appended"  # on a baked volume: its file was baked for another .blend


def fresh_path(folder, source_name):
    """A .vdb path in `folder` for the light of the object `source_name`, new at every call.

    Blender keeps what it once read from a path until it quits, even when the file is
    rewritten or deleted; so no bake may use the path of an earlier one.
    """
    name = bpy.path.clean_name(source_name)[:LONGEST_NAME]
    return Path(folder) / f"{name}_lb_{uuid.uuid4().hex[:8]}.vdb"


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

    @staticmethod
    def files(folder):
        """[path] of all frames in a folder."""
        return sorted(Path(folder).glob("frame_*.vdb"))

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
    _part_from_copies(ob)
    ob.pop(APPENDED, None)
    ob.data.filepath = stored_path(path)
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
    """The baked Volume object that shows a sequence of the light of `sources`, or None.

    Some of these may have been left out of it.
    """
    for ob in baked_volumes(scene):
        lit = sources_of(scene, ob)
        if ob.data.is_sequence and lit and set(lit) <= set(sources):
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
    sources, scenes = [ob for ob in scene.objects if RESULT in ob], scene_objects()
    return [ob for ob in sources if is_lost(ob, scenes)]


def scene_objects():
    """[set of objects] of each scene of the file."""
    return [set(scene.objects) for scene in bpy.data.scenes]


def is_lost(source, scenes):
    """True for a source that is in one of `scenes`, but nowhere together with its baked volume.

    scenes  what `scene_objects` returns
    Blender keeps a deleted object in the file as long as a source points to it.
    """
    own = [objects for objects in scenes if source in objects]
    return bool(own) and not any(source[RESULT] in objects for objects in own)


def tie(source, baked):
    """The Volume object `baked` shows the light of the object `source` from now on."""
    source[RESULT] = baked
    identify(source)


def identify(ob, anew=False):
    """Give a source or a baked volume its identity, where it has none or is to have it `anew`."""
    if anew or IDENTITY not in ob:
        ob[IDENTITY] = uuid.uuid4().hex


def forget(source):
    """The object `source` has no light any more."""
    for mark in (RESULT, IDENTITY, RETURNED):
        source.pop(mark, None)


def baked_path(ob):
    """The path of the file that the baked Volume object shows."""
    return volume_path(ob.data)


def volume_path(volume):
    """The path of the file that the datablock `volume` shows; of a sequence, of one frame."""
    return Path(os.path.normpath(bpy.path.abspath(volume.filepath, library=volume.library)))


def is_foreign(ob):
    """True for a baked volume whose file was baked for another .blend, and is its to delete."""
    return APPENDED in ob or not ob.data.is_editable


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


def remove_unused(baked):
    """Remove those of the Volume objects `baked` that nothing uses, not even a source."""
    for ob in dict.fromkeys(baked):
        if is_ours(ob) and not ob.users:
            remove_baked(ob)


def _part_from_copies(ob):
    """Leave the data and materials that copies of the baked Volume object `ob` share to them, and
    those that are linked to their file.

    Copies are the user's, and go on showing what they show now.
    """
    if _is_shared(ob.data):
        ob.data = ob.data.copy()
    materials = ob.data.materials
    for index, material in enumerate(materials):
        if material and is_ours(material) and _is_shared(material):
            materials[index] = material.copy()


def _is_shared(block):
    return block.users - block.use_fake_user > 1 or not block.is_editable


def delete_baked_file(path):
    """Delete the file at `path` if `write_vdb` wrote it; OutputError if that cannot be done."""
    if not is_baked_file(path):
        return
    try:
        Path(path).unlink()
    except OSError as error:
        raise OutputError(f"{path} could not be deleted; make its folder writable.") from error


def default_folder():
    """The folder for results: the .blend's, or `unsaved_folder` while the file is unsaved."""
    if bpy.data.filepath:
        return Path(bpy.data.filepath).parent
    with contextlib.suppress(OSError):  # `require_writable` says that it is not there
        unsaved_folder().mkdir(parents=True, exist_ok=True)
    return unsaved_folder()


def unsaved_folder():
    """The folder for results of files that are not saved yet, which outlives the extension."""
    return Path(bpy.utils.user_resource("DATAFILES", path="lb_lighting"))


def require_writable(folder):
    """OutputError, before any work, for a folder that is not there or takes no files."""
    if len(os.fsencode(fresh_path(folder, LONGEST_NAME * "x"))) > LONGEST_PATH:
        raise OutputError(
            f"The folder {str(folder)[:40]}... has too long a path for Blender; choose another."
        )
    if not os.path.isdir(folder):
        raise OutputError(f"The folder {folder} does not exist; choose another or make it.")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"Nothing can be written to {folder}; choose a folder that is writable."
        ) from error


def stored_path(path):
    """`path` as the .blend keeps it: relative to it, unless it is unsaved or on another drive."""
    try:
        return bpy.path.relpath(str(path)) if bpy.data.filepath else str(path)
    except ValueError:
        return str(path)


def _new_volume(scene, source_name):
    volume = bpy.data.volumes.new(f"LB {source_name}")
    ob = bpy.data.objects.new(volume.name, volume)
    volume[TAG] = ob[TAG] = "baked volume"
    identify(ob)
    scene.collection.objects.link(ob)
    return ob
