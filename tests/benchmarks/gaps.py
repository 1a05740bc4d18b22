# SPDX-License-Identifier: GPL-3.0-or-later
"""Time for which a bake blocks Blender's main thread: at its start, during the solve, at its end.

During the solve a timer ticks every hundredth of a second; a thread that holds Python's lock would
delay it. Blender's own work, such as drawing the new volume, is not included;
tests/blender/window.py measures gaps with it in a window.
"""

import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402 - OpenVDB has to be exposed first
from lb_lighting.bake import Baking  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.options import Options  # noqa: E402
from tests import scenery  # noqa: E402
from tests.benchmarks.table import publish  # noqa: E402

RESOLUTION = 128
LEAVES = 1_000_000
TICK = 0.01  # s


def cloud(folder):
    return scenery.add_fog(folder)


def triangles(_folder):
    return leaves(3)


def quads(_folder):
    return leaves(4)


def leaves(size):
    """A million faces of `size` corners, each a separate leaf."""
    rng = np.random.default_rng(0)
    centers = rng.uniform(-0.9, 0.9, (LEAVES, 1, 3))
    across = rng.uniform(-0.01, 0.01, (LEAVES, 2, 3))
    corners = centers + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])[:size] @ across
    count = size * LEAVES
    mesh = bpy.data.meshes.new("leaves")
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", corners.astype(np.float32).ravel())
    mesh.loops.add(count)
    mesh.loops.foreach_set("vertex_index", np.arange(count, dtype=np.int32))
    mesh.polygons.add(LEAVES)
    mesh.polygons.foreach_set("loop_start", np.arange(0, count, size, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.materials.append(scenery.leaf_material())
    return scenery.link("leaves", mesh)


def timed(action):
    """(seconds, result)."""
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def held(make):
    """A row: a bake in steps, as in a window."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder:
        ob = make(Path(folder))
        scenery.add_sun()
        bpy.context.view_layer.update()
        options = Options(resolution=RESOLUTION, folder=folder)
        begun, baking = timed(lambda: Baking(bpy.context, [ob], options))
        ticks, done = [time.perf_counter()], False
        while not done:
            time.sleep(TICK)
            done = baking.update()
            ticks.append(time.perf_counter())
        ended, outcome = timed(lambda: baking.apply(bpy.context))
    return {
        "lit": make.__name__,
        "start, s": begun,
        "longest gap meanwhile, s": np.diff(ticks).max(),
        "end, s": ended,
        "solver, s": sum(outcome.result.report.seconds.values()),
    }


lb_lighting.register()
publish("gaps", "main thread", [held(make) for make in (cloud, triangles, quads)])
leave(0)
