# SPDX-License-Identifier: GPL-3.0-or-later
"""Clear: remove what bakes made from the scene, and restore what they changed."""

import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import bpy

from .errors import OutputError
from .output import attribute, modifier, shading_surfaces, shading_volumes
from .output.render_settings import restore_scene
from .output.sources import RESULT, forget, lost_sources, show_source, sources_shown_by
from .output.ties import mend
from .output.volume import (
    Frames,
    baked_path,
    baked_volumes,
    delete_baked_file,
    is_foreign,
    is_sequence,
    remove_baked,
    remove_unused,
    volume_path,
)


class BakedFile(NamedTuple):
    """A .vdb file, or a sequence of them, that showed light.

    path         of the file; of a sequence, of one frame
    is_sequence  whether its folder holds a sequence
    is_foreign   whether another .blend baked it
    """

    path: Path
    is_sequence: bool
    is_foreign: bool


@dataclass
class Cleared:
    """What `clear` removed from a scene.

    count  of objects that had light
    files  that showed it, still on disk
    """

    count: int
    files: list[BakedFile]

    @property
    def summary(self) -> str:
        return f"LB light removed from {self.count} object{'s' * (self.count != 1)}"

    def delete_files(self) -> list[str]:
        """Delete the .vdb files, and all frames of sequences; notes on the files that were kept.

        Raises OutputError for a file that cannot be deleted, once all others are.
        """
        notes, failure = [], None
        for file in self.files:
            reason = _reason_to_keep(file)
            if reason:
                kept = file.path.parent if file.is_sequence else file.path
                notes.append(f"{kept} was kept, because {reason}.")
                continue
            try:
                _delete(file)
            except OutputError as error:
                failure = error
        if failure:
            raise failure
        return notes


def clear(context: bpy.types.Context) -> Cleared:
    """Remove everything that bakes made from the scene, and restore what they changed.

    Linked objects stay as they are in their own file. The .vdb files stay until
    `Cleared.delete_files`.
    """
    mend()
    scene = context.scene
    assert scene
    # Find all that is lit, before any of it changes.
    baked = [ob for ob in baked_volumes(scene) if ob.is_editable]
    lost = [ob for ob in lost_sources(scene) if ob.is_editable]
    unseen = _unseen_volumes(lost)
    sources = [source for ob in baked for source in sources_shown_by(scene, ob)] + lost
    surfaces = [ob for ob in scene.objects if shading_surfaces.is_lit(ob)]
    files = [BakedFile(baked_path(ob), is_sequence(ob), is_foreign(ob)) for ob in baked + unseen]
    count = len({*sources, *surfaces} or baked)
    # Restore the user's objects, then remove ours.
    release(context, sources, baked)
    for ob in surfaces:
        attribute.remove_ambient(ob)
        modifier.remove_modifier(ob)
    shading_surfaces.unwire_unused()
    for ob in baked:
        remove_baked(ob)
    remove_unused(unseen)
    restore_scene(scene)
    shading_volumes.remove_unused()
    return Cleared(count, list(dict.fromkeys(files)))


def release(
    context: bpy.types.Context,
    sources: Iterable[bpy.types.Object],
    baked: Sequence[bpy.types.Object],
) -> None:
    """Show `sources` as they were before the bake, selected if any of the volumes `baked` is."""
    selected = any(ob.select_get() for ob in baked)
    for ob in sources:
        was_hidden = ob.hide_viewport
        show_source(ob)
        forget(ob)
        if selected and was_hidden and not ob.hide_viewport and _in_view(context, ob):
            ob.select_set(True)


def _unseen_volumes(lost: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """The baked volumes of `lost` sources that are in no scene."""
    volumes = dict.fromkeys(source[RESULT] for source in lost if source[RESULT])
    return [ob for ob in volumes if not ob.users_scene]


def _in_view(context: bpy.types.Context, ob: bpy.types.Object) -> bool:
    return context.view_layer is not None and ob.name in context.view_layer.objects


def _reason_to_keep(file: BakedFile) -> str | None:
    """Why a file must not be deleted, or None."""
    user = _user_of(file)
    if user:
        return f"'{user}' still shows it"
    return "it belongs to another .blend file" if file.is_foreign else None


def _user_of(file: BakedFile) -> str | None:
    """The name of an object, or of a Volume data-block, that shows the file; or None."""
    folder = file.path.parent
    for volume in bpy.data.volumes:
        shown = volume_path(volume)
        if volume.users and (shown == file.path or (file.is_sequence and shown.parent == folder)):
            return next((ob.name for ob in bpy.data.objects if ob.data == volume), volume.name)
    return None


def _delete(file: BakedFile) -> None:
    if not file.is_sequence:
        delete_baked_file(file.path)
        return
    folder = file.path.parent
    for frame in Frames.files(folder):
        delete_baked_file(frame)
    with contextlib.suppress(OSError):  # it holds other files, or does not exist
        folder.rmdir()
