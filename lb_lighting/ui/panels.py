# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab "LB" of the 3D view."""

import textwrap
from typing import TYPE_CHECKING, Any

import bpy

from ..options import properties_of
from ..output.render_settings import uses_light
from ..scene.medium_choice import CUSTOM, FROM_MATERIAL
from ..scene.opening import SURFACE_TYPES
from . import running
from .operators import (
    LB_OT_bake,
    LB_OT_bake_animation,
    LB_OT_cancel,
    LB_OT_clear,
    LB_OT_customize,
    LB_OT_estimate,
    LB_OT_use,
)
from .presets import LB_PT_presets

LETTER, FRAME = 6.5, 60  # pixels: mean width of a letter, and width of the margins of a text

if TYPE_CHECKING:
    _BlenderPanel = bpy.types.Panel
else:
    _BlenderPanel = object  # Blender requires its own class last among the bases


class _Panel(_BlenderPanel):
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "LB"

    def draw(self, context: Any) -> None:
        assert self.layout is not None
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.draw_settings(context, self.layout.column(), properties_of(context.scene))

    def draw_settings(
        self, context: bpy.types.Context, column: bpy.types.UILayout, settings: Any
    ) -> None:
        """Draw the properties of the scene, `settings`, in a column."""


class SubPanel(_Panel):
    """A panel below ours."""

    bl_parent_id = "LB_PT_lighting"


class LB_PT_lighting(_Panel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "LB Lighting"

    def draw(self, context: Any) -> None:
        """Draw the buttons, or the progress of the bake; then the lines about the last one."""
        assert self.layout is not None
        layout = self.layout
        if running.baking is None:
            row = layout.row(align=True)
            row.scale_y = 1.4
            row.operator(LB_OT_bake.bl_idname, text="Bake", icon="LIGHT_SUN")
            row.operator(LB_OT_bake_animation.bl_idname, text="Animation", icon="RENDER_ANIMATION")
            row.operator(LB_OT_clear.bl_idname, text="Clear", icon="TRASH")
            row = layout.row(align=True)
            row.operator(LB_OT_estimate.bl_idname, text="Estimate", icon="TIME")
            used = uses_light(context.scene)
            icon: Any = "CHECKBOX_HLT" if used else "CHECKBOX_DEHLT"
            row.operator(LB_OT_use.bl_idname, icon=icon, depress=used)
        else:
            layout.progress(factor=running.shown[1], text=running.line())
            layout.operator(LB_OT_cancel.bl_idname, text="Cancel", icon="CANCEL")
        if running.last:
            box = layout.box().column(align=True)
            box.alert = running.failed
            for line in running.last:
                draw_text(context, box, line)


class LB_PT_domain(SubPanel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "Domain"

    def draw_settings(
        self, _context: bpy.types.Context, column: bpy.types.UILayout, settings: Any
    ) -> None:
        column.prop(settings, "domain", placeholder="Selection")
        column.prop(settings, "resolution")
        column.prop(settings, "padding")
        quality = column.column()
        quality.active = settings.model == "physical"
        quality.prop(settings, "quality")
        row = quality.row()
        row.operator(LB_OT_customize.bl_idname, icon="OPTIONS")


class LB_PT_medium(SubPanel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "Medium"

    def draw_header_preset(self, _context: Any) -> None:
        LB_PT_presets.draw_panel_header(self.layout)

    def draw_settings(
        self, context: bpy.types.Context, column: bpy.types.UILayout, settings: Any
    ) -> None:
        column.prop(settings, "medium")
        if settings.medium == CUSTOM:
            column.prop(settings, "sigma_s")
            column.prop(settings, "sigma_a")
            column.prop(settings, "g")
        depth = column.row()
        depth.active = settings.medium != FROM_MATERIAL
        depth.prop(settings, "optical_depth")
        column.prop(settings, "grid", placeholder="From material")
        ob = context.object
        if ob is not None and ob.type in SURFACE_TYPES:
            column.prop(properties_of(ob), "role")


class LB_PT_solver(SubPanel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "Solver"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_settings(
        self, _context: bpy.types.Context, column: bpy.types.UILayout, settings: Any
    ) -> None:
        column.prop(settings, "device", placeholder="Fastest")
        column.prop(settings, "model")
        if settings.model == "physical" and settings.quality == CUSTOM:
            for name in ("scattering", "rays", "merge", "handover", "photons", "tolerance"):
                column.prop(settings, name)
        absorbed = column.row()
        absorbed.active = settings.model == "paper"
        absorbed.prop(settings, "keep_absorbed")


class LB_PT_output(SubPanel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "Output"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_settings(
        self, _context: bpy.types.Context, column: bpy.types.UILayout, settings: Any
    ) -> None:
        column.prop(settings, "mode")
        column.prop(settings, "gather")
        column.prop(settings, "foliage")
        column.prop(settings, "sky")
        column.prop(settings, "strength")
        column.prop(settings, "folder", placeholder="Beside the .blend")
        column.prop(settings, "overwrite")


def draw_text(context: bpy.types.Context, layout: bpy.types.UILayout, text: str) -> None:
    """Draw a sentence, wrapped to the width of the panel."""
    assert context.region is not None
    assert context.preferences is not None
    layout = layout.column(align=True)
    width = context.region.width / context.preferences.system.ui_scale - FRAME
    for number, part in enumerate(textwrap.wrap(text, max(12, int(width / LETTER)))):
        layout.label(text=part, icon="BLANK1" if number else "DOT")


_CLASSES = (LB_PT_lighting, LB_PT_domain, LB_PT_medium, LB_PT_solver, LB_PT_output)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
