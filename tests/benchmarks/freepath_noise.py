# SPDX-License-Identifier: GPL-3.0-or-later
"""Free paths through fractal noise, by its effective resolution and its contrast."""

from time import perf_counter

import numpy as np

from lb_lighting.transport.photons.free_path import path_grid
from lb_lighting.transport.photons.perlin import STRONG, WEAK, PerlinMedium
from tests.benchmarks.freepath_timing import SUPERVOXELS, Point

CONTRASTS = {"weak": WEAK, "middle": {"cutoff": 0.5, "power": 2.0}, "strong": STRONG}
NOISE_STOPS = 0.5  # of the rays
# Effective resolution: contrasts. The talk's table has the resolutions with all contrasts.
NOISES = {
    256: ("weak", "middle", "strong"),
    1024: ("weak", "strong"),
    4096: ("weak", "middle", "strong"),
    16384: ("weak", "strong"),
    32768: ("weak", "strong"),
}
GIVEN_CELLS = (32, 128)  # super-voxels along an edge in the talk, besides the automatic number


def noise_rows(found):
    for resolution, contrasts in NOISES.items():
        for contrast in contrasts:
            rows = list(of_one_noise(resolution, contrast, found))
            march, woodcock = (row["million rays/s"] for row in rows[:2])
            for row in rows:
                row["times ray marching"] = row["million rays/s"] / march
                row["times Woodcock"] = row["million rays/s"] / woodcock
            yield from rows


def of_one_noise(resolution, contrast, found):
    """The rows of one noise, without the ratios; ray marching and Woodcock come first."""
    unit = PerlinMedium(resolution, 1.0, 0, 1, **CONTRASTS[contrast])
    mean = float(unit.voxels(64).density.mean(dtype=float))
    largest = float(unit.constant_majorants(1).values.max())
    depth = stopping_depth(unit, mean, found)
    medium = PerlinMedium(resolution, 1.0, 0, depth / mean, **CONTRASTS[contrast])
    cases = [("ray_march", None), ("woodcock", None), *((s, None) for s in SUPERVOXELS)]
    if NOISES[resolution] == tuple(CONTRASTS):
        cases += [(s, resolution // cells) for cells in GIVEN_CELLS for s in SUPERVOXELS]
    for sampler, size in cases:
        start = perf_counter()
        grid = path_grid(medium, sampler, supervoxel=size)
        prepared = perf_counter() - start
        point = Point(grid, found)
        speed = point.speed(grid.per_depth(0))
        # With ray marching, counting would take minutes, and each step is one cell.
        steps = {} if sampler == "ray_march" else point.steps(grid.per_depth(0))
        yield {
            "resolution": resolution,
            "contrast": contrast,
            "largest / mean": largest / mean,
            "depth": depth,
            "sampler": sampler,
            "super-voxels": {"ray_march": resolution, "woodcock": 1}.get(sampler, grid.cells[0]),
            "automatic": "yes" if sampler in SUPERVOXELS and size is None else "",
            "majorant / density": grid.majorants.mean / mean if grid.majorants else "",
            "million rays/s": speed.rays / 1e6,
            **steps,
            "prepare, s": prepared,
            "rays": speed.batch,
        }


def stopping_depth(medium, mean, found):
    """The mean optical depth from face to face at which NOISE_STOPS of the rays collide."""
    grid = path_grid(medium, "supervoxel_linear", supervoxel=medium.resolution // GIVEN_CELLS[0])
    point, low, high = Point(grid, found), 0.1, 1000.0
    for _ in range(8):
        depth = np.sqrt(low * high)
        if point.stopped(medium.resolution * mean / depth) < NOISE_STOPS:
            low = depth
        else:
            high = depth
    return float(np.sqrt(low * high))


def noise_summary(rows):
    """The effect of contrast and resolution on each super-voxel sampler."""
    for cells in ("automatic", *GIVEN_CELLS):
        for sampler in SUPERVOXELS:
            rows_of_cells = {
                (row["resolution"], row["contrast"]): row
                for row in rows
                if row["sampler"] == sampler
                and ("automatic" if row["automatic"] else row["super-voxels"]) == cells
            }
            of_4096 = [rows_of_cells[4096, contrast] for contrast in NOISES[4096]]
            speeds = [row["million rays/s"] for row in of_4096]
            largest = rows_of_cells.get((32768, "strong"))
            yield {
                "super-voxels": f"{cells}³" if cells in GIVEN_CELLS else cells,
                "sampler": sampler,
                "times ray marching, 4096³, least": min(
                    row["times ray marching"] for row in of_4096
                ),
                "times Woodcock, 4096³ strong": of_4096[-1]["times Woodcock"],
                "times Woodcock, 32768³ strong": largest["times Woodcock"] if largest else "",
                "fastest / slowest contrast, 4096³": max(speeds) / min(speeds),
            }
