# SPDX-License-Identifier: GPL-3.0-or-later
"""Brightness of a small cloud as baked, relative to Cycles' own picture, by kind of light.

    python -m tests.benchmarks.light_levels

renders the scenes of tests/output/test_light_levels.py with finer voxels and more samples than the
tests do. Columns are means over the picture, relative to Cycles, in each band.
"""

from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.transport import device  # noqa: E402
from tests.benchmarks.table import publish  # noqa: E402
from tests.output import test_light_levels as scenes  # noqa: E402

VOXELS, FIRE_VOXELS, SAMPLES = 24, 16, 256
INSIDE = (16, 24, 32)  # voxels, for a point inside


def lit(name, light, folder, mode="REPLACE", margin=4, add=scenes.add_cloud, **medium):
    """The row of one light.

    light  function that adds it to the scene
    add    function that adds the volume
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scenes.look()
    light()
    folder = fresh(folder)
    volume = add(folder, **medium)
    expected, ours, _ = scenes.pictures(folder, volume, mode, samples=SAMPLES, margin=margin)
    ratios = ours.mean(axis=(0, 1)) / expected.mean(axis=(0, 1))
    row = dict(zip(("red", "green", "blue"), map(float, ratios), strict=True))
    return {"light": name, "voxels": scenes.EDGE, "mode": mode} | row


def fresh(folder):
    """A new folder, as Blender reads a path only once."""
    return Path(mkdtemp(dir=folder))


def lamp(kind, place, **settings):
    def add():
        scenes.add_lamp(kind, place, **settings)

    return add


def none():
    """No light: a fire emits its own."""


def rows(folder):
    scenes.EDGE = VOXELS
    for light in scenes.LIGHTS:
        yield lit(light.__name__, light, folder)
    soft = lamp("POINT", scenes.INSIDE, energy=300.0, shadow_soft_size=0.1)
    for extinction in (2.0, 5.0):
        name = f"point inside, radius .1 m, {extinction:g}/m"
        yield lit(name, soft, folder, margin=8, extinction=extinction)
    for side, place in scenes.FORWARD.items():
        sun = lamp("SUN", place, energy=3.0)
        yield lit(f"g .85, sun {side}", sun, folder, **scenes.DENSE)
    scenes.EDGE = FIRE_VOXELS
    for kind, inputs in scenes.FIRES.items():
        for mode in ("REPLACE", "ADD"):
            yield lit(f"fire, {kind}", none, folder, mode, add=scenes.add_fire, **inputs)


def inside(folder):
    """Single scattering of a point's light, relative to its integral instead of Cycles."""
    for scenes.EDGE in INSIDE:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        ratio = float(np.mean(scenes.point_inside(fresh(folder))))
        yield {"light": "point inside, once, to the integral", "voxels": scenes.EDGE, "red": ratio}


def main():
    lb_lighting.register()
    with TemporaryDirectory() as folder:
        all_rows = [*rows(Path(folder)), *inside(Path(folder))]
    publish("light_levels", device.choose().label, all_rows)
    leave(0)


if __name__ == "__main__":
    main()
