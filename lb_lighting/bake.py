# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes: read a scene, light it in the solver's process, and write the light into the scene.

Operators, the command line and the tests start here. `read_scene` reads the scene in one go, and
`Baking.apply` writes into it in one go, once the whole result is on disk. In between, the user can
work on in Blender.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, cast

import bpy

from . import exchange
from .errors import SceneError
from .job import Job, Waitable, wait
from .options import Options
from .output import shading_surfaces, volume
from .reading import Objects, folder_of, read_scene, refuse_unwritable, scene_of, sources_of
from .showing import Looks, apply
from .tasks.bake import FIELD, BakeTask
from .tasks.estimate import Estimate, Expected
from .tasks.result import BakeResult, SequenceChoices
from .transport.field import Field
from .transport.planning.planner import Plan

DIRECTIONAL = "Directional scattering took {:.1f} s."
ALL_LIGHT = "Surfaces also show the direct light of the sky."


@dataclass
class Outcome:
    """The outcome of a bake: its result, its file, and notes for the user."""

    result: BakeResult
    path: Path
    notes: list[str]
    baking: "Baking"

    @property
    def summary(self) -> str:
        report = self.result.report
        bands = "1 colour band" if report.runs == 1 else f"{report.runs} colour bands"
        return (
            f"Lit {self._shape} voxels, {bands}, {report.steps} steps in "
            f"{sum(report.seconds.values()):.1f} s on {report.device}"
        )

    @property
    def report_lines(self) -> list[str]:
        """The figures of the bake, for the panel."""
        report, seconds = self.result.report, self.result.report.seconds
        return [
            f"{self._shape} voxels of {self.result.domain.voxel_size:.3g} m, "
            f"colour bands: {report.runs}",
            f"{sum(seconds.values()):.1f} s on {report.device}",
            f"Lattice: {report.steps} steps, {report.corrections} corrections, "
            f"residual {report.residual:.1%}",
            *([DIRECTIONAL.format(seconds["gather"])] if "gather" in seconds else []),
            *([ALL_LIGHT] if self.baking.task.all_light else []),
            *(self.plan.reasons if self.plan else []),
        ]

    @property
    def plan(self) -> Plan | None:
        """The `Plan` of the solve, or None."""
        return self.result.plan

    @cached_property
    def field(self) -> Field:
        """The `Field`. It is large and rarely needed, so it is read only now."""
        return cast(Field, exchange.load(Path(self.baking.folder.name, FIELD)))

    @property
    def _shape(self) -> str:
        return " x ".join(map(str, self.result.domain.shape))


@dataclass
class Kept:
    """The outcome of a bake that had nothing left to do, with the members of an `Outcome`."""

    summary: str
    path: Path
    notes: list[str] = field(default_factory=list)
    report_lines: list[str] = field(default_factory=list)
    plan: None = None


class Work[Result](Waitable, Protocol):
    """Work under way: a `Baking`, a `Sequence` or an `Estimating`.

    name  what it is
    kept  what is left of it if it is cancelled now
    """

    @property
    def name(self) -> str: ...

    @property
    def kept(self) -> str: ...

    @property
    def seconds_left(self) -> float | None:
        """An estimate, or None."""

    def must_wait(self, context: bpy.types.Context, /) -> str | None:
        """Why `apply` has to wait, or None."""

    def apply(self, context: bpy.types.Context, /) -> Result | None:
        """Take the step that is ready: the outcome, or None if there is more to do."""


def bake(
    context: bpy.types.Context,
    objects: Iterable[bpy.types.Object],
    options: Options,
    progress: Callable[[str, float], None] | None = None,
) -> Outcome:
    """Light the original `objects` of the scene and write the result into it.

    progress  called as progress(stage, fraction)
    Returns an `Outcome`. Raises a LightingError, and then the scene is unchanged.
    """
    return run(Baking(context, objects, options), context, progress)


def run[Result](
    work: Work[Result],
    context: bpy.types.Context,
    progress: Callable[[str, float], None] | None = None,
) -> Result:
    """Run work to its end; its outcome. Raises as its methods do."""
    while True:
        wait(work, progress)
        outcome = work.apply(context)
        if outcome is not None:
            return outcome


