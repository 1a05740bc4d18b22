# SPDX-License-Identifier: GPL-3.0-or-later
"""Foliage end to end: crowns and a real tree in Cycles and with baked light, and the difference.

The reference is Cycles with 32 bounces, stored in build/references. Its indirect light is the
picture minus the picture without bounces; ours is the emission of the leaves. Errors are those of
means over 4x4 pixels. Leaves have three colours at once, one for each band of a picture.
"""

import sys
import zlib
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import bpy
import numpy as np
from PIL import Image

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402
from lb_lighting import bake  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.options import Options  # noqa: E402
from lb_lighting.reading import read_scene  # noqa: E402
from lb_lighting.showing import apply  # noqa: E402
from lb_lighting.transport import trace  # noqa: E402
from lb_lighting.transport.field import Report  # noqa: E402
from tests.benchmarks import crowns  # noqa: E402
from tests.benchmarks.table import BUILD, publish  # noqa: E402
from tests.output.rendering import render, silent_stdout  # noqa: E402

REFERENCES = Path(__file__).parents[2] / "build" / "references"
SIZE, BLOCK = 160, 4  # pixels of a picture, and of the blocks that are averaged
SAMPLES = 96  # of each of the reference's two halves
OUR_SAMPLES = 64  # emission is noisy only at the edges of leaves
BOUNCES = 32
PHOTONS = 1_000_000
LIGHTS = {"sun": (True, False), "sun and sky": (True, True)}
UNDER_SKY = ("5 cm leaves", "tree")  # the only cases rendered under a sky


def main(names):
    lb_lighting.register()
    rows = []
    for name in names or crowns.CASES:
        for lights in LIGHTS:
            if lights == "sun" or name in UNDER_SKY:
                rows += compare(name, lights)
    publish("foliage", rows[0]["device"], rows)
    for solver in SOLVERS:
        print(reach([row for row in rows if row["solver"] == solver]))


def reach(rows):
    """A sentence on the worst of the rows of one solver, with the goal in brackets."""
    ours, cycles = defaultdict(float), defaultdict(float)
    for row in rows:  # both views of a crown together
        key = row["crown"], row["lights"], row["leaves"]
        ours[key] += row["mean"] * row["Cycles"]
        cycles[key] += row["Cycles"]
    both = [ours[key] / cycles[key] for key in ours]
    single = [row["mean"] for row in rows]
    worst = {
        color: max(row["picture"] for row in rows if row["leaves"] == color)
        for color in crowns.COLORS
    }
    return (
        f"{rows[0]['solver']}: mean of both views {min(both):.3f} to {max(both):.3f} (0.96 to "
        f"1.04), of one {min(single):.3f} to {max(single):.3f}; error of the picture up to "
        f"{worst['green']:.3f} green (0.02), {worst['white']:.3f} white (0.07)"
    )


def compare(name, lights):
    """[row] for each solver, view and colour."""
    case, rows = crowns.CASES[name], []
    references = {view: reference(case, lights, view) for view in crowns.VIEWS}
    for solver, solve in SOLVERS.items():
        objects = build(case, lights)
        start = perf_counter()
        report = solve(objects, case)
        seconds = perf_counter() - start
        switch_lights_off()
        for view, parts in references.items():
            crowns.look(case, view)
            ours = picture(0, OUR_SAMPLES)
            save(f"{name}-{lights}-{view}-{solver}", parts, ours)
            for band, color in enumerate(crowns.COLORS):
                facts = {"crown": name, "lights": lights, "view": view, "leaves": color}
                facts |= {"solver": solver, **figures(parts, ours, band)}
                rows.append(facts | {"s": seconds, "device": report.device})
        print(f"{name}, {lights}, {solver}: {seconds:.0f} s", flush=True)
    return rows


def figures(parts, ours, band):
    """{figure: value} of one band; errors are root mean squares over the blocks, relative to the
    reference."""
    full, direct = (blocks(parts[kind][..., band]) for kind in ("full", "direct"))
    indirect, ours = full - direct, blocks(ours[..., band])
    noise = rms(indirect[0] - indirect[1]) / 2  # of the mean of the halves
    error = ours - indirect.mean(axis=0)
    return {
        "mean": float(ours.mean() / indirect.mean()),
        "Cycles": float(indirect.mean()),
        "indirect": rms(error) / rms(indirect.mean(axis=0)),
        "picture": rms(error) / rms(full.mean(axis=0)),
        "noise": noise / rms(full.mean(axis=0)),
        "share": float(indirect.mean() / full.mean()),
        "direct alone": rms(indirect.mean(axis=0)) / rms(full.mean(axis=0)),
    }


