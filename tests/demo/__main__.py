# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job on real input: light three scenes and render each without LB light, with it, and
in LB light alone. Leaves the pictures, and the lit .blend files, in build/demo.
"""

import contextlib
import os
from pathlib import Path
from time import perf_counter

import bpy

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402 - OpenVDB has to be exposed first
from lb_lighting import bake  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402

from . import scenes  # noqa: E402

OUTPUT = Path(__file__).parents[2] / "build" / "demo"
SIZE = 480
SAMPLES = {"cloud": 12, "plant": 32, "teapot": 48}


def main():
    lb_lighting.register()
    OUTPUT.mkdir(parents=True, exist_ok=True)
    for name, build in (
        ("cloud", scenes.cloud),
        ("plant", scenes.plant),
        ("teapot", scenes.teapot),
    ):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        objects, changes = build()
        set_up_render(name)
        render(f"{name}-without")
        light(name, objects, changes)
        render(f"{name}-with")
        switch_lights_off()
        render(f"{name}-alone")


def light(name, objects, changes):
    scene = bpy.context.scene
    chosen = [scene.objects[ob] for ob in objects]
    options = bake.Options.of(scene, folder=str(OUTPUT), **changes)
    outcome = bake.bake(bpy.context, chosen, options)
    print(f"{name}: {outcome.summary}", *outcome.notes, sep="\n  ")
    bpy.ops.wm.save_as_mainfile(filepath=str(OUTPUT / f"{name}.blend"), compress=True)


def set_up_render(name):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES[name]
    scene.cycles.use_denoising = False
    scene.cycles.volume_bounces = 0  # Cycles' default
    scene.cycles.diffuse_bounces = 0  # the lattice stands for all of them, as in the paper
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "PNG"
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "Very High Contrast" if name == "cloud" else "None"


def switch_lights_off():
    """What then remains is emission: LB light."""
    bpy.data.objects["Sun"].hide_render = True
    background = next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = 0


def render(name):
    start = perf_counter()
    path = OUTPUT / f"{name}.png"
    bpy.context.scene.render.filepath = str(path)
    with silent_stdout():
        bpy.ops.render.render(write_still=True)
    print(f"build/demo/{path.name}: {perf_counter() - start:.0f} s", flush=True)


@contextlib.contextmanager
def silent_stdout():
    """Blender prints a line a sample from C, where Python cannot catch it."""
    kept = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


main()
leave(0)
