# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom media in Blender's preset system; `lb_lighting/presets` holds those that come with us."""

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

FOLDER = str(Path(__file__).parents[1])  # Blender looks for presets/lb_lighting in it


class LB_OT_preset_add(  # type: ignore[misc]  # noqa: N801 - as in Blender, whose stubs disagree
    AddPresetBase, bpy.types.Operator
):
    """Save the medium as a preset, or remove a preset"""

    bl_idname = "lb_lighting.preset_add"
    bl_label = "Add LB Preset"
    preset_menu = "LB_PT_presets"
    preset_subdir = "lb_lighting"
    preset_defines = ["settings = bpy.context.scene.lb_lighting"]
    preset_values = [
        f"settings.{name}" for name in ("medium", "sigma_s", "sigma_a", "g", "optical_depth")
    ]


class LB_PT_presets(PresetPanel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "LB Presets"
    bl_space_type = "VIEW_3D"
    preset_subdir = LB_OT_preset_add.preset_subdir
    preset_operator = "script.execute_preset"
    preset_add_operator = LB_OT_preset_add.bl_idname


def register() -> None:
    bpy.utils.register_class(LB_OT_preset_add)
    bpy.utils.register_class(LB_PT_presets)
    bpy.utils.register_preset_path(FOLDER)


def unregister() -> None:
    bpy.utils.unregister_preset_path(FOLDER)
    bpy.utils.unregister_class(LB_PT_presets)
    bpy.utils.unregister_class(LB_OT_preset_add)
