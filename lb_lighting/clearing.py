# SPDX-License-Identifier: GPL-3.0-or-later
"""Light out of the scene again: what bakes made goes, and what they changed is given back."""

import contextlib
from dataclasses import dataclass, field

import bpy

from .errors import OutputError
from .output import (
    attribute,
    modifier,
    shading_surfaces,
    shading_volumes,
    volume,
)
from .ties import mend


@dataclass
class Cleared:
    """What was taken out of a scene.

    count  of objects that had light
    files  [(path, whether it is of a sequence, whether another .blend's)] that showed it
    """

    count: int
    files: list = field(default_factory=list)

    @property
    def summary(self):
        return f"LB light taken out of {self.count} object{'s' * (self.count != 1)}"

    def delete_files(self):
        """Delete the .vdb files, of sequences all frames; notes on those that are kept.

        Raises OutputError for what cannot be deleted, after all else is.
        """
        notes, failed = [], None
        for path, is_sequence, appended in self.files:
            user = _user(path, is_sequence)
            if user or appended:
                why = f"'{user}' still shows it" if user else "it came here from another .blend"
                notes.append(f"{path.parent if is_sequence else path} was kept, because {why}.")
                continue
            try:
                _delete(path, is_sequence)
            except OutputError as error:
                failed = error
        if failed:
            raise failed
        return notes


def clear(context):
    """Take everything that bakes made out of the scene, and give back what they changed.

    What is linked from another file stays as it is there.
    Returns what was `Cleared`; the files stay until they are deleted there.
    """
    mend()
    scene = context.scene
    baked = [ob for ob in volume.baked_volumes(scene) if ob.is_editable]
    lost = [ob for ob in volume.lost_sources(scene) if ob.is_editable]
    unseen = [ob[volume.RESULT] for ob in lost if ob[volume.RESULT]]
    unseen = [ob for ob in dict.fromkeys(unseen) if not ob.users_scene]
    sources = [s for ob in baked for s in volume.sources_of(scene, ob)] + lost
    surfaces = [ob for ob in scene.objects if shading_surfaces.is_lit(ob)]
    files = [
        (volume.baked_path(ob), ob.data.is_sequence, volume.is_foreign(ob)) for ob in baked + unseen
    ]
    count = len({*sources, *surfaces} or baked)
    release(context, sources, baked)
    for ob in surfaces:
        attribute.remove_ambient(ob)
        modifier.remove_modifier(ob)
    shading_surfaces.unwire_unused()
    for ob in baked:
        volume.remove_baked(ob)
    volume.remove_unused(unseen)
    shading_volumes.restore_scene(scene)
    shading_volumes.remove_unused()
    return Cleared(count, list(dict.fromkeys(files)))


def release(context, sources, baked):
    """Show `sources` as they were before the bake, selected where their light was."""
    selected = any(ob.select_get() for ob in baked)
    for ob in sources:
        was_hidden = ob.hide_viewport
        shading_volumes.show_source(ob)
        volume.forget(ob)
        if selected and was_hidden and not ob.hide_viewport and _in_view(context, ob):
            ob.select_set(True)


def _in_view(context, ob):
    return ob.name in context.view_layer.objects


def _user(path, is_sequence):
    """The name of an object, or of a Volume datablock, that shows the file; or None."""
    for data in bpy.data.volumes:
        shown = volume.volume_path(data)
        if data.users and (shown == path or (is_sequence and shown.parent == path.parent)):
            return next((ob.name for ob in bpy.data.objects if ob.data == data), data.name)
    return None


def _delete(path, is_sequence):
    if not is_sequence:
        volume.delete_baked_file(path)
        return
    for frame in volume.Frames.files(path.parent):
        volume.delete_baked_file(frame)
    with contextlib.suppress(OSError):  # something else is in it, or it is gone
        path.parent.rmdir()
