# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of an animation, baked one after the other into a .vdb sequence."""

import contextlib
from pathlib import Path

from .bake import Baking, folder_of, sources_of
from .errors import OutputError, SceneError
from .output import volume
from .output.vdb import read_metadata
from .tasks.light import ESSENCE, GATHERED, WHOLE, Decided

MOVING = "Lamps move; each frame has its own light, but the shader has them as in the first frame."


class Sequence:
    """A bake of frames under way, with the methods of a `Baking`.

    Frames that are there already are kept, so a bake that was ended goes on where it was.
    """

    name = "bake"

    def __init__(self, context, objects, options, first, last, overwrite=False):
        """Start with the first frame that is missing; raises as `Baking` does.

        first, last  frames of the scene
        overwrite    bake those that are there, too
        """
        if last < first:
            raise SceneError("The last frame comes before the first; correct the frame range.")
        objects = sources_of(context.scene, objects)
        folder = self._folder(context.scene, objects, options, overwrite)
        self.frames = volume.Frames(folder, first, last)
        self.options = options
        self.objects = [ob.name for ob in objects]
        self.missing = [n for n in self.frames if not self.frames.path(n).exists()]
        self.total = len(self.missing)
        if not self.missing:
            raise SceneError(
                f"The frames {first} to {last} are all baked; choose Overwrite Frames to bake them "
                "again."
            )
        self.notes = {}  # in order, each once
        self.ways = None
        self.decided = _decided(folder)
        try:
            self._start_next(context, objects)
        except BaseException:
            self._drop_empty()
            raise

    @property
    def status(self):
        """(what it is doing, fraction from 0 to 1)."""
        stage, fraction = self.baking.status
        return f"Frame {self.missing[0]}: {stage}", (self._done + fraction) / self.total

    @property
    def kept(self):
        """As of a `Baking`."""
        if not self._done:
            return self.baking.kept
        return f"{self._done} of {self.total} frames are done and stay"

    @property
    def _done(self):
        return self.total - len(self.missing)

    @property
    def seconds_left(self):
        """An estimate, or None."""
        left = self.baking.seconds_left
        fraction = self.baking.status[1]
        if left is None or fraction >= 1:
            return None
        return left + left / (1 - fraction) * (len(self.missing) - 1)

    def update(self, wait=0.0):
        """As `Baking.update`, of the frame that is being lit."""
        return self.baking.update(wait)

    def must_wait(self, context):
        """As `Baking.must_wait`."""
        return self.baking.must_wait(context)

    def cancel(self):
        """End the frame that is being lit; those before it stay."""
        self.baking.cancel()
        self._drop_empty()

    def apply(self, context):
        """Show the frame that is done, and start the next: None, or the last one's `Outcome`."""
        outcome = self.baking.apply(context)
        self.notes |= dict.fromkeys(outcome.notes)
        ways = [_way(beam) for beam in outcome.lit.beams]
        self.ways = self.ways or ways
        if ways != self.ways:
            self.notes[MOVING] = None
        lit, settings = outcome.lit, self.decided.settings
        if lit.plan:  # one plan for all: what differed from frame to frame would flicker
            settings = lit.plan.settings
        task = self.baking.task
        self.decided = Decided(settings, lit.times, task.whole, task.readers)
        self.missing.pop(0)
        if self.missing:
            self._start_next(context, self.baking.found())
            return None
        outcome.notes = list(self.notes)
        return outcome

    def _start_next(self, context, objects):
        scene, shown = context.scene, context.scene.frame_current
        scene.frame_set(self.missing[0])
        try:
            self.baking = Baking(context, objects, self.options, self.frames, self.decided)
        finally:
            scene.frame_set(shown)

    def _drop_empty(self):
        with contextlib.suppress(OSError):  # there are frames in it
            self.frames.folder.rmdir()

    def _folder(self, scene, objects, options, overwrite):
        """Where the frames are, or are to be: Blender never reads a path again, so what is to be
        baked anew goes to a new folder."""
        found = volume.frames_folder(scene, objects)
        if found and found.is_dir() and not overwrite and _is_alike(found, options):
            return found
        fresh = volume.fresh_frames_folder(folder_of(options), objects[0].name)
        try:
            fresh.mkdir()
        except OSError as error:
            raise OutputError(
                f"The folder {fresh} could not be made; choose one that is writable."
            ) from error
        return fresh


def _way(beam):
    """What the shader knows of a beam."""
    return getattr(beam, "direction", None), getattr(beam, "position", None)


def _is_alike(folder, options):
    """Whether the frames in `folder` were baked with the same options."""
    return all(stamp.get(ESSENCE) == options.essence for stamp in _stamps(folder))


def _decided(folder):
    """What the frames in `folder` have `Decided`."""
    stamp = next(_stamps(folder), {})
    return Decided(times=stamp.get(GATHERED), whole=stamp.get(WHOLE))


def _stamps(folder):
    return map(read_metadata, Path(folder).glob("frame_*.vdb"))
