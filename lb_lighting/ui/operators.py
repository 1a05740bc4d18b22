# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake, Estimate, Cancel and Clear: thin shells over `bake.py` and `sequence.py`."""

import bpy
from bpy.props import BoolProperty

from .. import bake, clearing
from ..errors import LightingError
from ..output import shading_volumes
from ..scene.reader import CUSTOM
from ..sequence import Sequence
from . import running

FAR = 1000  # transport optical depths, in place of a handover at infinity, which Blender has not


class _Works:
    """What long work has in common: in a window it returns at once, in background it waits.

    `begin(context)` returns the `Baking`, `Sequence` or `Estimating` to be run.
    """

    @classmethod
    def poll(cls, context):
        why = running.why_not(context)
        if why is None and context.mode != "OBJECT":
            why = "Leave the mode that the object is in: light is for whole objects"
        if why is not None:
            cls.poll_message_set(why)
        return why is None

    def execute(self, context):
        windows = context.window_manager
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

    def invoke(self, context, _event):
        if bpy.app.background:
            return self.execute(context)
        try:
            running.start(self.begin(context))
        except LightingError as error:
            return self._refuse(error)
        windows = context.window_manager
        self._timer = windows.event_timer_add(running.INTERVAL, window=context.window)
        windows.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if running.baking is None:  # Cancel was pressed
            return self._leave(context, {"CANCELLED"})
        if event.type == "ESC" and event.value == "PRESS":
            running.stop("was cancelled")
            return self._leave(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            outcome = self._look(context)
        except LightingError as error:
            return self._leave(context, self._refuse(error))
        except Exception:  # a defect, which Blender shows; it must not block the next bake
            running.stop("failed")
            self._leave(context, set())
            raise
        if outcome is None:
            return {"PASS_THROUGH"}
        return self._leave(context, self._finish(outcome))

    def cancel(self, context):
        """Blender's way to say that the operator ends with its window or its file."""
        running.stop("was ended with its window")
        self._leave(context, set())

    def _look(self, context):
        """The `Outcome` where the bake has come to its end."""
        if not running.baking.update():
            running.show()
            return None
        waits = running.baking.must_wait(context)
        running.show(waits)
        return None if waits else running.baking.apply(context)

    def _leave(self, context, result):
        context.window_manager.event_timer_remove(self._timer)
        return result

    def _refuse(self, error):
        self.report({"ERROR"}, str(error))
        running.finish([str(error)], error=True)
        return {"CANCELLED"}

    def _finish(self, outcome):
        for note in outcome.notes:
            self.report({"WARNING"}, note)
        self.report({"INFO"}, outcome.summary)
        running.plan = outcome.plan or running.plan
        running.finish([*outcome.report_lines, *outcome.notes])
        return {"FINISHED"}


class LB_OT_bake(_Works, bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Light the selected volumes, smoke domains and meshes at the current frame"""

    bl_idname = "lb_lighting.bake"
    bl_label = "Bake LB Light"
    bl_options = {"REGISTER", "UNDO"}

    def begin(self, context):
        options = bake.Options.of(context.scene)
        return bake.Baking(context, context.selected_objects, options)


class LB_OT_bake_animation(_Works, bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Light the selected volumes and smoke domains at every frame of the scene's range, into a \
sequence of files. Frames that are there are kept"""

    bl_idname = "lb_lighting.bake_animation"
    bl_label = "Bake LB Light Animation"
    bl_options = {"REGISTER", "UNDO"}

    def begin(self, context):
        scene, options = context.scene, bake.Options.of(context.scene)
        frames, overwrite = (scene.frame_start, scene.frame_end), scene.lb_lighting.overwrite
        return Sequence(context, context.selected_objects, options, *frames, overwrite)


class LB_OT_estimate(_Works, bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Tell what a bake will take: voxels, memory and time; and how dense the medium is"""

    bl_idname = "lb_lighting.estimate"
    bl_label = "Estimate LB Light"
    bl_options = {"REGISTER"}

    def begin(self, context):
        options = bake.Options.of(context.scene)
        return bake.Estimating(context, context.selected_objects, options)


class LB_OT_customize(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Make the quality Custom, with the settings of the last plan, to change them by hand"""

    bl_idname = "lb_lighting.customize"
    bl_label = "Customize"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, _context):
        if running.plan is None:
            cls.poll_message_set("Estimate or bake first, by a quality other than Custom")
        return running.plan is not None

    def execute(self, context):
        settings, planned = context.scene.lb_lighting, running.plan.settings
        settings.quality = CUSTOM
        settings.photons = planned.photons or 0
        settings.handover = min(planned.handover, FAR)
        for name in ("scattering", "rays", "merge", "tolerance"):
            setattr(settings, name, getattr(planned, name))
        return {"FINISHED"}


class LB_OT_cancel(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """End the bake or the estimate that is under way"""

    bl_idname = "lb_lighting.cancel"
    bl_label = "Cancel LB Light"

    @classmethod
    def poll(cls, _context):
        if running.baking is None:
            cls.poll_message_set("Nothing is under way")
        return running.baking is not None

    def execute(self, _context):
        running.stop("was cancelled")
        return {"FINISHED"}


class LB_OT_clear(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Take LB light out of the scene and give back what bakes changed"""

    bl_idname = "lb_lighting.clear"
    bl_label = "Clear LB Light"
    bl_options = {"REGISTER", "UNDO"}

    delete_files: BoolProperty(
        name="Delete Files",
        description="Delete the baked .vdb files too; undo cannot bring them back",
    )

    def execute(self, context):
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
    """Set the bounces of Cycles for LB light, which stands for them; again to give them back"""

    bl_idname = "lb_lighting.use"
    bl_label = "Use LB Light"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if not hasattr(context.scene, "cycles"):
            cls.poll_message_set("Enable the add-on Cycles")
            return False
        if not (shading_volumes.uses_light(context.scene) or bake.is_lit(context.scene)):
            cls.poll_message_set("Bake LB light first")
            return False
        return True

    def execute(self, context):
        if shading_volumes.uses_light(context.scene):
            shading_volumes.leave_light(context.scene)
            self.report({"INFO"}, "Render settings are as they were")
        else:
            shading_volumes.use_light(context.scene)
            self.report({"INFO"}, "Render settings are those for LB light")
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


def register():
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
