# SPDX-License-Identifier: GPL-3.0-or-later
"""Free paths through a head of 512^3 voxels, by the resolution of the super-voxels."""

from dataclasses import replace

import numpy as np

from lb_lighting.transport import Medium
from lb_lighting.transport.photons import majorants
from lb_lighting.transport.photons.free_path import path_grid
from tests.benchmarks.freepath_timing import SUPERVOXELS, Point
from tests.setup import heads

EDGE = 512  # voxels of the head
DEPTHS = {"thin": 5.0, "dense": 50.0}  # mean optical depths from face to face
TALK = "as the talk"
TALK_RATIO = 9 / 7  # seconds of ray marching over those of Woodcock's method


def per_depth_of(depth, mean):
    """Fine cells times density in an optical depth of 1; `depth` is the mean from face to face."""
    return EDGE * mean / depth


def talks_depth(march, woodcock, mean):
    """The optical depth at which the times of the two have the talk's ratio."""
    low, high = 10.0, 3000.0
    for _ in range(6):
        depth = np.sqrt(low * high)
        per_depth = per_depth_of(depth, mean)
        if woodcock.speed(per_depth).rays / march.speed(per_depth).rays > TALK_RATIO:
            low = depth
        else:
            high = depth
    return float(np.sqrt(low * high))


def flat(majorants):
    """Constant `Majorants` as linear ones. With an edge of 1 or 2 voxels no linear majorant is
    tighter: it must reach the largest voxel at the centre, where its value is its mean."""
    values = np.zeros((*majorants.values.shape, 8), np.float32)
    values[..., 0] = majorants.values
    return replace(majorants, values=values)


def head_grid(medium, sampler, size, found):
    if sampler == "supervoxel_linear" and size <= 2:
        grid = path_grid(medium, "supervoxel_constant", supervoxel=size)
        return replace(grid, sampler=sampler, majorants=flat(grid.majorants))
    return path_grid(medium, sampler, supervoxel=size, device=found)


def head_rows(found):
    """The head at the three densities."""
    density = heads.resampled(heads.ch2better(), (EDGE,) * 3)
    mean = float(density.mean(dtype=float))
    medium = Medium(density, 1 / EDGE, 0, 1 / mean)  # of optical depth 1
    march, woodcock = (
        Point(path_grid(medium, sampler), found) for sampler in ("ray_march", "woodcock")
    )
    depths = DEPTHS | {TALK: talks_depth(march, woodcock, mean)}
    rows = of_head(march, EDGE, depths, mean) + of_head(woodcock, 1, depths, mean)
    alone = {(row["setting"], row["sampler"]): row["million rays/s"] for row in rows}
    for sampler in SUPERVOXELS:
        for size in majorants.sizes(medium.shape):
            if size <= 2 and not fits(sampler, size, found):
                continue
            point = Point(head_grid(medium, sampler, size, found), found)
            rows += of_head(point, EDGE // size, depths, mean)
    chosen = {
        (setting, sampler): EDGE
        // majorants.choose_size(
            density, 1 / per_depth_of(depth, mean), sampler.removeprefix("supervoxel_")
        )
        for setting, depth in depths.items()
        for sampler in SUPERVOXELS
    }
    for row in rows:
        speed, setting, sampler = (row[name] for name in ("million rays/s", "setting", "sampler"))
        row["times ray marching"] = speed / alone[setting, "ray_march"]
        row["times Woodcock"] = speed / alone[setting, "woodcock"]
        is_chosen = chosen.get((setting, sampler)) == row["super-voxels"]
        row["automatic"] = "yes" if is_chosen else ""
        if sampler == "woodcock":  # measured again at the end: far from 1 if the machine was busy
            again = woodcock.speed(per_depth_of(row["depth"], mean)).rays / 1e6
            row["again / first"] = again / speed
    return rows


def fits(sampler, size, found):
    """Whether the majorant's values fit: eight for each voxel need gigabytes."""
    values = (8 if sampler == "supervoxel_linear" else 1) * (EDGE // size) ** 3
    return 4 * values < min(found.largest_buffer, found.memory / 3)


def of_head(point, cells, depths, mean):
    """The rows of one sampler, without the ratios to other samplers."""
    grid, rows = point.grid, []
    majorant = {"ray_march": mean, "woodcock": grid.global_majorant}.get(grid.sampler)
    for setting, depth in depths.items():
        speed = point.speed(per_depth_of(depth, mean))
        steps = point.steps(per_depth_of(depth, mean))
        rows.append(
            {
                "setting": setting,
                "depth": depth,
                "sampler": grid.sampler,
                "super-voxels": cells,
                "majorant / density": (majorant or grid.majorants.mean) / mean,
                "million rays/s": speed.rays / 1e6,
                **steps,
                "ns/step": 1e9 / speed.rays / sum(steps.values()),
                "rays": speed.batch,
            }
        )
    return rows


def step_costs(rows):
    """The cost of crossing a super-voxel and of a particle, by kind of majorant, fitted to times.

    Only grids of super-voxels that fit into the caches count.
    """
    for sampler in SUPERVOXELS:
        fitted = [r for r in rows if r["sampler"] == sampler and 4 <= r["super-voxels"] <= 64]
        steps = np.array([(r["cells/ray"], r["particles/ray"]) for r in fitted])
        times = np.array([1e3 / r["million rays/s"] for r in fitted])  # ns
        # All rows have the same relative weight.
        (cell, particle), *_ = np.linalg.lstsq(
            steps / times[:, None], np.ones(len(fitted)), rcond=None
        )
        yield {
            "sampler": sampler,
            "ns/cell": float(cell),
            "ns/particle": float(particle),
            "cell / particle": float(cell / particle),
        }


def head_summary(rows):
    """The fastest super-voxel sampler at each density, the talk's ratios, and the relative speed
    of the default: the linear majorant with the automatic size."""
    for setting in (*DEPTHS, TALK):
        of_setting = [row for row in rows if row["setting"] == setting]
        with_cells = [row for row in of_setting if row["sampler"] in SUPERVOXELS]
        best = max(with_cells, key=lambda row: row["million rays/s"])
        default = next(
            row["million rays/s"]
            for row in with_cells
            if row["automatic"] and row["sampler"] == "supervoxel_linear"
        )
        yield {
            "setting": setting,
            "depth": best["depth"],
            "fastest": best["sampler"],
            "super-voxels": best["super-voxels"],
            "times ray marching": best["times ray marching"],
            "ray marching, talk": 9 / 1.4,
            "times Woodcock": best["times Woodcock"],
            "Woodcock, talk": 7 / 1.4,
            "default / fastest": default / best["million rays/s"],
        }
