# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab "LB" of the 3D view."""

import bpy

from ..bake import FROM_MATERIAL
from .operators import LB_OT_bake, LB_OT_clear


class LB_PT_lighting(bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "LB Lighting"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "LB"

    def draw(self, context):
        settings = context.scene.lb_lighting
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False

        column = layout.column()
        column.prop(settings, "domain")
        column.prop(settings, "resolution")
        column.prop(settings, "padding")

        column = layout.column()
        column.prop(settings, "medium")
        depth = column.row()
        depth.active = settings.medium != FROM_MATERIAL
        depth.prop(settings, "optical_depth")
        column.prop(settings, "grid")
        column.prop(settings, "keep_absorbed")
        if context.object is not None:
            column.prop(context.object.lb_lighting, "role")

        column = layout.column()
        column.prop(settings, "mode")
        column.prop(settings, "strength")
        column.prop(settings, "folder")
        column.prop(settings, "device", icon="MEMORY")

        row = layout.row(align=True)
        row.scale_y = 1.4
        row.operator(LB_OT_bake.bl_idname, text="Bake", icon="LIGHT_SUN")
        row.operator(LB_OT_clear.bl_idname, text="Clear", icon="TRASH")


def register():
    bpy.utils.register_class(LB_PT_lighting)


def unregister():
    bpy.utils.unregister_class(LB_PT_lighting)
