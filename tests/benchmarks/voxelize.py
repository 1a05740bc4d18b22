# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxelizing a million triangles to 128³ voxels, and writing the file of a baked volume."""

import tempfile
from pathlib import Path
from time import perf_counter
from types import SimpleNamespace

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

from lb_lighting.cli import leave  # noqa: E402 - OpenVDB has to be exposed first
from lb_lighting.output.vdb import AXES, direct_grid, flux_grid, write_vdb  # noqa: E402
from lb_lighting.scene.triangles import area_of  # noqa: E402
from lb_lighting.scene.voxelize import foliage_density, surface_area  # noqa: E402
from lb_lighting.transport import Domain  # noqa: E402
from tests.benchmarks.table import publish  # noqa: E402

COUNT = 1_000_000
DOMAIN = Domain.around((0, 0, 0), (1, 1, 1), 128, padding=2)
DOWN = np.array([0.0, 0.6, -0.8])
TIMES = 3  # the fastest counts, as other processes only slow a run down


def leaves(edge):
    """(COUNT, 3, 3): triangles of about `edge` voxels at random places and orientations."""
    rng = np.random.default_rng(0)
    reach = edge * DOMAIN.voxel_size
    centers = rng.uniform(reach, 1 - reach, (COUNT, 1, 3))
    return centers + rng.uniform(-reach / 2, reach / 2, (COUNT, 3, 3))


def seconds_of(action):
    """(seconds, result)."""
    seconds = []
    for _ in range(TIMES):
        start = perf_counter()
        result = action()
        seconds.append(perf_counter() - start)
    return min(seconds), result


def voxelized(edge):
    triangles = leaves(edge)
    faces = SimpleNamespace(triangles=triangles, closed=np.zeros(COUNT, bool))
    seconds, area = seconds_of(lambda: surface_area(triangles, DOMAIN))
    return {
        "edge, voxels": edge,
        "triangles": COUNT,
        "area, s": seconds,
        "leaves seen from a sun, s": seconds_of(lambda: foliage_density(faces, DOMAIN, DOWN))[0],
        "relative error": abs(area.sum() / area_of(triangles) - 1),
    }


def written(name, density):
    """Write all grids of scattered light under a sun, with values that do not compress."""
    rng = np.random.default_rng(0)
    names = [*map(flux_grid, AXES), direct_grid(1)]
    light, *rest = rng.uniform(0.1, 1, (1 + len(names), 3, *DOMAIN.shape)).astype(np.float32)
    others = dict(zip(names, rest, strict=True))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "light.vdb")
        seconds, _ = seconds_of(lambda: write_vdb(path, DOMAIN, density, light, {}, others))
        size = path.stat().st_size / 2**20
    return {"density": name, "occupied": np.mean(density > 0), "seconds": seconds, "MiB": size}


publish("voxelize", "NumPy", [voxelized(edge) for edge in (0.3, 1.0, 3.0)])
ball = np.linalg.norm(DOMAIN.centers() - 0.5, axis=-1) < 0.5
cases = {"ball": ball, "everywhere": np.ones(DOMAIN.shape)}
publish("write", "OpenVDB", [written(name, density) for name, density in cases.items()])
leave(0)
