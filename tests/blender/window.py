# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios for a windowed Blender: bake by clicks, as an artist does, and interrupt the bake.

Each scenario is a generator that yields the seconds until it continues; Blender runs meanwhile.
Screenshots go to build/screens, and the longest gaps in Blender's event loop to gaps.json there.

On a busy machine the scenarios are slower, but do not fail: they wait as long as anything changes.
"""

import faulthandler
import json
import os
import resource
import signal
import sys
import time
import traceback
from pathlib import Path

import addon_utils
import bpy

sys.path.append(str(Path(__file__).parent))

from driving import (
    LONGEST,
    PATIENCE,
    SHOWN,
    TAB,
    TICK,
    UNIT,
    build,
    click_button,
    drawn,
    ended,
    files,
    gaps,
    held,
    is_alive,
    lit,
    measured,
    move,
    nothing_changed,
    operators,
    overridden,
    press,
    preview,
    running,
    said,
    sidebar,
    solving,
    start,
    take_picture,
    until,
    view,
    xdotool,
)
from scenes import EXTENSION, SCREENS


def open_tab():
    """Open our tab of the sidebar; this is not a test."""
    view().spaces.active.show_region_ui = True
    view().tag_redraw()
    yield from until(tab_is_open)
    yield from drawn()


def tab_is_open():
    """Whether the sidebar shows our tab; it has no tabs before it is drawn."""
    try:
        sidebar().active_panel_category = TAB
    except (AttributeError, TypeError):
        return False
    return sidebar().active_panel_category == TAB


def as_it_comes():
    """A bake with the default quality."""
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
    """A whole bake of 128 voxels by clicks, which must not hold Blender's event loop.

    Gaps include drawing, which is done in software here, while the solver takes all cores. They are
    therefore also measured while Blender idles, with the same regions drawn as often.
    """
    cloud, _folder = build(resolution=128)
    yield from drawn()
    with measured("idle"):
        for _ in range(50):
            running.redraw()
            yield running.INTERVAL
    click_button(1 / 6)
    with held("bake, held by us", (operators.LB_OT_bake, "begin"), (operators._Works, "_outcome")):
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
    """A picture that refines, a histogram and advice; a change ends it and leaves nothing."""
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
    with bpy.data.libraries.load(blend) as (saved, _here):
        assert "Cloud" in saved.objects
        assert len(saved.volumes) == 1
    bpy.context.scene.frame_set(1)


def deleted():
    cloud, folder = build()
    start()
    yield 0.1
    bpy.data.objects.remove(cloud)
    yield from until(ended)
    said("was deleted during the bake; nothing was changed")
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
    bpy.context.scene.lb_lighting.device = "NumPy"  # drivers may crash
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
    """The light is written when the mesh leaves Edit Mode."""
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
    """The last scenario; __main__.py then checks that the worker has ended."""
    build(resolution=128)
    pid = start()
    yield from until(solving)
    (SCREENS / "worker.pid").write_text(str(pid))


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
    """End Blender with a traceback if this is not called again in time."""
    faulthandler.dump_traceback_later(PATIENCE, exit=True, file=sys.__stderr__)


def next_step():
    """Run the next step of the scenarios; Blender's exit code is 1 if one fails."""
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
