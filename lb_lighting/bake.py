# SPDX-License-Identifier: GPL-3.0-or-later
"""The street: a scene goes in, it is lit in a process of its own, and the light goes back.

Operators, the command line and the tests all come here. `gather` reads the scene in one go, and
`Baking.apply` writes into it in one go, only when the whole result is on disk; in between Blender
and the scene are free.
"""

from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import bpy
import numpy as np

from . import exchange
from .clearing import clear, release
from .errors import OutputError, SceneError, SettingsError
from .job import Job, wait
from .options import Options
from .output import (
    attribute,
    modifier,
    shading_surfaces,
    shading_volumes,
    volume,
)
from .output.ambient import STAND_OFF
from .output.render_settings import prepare_scene
from .output.sources import hide_source, lost_sources, show_source, sources_shown_by
from .output.ties import mend
from .scene.frames import at_frame
from .scene.grids.resample import box_bounds
from .scene.lights.lamps import scene_lights
from .scene.lights.receivers import Receivers
from .scene.opening import open_sources
from .scene.reader import Reader
from .scene.surroundings import tell_surroundings
from .tasks.estimate import Estimate
from .tasks.light import (
    FIELD,
    Decided,
    Light,
    Lit,
)
from .transport.lights.distant import Sky
from .transport.medium import Optics

__all__ = [
    "Baking", "Estimating", "Options", "Outcome", "apply", "bake", "clear", "folder_of", "gather",
    "is_lit", "run", "sources_of",
]  # fmt: skip


GATHERED = "Pictures: what it scatters forwards was gathered along many directions, {:.1f} s."
WHOLE = "Pictures: surfaces show the sky's own light, too."


@dataclass
class Outcome:
    """What a bake made: what it came to, the file, and what to tell the user."""

    lit: Lit
    path: Path
    notes: list
    baking: Job

    @property
    def summary(self):
        report = self.lit.report
        shape = " x ".join(map(str, self.lit.domain.shape))
        bands = "1 band" if report.runs == 1 else f"{report.runs} bands"
        return (
            f"Lit {shape} voxels, {bands}, {report.steps} steps in "
            f"{sum(report.seconds.values()):.1f} s on {report.device}"
        )

    @property
    def facts(self):
        """[line]: what the bake came to, for the panel."""
        report, seconds = self.lit.report, self.lit.report.seconds
        shape = " x ".join(map(str, self.lit.domain.shape))
        return [
            f"{shape} voxels of {self.lit.domain.voxel_size:.3g} m, bands: {report.runs}",
            f"{sum(seconds.values()):.1f} s on {report.device}",
            f"{report.steps} steps, {report.corrections} corrections, "
            f"settled to {report.residual:.1%}",
            *([GATHERED.format(seconds["gather"])] if "gather" in seconds else []),
            *([WHOLE] if self.baking.task.whole else []),
            *(self.plan.reasons if self.plan else []),
        ]

    @property
    def plan(self):
        """The `Plan` that it was solved by, or None."""
        return self.lit.plan

    @cached_property
    def field(self):
        """The `Field`, which is read only now: it is large, and most have no use for it."""
        return exchange.load(Path(self.baking.folder.name, FIELD))


def bake(context, objects, options, progress=None):
    """Light the original `objects` of the scene and write the result into it.

    progress  called as progress(stage, fraction)
    Returns an `Outcome`. Raises a LightingError, and then the scene is as it was.
    """
    return run(Baking(context, objects, options), context, progress)


def run(baking, context, progress=None):
    """Bring a `Baking` or a `Sequence` to its end; its `Outcome`. Raises as they do."""
    while True:
        wait(baking, progress)
        outcome = baking.apply(context)
        if outcome is not None:
            return outcome


