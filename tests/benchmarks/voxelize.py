# SPDX-License-Identifier: GPL-3.0-or-later
"""A million triangles onto 128³ voxels: seconds, and the area that arrives."""

from time import perf_counter

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

from lb_lighting.cli import leave  # noqa: E402 - OpenVDB has to be exposed first
from lb_lighting.scene.voxelize import surface_area  # noqa: E402
from lb_lighting.transport import Domain  # noqa: E402
from tests.benchmarks.table import publish  # noqa: E402

COUNT = 1_000_000
DOMAIN = Domain.around((0, 0, 0), (1, 1, 1), 128, padding=2)


def leaves(edge):
    """(COUNT, 3, 3): triangles of about `edge` voxels, anywhere and turned every way."""
    rng = np.random.default_rng(0)
    reach = edge * DOMAIN.voxel_size
    centers = rng.uniform(reach, 1 - reach, (COUNT, 1, 3))
    return centers + rng.uniform(-reach / 2, reach / 2, (COUNT, 3, 3))


def row(edge):
    triangles = leaves(edge)
    sides = triangles[:, 1:] - triangles[:, :1]
    true = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    start = perf_counter()
    found = surface_area(triangles, DOMAIN).sum()
    seconds = perf_counter() - start
    return {"edge, voxels": edge, "seconds": seconds, "relative error": abs(found / true - 1)}


publish("voxelize", "NumPy", [row(edge) for edge in (0.3, 1.0, 3.0)])
leave(0)
