# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a fixed set of solves and bakes, compared bit by bit before and after a refactoring.

    python -m tests.benchmarks.behaviour keep       write build/bench/behaviour.npz
    python -m tests.benchmarks.behaviour compare    print the differences; exit code 1 if any

A runtime gives the same bits in every run on one machine, so there is no tolerance. Each solve runs
with NumPy and on every OpenCL device; bakes run with NumPy and on the first device.
"""

import os
import sys
import tempfile
from itertools import product
from math import inf
from pathlib import Path

import numpy as np

from lb_lighting.transport import (
    SAMPLERS,
    AreaLight,
    Medium,
    PerlinMedium,
    PointLight,
    Settings,
    Sky,
    SpotLight,
    Sun,
    device,
    paper_units,
    sample_free_paths,
    solve,
    trace,
)
from tests.benchmarks.table import BUILD

KEPT = BUILD / "behaviour.npz"
EDGE = 12  # voxels
FIELDS = ("fluence", "direct", "flux", "direct_flux", "by_light", "forward", "variance")
BANDS = (8.0, 7.0, 5.0), (0.1, 0.5, 1.0)  # sigma_s and sigma_a, 1/m
LIGHTS = {
    "sun": Sun((0.3, 0.2, -0.93), 2.0),
    "colored sun": Sun((0.3, 0.2, -0.93), (2.0, 1.0, 0.5)),
    "sky": Sky(1.0),
    "half sky": Sky(lambda towards: np.maximum(towards[2], 0.0)),
    "point": PointLight((1.5, 0.4, 0.6), 5.0),
    "point inside": PointLight((0.52, 0.47, 0.55), 5.0, 0.05),
    "spot": SpotLight((0.5, 0.5, 2.0), (0, 0, -1), 5.0, 0.6, 0.3),
    "area": AreaLight((0.5, 0.5, 1.5), (0.5, 0, 0), (0, -0.5, 0), 5.0),
}
WAYS = {
    "lattice": Settings(),
    "merged": Settings(merge=2),
    "divided": Settings(divide=2),
    "unscattered": Settings(scattering="single", rays=0.5),
    "handover 1": Settings(handover=1.0, photons=2000),
    "photons": Settings(handover=inf, photons=2000),
}


def media():
    """{name: Medium}: a cloud, forward scattering, in three bands, glowing, with opaque voxels."""
    rng = np.random.default_rng(0)
    density = rng.uniform(0, 2, (EDGE, EDGE, EDGE - 2)) * (rng.random((EDGE, EDGE, EDGE - 2)) > 0.4)
    size, shape = 1 / EDGE, density.shape
    emission = rng.uniform(0, 3, shape) * (density > 1)
    occlusion = np.zeros(shape)
    occlusion[4:7, 5:8, 3:5] = rng.uniform(0.5, 1, (3, 3, 2))
    return {
        "cloud": Medium(density, size, 8.0, 0.2),
        "forward cloud": Medium(density, size, 20.0, 0.2, 0.85),
        "bands": Medium(density, size, *BANDS, (0.0, 0.3, 0.6)),
        "leaves": Medium(density, size, 3.0, 1.0, -0.2),
        "fire": Medium(density, size, 8.0, 0.2, emission=emission),
        "occluded": Medium(
            density, size, 8.0, 0.2, occlusion=occlusion, occlusion_albedo=np.full((1, *shape), 0.5)
        ),
        "deep": Medium(20 * density, size, 8.0, 0.001),
    }


def arrays(field):
    """{name: array} of the arrays that a `Field` has."""
    found = {name: getattr(field, name, None) for name in FIELDS}
    return {name: np.asarray(values) for name, values in found.items() if values is not None}


def solves(found):
    """Yields (name, {part: array}) of the solver on a device."""
    kept = media()
    for (kind, light), name in product(LIGHTS.items(), ("cloud", "bands", "occluded")):
        if np.size(light.spectrum) > kept[name].bands:
            continue
        yield f"{name}, {kind}", arrays(solve(kept[name], [light], Settings(), found))
    for (way, settings), (name, medium) in product(WAYS.items(), kept.items()):
        lights = [LIGHTS["sun"], LIGHTS["sky"]]
        yield f"{name}, {way}", arrays(solve(medium, lights, settings, found))
    for keep_absorbed in (False, True):
        settings = Settings(model="paper", keep_absorbed=keep_absorbed)
        medium = paper_units(kept["bands"])
        yield f"paper, {keep_absorbed}", arrays(solve(medium, [LIGHTS["sun"]], settings, found))
    for name in ("forward cloud", "bands", "fire", "occluded"):
        yield f"trace, {name}", arrays(trace(kept[name], [LIGHTS["sun"]], 2000, device=found))


def samples(found):
    """Like `solves`, for free paths."""
    rng = np.random.default_rng(1)
    origins, directions = rng.uniform(0, 1, (500, 3)), rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    noise = PerlinMedium(16, 1.0, 5.0, 0.5)
    for name, medium in (("cloud", media()["cloud"]), ("noise", noise)):
        for sampler in SAMPLERS:
            paths = sample_free_paths(medium, origins, directions, sampler, device=found)
            yield f"{sampler}, {name}", {"distances": np.asarray(paths)}


def bakes(found, folder):
    """Like `solves`, for the data that bakes write into a scene."""
    import bpy

    from tests import scenery

    def baked(name, make, **changes):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scenery.add_sun()
        objects = make()
        usual = {"resolution": 16, "quality": "CUSTOM", "device": found.label, "folder": folder}
        outcome = scenery.bake_light(*objects, **usual | changes)
        written = {f"grid {key}": values for key, values in grids(outcome.path)}
        for ob in objects:
            if ob.type == "MESH" and "lb_ambient" in ob.data.attributes:
                written[f"light of {ob.name}"] = scenery.ambient(ob)
        return name, written

    place = Path(folder)
    fog, leaves = lambda: [scenery.add_fog(place)], lambda: [scenery.add_leaves()]
    yield baked("volume", fog)
    yield baked("volume that scatters forwards", lambda: [forward_fog(scenery, place)])
    yield baked("volume, added", fog, mode="ADD")
    yield baked("volume, by the paper", fog, model="paper")
    yield baked("volume, photons before", fog, handover=2.0, photons=2000)
    yield baked("leaves", leaves)
    yield baked("leaves, by a modifier", leaves, foliage="MODIFIER")
    yield baked("both, and an occluder", lambda: [*fog(), *leaves(), wall(scenery)])
    yield baked("solid", lambda: [scenery.add_ball(material=scenery.volume_material())])


def forward_fog(scenery, place):
    """A fog whose light is computed along many ordinates."""
    ob = scenery.add_fog(place, material=False)
    ob.data.materials.append(scenery.volume_material(anisotropy=0.85))
    return ob


def wall(scenery):
    ob = scenery.add_ball("wall", 0.4, "OCCLUDER")
    ob.location = 0.5, 0.5, 0
    return ob


def grids(path):
    """Yields (name, values) of each grid of a .vdb."""
    import openvdb

    for grid in openvdb.readAllGridMetadata(str(path)):
        full = openvdb.read(str(path), grid.name)
        if not full.activeVoxelCount():
            continue
        first, last = full.evalActiveVoxelBoundingBox()
        edges = tuple(np.subtract(last, first) + 1)
        vector = isinstance(full.zeroValue, tuple)
        values = np.empty((*edges, 3) if vector else edges, np.float32)
        full.copyToArray(values, first)
        yield grid.name, values


def everything():
    """Yields (name, array)."""
    for found in device.devices():
        for make in (solves, samples):
            for case, parts in make(found):
                for part, values in parts.items():
                    yield f"{found.label}: {case}: {part}", values
    import bpy

    bpy.utils.expose_bundled_modules()

    import lb_lighting

    lb_lighting.register()
    with tempfile.TemporaryDirectory() as folder:
        for found in (device.devices()[0], device.numpy_device()):
            for case, parts in bakes(found, folder):
                for part, values in parts.items():
                    yield f"{found.label}: bake of {case}: {part}", values


def main(verb):
    found = {name: np.asarray(values) for name, values in everything()}
    if verb == "keep":
        BUILD.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(KEPT, **found)
        print(f"kept {len(found)} arrays")
        return 0
    kept = np.load(KEPT)
    other = [
        name
        for name in sorted({*kept.files, *found})
        if name not in found or name not in kept or not _equal(found[name], kept[name])
    ]
    print(*other, sep="\n")
    print(f"{len(found)} arrays, {len(other)} differ")
    return 1 if other else 0


def _equal(values, kept):
    return values.dtype == kept.dtype and np.array_equal(values, kept, equal_nan=True)


if __name__ == "__main__":
    code = main(sys.argv[1])
    sys.stdout.flush()
    os._exit(code)  # Blender sometimes crashes at Python's exit
