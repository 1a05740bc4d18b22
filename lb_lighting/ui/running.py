# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake under way, and how the last one ended; none of it is stored in the .blend."""

import sys
from collections.abc import Callable, Iterable
from typing import Any

import bpy

from ..bake import Kept, Outcome, Work
from ..tasks.estimate import Expected, duration
from ..transport.planning.planner import Plan

INTERVAL = 0.1  # s between checks on the solver

baking: Work[Outcome | Kept | Expected] | None = None
shown: tuple[str, float, float | None] = ("", 0.0, None)  # stage, fraction, seconds left
last: tuple[str, ...] = ()  # lines about the previous one
failed = False  # whether those are about an error
plan: Plan | None = None  # the latest


def persistent[Handler: Callable[..., None]](handler: Handler) -> Handler:
    """Keep a handler when Blender loads another file: its own decorator, with types."""
    kept: Handler = bpy.app.handlers.persistent(handler)
    return kept


def selected(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected objects."""
    return list(context.selected_objects or ())


def start(work: Work[Outcome | Kept | Expected]) -> None:
    """Note that `work` is under way."""
    global baking
    baking = work
    show()


def stop(how: str) -> None:
    """End the work under way, if any, at once; the message says `how` it ended."""
    if baking is not None:
        sentence = f"The {baking.name} {how}; {baking.kept}"
        baking.cancel()
        finish([sentence], error=True)


def why_not(context: bpy.types.Context) -> str | None:
    """Why no work can start with the selection, or None."""
    if baking is not None:
        return "A bake or an estimate is running; cancel it or wait for it"
    if not selected(context):
        return "Select a volume, a smoke domain or a mesh"
    return None


def finish(lines: Iterable[str], error: bool = False) -> None:
    """Note that nothing is under way any more, and keep the lines about it."""
    global baking, last, failed
    baking, last, failed = None, tuple(lines), error
    redraw()


def add_line(line: str) -> None:
    """Add a line to the panel and print it on the console."""
    global last
    print(f"lb_lighting: {line}", file=sys.stderr)
    last = (*last, line)
    redraw()


def show(waiting: str | None = None) -> None:
    """Show the progress, or what the work is `waiting` for."""
    global shown
    assert baking is not None
    stage, fraction = baking.status
    before, shown = shown, (waiting or stage, fraction, baking.seconds_left)
    if shown != before:
        redraw()


def line() -> str:
    """The stage, fraction and time left, for a progress bar."""
    stage, fraction, seconds = shown
    left = "" if seconds is None else f", {duration(seconds)} left"
    return f"{stage}, {fraction:.0%}{left}"


def redraw() -> None:
    """Redraw the sidebars and the status bar, but not the views, which may be slow."""
    assert bpy.context.window_manager is not None
    for window in bpy.context.window_manager.windows:
        areas = [area for area in window.screen.areas if area.type == "VIEW_3D"]
        for region in (region for area in areas for region in area.regions):
            if region.type == "UI":
                region.tag_redraw()
        window.workspace.status_text_set_internal(None)


_status_bar: Any = bpy.types.STATUSBAR_HT_header  # the stubs lack the header's argument


def draw_status(header: Any, _context: bpy.types.Context) -> None:
    """Draw the progress in the status bar."""
    if baking is not None:
        row = header.layout.row()
        row.ui_units_x = 16
        row.progress(factor=shown[1], text=f"LB Lighting: {line()}")


@persistent
def _stop_for_another_file(*_arguments: Any) -> None:
    stop("was stopped because another file was opened")


def register() -> None:
    _status_bar.append(draw_status)
    bpy.app.handlers.load_pre.append(_stop_for_another_file)


def unregister() -> None:
    stop("was stopped because the extension was disabled")
    bpy.app.handlers.load_pre.remove(_stop_for_another_file)
    _status_bar.remove(draw_status)
