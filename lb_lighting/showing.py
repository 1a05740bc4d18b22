# SPDX-License-Identifier: GPL-3.0-or-later
"""Showing the light of a bake in the scene."""

import bpy

from .clearing import release
from .output import attribute, modifier, shading_surfaces, shading_volumes, volume
from .output.ambient import STAND_OFF
from .output.look import Look
from .output.render_settings import prepare_scene
from .output.sources import hide_source, lost_sources, show_source, sources_shown_by
from .reading import Objects, scene_of
from .scene.surface_sources import FoliageSource
from .tasks.bake import BakeTask
from .tasks.result import BakeResult

type Looks = dict[int, Look]  # by frame


def apply(
    context: bpy.types.Context,
    objects: Objects,
    task: BakeTask,
    result: BakeResult,
    frames: volume.Frames | None = None,
    looks: Looks | None = None,
) -> bpy.types.Object:
    """Let `objects`, the sources of the task, show the light of its result.

    frames  the `Frames` that it is one of, or None
    looks   {frame: `Look`} of those that are baked
    Returns the Volume object that shows it. Raises OutputError for an object that cannot show its
    light; then the scene is unchanged.
    """
    arguments = task.options.strength, task.all_light
    # Write the light on vertices.
    surfaces = [objects[number] for number in result.ambient]
    attribute.write_ambient(surfaces, list(result.ambient.values()), task.all_light)
    shown = _show_volume(context, objects, task, result, frames, looks)
    for ob in surfaces:
        modifier.remove_modifier(ob)
        shading_surfaces.light_surface(ob, *arguments)
    # Let modifiers look the light up in the volume.
    for number in result.readers:
        ob, source = objects[number], task.sources[number]
        if number not in result.ambient:
            attribute.remove_ambient(ob)
        stand_off = STAND_OFF * result.domain.voxel_size if source.is_wall else 0.0
        modifier.add_modifier(ob, shown, task.all_light, source.is_body, stand_off)
        shading_surfaces.light_surface(ob, *arguments)
        if isinstance(source, FoliageSource):
            materials = [
                bpy.data.materials.get(name) if name else None for name in source.instanced
            ]
            result.notes.extend(shading_surfaces.light_instances(ob, materials, *arguments))
    return shown


def _show_volume(
    context: bpy.types.Context,
    objects: Objects,
    task: BakeTask,
    result: BakeResult,
    frames: volume.Frames | None,
    looks: Looks | None,
) -> bpy.types.Object:
    """The Volume object for the file; it renders only if there are volumes among the sources."""
    scene = scene_of(context)
    ob: bpy.types.Object = volume.show_volume(context, objects, task.path, frames)
    has_others = len(looks or ()) > 1  # frames, which may show what is left out of this one
    # Release the sources of an older bake that are not lit any more.
    gone = [s for s in sources_shown_by(scene, ob) if s not in objects and not has_others]
    release(context, gone + lost_sources(scene), [])
    mode = task.options.mode
    looks = looks or {task.metadata["frame"]: result.look}
    shading_volumes.shade_frames(ob, mode, looks, task.options.strength)
    # Show the volume, and hide the sources that it replaces.
    left_out = {task.sources[number] for number in result.left_out}
    has_volumes = any(source.is_volume for source in task.sources if source not in left_out)
    if has_volumes or not has_others:
        ob.hide_render = ob.hide_viewport = not has_volumes
    for source_object, source in zip(objects, task.sources, strict=True):
        if source in left_out and has_others:
            continue
        if source.is_volume and mode == "REPLACE" and source not in left_out:
            # Blender deselects what is hidden, and the next bake needs the selection.
            ob.select_set(ob.select_get() or source_object.select_get())
            hide_source(source_object)
        else:
            show_source(source_object)
    if has_volumes:
        prepare_scene(scene)
    return ob
