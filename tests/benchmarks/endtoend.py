# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures with baked light, compared with pictures in which Cycles traces every scattering.

    python -m tests.benchmarks.endtoend [CASE ...]

Both show the same .vdb, which has the resolution of the lattice. The table lists for each picture:
its mean relative to the reference, in the band where this is farthest from 1; its error, the
relative L2 over pixels and bands; and the error of the reference, from two halves that are rendered
separately. References are stored in build/references, pictures in build/bench/endtoend.
"""

import argparse
import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import bpy
import numpy as np
from mathutils import Vector

bpy.utils.expose_bundled_modules()

import openvdb  # noqa: E402 - only now is it exposed

import lb_lighting  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.job import Job  # noqa: E402
from lb_lighting.options import Options  # noqa: E402
from lb_lighting.reading import read_scene  # noqa: E402
from lb_lighting.showing import apply  # noqa: E402
from tests.benchmarks import media  # noqa: E402
from tests.benchmarks.table import BUILD, publish  # noqa: E402
from tests.jobs import Solve  # noqa: E402
from tests.output.rendering import dark_scene, render  # noqa: E402

REFERENCES = BUILD.parent / "references"
PICTURES = BUILD / "endtoend"
EDGE = 60  # voxels of a medium; 64 with the padding, which are 1 m
VOXEL = 1 / 64  # m
LATTICE = {"resolution": 64, "domain": "Bounds"}
PHOTONS = 3_000_000  # without a lattice: 11 per voxel
SIZE = 128  # pixels
SAMPLES = 64
BOUNCES = 1024  # of the reference, more than light has in any of these cases
CAMERA = (0.0, -3.0, 0.6)
WHITE = (1.0, 1.0, 1.0)
FROM_THE_LEFT, FROM_THE_RIGHT = (0.8, 0.3, -0.5), (-0.6, -0.5, -0.6)


@dataclass(frozen=True)
class Case:
    """A medium in suns.

    density  (EDGE, EDGE, EDGE)
    sigma_t  extinction at density 1, 1/m
    suns     ((direction, irradiance (3,) W/m^2), ...)
    half     samples of each half of the reference
    """

    name: str
    density: np.ndarray
    sigma_t: float
    albedo: float
    g: float
    suns: tuple
    half: int = 128

    @property
    def key(self):
        """Hash of everything that the reference depends on."""
        numbers = self.sigma_t, self.albedo, self.g, self.suns, self.half, SIZE, BOUNCES, CAMERA
        digest = hashlib.sha256(self.density.tobytes() + repr(numbers).encode())
        return f"endtoend-{self.name.replace(' ', '-')}-{digest.hexdigest()[:8]}"


def cases():
    cloud = media.cloud(EDGE).astype(np.float32)
    white, blue = ((FROM_THE_LEFT, WHITE),), (FROM_THE_RIGHT, (0.2, 0.5, 1.2))
    yield Case("cloud", cloud, 40.0, 0.99, 0.0, white, half=512)
    yield Case("block", np.ones((EDGE,) * 3, np.float32), 8.0, 0.99, 0.0, white)
    yield Case("smoke", cloud, 12.0, 0.8, 0.6, white)
    yield Case("two suns", cloud, 20.0, 0.99, 0.3, ((FROM_THE_LEFT, (1.2, 0.8, 0.3)), blue))


# --- Scenes --------------------------------------------------------------------------------------


def build(case, folder):
    """Fill the empty file with the case and return the Volume object."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    turn = (-Vector(CAMERA)).to_track_quat("-Z", "Y").to_euler()
    scene = dark_scene(CAMERA, turn, 1)
    scene.camera.data.type, scene.camera.data.lens = "PERSP", 80
    for direction, irradiance in case.suns:
        lamp = bpy.data.lights.new("Sun", "SUN")
        lamp.angle, lamp.energy, lamp.color = 0, 1, irradiance
        sun = bpy.data.objects.new("Sun", lamp)
        sun.rotation_euler = Vector(direction).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(sun)
    bounds = bpy.data.meshes.new("Bounds")
    half = EDGE * VOXEL / 2
    bounds.from_pydata([(-half,) * 3, (half,) * 3], [], [])
    scene.collection.objects.link(bpy.data.objects.new("Bounds", bounds))
    data = bpy.data.volumes.new("Source")
    data.filepath = str(write_grids(folder / "source.vdb", density=case.density))
    data.materials.append(medium(case))
    source = bpy.data.objects.new("Source", data)
    scene.collection.objects.link(source)
    return source


def write_grids(path, **grids):
    """Write named (EDGE, EDGE, EDGE) grids around the origin to a .vdb, and return its path."""
    written = []
    for name, values in grids.items():
        grid = openvdb.FloatGrid()
        grid.copyFromArray(np.ascontiguousarray(values))
        grid.name, grid.gridClass = name, openvdb.GridClass.FOG_VOLUME
        grid.transform = openvdb.createLinearTransform(VOXEL)
        grid.transform.postTranslate(((1 - EDGE) * VOXEL / 2,) * 3)
        written.append(grid)
    openvdb.write(str(path), written)
    return path


