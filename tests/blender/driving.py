# SPDX-License-Identifier: GPL-3.0-or-later
"""Drives a windowed Blender for window.py: mouse, keys, screenshots, waiting, and measured gaps."""

import importlib
import os
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
from scenes import EXTENSION, SCREENS, sun, volume_material, volume_object, write_ball

TAB = "LB"
SHOWN = 1.0  # s from the end of drawing to the screen
PATIENCE = 600.0  # s without any progress that count as a hang
CHECK = 0.05  # s between checks of a bake
UNIT = 20  # pixels: the height of a button at scale 1
TICK = 0.01  # s, of the timer that finds gaps
LONGEST = 0.2  # s of processor time for which we may hold Blender

running = importlib.import_module(f"{EXTENSION}.lb_lighting.ui.running")
panels = importlib.import_module(f"{EXTENSION}.lb_lighting.ui.panels")
operators = importlib.import_module(f"{EXTENSION}.lb_lighting.ui.operators")
preview = importlib.import_module(f"{EXTENSION}.lb_lighting.ui.preview")
volume = importlib.import_module(f"{EXTENSION}.lb_lighting.output.volume")
gaps = {}


def window():
    return bpy.context.window_manager.windows[0]


def view():
    """The area of the 3D view."""
    return next(area for area in window().screen.areas if area.type == "VIEW_3D")


def sidebar():
    return next(region for region in view().regions if region.type == "UI")


def xdotool(*command):
    subprocess.run(["xdotool", *map(str, command)], check=True)


def move(x, y):
    """Move the mouse to a point of the window, measured from below as in Blender."""
    xdotool("mousemove", int(x), int(window().height - y))


def click_button(share):
    """Click the top row of our panel at a share of its width."""
    region = sidebar()
    move(region.x + share * (region.width - UNIT), region.y + region.height - 2.7 * UNIT)
    xdotool("click", 1)


def press(key):
    """Press a key with the mouse over the 3D view."""
    area = view()
    move(area.x + area.width / 4, area.y + area.height / 2)
    xdotool("key", key)


def take_picture(name):
    """By the X server, as Blender's own screenshot is black if OpenGL is rendered in software."""
    path = SCREENS / f"{name}.png"
    subprocess.run(["import", "-window", "root", path], check=True)
    pixels = np.array(bpy.data.images.load(str(path)).pixels).reshape(-1, 4)
    colours = len(np.unique(pixels, axis=0))
    assert colours > 20, f"The screenshot {name} is blank: it has {colours} colours."
    bpy.data.images.remove(bpy.data.images[path.name])


def build(resolution=48, voxel=0.05, quality="CUSTOM"):
    """A selected cloud in the light of a sun, with its files in a new folder.

    quality  the default solves all voxels, which leaves time to interrupt the bake
    """
    bpy.data.batch_remove(list(bpy.data.objects))
    bpy.data.batch_remove(list(bpy.data.volumes))
    folder = Path(bpy.app.tempdir, f"scene{time.monotonic_ns()}")
    folder.mkdir()
    write_ball(folder / "ball.vdb", center=(0, 0, 0), radius=0.9, voxel=voxel)
    cloud = volume_object(folder / "ball.vdb", volume_material(density=8.0))
    sun((-0.5, 0, -1))
    with overridden():
        bpy.context.view_layer.objects.active = cloud
    settings = bpy.context.scene.lb_lighting
    settings.resolution, settings.folder, settings.device = resolution, str(folder), ""
    settings.quality = quality
    running.last = ()
    return cloud, folder


def overridden():
    return bpy.context.temp_override(window=window(), area=view(), region=sidebar())


def start():
    """Press Bake without a mouse, and return the worker's process number."""
    with overridden():
        assert bpy.ops.lb_lighting.bake("INVOKE_DEFAULT", True) == {"RUNNING_MODAL"}
    return worker()


def worker():
    return running.baking._process.pid


def until(condition):
    """Yield until `condition()` holds; fail if nothing changes for long."""
    seen, since = None, time.monotonic()
    while not condition():
        if (now := progress()) != seen:
            seen, since = now, time.monotonic()
        waited = time.monotonic() - since
        assert waited < PATIENCE, f"Nothing has changed for {waited:.0f} s: {seen}"
        yield CHECK


def progress():
    """The state that changes while a bake or a preview runs."""
    works = [work for work in (running.baking, preview._job) if work is not None]
    shown = running.shown[0], running.last, preview._survey is None
    return *shown, *((work.status, worked(work._process.pid)) for work in works)


def worked(pid):
    """Whole seconds of processor time that a process has used, or None if it has ended."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    user, system = map(int, state.rsplit(")", 1)[1].split()[11:13])
    return (user + system) // os.sysconf("SC_CLK_TCK")


def drawn():
    """Yield until the sidebar has been drawn in its present state and is on the screen."""
    before = counted.draws
    view().tag_redraw()
    sidebar().tag_redraw()
    yield from until(lambda: counted.draws > before)
    yield SHOWN


def counted(panel, context):  # Blender counts the arguments
    """Draw our panel and count it."""
    counted.draws += 1
    counted.draw(panel, context)


counted.draws, counted.draw = 0, panels.LB_PT_lighting.draw
panels.LB_PT_lighting.draw = counted


def solving():
    return running.baking is not None and running.baking.status[0].startswith("Solving")


def ended():
    return running.baking is None


def lit():
    return [ob for ob in bpy.data.objects if volume.is_ours(ob)]


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def is_alive(pid):
    """Whether the process exists and is no zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return state.rsplit(")", 1)[1].split()[0] != "Z"


def said(words):
    """Check that the panel reports an error with these words, in one line."""
    assert running.failed, running.last
    assert len(running.last) == 1, running.last
    assert words in running.last[0], running.last


def nothing_changed(folder):
    assert files(folder) == ["ball.vdb"], files(folder)
    assert lit() == []
    assert not bpy.data.objects[0].hide_viewport


class measured:  # noqa: N801 - reads as a function
    """Store the longest gap between ticks of a timer under a name."""

    def __init__(self, name):
        self.name = name

    def __enter__(self):
        self.last, gaps[self.name] = time.monotonic(), 0.0
        self.timer = self.tick  # Blender knows it by its identity
        bpy.app.timers.register(self.timer, persistent=True)

    def tick(self):
        now = time.monotonic()
        gaps[self.name], self.last = max(gaps[self.name], now - self.last), now
        return TICK

    def __exit__(self, *_error):
        bpy.app.timers.unregister(self.timer)


@contextmanager
def held(name, *methods):
    """Store the longest processor time of a call of one of `methods` (class, name) under a name.

    It is not wall time, in which other processes count.
    """
    gaps[name] = 0.0

    def timed(method):
        def called(*arguments):
            start = time.thread_time()
            try:
                return method(*arguments)
            finally:
                gaps[name] = max(gaps[name], time.thread_time() - start)

        return called

    before = [(cls, method, getattr(cls, method)) for cls, method in methods]
    for cls, method, function in before:
        setattr(cls, method, timed(function))
    try:
        yield
    finally:
        for cls, method, function in before:
            setattr(cls, method, function)
