# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview: a picture that keeps improving, a histogram of free paths, and advice.

None of it is stored in the .blend.
"""

from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np
from bpy.props import BoolProperty

from .. import exchange
from ..arrays import Floats
from ..errors import LightingError
from ..job import Job
from ..options import Options
from ..reading import read_scene, scene_of, sources_of
from ..tasks.preview import PICTURE, SURVEY, Preview, Survey
from ..transport.preview.pictures import View
from . import running
from .panels import SubPanel, draw_text

SIZE = 160  # pixels of the picture's edge
SCALE = 9.0  # of the picture, in buttons
DARK = 0.12  # background of a plot, in display values
DIM = 0.05  # background of the picture, linear

_job: Job | None = None
_survey: Survey | None = None
_failed = ""
_icons: Any = None  # a collection of pictures, while we are registered


class LB_OT_preview(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Preview the selected medium in the light of the scene by tracing free paths. It needs no \
bake, and any change to the scene stops it"""

    bl_idname = "lb_lighting.preview"
    bl_label = "Preview LB Light"

    noise: BoolProperty(  # type: ignore[valid-type] # Blender's way to declare properties
        name="As Noise",
        description="Fill the selection with fractal noise of 4096 cells along an edge, which is "
        "too fine for a grid",
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        why = running.why_not(context)
        if why is not None:
            cls.poll_message_set(why)
        return why is None

    def execute(self, context: Any) -> set[Any]:
        scene = scene_of(context)
        options = Options.of(scene)
        try:
            objects = sources_of(scene, running.selected(context))
            task = Preview(read_scene(context, objects, options), _view(context), self.noise)
            start(Job(task))
        except LightingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if bpy.app.background:
            while look() is not None:
                pass
        return {"FINISHED"}


class LB_OT_preview_stop(bpy.types.Operator):  # noqa: N801 - Blender's convention
    """Stop the preview"""

    bl_idname = "lb_lighting.preview_stop"
    bl_label = "Stop LB Preview"

    def execute(self, _context: Any) -> set[Any]:
        stop()
        return {"FINISHED"}


class LB_PT_preview(SubPanel, bpy.types.Panel):  # noqa: N801 - Blender's convention
    bl_label = "Free-Path Preview"

    def draw_settings(
        self, context: bpy.types.Context, column: bpy.types.UILayout, _settings: Any
    ) -> None:
        if _job is None:
            row = column.row(align=True)
            row.operator(LB_OT_preview.bl_idname, text="Preview", icon="HIDE_OFF").noise = False
            row.operator(LB_OT_preview.bl_idname, text="As Noise").noise = True
        else:
            stage, fraction = _job.status
            column.progress(factor=fraction, text=stage)
            column.operator(LB_OT_preview_stop.bl_idname, text="Stop", icon="CANCEL")
        if _failed:
            draw_text(context, column, _failed)
        if PICTURE in _icons:
            column.template_icon(_icons[PICTURE].icon_id, scale=SCALE)
        if _survey is not None:
            _draw_survey(context, column, _survey)


def _draw_survey(context: bpy.types.Context, column: bpy.types.UILayout, survey: Survey) -> None:
    figures = survey.statistics
    draw_text(context, column, survey.advice)
    column.template_icon(_icons[SURVEY].icon_id, scale=SCALE)
    grid = column.grid_flow(columns=2, row_major=True, even_columns=True)
    for name, value in (
        ("Mean free path", _length(figures.mean_free_path)),
        ("In matter only", _length(figures.in_matter)),
        ("Optical depth", " x ".join(f"{depth:.3g}" for depth in figures.depth_max)),
        ("Depth of a voxel", f"{figures.voxel_depth_max:.2g}"),
        ("Passes through", f"{figures.escaped:.0%}"),
        ("Empty space", f"{figures.void:.0%}"),
    ):
        grid.label(text=name)
        grid.label(text=value)
    for name, sampling in figures.samplers.items():
        grid.label(text=name.replace("_", " "))
        grid.label(text=f"{sampling.acceptance:.0%}, {sampling.rays_a_second / 1e6:.2g} M rays/s")


def start(job: Job) -> None:
    """Show the results of `job`, a `Preview`, as they come."""
    global _job, _survey, _failed
    stop()
    _job, _survey, _failed = job, None, ""
    _icons.clear()
    if not bpy.app.background:
        bpy.app.timers.register(look, first_interval=running.INTERVAL)


def stop() -> None:
    """End the preview at once; its picture stays."""
    global _job
    if _job is not None:
        _job.cancel()
    _job = None
    running.redraw()


def look() -> float | None:
    """Show what is new; the seconds until the next call, or None for the last one."""
    global _survey, _failed
    if _job is None:
        return None
    task: Any = _job.task
    if task.bake.options != Options.of(scene_of(bpy.context)):
        stop()
        return None
    try:
        done = _job.update(wait=0.1 if bpy.app.background else 0.0)
        if _job.said.pop(PICTURE, False):
            _show(PICTURE, _over(_load(_job, PICTURE)))
        if _job.said.pop(SURVEY, False):
            survey: Survey = _load(_job, SURVEY)
            _survey = survey
            _show(SURVEY, _square(_on_dark(survey.histogram)))
    except LightingError as error:
        _failed, done = str(error), True
    if done:
        stop()
        return None
    running.redraw()
    return running.INTERVAL


def _load(job: Job, name: str) -> Any:
    return exchange.load(Path(job.folder.name, name))


def _show(name: str, pixels: Floats) -> None:
    """Store pixels (height, width, 4), in display values, as the icon `name`."""
    icon = _icons[name] if name in _icons else _icons.new(name)
    icon.image_size = pixels.shape[1::-1]
    icon.image_pixels_float.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())