def medium(case):
    material = bpy.data.materials.new("Medium")
    nodes = material.node_tree.nodes
    nodes.clear()
    output, volume = (
        nodes.new(kind) for kind in ("ShaderNodeOutputMaterial", "ShaderNodeVolumePrincipled")
    )
    volume.inputs["Density"].default_value = case.sigma_t
    volume.inputs["Color"].default_value = (*[case.albedo] * 3, 1)
    volume.inputs["Absorption Color"].default_value = (0, 0, 0, 1)
    volume.inputs["Anisotropy"].default_value = case.g
    material.node_tree.links.new(volume.outputs["Volume"], output.inputs["Volume"])
    return material


# --- Pictures ------------------------------------------------------------------------------------


def picture(folder, samples, bounces=0, seed=0):
    """((SIZE, SIZE, 3) radiance of the scene, seconds); nothing is clamped or omitted."""
    scene = bpy.context.scene
    scene.cycles.volume_bounces = scene.cycles.max_bounces = bounces
    scene.cycles.sample_clamp_indirect = scene.cycles.light_sampling_threshold = 0
    scene.cycles.seed = seed
    scene.render.use_persistent_data = False
    start = perf_counter()
    pixels = render(scene, folder / "picture.exr", SIZE, samples)
    return pixels, perf_counter() - start


def reference(case, folder):
    """The two halves of the reference, (2, SIZE, SIZE, 3), which are rendered once and stored."""
    path = REFERENCES / f"{case.key}.npz"
    if not path.exists():
        build(case, folder)
        halves = [picture(folder, case.half, BOUNCES, seed)[0] for seed in (1, 2)]
        REFERENCES.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, halves=np.array(halves, np.float32))
    return np.load(path)["halves"].astype(float)


def solved(case, folder, handover):
    """(field, seconds) of the solve that `bake` does."""
    source = build(case, folder)
    options = Options.of(bpy.context.scene, handover=handover, **LATTICE)
    problem = read_scene(bpy.context, [source], options).problem()
    start = perf_counter()
    settings = replace(options.settings(), photons=PHOTONS)
    field = Job(Solve(problem.medium, problem.lights, settings)).wait()
    return field, perf_counter() - start


def lit(case, folder, field, mode, samples):
    """(picture, seconds) of the scene with the field."""
    source = build(case, folder)
    options = Options.of(bpy.context.scene, mode=mode, folder=str(folder), **LATTICE)
    task = read_scene(bpy.context, [source], options)
    apply(bpy.context, [source], task, task.keep(task.problem(), field))
    return picture(folder, samples)


def compare(name, found, wanted, seconds, solving=0.0):
    """A row of the table."""
    halves, mean = wanted, wanted.mean(axis=0)
    ratios = found.mean(axis=(0, 1)) / mean.mean(axis=(0, 1))
    noise = np.linalg.norm(halves[0] - halves[1]) / 2 / np.linalg.norm(mean)
    return {
        "picture": name,
        "mean / reference": float(ratios[np.argmax(np.abs(ratios - 1))]),
        "error": float(np.linalg.norm(found - mean) / np.linalg.norm(mean)),
        "noise of the reference": float(noise),
        "seconds": seconds,
        "solving": solving,
    }


def rows_of(case):
    with TemporaryDirectory() as name:
        folder = Path(name)
        wanted = reference(case, folder)
        build(case, folder)
        found, seconds = picture(folder, SAMPLES, BOUNCES)
        yield compare(f"{case.name}: Cycles, {SAMPLES} samples", found, wanted, seconds)
        for light, handover, pictures in (
            ("lattice", 0.0, (("REPLACE", 1), ("REPLACE", SAMPLES), ("ADD", SAMPLES))),
            ("photons", np.inf, (("REPLACE", SAMPLES), ("ADD", SAMPLES))),
        ):
            field, solving = solved(case, folder, handover)
            for mode, samples in pictures:
                found, seconds = lit(case, folder, field, mode, samples)
                name = f"{case.name}: {mode.title()}, {light}"
                yield compare(f"{name}, {samples} samples", found, wanted, seconds, solving)
                if samples == SAMPLES:
                    save(f"{case.name}-{mode.lower()}-{light}", wanted.mean(axis=0), found)


def save(name, wanted, found):
    """The reference, ours, and four times their difference around grey, side by side."""
    level = 0.9 / np.percentile(wanted, 99.5)
    grey = 0.5 + 2 * level * (found - wanted)
    panels = [np.clip(level * wanted, 0, 1) ** (1 / 2.2), np.clip(level * found, 0, 1) ** (1 / 2.2)]
    strip = np.concatenate([*panels, np.clip(grey, 0, 1)], axis=1)
    image = bpy.data.images.new(name, strip.shape[1], strip.shape[0])
    image.pixels.foreach_set(np.dstack([strip, np.ones(strip.shape[:2])]).astype("f4").ravel())
    PICTURES.mkdir(parents=True, exist_ok=True)
    image.filepath_raw = str(PICTURES / f"{name.replace(' ', '-')}.png")
    image.file_format = "PNG"
    image.save()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", help="default: all")
    chosen = parser.parse_args().cases
    lb_lighting.register()
    rows = []
    for case in cases():
        if not chosen or case.name in chosen:
            rows += rows_of(case)
    publish("endtoend", "Cycles on the processor", rows)


if __name__ == "__main__":
    main()
    leave(0)
