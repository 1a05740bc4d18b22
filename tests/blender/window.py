# SPDX-License-Identifier: GPL-3.0-or-later
"""Run in a windowed Blender: bake a cloud, open our tab of the sidebar, take a picture, quit."""

import os
import subprocess
import sys
import traceback
from pathlib import Path

import bpy
import numpy as np

sys.path.append(str(Path(__file__).parent))

from scenes import SCREENS, sun, volume_material, volume_object, write_ball

SCREENSHOT = SCREENS / "sidebar.png"
TAB = "LB"
REDRAW = 3.0  # s between steps: software rendering draws a window in about one


def view():
    """The area of the 3D view."""
    screen = bpy.context.window_manager.windows[0].screen
    return next(area for area in screen.areas if area.type == "VIEW_3D")


def bake():
    """A cloud takes the place of the default cube, and is lit."""
    bpy.data.batch_remove([bpy.data.objects["Cube"], bpy.data.objects["Light"]])
    folder = Path(bpy.app.tempdir)
    write_ball(folder / "ball.vdb", center=(0, 0, 0), radius=0.9)
    cloud = volume_object(folder / "ball.vdb", volume_material(density=5.0))
    sun((-0.5, 0, -1))
    bpy.context.view_layer.objects.active = cloud
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=view()):
        assert bpy.ops.lb_lighting.bake("EXEC_DEFAULT", True) == {"FINISHED"}
        assert bpy.data.objects["LB Cloud"].data.grids.load()


def open_sidebar():
    area = view()
    area.spaces.active.show_region_ui = True
    area.tag_redraw()


def choose_tab():
    area = view()
    sidebar = next(region for region in area.regions if region.type == "UI")
    sidebar.active_panel_category = TAB
    assert sidebar.active_panel_category == TAB
    area.tag_redraw()


def take_picture():
    """From the X server: Blender's own screenshot is black where OpenGL is rendered in software."""
    subprocess.run(["import", "-window", "root", SCREENSHOT], check=True)


def check_picture():
    pixels = np.array(bpy.data.images.load(str(SCREENSHOT)).pixels).reshape(-1, 4)
    colours = len(np.unique(pixels, axis=0))
    assert colours > 20, f"The screenshot is blank: it has {colours} colours."


STEPS = iter([bake, open_sidebar, choose_tab, take_picture, check_picture])


def next_step():
    """Do a step and let Blender redraw; the exit code tells whether all of them went well."""
    try:
        if step := next(STEPS, None):
            step()
            return REDRAW
    except Exception:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    bpy.ops.wm.quit_blender()
    return None


bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(next_step, first_interval=REDRAW)