def _over(picture: Floats) -> Floats:
    """A picture of light over a dim background, in display values."""
    view = scene_of(bpy.context).view_settings
    assert view is not None
    exposed = picture[..., :3] * 2**view.exposure
    light = np.clip(exposed + DIM * (1 - picture[..., 3:]), 0, 1)
    srgb = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.concatenate([srgb, np.ones_like(picture[..., 3:])], axis=2)


def _on_dark(plot: Floats) -> Floats:
    """A plot over a dark background, in display values."""
    alpha = plot[..., 3:]
    return np.concatenate([plot[..., :3] * alpha + DARK * (1 - alpha), np.ones_like(alpha)], axis=2)


def _square(picture: Floats) -> Floats:
    """A picture padded to a square above and below, because icons are squares."""
    height, width = picture.shape[:2]
    pad = (width - height) // 2
    return np.pad(picture, [(pad, width - height - pad), (0, 0), (0, 0)])


def _length(metres: float) -> str:
    if not np.isfinite(metres):
        return "none"
    return f"{metres:.3g} m"


def _view(context: Any) -> View | None:
    """The view of the 3D view, or None if there is none."""
    area = context.area
    if area is None or area.type != "VIEW_3D":
        return None
    region = area.spaces.active.region_3d
    matrix = np.array(region.view_matrix.inverted())
    height = 2 / region.window_matrix[1][1]
    return View(matrix, height, (SIZE, SIZE), region.is_perspective)


@running.persistent
def _stop_with_a_change(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if _job is not None and len(depsgraph.updates):
        stop()


@running.persistent
def _stop_anyway(*_arguments: Any) -> None:
    stop()


_HANDLERS: tuple[tuple[Any, Any], ...] = (
    (bpy.app.handlers.depsgraph_update_post, _stop_with_a_change),
    (bpy.app.handlers.frame_change_post, _stop_anyway),
    (bpy.app.handlers.load_pre, _stop_anyway),
)
_CLASSES = (LB_OT_preview, LB_OT_preview_stop, LB_PT_preview)


def register() -> None:
    global _icons
    _icons = bpy.utils.previews.new()
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    for handlers, ours in _HANDLERS:
        handlers.append(ours)


def unregister() -> None:
    global _survey
    stop()
    _survey = None  # its picture goes with the icons
    for handlers, ours in _HANDLERS:
        handlers.remove(ours)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    bpy.utils.previews.remove(_icons)
