# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading a scene: from the objects that the user selected to the task of a bake."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from .arrays import Floats
from .errors import OutputError, SettingsError
from .options import Options
from .output import attribute, modifier, shading_surfaces, volume
from .output.ambient import Vertices
from .output.sources import sources_shown_by
from .output.ties import mend
from .scene.frames import at_frame
from .scene.grids.resample import box_bounds
from .scene.lights.lamps import scene_lights
from .scene.lights.receivers import Receivers
from .scene.opening import open_sources
from .scene.reader import Reader
from .scene.sources import Source
from .scene.surface_sources import FoliageSource
from .scene.surroundings import note_surroundings
from .tasks.bake import BakeTask
from .tasks.result import SequenceChoices
from .transport.lights.base import Light
from .transport.lights.distant import Sky
from .transport.medium import Optics

type Objects = list[bpy.types.Object]


def read_scene(
    context: bpy.types.Context,
    objects: Objects,
    options: Options,
    path: Path | None = None,
    choices: SequenceChoices | None = None,
    frame: int | None = None,
) -> BakeTask:
    """The `BakeTask` for the scene at a frame.

    path     of the file to write, or None for a new one
    choices  the `SequenceChoices` of frames baked before, or None
    frame    of the scene, or None for the current one

    Its `sources` are those `objects` that can be lit; `uid` says which one each is. Notes name the
    others. Raises a LightingError for a scene that cannot be lit.
    """
    scene, choices = scene_of(context), choices or SequenceChoices()
    domain = scene.objects.get(options.domain)
    # Blender keeps what it has read of each frame, and may hang on a damaged one.
    unread = [ob for ob in volume.baked_volumes(scene) if volume.is_sequence(ob)]
    with at_frame(context, [*objects, *filter(None, [domain])], frame, unread) as frame:
        depsgraph = context.evaluated_depsgraph_get()
        # Read the sources.
        reader = _reader(depsgraph, options)
        sources = open_sources(objects, reader, refuse_unwritable)
        uids = {source.uid for source in sources}
        objects = [ob for ob in objects if ob.session_uid in uids]
        box = _box(scene, options.domain) if options.domain else None
        # Choose which surfaces hold their light, and which look it up.
        readers = _readers(objects, sources, depsgraph, options, choices, reader.notes)
        choices = replace(choices, readers=readers)
        numbers = [n for n, source in enumerate(sources) if readers[source.name]]
        surfaces = _surfaces(objects, sources, numbers, depsgraph, options)
        # Read the lights, and note what else would matter.
        is_lamp_needed = not any(source.shines for source in sources)
        receivers = Receivers.of(objects, sources, depsgraph, box)
        lights = scene_lights(scene, depsgraph, reader.notes, is_lamp_needed, receivers)
        note_surroundings(depsgraph, lights, receivers, reader.notes, {options.domain})
    if choices.all_light is None:
        all_light = options.sky and _takes_sky(objects, sources, lights, reader.notes)
        choices = replace(choices, all_light=all_light)
    reader.notes.extend(_without_mesh(objects, sources))
    return BakeTask(
        options=options,
        sources=sources,
        medium_choice=reader.choice,
        lights=lights,
        box=box,
        surfaces=surfaces,
        readers=numbers,
        path=str(path or volume.fresh_path(folder_of(options), objects[0].name)),
        metadata={"sources": ", ".join(source.name for source in sources), "frame": frame},
        choices=choices,
        left_out=[],
        is_frame=path is not None,
    )


def scene_of(context: bpy.types.Context) -> bpy.types.Scene:
    """The scene of a context, which always has one where this extension runs."""
    assert context.scene is not None
    return context.scene


