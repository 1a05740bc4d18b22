# SPDX-License-Identifier: GPL-3.0-or-later
"""Run in a windowed Blender: bake as an artist does, by clicks, and do all that may come between.

Each scenario is a generator that yields the seconds until it goes on; meanwhile Blender lives.
Pictures go to build/screens, and the longest gaps in Blender's event loop to gaps.json there.

A busy machine only makes it slower: a scenario waits for as long as anything moves.
"""

import faulthandler
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
import traceback
from contextlib import contextmanager
from pathlib import Path

import addon_utils
import bpy
import numpy as np

sys.path.append(str(Path(__file__).parent))

from scenes import EXTENSION, SCREENS, sun, volume_material, volume_object, write_ball

TAB = "LB"
SHOWN = 1.0  # s from the end of drawing to the screen
PATIENCE = 600.0  # s without any progress, after which something hangs
LOOK = 0.05  # s between looks at a bake
UNIT = 20  # pixels, of a button at the scale of 1
TICK = 0.01  # s, of the timer that finds gaps
LONGEST = 0.2  # s of its processor's time that we may hold Blender

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
    """The mouse to a point of the window, counted from below as Blender does."""
    xdotool("mousemove", int(x), int(window().height - y))


def click_button(share):
    """Click the top row of our panel at a share of its width."""
    region = sidebar()
    move(region.x + share * (region.width - UNIT), region.y + region.height - 2.7 * UNIT)
    xdotool("click", 1)


def press(key):
    """A key with the mouse over the 3D view."""
    area = view()
    move(area.x + area.width / 4, area.y + area.height / 2)
    xdotool("key", key)


def take_picture(name):
    """From the X server: Blender's own screenshot is black where OpenGL is rendered in software."""
    path = SCREENS / f"{name}.png"
    subprocess.run(["import", "-window", "root", path], check=True)
    pixels = np.array(bpy.data.images.load(str(path)).pixels).reshape(-1, 4)
    colours = len(np.unique(pixels, axis=0))
    assert colours > 20, f"The screenshot {name} is blank: it has {colours} colours."
    bpy.data.images.remove(bpy.data.images[path.name])


def build(resolution=48, voxel=0.05, quality="CUSTOM"):
    """A cloud alone in the light of a sun, selected; its files in a folder of its own.

    quality  all voxels, that there is time to interrupt it
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
    """Press Bake without a mouse; the worker's process number."""
    with overridden():
        assert bpy.ops.lb_lighting.bake("INVOKE_DEFAULT", True) == {"RUNNING_MODAL"}
    return worker()


def worker():
    return running.baking._process.pid


def until(condition):
    """Yield until `condition()` holds; fail where nothing has moved for long."""
    seen, since = None, time.monotonic()
    while not condition():
        if (now := progress()) != seen:
            seen, since = now, time.monotonic()
        waited = time.monotonic() - since
        assert waited < PATIENCE, f"Nothing has moved for {waited:.0f} s: {seen}"
        yield LOOK


def progress():
    """What changes while a bake or a preview is under way."""
    works = [work for work in (running.baking, preview._job) if work is not None]
    told = running.shown[0], running.last, preview._survey is None
    return *told, *((work.status, worked(work._process.pid)) for work in works)


def worked(pid):
    """Whole seconds of its processors' time that a process has taken, or None where it is gone."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    user, system = map(int, state.rsplit(")", 1)[1].split()[11:13])
    return (user + system) // os.sysconf("SC_CLK_TCK")


def drawn():
    """Yield until the sidebar has been drawn as it is now, and is on the screen."""
    before = counted.draws
    view().tag_redraw()
    sidebar().tag_redraw()
    yield from until(lambda: counted.draws > before)
    yield SHOWN


def counted(panel, context):  # Blender counts the arguments
    """Draw our panel, and count that."""
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
    """Whether there is such a process that is not just waiting to be buried."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return state.rsplit(")", 1)[1].split()[0] != "Z"


def said(words):
    """The panel tells of an error with these words, in one line."""
    assert running.failed, running.last
    assert len(running.last) == 1, running.last
    assert words in running.last[0], running.last


def nothing_changed(folder):
    assert files(folder) == ["ball.vdb"], files(folder)
    assert lit() == []
    assert not bpy.data.objects[0].hide_viewport


def open_tab():
    """Not a test: our tab of the sidebar."""
    view().spaces.active.show_region_ui = True
    view().tag_redraw()
    yield from until(tab_is_open)
    yield from drawn()


def tab_is_open():
    """Whether the sidebar shows our tab; it has tabs once it has been drawn."""
    try:
        sidebar().active_panel_category = TAB
    except (AttributeError, TypeError):
        return False
    return sidebar().active_panel_category == TAB


