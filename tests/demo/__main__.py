# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: light three real scenes, and render each without LB light, with it, and with it alone.

Writes the pictures and the lit .blend files to build/demo.
"""

from pathlib import Path
from time import perf_counter

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

import openvdb  # noqa: E402 - only now is it exposed

import lb_lighting  # noqa: E402
from lb_lighting import bake  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.options import Options  # noqa: E402
from lb_lighting.output.vdb import DENSITY_GRID  # noqa: E402
from tests.output.rendering import silent_stdout  # noqa: E402

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
    options = Options.of(scene, folder=str(OUTPUT), **changes)
    outcome = bake.bake(bpy.context, chosen, options)
    print(f"{name}: {outcome.summary}", fall_off(outcome), *outcome.notes, sep="\n  ")
    bpy.ops.wm.save_as_mainfile(filepath=str(OUTPUT / f"{name}.blend"), compress=True)


def fall_off(outcome):
    """A line on the transmitted share of the sun's light, where it leaves the medium."""
    density = openvdb.read(str(outcome.path), DENSITY_GRID)
    values = np.empty(outcome.field.domain.shape, np.float32)
    density.copyToArray(values)
    filled = values > 0
    along = outcome.field.domain.centers()[filled] @ scenes.SUN
    light = outcome.field.fluence.mean(axis=0)[filled]
    lit, far = (
        np.average(light[part])
        for part in (along <= np.quantile(along, 0.1), along >= np.quantile(along, 0.9))
    )
    return f"fluence: {lit:.2f} W/m^2 in the tenth towards the sun, {far:.2f} in the tenth away"


def set_up_render(name):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES[name]
    scene.cycles.use_denoising = False
    scene.cycles.volume_bounces = 0  # Cycles' default
    scene.cycles.diffuse_bounces = 0  # the lattice replaces all of them, as in the paper
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "PNG"
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "Very High Contrast" if name == "cloud" else "None"


def switch_lights_off():
    """Remove all lights, so that only emission remains: LB light."""
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


main()
leave(0)