def blocks(pictures):
    """Means over BLOCK x BLOCK pixels of the last two axes."""
    shape = (*pictures.shape[:-2], SIZE // BLOCK, BLOCK, SIZE // BLOCK, BLOCK)
    return pictures.astype(float).reshape(shape).mean(axis=(-3, -1))


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def by_lattice(objects, case):
    """Bake the light of `objects`, and return the `Report`."""
    with TemporaryDirectory() as folder:
        options = Options(resolution=case.resolution, folder=folder)
        return bake.bake(bpy.context, objects, options).field.report


def by_photons(objects, case):
    """Light `objects` by photons traced in the same medium: the error is not the lattice's.

    Photons do not use `shadow_density`, so nearly horizontal leaves are worse here.
    """
    with TemporaryDirectory() as folder:
        options = Options(resolution=case.resolution, folder=folder)
        task = read_scene(bpy.context, objects, options)
        problem = task.problem()
        field = trace(problem.medium, problem.lights, PHOTONS)
        field.report = Report("photons", field.report.device)  # files cannot store its arrays
        apply(bpy.context, objects, task, task.keep(problem, field))
    return field.report


SOLVERS = {"lattice": by_lattice, "photons": by_photons}


def switch_lights_off():
    """Remove all lights, so that only emission remains: our light."""
    for ob in bpy.context.scene.objects:
        ob.hide_render = ob.type == "LIGHT"
    background = next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = 0


def save(name, parts, ours):
    """The three bands as rows: without bounces, with ours, with all, and 4 x (ours - all)."""
    full, direct = (parts[kind].mean(axis=0) for kind in ("full", "direct"))
    light = np.percentile(full, 99.5, axis=(0, 1))
    pictures = [direct, direct + ours, full, light / 2 + 4 * (direct + ours - full)]
    row = np.concatenate(pictures, axis=1) / light
    picture = np.concatenate(list(np.moveaxis(row[::-1], -1, 0)))
    grey = (255 * np.clip(picture, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    BUILD.mkdir(parents=True, exist_ok=True)
    Image.fromarray(grey).save(BUILD / f"foliage-{name.replace(' ', '-')}.png")


def reference(case, lights, view):
    """{"full", "direct": (2, SIZE, SIZE, 3)}: both halves of the reference, cached.

    full    with all bounces
    direct  without bounces, from the same samples, so that much of the noise is the same
    """
    objects = build(case, lights)
    crowns.look(case, view)
    REFERENCES.mkdir(parents=True, exist_ok=True)
    path = REFERENCES / f"foliage-{_print_of(objects, case, lights, view):08x}.npz"
    if not path.exists():
        pictures = {
            kind: np.stack([picture(bounces, SAMPLES, seed) for seed in (0, 1)]).astype(np.float32)
            for kind, bounces in (("full", BOUNCES), ("direct", 0))
        }
        np.savez_compressed(path, **pictures)
    return dict(np.load(path))


def build(case, lights):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    objects = crowns.build(case)
    crowns.light(*LIGHTS[lights])
    return objects


def _print_of(objects, case, lights, view):
    """A hash of everything that the reference depends on."""
    facts = [*crowns.COLORS.values(), crowns.BARK, crowns.SOIL, *crowns.SUN, *crowns.VIEWS[view]]
    facts += [crowns.IRRADIANCE, crowns.RADIANCE, LIGHTS[lights], SIZE, SAMPLES, BOUNCES]
    found = zlib.crc32(repr((facts, case.width, case.middle)).encode())
    for ob in objects:
        points = np.empty(3 * len(ob.data.vertices), np.float32)
        ob.data.vertices.foreach_get("co", points)
        found = zlib.crc32(points.tobytes(), found)
    return found


def picture(bounces, samples, seed=0):
    """(SIZE, SIZE, 3) radiance, row 0 at the bottom."""
    scene = bpy.context.scene
    scene.cycles.seed = seed
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(scene.cycles, f"{kind}_bounces", bounces)
    with TemporaryDirectory() as folder, silent_stdout():
        return render(scene, Path(folder) / "picture.exr", SIZE, samples)


if __name__ == "__main__":
    main(sys.argv[1:])
    leave(0)