def as_it_comes():
    """A bake by the quality that scenes have from the start."""
    scene = bpy.context.scene
    build(resolution=96, quality=scene.lb_lighting.bl_rna.properties["quality"].default)
    yield from drawn()
    take_picture("idle")
    click_button(1 / 6)
    yield from until(lambda: running.baking is not None)
    yield from until(ended)
    yield from drawn()
    assert not running.failed, running.last
    assert lit()[0].data.grids.load()
    take_picture("done")


def by_clicks():
    """A whole bake of 128 voxels by clicks; we do not hold Blender's event loop meanwhile.

    The gaps that it has tell of drawing, too: in software, beside a solver that takes all cores.
    So they are measured while it idles as well, with the same regions drawn as often.
    """
    cloud, _folder = build(resolution=128)
    yield from drawn()
    with measured("idle"):
        for _ in range(50):
            running.redraw()
            yield running.INTERVAL
    click_button(1 / 6)
    with held("bake, held by us", (operators.LB_OT_bake, "begin"), (operators._Works, "_look")):
        with measured("bake, until it solves"):
            yield from until(solving)
        with measured("bake, solving"):
            yield from until(lambda: not solving())
        with measured("bake, its end"):
            yield from until(ended)
            yield 1.0
    assert gaps["idle"] > TICK, "The gaps while Blender idles were not measured."
    assert gaps["bake, held by us"] < LONGEST, gaps
    assert not running.failed, running.last
    assert cloud.hide_viewport
    assert lit()[0].data.grids.load()


def picture_of_a_running_bake():
    _cloud, _folder = build(resolution=128)
    yield from drawn()
    click_button(1 / 6)
    yield from until(solving)
    yield from drawn()
    take_picture("running")
    running.stop("was cancelled")
    yield from drawn()


def previewed():
    """A picture that refines, a histogram and advice; a change ends it, and nothing is kept."""
    cloud, folder = build(resolution=64)
    with overridden():
        assert bpy.ops.lb_lighting.preview() == {"FINISHED"}
    pid = preview._job._process.pid
    yield from until(lambda: preview._job is None or preview._survey)
    assert preview._job, preview._failed
    cloud.location.x = 0.1
    yield from until(lambda: preview._job is None)
    assert not is_alive(pid)
    nothing_changed(folder)
    yield from drawn()
    take_picture("preview")


def cancelled(how):
    def scenario():
        _cloud, folder = build(resolution=128)
        yield 0.5
        pid = start()
        yield from until(solving)
        yield from drawn()  # with the button
        how()
        asked = time.monotonic()
        yield from until(ended)
        gaps[f"cancel {how.__name__}"] = time.monotonic() - asked
        yield 0.5
        assert not is_alive(pid)
        said("The bake was cancelled; nothing was changed")
        nothing_changed(folder)

    scenario.__name__ = f"cancelled_{how.__name__}"
    return scenario


def by_escape():
    press("Escape")


def by_button():
    region = sidebar()
    move(region.x + region.width / 2, region.y + region.height - 3.4 * UNIT)
    xdotool("click", 1)


def undone_and_redone():
    cloud, _folder = build()
    with overridden():
        bpy.ops.ed.undo_push(message="scene")
        cloud.location.x = 1
        bpy.ops.ed.undo_push(message="moved")
    start()
    yield 0.1
    with overridden():
        bpy.ops.ed.undo()
    yield 0.2
    with overridden():
        bpy.ops.ed.redo()
    yield from until(ended)
    assert not running.failed, running.last
    assert len(lit()) == 1
    with overridden():
        bpy.ops.ed.undo()  # the bake is one step
    assert lit() == []
    assert bpy.data.objects["Cloud"].location.x == 1


def saved_renamed_and_on_another_frame():
    cloud, folder = build()
    start()
    yield 0.1
    blend = str(folder / "scene.blend")
    with overridden():
        bpy.ops.wm.save_as_mainfile(filepath=blend, copy=True)
    cloud.name = "Renamed"
    bpy.context.scene.frame_set(7)
    yield from until(ended)
    assert not running.failed, running.last
    assert len(lit()) == 1
    assert cloud.hide_viewport
    with bpy.data.libraries.load(blend) as (there, _here):
        assert "Cloud" in there.objects
        assert len(there.volumes) == 1
    bpy.context.scene.frame_set(1)


def deleted():
    cloud, folder = build()
    start()
    yield 0.1
    bpy.data.objects.remove(cloud)
    yield from until(ended)
    said("has been deleted meanwhile; nothing was changed")
    assert files(folder) == ["ball.vdb"]