class Baking(Job):
    """A bake under way: when `update` says that it is done, `apply` is to be called.

    Objects may be renamed, moved, hidden or deleted meanwhile, undone and redone: they are known by
    the number that Blender gives them for the session.

    name  what it is
    kept  what is left of it if it is cancelled now
    """

    name, kept = "bake", "nothing was changed"

    def __init__(self, context, objects, options, frames=None, decided=None, frame=None):
        """Read the scene and start; raises as `gather` does.

        frames   the `Frames` that this is one of, or None
        decided  what another of them has `Decided`, or None
        frame    which of them it is
        """
        objects = sources_of(context.scene, objects)
        volume.require_writable(folder_of(options))
        self.options, self.frames = options, frames
        self.scene = context.scene.session_uid
        path = frames.path(frame) if frames else None
        task = gather(context, objects, options, path, decided, frame)
        self.objects = [source.uid for source in task.sources]
        super().__init__(task)

    def must_wait(self, context):
        """Why the scene cannot take the light at the moment, or None."""
        return why_wait(context, self.found())

    def apply(self, context, looks=None):
        """Write the light into the scene: an `Outcome`. Raises a LightingError for a scene that
        cannot take it any more; then it is as it was, and the file is gone.

        looks  {frame: `Look`} of the frames that are there, of which this is one, or None
        """
        try:
            with overridden(context, self.scene, self.objects) as objects:
                for own in objects:
                    _refuse_unwritable(own)
                volume.require_writable(folder_of(self.options))
                lit = self.result()
                ob = apply(context, objects, self.task, lit, self.frames, looks)
                source = self.task.sources[0]
                if source.is_volume and len(objects) == 1 and self.frames is None:
                    volume.follow(ob, objects[0], source.place)
        except BaseException:
            self.cancel()
            raise
        return Outcome(lit, Path(self.task.path), lit.notes, self)

    def found(self):
        """The objects as they are now, without those that are gone."""
        return find_objects(self.objects)


def find_objects(numbers):
    """The objects that Blender gave these numbers for the session, without those that are gone."""
    wanted = dict.fromkeys(numbers)
    wanted |= {ob.session_uid: ob for ob in bpy.data.objects if ob.session_uid in wanted}
    return [ob for ob in wanted.values() if ob is not None]


def why_wait(context, objects):
    """Why the scene cannot take light on `objects` at the moment, or None."""
    if bpy.app.is_job_running("RENDER"):
        return "Waits for the render to end"
    if context.mode != "OBJECT" and any(ob.mode == "EDIT" for ob in objects):
        return "Waits for Edit Mode to end"
    return None


@contextmanager
def overridden(context, scene, numbers):
    """Inside, `context` has the scene of that number, whatever is in view: the objects of these
    numbers. SceneError where some are gone."""
    scene = next((s for s in bpy.data.scenes if s.session_uid == scene), None)
    objects = [ob for ob in find_objects(numbers) if scene and ob.name in scene.objects]
    if len(objects) < len(numbers):
        raise SceneError("What was being lit has been deleted meanwhile; nothing was changed.")
    with context.temp_override(scene=scene, view_layer=_view_layer(context, scene)):
        yield objects


class Estimating(Job):
    """An estimate under way, with the methods of a `Baking`; it changes nothing."""

    name, kept = "estimate", "nothing was changed"

    def __init__(self, context, objects, options):
        """Read the scene and start; raises as `gather` does."""
        objects = sources_of(context.scene, objects)
        super().__init__(Estimate(gather(context, objects, options)))

    def apply(self, _context):
        """What was found out: an `Expected`."""
        return self.result()


