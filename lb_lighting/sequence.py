# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking the frames of an animation, one after the other, into a .vdb sequence.

A frame that is baked already is kept if the scene at that frame has not changed since, so frames of
different bakes never mix. Other processes may bake the same frames into the same folder.
"""

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy

from .bake import Baking, Kept, Outcome, find_objects, overridden, why_wait
from .errors import EmptyError, OutputError, SceneError
from .options import Options
from .ours import is_overridden
from .output import shading_volumes, volume
from .output.keys import are_keyed
from .output.look import Look
from .output.vdb import link_or_copy, read_whole, write_empty
from .reading import Objects, folder_of, read_scene, scene_of, sources_of
from .showing import Looks
from .tasks.result import CACHE_KEY, LIGHTS, LOOK, SOURCES, SequenceChoices

EMPTY = "empty"  # in a file's metadata: why there is nothing to light
# Why a frame is baked again, by the first of its cache_keys that differs.
REASONS = {
    CACHE_KEY: "the settings have changed",
    LIGHTS: "the lamps or the world have changed",
    SOURCES: "the lit objects have changed",
}
UNREADABLE = "they are damaged, or come from an earlier version"


class Sequence:
    """A bake of frames under way, with the methods of a `Baking`.

    Frames that are baked already are compared with the scene first. Then all others are baked, one
    step at each `apply`. Blender never reads a path twice, so if a frame differs, all frames go to
    a new folder.
    """

    name = "bake"

    def __init__(
        self,
        context: bpy.types.Context,
        objects: Iterable[bpy.types.Object],
        options: Options,
        first: int,
        last: int,
        overwrite: bool = False,
    ) -> None:
        """Start with the first frame; raises as `Baking` does.

        first, last  frames of the scene
        overwrite    bake frames again that are baked already
        """
        if last < first:
            raise SceneError("The last frame comes before the first; correct the frame range.")
        scene = scene_of(context)
        sources = sources_of(scene, objects)
        self.options, self.scene = options, scene.session_uid
        self.objects = [ob.session_uid for ob in sources]
        shown: Path | None = None if overwrite else volume.frames_folder(scene, sources)
        folder: Any = shown if shown and shown.is_dir() else None  # None only until `_begin`
        self.frames = volume.Frames(folder, first, last)
        self.is_unused = False  # whether the folder is new, and nothing shows it yet
        self.unchecked = [n for n in self.frames if folder and self.frames.path(n).exists()]
        self.baked: dict[int, Look | None] = {}  # frames up to date; None for an empty one
        self.kept_frames: list[int] = []
        self.outdated: dict[int, str] = {}  # {frame: why} of those to be baked again
        self.empty: dict[int, dict[str, Any]] = {}  # {frame: metadata} of those found to be empty
        self.missing: list[int] = []
        self.total = 0
        self.notes: dict[str, None] = {}  # in order, each once
        self.choices = SequenceChoices()
        self.baking: Baking | None = None
        self.outcome: Outcome | None = None
        if not self.unchecked:
            try:
                self._begin(context, sources)
                self._start_next(context, sources)
            except BaseException:
                self._drop_unused()
                raise

    @property
    def status(self) -> tuple[str, float]:
        """(what it is doing, fraction from 0 to 1)."""
        if self.unchecked:
            return f"Frame {self.unchecked[0]}: Checking for changes", 0.0
        if not self.baking:
            return "Starting", self._done / max(self.total, 1)
        stage, fraction = self.baking.status
        return f"Frame {self.missing[0]}: {stage}", (self._done + fraction) / self.total

    @property
    def kept(self) -> str:
        """What is left of it if it is cancelled now."""
        if self.outcome is None:
            return "nothing was changed"
        return f"{self._done} of {self.total} frames are baked and kept"

    @property
    def _done(self) -> int:
        return self.total - len(self.missing)

    @property
    def seconds_left(self) -> float | None:
        """An estimate, or None."""
        left = self.baking.seconds_left if self.baking else None
        if self.baking is None or left is None or self.baking.status[1] >= 1:
            return None
        return left + left / (1 - self.baking.status[1]) * (len(self.missing) - 1)

    def update(self, wait: float = 0.0) -> bool:
        """As `Baking.update`, of the frame that is being lit."""
        if self.baking is None:
            return True
        try:
            return self.baking.update(wait)
        except EmptyError as error:
            self._pass_over(error, self.baking.task.cache_keys())
            self.baking = None
            return True
        except BaseException:
            self._drop_unused()
            raise

    def must_wait(self, context: bpy.types.Context) -> str | None:
        """As `Baking.must_wait`."""
        return why_wait(context, find_objects(self.objects))

    def cancel(self) -> None:
        """End the frame that is being lit; those before it stay."""
        if self.baking:
            self.baking.cancel()
        self._drop_unused()

    def apply(self, context: bpy.types.Context) -> Outcome | Kept | None:
        """Take the next step: None, or the outcome if it was the last.

        Raises as `Baking.apply` does; SceneError if all frames are baked already, or empty.
        """
        try:
            with overridden(context, self.scene, self.objects) as objects:
                if self.unchecked:
                    self._compare(context, objects, self.unchecked.pop(0))
                    if self.unchecked:
                        return None
                    self._begin(context, objects)
                if self.baking:
                    self._show(context, self.baking)
                if not self.missing:
                    return self._finish(context, objects)
                self._start_next(context, objects)
                return None
        except BaseException:
            self.cancel()
            raise

    def _compare(self, context: bpy.types.Context, objects: Objects, frame: int) -> None:
        """Keep the file of a frame, or note why it is to be baked again."""
        metadata = read_whole(self.frames.path(frame))
        self.outdated.pop(frame, None)
        if not metadata.keys() >= REASONS.keys():
            self.outdated[frame] = UNREADABLE
        elif metadata[CACHE_KEY] != self.options.cache_key:  # no need to read the scene
            self.outdated[frame] = REASONS[CACHE_KEY]
        else:
            choices = SequenceChoices.read(metadata)
            now = self._cache_keys(context, objects, frame, choices)
            changed = [why for name, why in REASONS.items() if metadata[name] != now[name]]
            if changed:
                self.outdated[frame] = changed[0]
                return
            self.baked[frame] = None if EMPTY in metadata else Look.read(metadata[LOOK])
            self.kept_frames.append(frame)
            if self.choices == SequenceChoices():
                self.choices = choices

    def _cache_keys(
        self, context: bpy.types.Context, objects: Objects, frame: int, choices: SequenceChoices
    ) -> dict[str, str]:
        """Those of `BakeTask.cache_keys`, as the scene is at a frame now."""
        try:
            path = self.frames.path(frame)
            task = read_scene(context, objects, self.options, path, choices, frame=frame)
            return task.cache_keys()
        except EmptyError:
            return self._cache_keys_of_nothing

    @property
    def _cache_keys_of_nothing(self) -> dict[str, str]:
        return {CACHE_KEY: self.options.cache_key, LIGHTS: EMPTY, SOURCES: EMPTY}

    def _begin(self, context: bpy.types.Context, objects: Objects) -> None:
        """Choose the folder and the frames to bake, once all baked frames are compared."""
        if self.frames.folder is None or self.outdated:
            self._move(objects)
        elif not self.baked:
            self.choices = _choices(self.frames.folder, self.options)
        self.missing = [n for n in self.frames if n not in self.baked]
        self.total = len(self.missing)

    def _start_next(self, context: bpy.types.Context, objects: Objects) -> None:
        """Start to light the first missing frame, or find that it need not be lit."""
        frame = self.missing[0]
        if self.frames.path(frame).exists():  # another process baked it meanwhile
            self._compare(context, objects, frame)
            if frame in self.baked:
                self.missing.pop(0)
                return
            self._move(objects)
        try:
            self.baking = Baking(
                context, objects, self.options, self.frames, self.choices, frame=frame
            )
        except EmptyError as error:
            self._pass_over(error, self._cache_keys_of_nothing)

    def _show(self, context: bpy.types.Context, baking: Baking) -> None:
        """Show the frame that is lit."""
        frame, result = self.missing[0], baking.result()
        self._write_empty(self.frames.path(frame))
        self.outcome = baking.apply(context, self._looks | {frame: result.look})
        self.is_unused = False
        self.baked[self.missing.pop(0)] = result.look
        self.notes |= dict.fromkeys(self.outcome.notes)
        # All frames share one plan, because changes from frame to frame would flicker.
        settings = result.plan.settings if result.plan else self.choices.settings
        task = baking.task
        self.choices = SequenceChoices(
            settings, result.iterations, task.all_light, task.choices.readers
        )
        self.baking = None

    @property
    def _looks(self) -> Looks:
        return {frame: look for frame, look in self.baked.items() if look is not None}

    def _pass_over(self, error: EmptyError, cache_keys: dict[str, str]) -> None:
        """Note that the first missing frame is empty; its file is written like that of another."""
        self.empty[self.missing.pop(0)] = {**cache_keys, EMPTY: str(error)}

    def _write_empty(self, like: Path) -> list[int]:
        """Write the files of the empty frames with the grids of the file `like`: these frames."""
        waiting = [frame for frame in self.empty if frame not in self.baked]
        for frame in waiting:
            write_empty(self.frames.path(frame), self.empty[frame], like)
            self.baked[frame] = None
        return waiting

    def _finish(self, context: bpy.types.Context, objects: Objects) -> Outcome | Kept:
        """The outcome, once all frames are baked."""
        if not self._looks:
            reason = self._why_empty("Choose other frames.")
            raise SceneError(f"There is nothing to light in {_named(list(self.frames))}. {reason}")
        like = self.frames.path(next(iter(self._looks)))
        written = self._write_empty(like)
        first, last = self.frames.first, self.frames.last
        if not self.total and volume.shows(scene_of(context), objects, self.frames):
            raise SceneError(
                f"The frames {first} to {last} are all baked; choose Overwrite Frames to bake them "
                "again."
            )
        if self.outcome is None or self.is_unused or written:
            # Use a path other than the latest, so that Blender looks for files again.
            path = self.frames.path(written[-1]) if written else like
            ob = volume.show_volume(context, objects, path, self.frames)
            shading_volumes.shade_frames(ob, self.options.mode, self._looks, self.options.strength)
            self.is_unused = False
        outcome = self.outcome or Kept(f"The frames {first} to {last} are all baked", like)
        outcome.notes = [*self._remarks(objects), *self.notes]
        return outcome

    def _why_empty(self, default: str) -> str:
        """The sentence on the first empty frame."""
        return next((metadata[EMPTY] for metadata in self.empty.values()), default)

    def _remarks(self, objects: Objects) -> list[str]:
        """Sentences on frames that were not simply baked, and on objects that stay the same."""
        remarks = []
        for reason in dict.fromkeys(self.outdated.values()):
            again = [frame for frame, why in sorted(self.outdated.items()) if why == reason]
            remarks.append(f"Baked again, because {reason}: {_named(again)}.")
        if self.kept_frames:
            remarks.append(
                f"Kept, because nothing has changed: {_named(sorted(self.kept_frames))}."
            )
        empty = sorted(frame for frame, look in self.baked.items() if look is None)
        if empty:
            sentence = f"Empty, so nothing is shown: {_named(empty)}. {self._why_empty('')}"
            remarks.append(sentence.strip())
        if self.outcome and len(self.baked) > 1:
            task, result = self.outcome.baking.task, self.outcome.result
            remarks.extend(
                f"'{task.sources[number].name}' shows the light of the last frame in all frames; "
                "only volumes, and foliage that is lit by the modifier, change from frame to frame."
                for number in result.ambient
                if number not in result.readers
            )
        remarks.extend(
            f"Keyframes show '{ob.name}' again beside its light; remove its visibility keyframes."
            for ob in objects
            if is_overridden(ob, "hide_render") and are_keyed(ob, "hide_viewport", "hide_render")
        )
        return remarks

    def _move(self, objects: Objects) -> None:
        """Go on in a new folder, with the frames that are up to date."""
        volume.require_writable(folder_of(self.options))
        old = self.frames
        name = objects[0].name if objects else ""
        folder = volume.fresh_frames_folder(folder_of(self.options), name)
        try:
            folder.mkdir()
        except OSError as error:
            raise OutputError(
                f"The folder {folder} could not be created; choose one that is writable."
            ) from error
        self.frames = volume.Frames(folder, old.first, old.last)
        self.is_unused = True
        for frame in self.baked:
            _link(old.path(frame), self.frames.path(frame))

    def _drop_unused(self) -> None:
        """Delete the folder if nothing shows it."""
        if self.is_unused:
            for path in volume.Frames.files(self.frames.folder):
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                self.frames.folder.rmdir()


def _choices(folder: Path, options: Options) -> SequenceChoices:
    """The `SequenceChoices` of other frames in `folder` that have the same options."""
    for path in volume.Frames.files(folder):
        metadata = read_whole(path)
        if metadata.get(CACHE_KEY) == options.cache_key and EMPTY not in metadata:
            return SequenceChoices.read(metadata)
    return SequenceChoices()


def _link(old: Path, new: Path) -> None:
    """Make the file `old` available as `new` too."""
    try:
        link_or_copy(old, new)
    except OSError as error:
        raise OutputError(
            f"{new} could not be written; choose a folder that is writable and has free space."
        ) from error


def _named(frames: list[int]) -> str:
    """A text like: frames 1 to 3, 5."""
    spans: list[list[int]] = []
    for frame in frames:
        if spans and frame == spans[-1][1] + 1:
            spans[-1][1] = frame
        else:
            spans.append([frame, frame])
    texts = [str(a) if a == b else f"{a} to {b}" for a, b in spans]
    return f"frame{'s' * (len(frames) > 1)} {', '.join(texts)}"
