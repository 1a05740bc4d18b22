# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake that is under way, and how the last one ended; nothing of it is in the .blend."""

import sys

import bpy
from bpy.app.handlers import persistent

from ..tasks.estimate import duration

INTERVAL = 0.1  # s between looks at the solver

baking = None  # a `Baking`, a `Sequence` or an `Estimating`
told = "", 0.0, None  # what to show of it: stage, fraction, seconds left
last = ()  # lines about the one before
failed = False  # whether those tell of an error
plan = None  # the latest `Plan`


def start(work):
    """`work` is under way."""
    global baking
    baking = work
    show()


def stop(how):
    """End what is under way, if anything is, at once; `how` it ended follows its name."""
    if baking is not None:
        sentence = f"The {baking.name} {how}; {baking.kept}"
        baking.cancel()
        finish([sentence], error=True)


def why_not(context):
    """Why nothing can be begun with what is selected, or None."""
    if baking is not None:
        return "A bake or an estimate is under way; cancel it or wait for it"
    if not context.selected_objects:
        return "Select a volume, a smoke domain or a mesh"
    return None


def finish(lines, error=False):
    """Nothing is under way any more; keep what there is to say about it."""
    global baking, last, failed
    baking, last, failed = None, tuple(lines), error
    redraw()


def tell(line):
    """Say one thing more in the panel and on the console, whatever is under way."""
    global last
    print(f"lb_lighting: {line}", file=sys.stderr)
    last = (*last, line)
    redraw()


def show(waits=None):
    """Show how far it is, or what it `waits` for."""
    global told
    stage, fraction = baking.status
    before, told = told, (waits or stage, fraction, baking.seconds_left)
    if told != before:
        redraw()


def line():
    """What it does and how long that takes yet, for a progress bar."""
    stage, fraction, seconds = told
    left = "" if seconds is None else f", {duration(seconds)} left"
    return f"{stage}, {fraction:.0%}{left}"


def redraw():
    """Draw the sidebars and the status bar anew, and not the views, which may be slow."""
    for window in bpy.context.window_manager.windows:
        areas = [area for area in window.screen.areas if area.type == "VIEW_3D"]
        for region in (region for area in areas for region in area.regions):
            if region.type == "UI":
                region.tag_redraw()
        window.workspace.status_text_set_internal(None)


def draw_status(header, _context):
    """Our part of the status bar."""
    if baking is not None:
        row = header.layout.row()
        row.ui_units_x = 16
        row.progress(factor=told[1], text=f"LB Lighting: {line()}")


@persistent
def _stop_for_another_file(*_arguments):
    stop("was ended, because another file was opened")


def register():
    bpy.types.STATUSBAR_HT_header.append(draw_status)
    bpy.app.handlers.load_pre.append(_stop_for_another_file)


def unregister():
    stop("was ended, because the extension was disabled")
    bpy.app.handlers.load_pre.remove(_stop_for_another_file)
    bpy.types.STATUSBAR_HT_header.remove(draw_status)
