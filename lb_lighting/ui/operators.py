# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake, Estimate, Cancel and Clear: thin shells over `bake.py` and `sequence.py`."""

from typing import TYPE_CHECKING, Any

import bpy
from bpy.props import BoolProperty

from .. import bake, clearing
from ..errors import LightingError
from ..options import Options, properties_of
from ..output import render_settings
from ..reading import scene_of
from ..scene.medium_choice import CUSTOM
from ..sequence import Sequence
from ..tasks.estimate import Expected
from . import running

FAR = 1000  # transport optical depths, for a handover at infinity, which Blender cannot show

if TYPE_CHECKING:
    _Operator = bpy.types.Operator
else:
    _Operator = object  # Blender requires its own class last among the bases

# What running operators return: a set of one word, as in {"FINISHED"}.
type _Status = set[Any]
type _AnyWork = bake.Work[bake.Outcome | bake.Kept | Expected]


class _Works(_Operator):
    """Long work: in a window the operator returns at once, in the background it waits."""

    _timer: bpy.types.Timer

    def begin(self, context: bpy.types.Context) -> _AnyWork:
        """Start the work."""
        raise NotImplementedError

    @classmethod
    def poll(cls, context: Any) -> bool:
        why = running.why_not(context)
        if why is None and context.mode != "OBJECT":
            why = "Switch to Object Mode: light is baked for whole objects"
        if why is not None:
            cls.poll_message_set(why)
        return why is None

    def execute(self, context: Any) -> _Status:
        windows = _windows(context)
        windows.progress_begin(0, 100)
        try:
            outcome = bake.run(
                self.begin(context),
                context,
                lambda _stage, fraction: windows.progress_update(100 * fraction),
            )
        except LightingError as error:
            return self._refuse(error)
        finally:
            windows.progress_end()
        return self._finish(outcome)

    def invoke(self, context: Any, _event: Any) -> _Status:
        if bpy.app.background:
            return self.execute(context)
        try:
            running.start(self.begin(context))
        except LightingError as error:
            return self._refuse(error)
        windows = _windows(context)
        self._timer = windows.event_timer_add(running.INTERVAL, window=context.window)
        windows.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> _Status:
        if running.baking is None:  # Cancel was pressed
            return self._leave(context, {"CANCELLED"})
        if event.type == "ESC" and event.value == "PRESS":
            running.stop("was cancelled")
            return self._leave(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            outcome = self._outcome(context)
        except LightingError as error:
            return self._leave(context, self._refuse(error))
        except Exception:  # a defect, which Blender shows; the next bake must still be possible
            running.stop("failed")
            self._leave(context, set())
            raise
        if outcome is None:
            return {"PASS_THROUGH"}
        return self._leave(context, self._finish(outcome))

    def cancel(self, context: Any) -> None:
        """Blender calls this when the operator ends with its window or its file."""
        running.stop("was stopped because its window closed")
        self._leave(context, set())

    def _outcome(self, context: bpy.types.Context) -> bake.Outcome | bake.Kept | Expected | None:
        """The outcome, or None while the work is not done."""
        assert running.baking is not None
        if not running.baking.update():
            running.show()
            return None
        waiting = running.baking.must_wait(context)
        running.show(waiting)
        return None if waiting else running.baking.apply(context)

    def _leave(self, context: bpy.types.Context, status: _Status) -> _Status:
        _windows(context).event_timer_remove(self._timer)
        return status

    def _refuse(self, error: LightingError) -> _Status:
        self.report({"ERROR"}, str(error))
        running.finish([str(error)], error=True)
        return {"CANCELLED"}

    def _finish(self, outcome: bake.Outcome | bake.Kept | Expected) -> _Status:
        for note in outcome.notes:
            self.report({"WARNING"}, note)
        self.report({"INFO"}, outcome.summary)
        running.plan = outcome.plan or running.plan
        running.finish([*outcome.report_lines, *outcome.notes])
        return {"FINISHED"}


def _windows(context: bpy.types.Context) -> bpy.types.WindowManager:
    assert context.window_manager is not None
    return context.window_manager


class LB_OT_bake(_Works, bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Bake light into the selected volumes, smoke domains and meshes at the current frame"""

    bl_idname = "lb_lighting.bake"
    bl_label = "Bake LB Light"
    bl_options = {"REGISTER", "UNDO"}

    def begin(self, context: bpy.types.Context) -> _AnyWork:
        options = Options.of(scene_of(context))
        return bake.Baking(context, running.selected(context), options)


class LB_OT_bake_animation(_Works, bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Bake the light of every frame in the scene's frame range, into a sequence of .vdb files. \
Frames that are already baked are kept"""

    bl_idname = "lb_lighting.bake_animation"
    bl_label = "Bake LB Light Animation"
    bl_options = {"REGISTER", "UNDO"}

    def begin(self, context: bpy.types.Context) -> _AnyWork:
        scene = scene_of(context)
        options, overwrite = Options.of(scene), properties_of(scene).overwrite
        first, last = scene.frame_start, scene.frame_end
        return Sequence(context, running.selected(context), options, first, last, overwrite)


class LB_OT_estimate(_Works, bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Estimate the voxels, memory and time of a bake, and show how dense the medium is"""

    bl_idname = "lb_lighting.estimate"
    bl_label = "Estimate LB Light"
    bl_options = {"REGISTER"}

    def begin(self, context: bpy.types.Context) -> _AnyWork:
        options = Options.of(scene_of(context))
        return bake.Estimating(context, running.selected(context), options)


class LB_OT_customize(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Set the quality to Custom and copy the planned settings, to change them by hand"""

    bl_idname = "lb_lighting.customize"
    bl_label = "Customize"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if running.plan is None:
            cls.poll_message_set("Estimate or bake first, with a quality other than Custom")
        return running.plan is not None

    def execute(self, context: Any) -> _Status:
        assert running.plan is not None
        settings, planned = properties_of(scene_of(context)), running.plan.settings
        settings.quality = CUSTOM
        settings.photons = planned.photons or 0
        settings.handover = min(planned.handover, FAR)
        for name in ("scattering", "rays", "merge", "tolerance"):
            setattr(settings, name, getattr(planned, name))
        return {"FINISHED"}


class LB_OT_cancel(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Cancel the running bake or estimate"""

    bl_idname = "lb_lighting.cancel"
    bl_label = "Cancel LB Light"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if running.baking is None:
            cls.poll_message_set("Nothing is running")
        return running.baking is not None

    def execute(self, _context: Any) -> _Status:
        running.stop("was cancelled")
        return {"FINISHED"}


class LB_OT_clear(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Remove LB light from the scene and restore what bakes changed"""

    bl_idname = "lb_lighting.clear"
    bl_label = "Clear LB Light"
    bl_options = {"REGISTER", "UNDO"}

    delete_files: BoolProperty(  # type: ignore[valid-type] # Blender's way to declare properties
        name="Delete Files",
        description="Delete the baked .vdb files too. Undo cannot restore them",
    )

    def execute(self, context: Any) -> _Status:
        cleared = clearing.clear(context)
        if not cleared.count:
            self.report({"INFO"}, "Nothing to clear: this scene has no LB light")
            return {"CANCELLED"}
        try:
            notes = cleared.delete_files() if self.delete_files else []
        except LightingError as error:  # the scene is cleared, a file is left
            notes = [str(error)]
        for note in notes:
            self.report({"WARNING"}, note)
        self.report({"INFO"}, cleared.summary)
        return {"FINISHED"}


class LB_OT_use(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Turn off the Cycles bounces that LB light replaces. Press again to restore them"""

    bl_idname = "lb_lighting.use"
    bl_label = "Use LB Light"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not hasattr(context.scene, "cycles"):
            cls.poll_message_set("Enable the Cycles add-on")
            return False
        if not (render_settings.uses_light(context.scene) or bake.is_lit(scene_of(context))):
            cls.poll_message_set("Bake LB light first")
            return False
        return True

    def execute(self, context: Any) -> _Status:
        if render_settings.uses_light(context.scene):
            render_settings.leave_light(context.scene)
            self.report({"INFO"}, "The render settings were restored")
        else:
            render_settings.use_light(context.scene)
            self.report({"INFO"}, "The render settings were set for LB light")
        return {"FINISHED"}


_CLASSES = (
    LB_OT_bake,
    LB_OT_bake_animation,
    LB_OT_estimate,
    LB_OT_customize,
    LB_OT_cancel,
    LB_OT_clear,
    LB_OT_use,
)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