def gather(context, objects, options, path=None, decided=None, frame=None):
    """The task `Light` that the scene poses at a frame.

    path     of the file that it is to write, or None for one that is new
    decided  what another frame has `Decided`, or None
    frame    of the scene, or None for the current one

    Its `sources` are those of `objects` that can be lit; their `uid` tells which. Notes name the
    others.
    """
    decided = decided or Decided()
    around = context.scene.objects.get(options.domain)
    # Blender keeps what it has read of each frame, and may never end with one that is damaged.
    unread = [ob for ob in volume.baked_volumes(context.scene) if ob.data.is_sequence]
    with at_frame(context, [*objects, *filter(None, [around])], frame, unread) as frame:
        depsgraph = context.evaluated_depsgraph_get()
        reader = Reader(
            depsgraph,
            options.medium,
            options.optical_depth,
            options.grid,
            custom=Optics(options.sigma_s, options.sigma_a, options.g),
        )
        sources = open_sources(objects, reader, _refuse_unwritable)
        lit = {source.uid for source in sources}
        objects = [ob for ob in objects if ob.session_uid in lit]
        box = _box(context, options.domain) if options.domain else None
        decided = replace(
            decided, readers=_readers(objects, sources, depsgraph, options, decided, reader.notes)
        )
        readers = [n for n, source in enumerate(sources) if decided.readers[source.name]]
        surfaces = {
            number: attribute.read_vertices(ob, depsgraph, source.is_body, source.is_wall)
            for number, (ob, source) in enumerate(zip(objects, sources, strict=True))
            if source.shows_light and ob.type == "MESH"
            if number not in readers or _keeps_mean(ob, options)
        }
        shining = any(source.shines for source in sources)
        receivers = Receivers.of(objects, sources, depsgraph, box)
        lights = scene_lights(context.scene, depsgraph, reader.notes, not shining, receivers)
        tell_surroundings(depsgraph, lights, receivers, reader.notes, {options.domain})
    if decided.whole is None:
        whole = options.sky and _takes_sky(objects, sources, lights, reader.notes)
        decided = replace(decided, whole=whole)
    reader.notes.extend(_without_mesh(objects, sources))
    return Light(
        options=options,
        sources=sources,
        reader=reader.choice,
        lights=lights,
        box=box,
        surfaces=surfaces,
        readers=readers,
        path=str(path or volume.fresh_path(folder_of(options), objects[0].name)),
        facts={
            "sources": ", ".join(source.name for source in sources),
            "frame": frame,
        },
        decided=decided,
        left_out=[],
        is_frame=path is not None,
    )


def apply(context, objects, task, lit, frames=None, looks=None):
    """Let `objects`, the sources of the task `Light`, show the light that it came to, a `Lit`.

    frames  the `Frames` that it is one of, or None
    looks   {frame: `Look`} of those that are there
    Returns the Volume object that shows it. Raises OutputError for what cannot take it; then the
    scene is as it was.
    """
    how = task.options.strength, task.whole
    surfaces = [objects[number] for number in lit.ambient]
    attribute.write_ambient(surfaces, list(lit.ambient.values()), task.whole)
    shown = _show_volume(context, objects, task, lit, frames, looks)
    for ob in surfaces:
        modifier.remove_modifier(ob)
        shading_surfaces.light_surface(ob, *how)
    for number in lit.readers:
        ob, source = objects[number], task.sources[number]
        if number not in lit.ambient:
            attribute.remove_ambient(ob)
        off = STAND_OFF * lit.domain.voxel_size if source.is_wall else 0.0
        modifier.add_modifier(ob, shown, task.whole, source.is_body, off)
        shading_surfaces.light_surface(ob, *how)
        if source.is_foliage:
            materials = [name and bpy.data.materials.get(name) for name in source.instanced]
            lit.notes.extend(shading_surfaces.light_instances(ob, materials, *how))
    return shown


def _readers(objects, sources, depsgraph, options, decided, notes):
    """{name of a source: whether a modifier is to light it}; what is `decided` stays so."""
    new = [n for n, source in enumerate(sources) if source.name not in decided.readers]
    chosen = options.foliage == "MODIFIER"
    own, of_own = [objects[n] for n in new], [sources[n] for n in new]
    read = modifier.readers(own, of_own, depsgraph, chosen, notes)
    return decided.readers | {source.name: n in read for n, source in enumerate(of_own)}


def _without_mesh(objects, sources):
    """[sentence] on those that could show light, but have nothing to show it on."""
    return [
        f"'{ob.name}' has no mesh of its own to show light on; make its instances real, or "
        "convert it to a mesh."
        for ob, source in zip(objects, sources, strict=True)
        if source.shows_light and ob.type != "MESH"
    ]


def _keeps_mean(ob, options):
    """Whether a mesh that a modifier lights has light on its vertices, too.

    Where several objects share it: for those of them that no modifier lights.
    """
    return ob.data.users > 1 and options.foliage != "MODIFIER"


