# SPDX-License-Identifier: GPL-3.0-or-later
"""Light in a scene as a bake leaves it, without the solve."""

import bpy
import numpy as np

from lb_lighting.output import shading_volumes, volume
from lb_lighting.output.sources import hide_source
from lb_lighting.output.vdb import write_vdb
from lb_lighting.transport.medium import Domain

SHAPE = 3, 4, 5


def write_light(path):
    """Write a small .vdb of ours to `path`, and return the path."""
    ones = np.ones(SHAPE, np.float32)
    write_vdb(path, Domain((-1.0, -1.0, -1.0), 0.5, SHAPE), ones, ones[None], {})
    return path


def light(*sources, folder, frames=None):
    """The Volume object that replaces the hidden `sources`.

    frames  (first, last) of a sequence, or None
    """
    if frames is None:
        path = write_light(volume.fresh_path(folder, sources[0].name))
    else:
        frames = volume.Frames(volume.fresh_frames_folder(folder, sources[0].name), *frames)
        frames.folder.mkdir()
        for path in map(frames.path, reversed(list(frames))):
            write_light(path)
    ob = volume.show_volume(bpy.context, sources, path, frames)
    shading_volumes.shade_volume(ob, "REPLACE", 3.6, 0.4)
    for source in sources:
        hide_source(source)
    return ob


def hidden(*objects):
    """Whether each is hidden, in the viewport and in renders alike."""
    assert all(ob.hide_viewport == ob.hide_render for ob in objects)
    return [ob.hide_render for ob in objects]