def sources_of(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> Objects:
    """`objects` with each baked volume replaced by the objects whose light it shows."""
    mend()
    baked = volume.baked_volumes(scene)
    sources: dict[bpy.types.Object, None] = {}  # keeps the order
    for ob in objects:
        shown = sources_shown_by(scene, ob) if ob in baked else []
        sources.update(dict.fromkeys(shown or [ob]))
    return list(sources)


def folder_of(options: Options) -> Path:
    """The folder for the files."""
    if not options.folder:
        return Path(volume.default_folder())
    return Path(bpy.path.abspath(options.folder)).absolute()


def refuse_unwritable(ob: bpy.types.Object) -> None:
    """Raise OutputError, before any work, for an object that cannot show its light."""
    if not ob.is_editable:
        raise OutputError(f"'{ob.name}' is linked from another file; make it local.")
    if ob.type == "MESH":
        attribute.refuse_unwritable([ob])
        shading_surfaces.refuse_unwritable([ob])


def _reader(depsgraph: bpy.types.Depsgraph, options: Options) -> Reader:
    custom = Optics(options.sigma_s, options.sigma_a, options.g)
    medium, depth, grid = options.medium, options.optical_depth, options.grid
    return Reader(depsgraph, medium, depth, grid, custom=custom)


def _readers(
    objects: Objects,
    sources: list[Source],
    depsgraph: bpy.types.Depsgraph,
    options: Options,
    choices: SequenceChoices,
    notes: list[str],
) -> dict[str, bool]:
    """{name of a source: whether a modifier is to light it}; earlier `choices` stay."""
    new = [n for n, source in enumerate(sources) if source.name not in choices.readers]
    is_preferred = options.foliage == "MODIFIER"
    new_objects, new_sources = [objects[n] for n in new], [sources[n] for n in new]
    read = modifier.readers(new_objects, new_sources, depsgraph, is_preferred, notes)
    return choices.readers | {source.name: n in read for n, source in enumerate(new_sources)}


def _surfaces(
    objects: Objects,
    sources: list[Source],
    readers: list[int],
    depsgraph: bpy.types.Depsgraph,
    options: Options,
) -> dict[int, Vertices]:
    """{number of the source: its vertices} of the meshes that hold their light."""
    return {
        number: attribute.read_vertices(ob, depsgraph, source.is_body, source.is_wall)
        for number, (ob, source) in enumerate(zip(objects, sources, strict=True))
        if source.shows_light and ob.type == "MESH"
        if number not in readers or _keeps_mean(ob, options)
    }


def _keeps_mean(ob: bpy.types.Object, options: Options) -> bool:
    """Whether a mesh that a modifier lights has light on its vertices too.

    If several objects share it, the vertices serve those that no modifier lights.
    """
    assert isinstance(ob.data, bpy.types.Mesh)
    return ob.data.users > 1 and options.foliage != "MODIFIER"


def _without_mesh(objects: Objects, sources: list[Source]) -> list[str]:
    """Sentences on objects that should show light but have no mesh to show it on."""
    return [
        f"'{ob.name}' has no mesh of its own to show light on; make its instances real, or "
        "convert it to a mesh."
        for ob, source in zip(objects, sources, strict=True)
        if source.shows_light and ob.type != "MESH"
    ]


def _takes_sky(
    objects: Objects, sources: list[Source], lights: Sequence[Light], notes: list[str]
) -> bool:
    """Whether surfaces can show the uncollided light of the sky too; if not, a note says why."""
    showing = {s: ob for ob, s in zip(objects, sources, strict=True) if s.shows_light}
    if not showing:
        return False
    materials = [slot.material for ob in showing.values() for slot in ob.material_slots]
    foliage = [source for source in showing if isinstance(source, FoliageSource)]
    names = {name for source in foliage for name in source.instanced}
    materials += [bpy.data.materials.get(name) for name in names if name]
    hindrance = shading_surfaces.hindrance(materials)
    has_lamp = not all(isinstance(light, Sky) for light in lights)
    for is_hindered, reason in (
        (has_lamp, "a lamp, or a sun in the sky, shines"),
        (any(source.shines for source in sources), "fire shines"),
        (any(source.is_body for source in showing), "a solid is lit"),
        (hindrance, hindrance),
    ):
        if is_hindered:
            notes.append(f"The sky's direct light was not baked, because {reason}; Cycles adds it.")
            return False
    return True


def _box(scene: bpy.types.Scene, name: str) -> tuple[Floats, Floats]:
    """(lower, upper), each (3,) m: the bounds of the object `name` in world space."""
    if name not in scene.objects:
        raise SettingsError(f"There is no object '{name}' to use as the domain; choose another.")
    ob = scene.objects[name]
    corners = np.array(ob.bound_box)
    lower, upper = box_bounds(corners.min(axis=0), corners.max(axis=0), np.array(ob.matrix_world))
    if not np.isfinite([lower, upper]).all():
        raise SettingsError(
            f"The domain '{name}' has a location, rotation or scale that is not a number; clear it."
        )
    if not np.ptp([lower, upper], axis=0).any():
        raise SettingsError(f"The domain '{name}' has no size; choose a mesh.")
    return lower, upper