def asked_twice():
    build(resolution=96)
    start()
    with overridden():
        assert not bpy.ops.lb_lighting.bake.poll()
        assert not bpy.ops.lb_lighting.bake_animation.poll()
    yield from until(ended)
    assert not running.failed, running.last


def killed():
    _cloud, folder = build(resolution=128)
    pid = start()
    yield from until(solving)
    os.kill(pid, signal.SIGKILL)
    yield from until(ended)
    said("ended by signal 9; nothing was changed")
    nothing_changed(folder)
    yield from drawn()
    take_picture("error")


def on_a_full_disk():
    _cloud, folder = build(resolution=24)
    bpy.context.scene.lb_lighting.device = "NumPy"  # drivers end in their own way
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        start()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    yield from until(ended)
    said("free")
    nothing_changed(folder)


def without_the_device():
    _cloud, folder = build()
    bpy.context.scene.lb_lighting.device = "abacus"
    start()
    yield from until(ended)
    said("There is no device called 'abacus'; choose one of: ")
    nothing_changed(folder)
    yield from drawn()
    take_picture("no_device")


def in_edit_mode_at_the_end():
    """The light waits until the mesh can take it."""
    build()
    bpy.data.batch_remove([bpy.data.objects["Cloud"]])
    with overridden():
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=8, y_subdivisions=8)
        leaf = bpy.context.object
        leaf.data.materials.append(bpy.data.materials.new("Leaf"))
    start()
    with overridden():
        bpy.ops.object.mode_set(mode="EDIT")
    yield from until(lambda: running.shown[0] == "Waiting for Edit Mode to end")
    assert "lb_ambient" not in leaf.data.attributes
    with overridden():
        bpy.ops.object.mode_set(mode="OBJECT")
    yield from until(ended)
    assert not running.failed, running.last
    assert "lb_ambient" in leaf.data.attributes


def with_the_extension_disabled():
    _cloud, folder = build(resolution=128)
    pid = start()
    yield from until(solving)
    addon_utils.disable(EXTENSION)
    yield 1.0
    assert not is_alive(pid)
    nothing_changed(folder)
    addon_utils.enable(EXTENSION)
    yield 0.5


def with_another_file_opened():
    _cloud, folder = build(resolution=128)
    pid = start()
    yield from until(solving)
    with overridden():
        bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    assert not is_alive(pid)
    assert files(folder) == ["ball.vdb"]
    assert running.baking is None


def quit_meanwhile():
    """The last: who started Blender looks whether the worker is gone."""
    build(resolution=128)
    pid = start()
    yield from until(solving)
    (SCREENS / "worker.pid").write_text(str(pid))


class measured:  # noqa: N801 - reads as a function
    """Inside, the longest gap between ticks of a timer is kept under a name."""

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
    """Inside, the longest time that one of `methods` (class, name) takes of the processor is kept
    under a name: what the machine does meanwhile for others is not ours."""
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


SCENARIOS = [
    open_tab,
    as_it_comes,
    by_clicks,
    picture_of_a_running_bake,
    previewed,
    cancelled(by_escape),
    cancelled(by_button),
    undone_and_redone,
    saved_renamed_and_on_another_frame,
    deleted,
    asked_twice,
    killed,
    on_a_full_disk,
    without_the_device,
    in_edit_mode_at_the_end,
    with_the_extension_disabled,
    with_another_file_opened,
    quit_meanwhile,
]


def all_steps():
    chosen = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    for scenario in SCENARIOS:
        if not chosen or scenario.__name__ in ("open_tab", *chosen):
            yield from scenario()
            print(f"{scenario.__name__}: passed", flush=True)


STEPS = all_steps()


def end_if_blender_hangs():
    """End Blender where this is not called again for long, and tell where it is."""
    faulthandler.dump_traceback_later(PATIENCE, exit=True, file=sys.__stderr__)


def next_step():
    """Go on until the scenarios end; the exit code tells whether all of them went well."""
    end_if_blender_hangs()
    try:
        return next(STEPS)
    except StopIteration:
        (SCREENS / "gaps.json").write_text(json.dumps(gaps, indent=1))
        print("Longest gaps, s:", json.dumps(gaps), flush=True)
        bpy.ops.wm.quit_blender()
    except BaseException:
        traceback.print_exc()
        take_picture("failed")
        sys.stderr.flush()
        os._exit(1)
    return None


bpy.context.preferences.view.show_splash = False
end_if_blender_hangs()
bpy.app.timers.register(next_step, first_interval=SHOWN, persistent=True)
