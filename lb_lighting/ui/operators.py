# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake and Clear: thin shells over `bake.py`."""

import bpy
from bpy.props import BoolProperty

from .. import bake
from ..errors import LightingError


class LB_OT_bake(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Light the selected volumes, smoke domains and meshes"""

    bl_idname = "lb_lighting.bake"
    bl_label = "Bake LB Light"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if not context.selected_objects:
            cls.poll_message_set("Select a volume, a smoke domain or a mesh")
            return False
        return True

    def execute(self, context):
        windows = context.window_manager
        windows.progress_begin(0, 100)
        try:
            outcome = bake.bake(
                context,
                context.selected_objects,
                bake.Options.of(context.scene),
                progress=lambda _stage, fraction: windows.progress_update(100 * fraction),
            )
        except LightingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            windows.progress_end()
        for note in outcome.notes:
            self.report({"WARNING"}, note)
        self.report({"INFO"}, outcome.summary)
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
        try:
            count = bake.clear(context, self.delete_files)
        except LightingError as error:  # the scene is cleared, a file is left
            self.report({"WARNING"}, str(error))
            return {"FINISHED"}
        if not count:
            self.report({"INFO"}, "Nothing to clear: this scene has no LB light")
            return {"CANCELLED"}
        self.report({"INFO"}, f"LB light taken out of {count} object{'s' * (count > 1)}")
        return {"FINISHED"}


def register():
    bpy.utils.register_class(LB_OT_bake)
    bpy.utils.register_class(LB_OT_clear)


def unregister():
    bpy.utils.unregister_class(LB_OT_clear)
    bpy.utils.unregister_class(LB_OT_bake)
