# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: the devices of this machine."""

from typing import Any

import bpy

from .. import job
from ..errors import LightingError

PACKAGE = __package__.removesuffix(".lb_lighting.ui")  # the extension, or the plain package's ui
_found: list[str] = []  # lines, once the user asked for them
_troubles: list[str] = []  # sentences about devices that cannot be used


class LB_OT_find_devices(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """List the devices that can compute light, the best first"""

    bl_idname = "lb_lighting.find_devices"
    bl_label = "Find Devices"

    def execute(self, _context: Any) -> set[Any]:
        try:
            _found[:], _troubles[:] = job.find_devices()
        except LightingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for trouble in _troubles:
            self.report({"WARNING"}, trouble)
        self.report({"INFO"}, f"The best device is {_found[0]}")
        return {"FINISHED"}


class LB_AP_preferences(bpy.types.AddonPreferences):  # noqa: N801 - Blender's convention
    bl_idname = PACKAGE

    def draw(self, _context: Any) -> None:
        assert self.layout is not None
        column = self.layout.column()
        column.operator(LB_OT_find_devices.bl_idname, icon="VIEWZOOM")
        for number, line in enumerate(_found):
            column.label(text=line, icon="NONE" if number else "CHECKMARK")
        for trouble in _troubles:
            column.label(text=trouble, icon="ERROR")
        if len(_found) == 1 and not _troubles:
            column.label(
                text="Only NumPy is available. An OpenCL driver for your processor or graphics "
                "card makes bakes many times faster.",
                icon="INFO",
            )
        column.label(text="To choose the device, see the 3D view: sidebar, tab LB, panel Solver.")


def register() -> None:
    bpy.utils.register_class(LB_OT_find_devices)
    bpy.utils.register_class(LB_AP_preferences)


def unregister() -> None:
    bpy.utils.unregister_class(LB_AP_preferences)
    bpy.utils.unregister_class(LB_OT_find_devices)