def _takes_sky(objects, sources, lights, notes):
    """Whether surfaces can show the sky's own light, too; if not, the notes say why."""
    showing = {s: ob for ob, s in zip(objects, sources, strict=True) if s.shows_light}
    if not showing:
        return False
    materials = [slot.material for ob in showing.values() for slot in ob.material_slots]
    names = {name for source in showing if source.is_foliage for name in source.instanced}
    materials += [bpy.data.materials.get(name) for name in names if name]
    hindrance = shading_surfaces.hindrance(materials)
    for hinders, reason in (
        (
            not all(isinstance(light, Sky) for light in lights),
            "a lamp, or a sun in the sky, shines",
        ),
        (any(source.shines for source in sources), "fire shines"),
        (any(source.is_body for source in showing), "a solid shows light"),
        (hindrance, hindrance),
    ):
        if hinders:
            notes.append(f"The sky's own light was not baked, for {reason}; Cycles adds it.")
            return False
    return True


def is_lit(scene):
    """True where something in the scene shows light of a bake."""
    return bool(volume.baked_volumes(scene)) or any(map(shading_surfaces.is_lit, scene.objects))


def sources_of(scene, objects):
    """`objects` with each baked volume replaced by the objects whose light it shows."""
    mend()
    baked = volume.baked_volumes(scene)
    found = {}  # keeps the order
    for ob in objects:
        sources = sources_shown_by(scene, ob) if ob in baked else []
        found.update(dict.fromkeys(sources or [ob]))
    return list(found)


def _refuse_unwritable(ob):
    """Raise OutputError, before any work, for an object that could not take its light."""
    if not ob.is_editable:
        raise OutputError(f"'{ob.name}' is linked from another file; make it local.")
    if ob.type == "MESH":
        attribute.refuse_unwritable([ob])
        shading_surfaces.refuse_unwritable([ob])


def _box(context, name):
    """(lower, upper), each (3,) m: the bounds of the object `name` in world space."""
    ob = context.scene.objects.get(name)
    if ob is None:
        raise SettingsError(f"There is no object '{name}' to light the bounds of; choose another.")
    corners = np.array(ob.bound_box)
    lower, upper = box_bounds(corners.min(axis=0), corners.max(axis=0), np.array(ob.matrix_world))
    if not np.isfinite([lower, upper]).all():
        raise SettingsError(
            f"The domain '{name}' has a location, rotation or scale that is not a number; clear it."
        )
    if not np.ptp([lower, upper], axis=0).any():
        raise SettingsError(f"The domain '{name}' has no size of its own; choose a mesh.")
    return lower, upper


def folder_of(options):
    """The folder that the files go to."""
    if not options.folder:
        return volume.default_folder()
    return Path(bpy.path.abspath(options.folder)).absolute()


def _view_layer(context, scene):
    """The one in use, or the first of a scene that is not in view."""
    return context.view_layer if context.scene == scene else scene.view_layers[0]


def _show_volume(context, objects, task, lit, frames, looks):
    """A Volume object for the file; it renders only where it stands for volumes."""
    ob = volume.show_volume(context, objects, task.path, frames)
    others = len(looks or ()) > 1  # frames, which may show what is left out of this one
    # An older bake may have had more sources than this one; they have no light now.
    gone = [s for s in sources_shown_by(context.scene, ob) if s not in objects and not others]
    release(context, gone + lost_sources(context.scene), [])
    mode = task.options.mode
    looks = looks or {task.facts["frame"]: lit.look}
    shading_volumes.shade_frames(ob, mode, looks, task.options.strength)
    lost = {task.sources[number] for number in lit.left_out}
    volumes = any(source.is_volume for source in task.sources if source not in lost)
    if volumes or not others:
        ob.hide_render = ob.hide_viewport = not volumes
    for own, source in zip(objects, task.sources, strict=True):
        if source in lost and others:
            continue
        if source.is_volume and mode == "REPLACE" and source not in lost:
            # Blender deselects what is hidden; the next bake is to find it all the same.
            ob.select_set(ob.select_get() or own.select_get())
            hide_source(own)
        else:
            show_source(own)
    if volumes:
        prepare_scene(context.scene)
    return ob
