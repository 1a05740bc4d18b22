# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of an animation, baked one after the other into a .vdb sequence.

A frame that is there is kept where it was made of what the scene is at that frame now, so two
lightings are never mixed. Other processes may bake the same frames into the same folder.
"""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path

from .bake import (
    Baking,
    find_objects,
    folder_of,
    gather,
    overridden,
    sources_of,
    why_wait,
)
from .errors import EmptyError, OutputError, SceneError
from .ours import is_overridden
from .output import shading_volumes, volume
from .output.keys import are_keyed
from .output.look import Look
from .output.vdb import link_or_copy, read_whole, write_empty
from .tasks.light import (
    CACHE_KEY,
    LIGHTS,
    LOOK,
    SOURCES,
    Decided,
)

EMPTY = "empty"  # in a file's metadata: why there is nothing to light
# Why a frame that is there is baked again, by the first of its cache keys that differs.
REASONS = {
    CACHE_KEY: "the settings have changed",
    LIGHTS: "the lamps or the world have changed",
    SOURCES: "what is lit has changed",
}
UNREADABLE = "they are damaged, or of an earlier version"


@dataclass
class Kept:
    """What a bake came to that found nothing left to do; as an `Outcome`."""

    summary: str
    path: Path
    notes: list = field(default_factory=list)
    facts: list = field(default_factory=list)
    plan: None = None


class Sequence:
    """A bake of frames under way, with the methods of a `Baking`.

    Frames that are there are compared with the scene first, then all others are baked, one step at
    each `apply`. Blender never reads a path again: where a frame differs, all go to a new folder.
    """

    name = "bake"

    def __init__(self, context, objects, options, first, last, overwrite=False):
        """Start with the first frame; raises as `Baking` does.

        first, last  frames of the scene
        overwrite    bake those that are there, too
        """
        if last < first:
            raise SceneError("The last frame comes before the first; correct the frame range.")
        objects = sources_of(context.scene, objects)
        self.options, self.scene = options, context.scene.session_uid
        self.objects = [ob.session_uid for ob in objects]
        found = None if overwrite else volume.frames_folder(context.scene, objects)
        found = found if found and found.is_dir() else None
        self.frames = volume.Frames(found, first, last)
        self.is_unused = False  # the folder: it is new, and nothing shows it yet
        self.unknown = [n for n in self.frames if found and self.frames.path(n).exists()]
        self.there = {}  # {frame: its `Look`, None where it is empty} of those that are right
        self.kept_frames = []
        self.again = {}  # {frame: why} of those that are there and are to be baked again
        self.empty = {}  # {frame: metadata} of those that are found to be empty
        self.missing, self.total = [], 0
        self.notes = {}  # in order, each once
        self.decided, self.baking, self.outcome = Decided(), None, None
        if not self.unknown:
            try:
                self._begin(context, objects)
                self._start_next(context, objects)
            except BaseException:
                self._drop_unused()
                raise

    @property
    def status(self):
        """(what it is doing, fraction from 0 to 1)."""
        if self.unknown:
            return f"Frame {self.unknown[0]}: Comparing", 0.0
        if not self.baking:
            return "Starting", self._done / max(self.total, 1)
        stage, fraction = self.baking.status
        return f"Frame {self.missing[0]}: {stage}", (self._done + fraction) / self.total

    @property
    def kept(self):
        """As of a `Baking`."""
        if self.outcome is None:
            return "nothing was changed"
        return f"{self._done} of {self.total} frames are done and stay"

    @property
    def _done(self):
        return self.total - len(self.missing)

    @property
    def seconds_left(self):
        """An estimate, or None."""
        left = self.baking.seconds_left if self.baking else None
        if left is None or self.baking.status[1] >= 1:
            return None
        return left + left / (1 - self.baking.status[1]) * (len(self.missing) - 1)

    def update(self, wait=0.0):
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

    def must_wait(self, context):
        """As `Baking.must_wait`."""
        return why_wait(context, find_objects(self.objects))

    def cancel(self):
        """End the frame that is being lit; those before it stay."""
        if self.baking:
            self.baking.cancel()
        self._drop_unused()

    def apply(self, context):
        """Take the next step: None, or an `Outcome` where it was the last.

        Raises as `Baking.apply` does; SceneError where all frames are baked already, or empty.
        """
        try:
            with overridden(context, self.scene, self.objects) as objects:
                if self.unknown:
                    self._compare(context, objects, self.unknown.pop(0))
                    if self.unknown:
                        return None
                    self._begin(context, objects)
                if self.baking:
                    self._show(context)
                if not self.missing:
                    return self._finish(context, objects)
                self._start_next(context, objects)
                return None
        except BaseException:
            self.cancel()
            raise

    def _compare(self, context, objects, frame):
        """Keep the file of a frame, or note why it is to be baked again."""
        stamp = read_whole(self.frames.path(frame))
        self.again.pop(frame, None)
        if not stamp.keys() >= REASONS.keys():
            self.again[frame] = UNREADABLE
        elif stamp[CACHE_KEY] != self.options.cache_key:  # no need to look at the scene
            self.again[frame] = REASONS[CACHE_KEY]
        else:
            now = self._cache_keys(context, objects, frame, Decided.read(stamp))
            changed = [why for name, why in REASONS.items() if stamp[name] != now[name]]
            if changed:
                self.again[frame] = changed[0]
                return
            self.there[frame] = None if EMPTY in stamp else Look.read(stamp[LOOK])
            self.kept_frames.append(frame)
            if self.decided == Decided():
                self.decided = Decided.read(stamp)

    def _cache_keys(self, context, objects, frame, decided):
        """Those of `Light.cache_keys`, as the scene is at a frame now."""
        try:
            path = self.frames.path(frame)
            task = gather(context, objects, self.options, path, decided, frame=frame)
            return task.cache_keys()
        except EmptyError:
            return self._cache_keys_of_nothing

    @property
    def _cache_keys_of_nothing(self):
        return {CACHE_KEY: self.options.cache_key, LIGHTS: EMPTY, SOURCES: EMPTY}

    def _begin(self, context, objects):
        """All frames that are there are known: settle the folder, and what is to be baked."""
        if self.frames.folder is None or self.again:
            self._move(context, objects)
        elif not self.there:
            self.decided = _decided(self.frames.folder, self.options)
        self.missing = [n for n in self.frames if n not in self.there]
        self.total = len(self.missing)

    def _start_next(self, context, objects):
        """Begin to light the first frame that is missing, or find that there is no need to."""
        frame = self.missing[0]
        if self.frames.path(frame).exists():  # by another process, meanwhile
            self._compare(context, objects, frame)
            if frame in self.there:
                self.missing.pop(0)
                return
            self._move(context, objects)
        try:
            self.baking = Baking(
                context, objects, self.options, self.frames, self.decided, frame=frame
            )
        except EmptyError as error:
            self._pass_over(error, self._cache_keys_of_nothing)

    def _show(self, context):
        """Show the frame that is lit."""
        frame, lit = self.missing[0], self.baking.result()
        self._write_empty(self.frames.path(frame))
        self.outcome = self.baking.apply(context, self._looks | {frame: lit.look})
        self.is_unused = False
        self.there[self.missing.pop(0)] = lit.look
        self.notes |= dict.fromkeys(self.outcome.notes)
        # One plan for all: what differed from frame to frame would flicker.
        settings = lit.plan.settings if lit.plan else self.decided.settings
        task = self.baking.task
        self.decided = Decided(settings, lit.times, task.whole, task.decided.readers)
        self.baking = None

    @property
    def _looks(self):
        return {frame: look for frame, look in self.there.items() if look is not None}

    def _pass_over(self, error, cache_keys):
        """The first frame that is missing is empty; its file waits for one to be like."""
        self.empty[self.missing.pop(0)] = {**cache_keys, EMPTY: str(error)}

    def _write_empty(self, like):
        """Write the files of the frames that are empty, by a whole one: [frame] of these."""
        waiting = [frame for frame in self.empty if frame not in self.there]
        for frame in waiting:
            write_empty(self.frames.path(frame), self.empty[frame], like)
            self.there[frame] = None
        return waiting

    def _finish(self, context, objects):
        """All frames are there: the `Outcome`."""
        if not self._looks:
            reason = next(iter(self.empty.values()), {EMPTY: "Choose other frames."})[EMPTY]
            raise SceneError(f"There is nothing to light in {_named(list(self.frames))}. {reason}")
        like = self.frames.path(next(iter(self._looks)))
        shown_anew = self._write_empty(like)
        first, last = self.frames.first, self.frames.last
        if not self.total and volume.shows(context.scene, objects, self.frames):
            raise SceneError(
                f"The frames {first} to {last} are all baked; choose Overwrite Frames to bake them "
                "again."
            )
        if self.outcome is None or self.is_unused or shown_anew:
            # By a path that is not the latest, for Blender to look for files again.
            path = self.frames.path(shown_anew[-1]) if shown_anew else like
            ob = volume.show_volume(context, objects, path, self.frames)
            shading_volumes.shade_frames(ob, self.options.mode, self._looks, self.options.strength)
            self.is_unused = False
        outcome = self.outcome or Kept(f"The frames {first} to {last} are all baked", like)
        outcome.notes = [*self._remarks(objects), *self.notes]
        return outcome

    def _remarks(self, objects):
        """[sentence] on the frames that were not simply baked, and on what has no frames."""
        found = []
        for reason in dict.fromkeys(self.again.values()):
            again = [frame for frame, why in sorted(self.again.items()) if why == reason]
            found.append(f"Baked again, because {reason}: {_named(again)}.")
        if self.kept_frames:
            found.append(f"Kept as before: {_named(sorted(self.kept_frames))}.")
        empty = sorted(frame for frame, look in self.there.items() if look is None)
        if empty:
            reason = next(iter(self.empty.values()), {EMPTY: ""})[EMPTY]
            found.append(f"Empty, and nothing is shown: {_named(empty)}. {reason}".strip())
        if self.outcome and len(self.there) > 1:
            task, lit = self.outcome.baking.task, self.outcome.lit
            found.extend(
                f"'{task.sources[number].name}' shows the light of the last frame in all of them; "
                "volumes, and foliage that has its light from the modifier, show that of each."
                for number in lit.ambient
                if number not in lit.readers
            )
        found.extend(
            f"The keys of '{ob.name}' show it again beside its light; remove those of its "
            "visibility."
            for ob in objects
            if is_overridden(ob, "hide_render") and are_keyed(ob, "hide_viewport", "hide_render")
        )
        return found

    def _move(self, context, objects):
        """Go on in a new folder, with the frames that are there."""
        volume.require_writable(folder_of(self.options))
        old = self.frames
        name = objects[0].name if objects else ""
        fresh = volume.fresh_frames_folder(folder_of(self.options), name)
        try:
            fresh.mkdir()
        except OSError as error:
            raise OutputError(
                f"The folder {fresh} could not be made; choose one that is writable."
            ) from error
        self.frames = volume.Frames(fresh, old.first, old.last)
        self.is_unused = True
        for frame in self.there:
            _link(old.path(frame), self.frames.path(frame))

    def _drop_unused(self):
        """Delete the folder where nothing shows it."""
        if self.is_unused:
            for path in volume.Frames.files(self.frames.folder):
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                self.frames.folder.rmdir()


def _decided(folder, options):
    """What other frames in `folder` have `Decided`, if they were baked with the same options."""
    for path in volume.Frames.files(folder):
        stamp = read_whole(path)
        if stamp.get(CACHE_KEY) == options.cache_key and EMPTY not in stamp:
            return Decided.read(stamp)
    return Decided()


def _link(old, new):
    """Let the file `old` be found at `new`, too."""
    try:
        link_or_copy(old, new)
    except OSError as error:
        raise OutputError(
            f"{new} could not be written; choose a folder that is writable and has free space."
        ) from error


def _named(frames):
    """A text like: frames 1 to 3, 5."""
    spans = []
    for frame in frames:
        if spans and frame == spans[-1][1] + 1:
            spans[-1][1] = frame
        else:
            spans.append([frame, frame])
    texts = [str(a) if a == b else f"{a} to {b}" for a, b in spans]
    return f"frame{'s' * (len(frames) > 1)} {', '.join(texts)}"
