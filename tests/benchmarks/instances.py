# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost and error of the modifier on instances, compared with making them real.

    python -m tests.benchmarks.instances

A plant of 30 000 leaves of 4 cm, instanced by geometry nodes, in 64 voxels: seconds to evaluate it
after it has moved, and the picture of its LB light alone, with instances relative to points. Writes
build/bench/instances.json.
"""

import tempfile
from pathlib import Path
from time import perf_counter

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from tests import scenery  # noqa: E402
from tests.benchmarks.table import publish  # noqa: E402
from tests.output.rendering import dark_scene, render, silent_stdout  # noqa: E402
from tests.output.test_modifier import scatter_group, set_input  # noqa: E402

LEAVES, WIDTH, SIZE, SAMPLES = 30_000, 0.04, 128, 64


def plant():
    """The lit plant; each of its leaves is a grid of 4 x 4 faces."""
    scenery.add_sun()
    corners = [(x, y, 0) for x in np.linspace(-0.5, 0.5, 5) for y in np.linspace(-0.5, 0.5, 5)]
    faces = [(n, n + 1, n + 6, n + 5) for n in range(20) if n % 5 < 4]
    mesh = bpy.data.meshes.new("leaf")
    mesh.from_pydata((WIDTH * np.array(corners)).tolist(), [], faces)
    mesh.materials.append(scenery.leaf_material((0.4, 0.4, 0.4)))
    leaf = scenery.link("leaf", mesh)
    leaf.hide_render = leaf.hide_viewport = True
    points = bpy.data.meshes.new("plant")
    places = np.random.default_rng(3).normal(0, 0.5, (LEAVES, 3))
    points.from_pydata(places.tolist(), [], [])
    ob = scenery.link("plant", points)
    ob.modifiers.new("scatter", "NODES").node_group = scatter_group(leaf)
    return ob


def measured(ob, folder, realize):
    """(seconds of an evaluation, picture) with instances, or with instances made real."""
    set_input(ob, "Realize Instances", realize)
    bpy.context.view_layer.update()
    ob.location.x += 1e-3
    begin = perf_counter()
    bpy.context.view_layer.update()
    seconds = perf_counter() - begin
    ob.location.x = 0
    return seconds, render(bpy.context.scene, folder / "a.exr", SIZE, SAMPLES)


def main():
    lb_lighting.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with tempfile.TemporaryDirectory() as folder, silent_stdout():
        folder = Path(folder)
        ob = plant()
        outcome = scenery.bake_light(ob, foliage="MODIFIER", folder=str(folder))
        bpy.data.objects["sun"].hide_render = True
        dark_scene((0, -6, 0), (np.pi / 2, 0, 0), width=4)
        seconds, pictures = zip(
            *(measured(ob, folder, realize) for realize in (False, True)), strict=True
        )
    instances, points = pictures
    publish("instances", outcome.field.report.device, [{
        "leaves": LEAVES,
        "voxel, m": round(outcome.field.domain.voxel_size, 3),
        "s, instances": round(seconds[0], 3),
        "s, real": round(seconds[1], 3),
        "mean": round(instances.mean() / points.mean(), 4),
        "error": round(float(np.linalg.norm(instances - points) / np.linalg.norm(points)), 4),
    }])  # fmt: skip


if __name__ == "__main__":
    main()
    leave(0)