class Baking(Job):
    """A bake under way. Once `update` says that it is done, call `apply`.

    Objects may be renamed, moved, hidden, deleted, undone and redone meanwhile: they are known by
    the number that Blender gives them for the session.
    """

    name, kept = "bake", "nothing was changed"
    task: BakeTask

    def __init__(
        self,
        context: bpy.types.Context,
        objects: Iterable[bpy.types.Object],
        options: Options,
        frames: volume.Frames | None = None,
        choices: SequenceChoices | None = None,
        frame: int | None = None,
    ) -> None:
        """Read the scene and start; raises as `read_scene` does.

        frames   the `Frames` that this is one of, or None
        choices  the `SequenceChoices` of those baked before, or None
        frame    which of them it is
        """
        scene = scene_of(context)
        sources = sources_of(scene, objects)
        volume.require_writable(folder_of(options))
        self.options, self.frames = options, frames
        self.scene = scene.session_uid
        path = None if frames is None or frame is None else frames.path(frame)
        task = read_scene(context, sources, options, path, choices, frame)
        self.objects = [source.uid for source in task.sources]
        super().__init__(task)

    def must_wait(self, context: bpy.types.Context) -> str | None:
        """Why the scene cannot take the light at the moment, or None."""
        return why_wait(context, find_objects(self.objects))

    def apply(self, context: bpy.types.Context, looks: Looks | None = None) -> Outcome:
        """Write the light into the scene: an `Outcome`. Raises a LightingError for a scene that
        cannot take it any more; then the scene is unchanged and the file is deleted.

        looks  {frame: `Look`} of the frames that are baked, this one included, or None
        """
        try:
            with overridden(context, self.scene, self.objects) as objects:
                for source_object in objects:
                    refuse_unwritable(source_object)
                volume.require_writable(folder_of(self.options))
                result: BakeResult = self.result()
                ob = apply(context, objects, self.task, result, self.frames, looks)
                source = self.task.sources[0]
                if source.is_volume and len(objects) == 1 and self.frames is None:
                    volume.follow(ob, objects[0], source.place)
        except BaseException:
            self.cancel()
            raise
        return Outcome(result, Path(self.task.path), result.notes, self)


class Estimating(Job):
    """An estimate under way, with the methods of a `Baking`; it changes nothing."""

    name, kept = "estimate", "nothing was changed"

    def __init__(
        self, context: bpy.types.Context, objects: Iterable[bpy.types.Object], options: Options
    ) -> None:
        """Read the scene and start; raises as `read_scene` does."""
        sources = sources_of(scene_of(context), objects)
        super().__init__(Estimate(read_scene(context, sources, options)))

    def apply(self, _context: bpy.types.Context) -> Expected:
        """The `Expected` cost."""
        return cast(Expected, self.result())


def find_objects(numbers: Iterable[int]) -> Objects:
    """The objects that Blender gave these numbers for the session, without those that are gone."""
    by_number: dict[int, bpy.types.Object | None] = dict.fromkeys(numbers)
    by_number |= {ob.session_uid: ob for ob in bpy.data.objects if ob.session_uid in by_number}
    return [ob for ob in by_number.values() if ob is not None]


def why_wait(context: bpy.types.Context, objects: Objects) -> str | None:
    """Why the scene cannot take light on `objects` at the moment, or None."""
    if bpy.app.is_job_running("RENDER"):
        return "Waiting for the render to end"
    if context.mode != "OBJECT" and any(ob.mode == "EDIT" for ob in objects):
        return "Waiting for Edit Mode to end"
    return None


@contextmanager
def overridden(context: bpy.types.Context, number: int, numbers: list[int]) -> Iterator[Objects]:
    """Inside, `context` has the scene of that number, even if another is in view: the objects of
    these numbers. Raises SceneError if some are gone."""
    scene = next((s for s in bpy.data.scenes if s.session_uid == number), None)
    objects = [ob for ob in find_objects(numbers) if scene and ob.name in scene.objects]
    if scene is None or len(objects) < len(numbers):
        raise SceneError(
            "An object to light, or its scene, was deleted during the bake; nothing was changed."
        )
    is_in_view = context.scene == scene
    view_layer = context.view_layer if is_in_view else scene.view_layers[0]
    override: Any = context.temp_override(scene=scene, view_layer=view_layer)
    with override:
        yield objects


def is_lit(scene: bpy.types.Scene) -> bool:
    """True if something in the scene shows light of a bake."""
    return bool(volume.baked_volumes(scene)) or any(map(shading_surfaces.is_lit, scene.objects))
