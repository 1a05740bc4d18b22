# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of "Free Path Sampling in High Resolution Inhomogeneous Participating Media", here.

A head of 512^3 voxels against the resolution of the super-voxels, then fractal noise against its
effective resolution and its contrast. What is timed is free path sampling alone, everything else
being prepared: rays per second of the device's kernel, the median of some batches. Rays enter
uniformly over the faces from all directions, as a sky's photons do; with a sampler that is slow
they are fewer.

The talk does not say how dense its media are, and all ratios depend on that. So the head is
measured three times: thin, dense, and as dense as makes ray marching and Woodcock's method take
times in the talk's proportion, 9 : 7. Noise is as dense as stops half of the rays.
"""

import sys
from dataclasses import dataclass, replace
from functools import cache
from time import perf_counter

import numpy as np

from lb_lighting.transport import Medium, Sky, device
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.photons import majorants, paths_numpy
from lb_lighting.transport.photons.free_path import MOST_STEPS, path_grid
from lb_lighting.transport.photons.perlin import STRONG, WEAK, PerlinMedium
from tests.benchmarks.table import publish
from tests.setup import heads

EDGE = 512  # voxels of the head
DEPTHS = {"thin": 5.0, "dense": 50.0}  # mean optical depths from face to face
TALK = "as the talk"
TALK_RATIO = 9 / 7  # seconds of ray marching over those of Woodcock's method
SUPERVOXELS = ("supervoxel_constant", "supervoxel_linear")

CONTRASTS = {"weak": WEAK, "middle": {"cutoff": 0.5, "power": 2.0}, "strong": STRONG}
NOISE_STOPS = 0.5  # of the rays
# Effective resolution: contrasts. The talk's table is of those that have all.
NOISES = {
    256: ("weak", "middle", "strong"),
    1024: ("weak", "strong"),
    4096: ("weak", "middle", "strong"),
    16384: ("weak", "strong"),
    32768: ("weak", "strong"),
}
GIVEN_CELLS = (32, 128)  # super-voxels along an edge that it has, beside the automatic number

RAYS = 2**18  # at most in a batch
FEWEST = 2**10
BATCH_SECONDS, POINT_SECONDS = 0.25, 1.0
PROFILED = 1024  # rays whose steps are counted; a quarter in noise, which takes long


@dataclass(frozen=True)
class Speed:
    """Rays per second, and how many of them a batch had."""

    rays: float
    batch: int


@cache
def unit_rays():
    """(6, RAYS) float32: a sky's photons on a cube with edge 1."""
    cube = Medium(np.ones((1, 1, 1)), 1.0, 0, 1)
    origins, directions, _ = Sky(1.0).emit(RAYS, cube, np.random.default_rng(0), 0)
    return np.concatenate([origins, directions], axis=1).T.astype(np.float32)


def rays_through(grid, count):
    """(6, count) float32 of `unit_rays`, in fine cells, spread over all of them."""
    rays = unit_rays()[:, :: RAYS // count].copy()
    rays[:3] *= np.float32(grid.fine.upper[0])
    return rays


class Point:
    """One sampler on one grid, ready to be timed at any density."""

    def __init__(self, grid, found):
        self.grid, self.paths = grid, backend_of(found).paths(grid)
        self.most_items = self.paths.items
        self.units = self.paths.queue.device.max_compute_units
        self._seconds(1, np.inf, 0)  # builds the program

    def speed(self, per_depth):
        """The `Speed` at so many fine cells times density in an optical depth of 1."""
        count = FEWEST
        seconds = [self._seconds(count, per_depth, 0)]
        while seconds[0] < BATCH_SECONDS and count < RAYS:
            count *= 2
            seconds = [self._seconds(count, per_depth, 0)]
        while sum(seconds) < POINT_SECONDS:
            seconds.append(self._seconds(count, per_depth, len(seconds)))
        return Speed(count / float(np.median(seconds)), count)

    def steps(self, per_depth):
        """What a ray meets, on average, by NumPy's twin: columns for a row."""
        rays = rays_through(self.grid, PROFILED // (4 if self.grid.procedural else 1))
        going = np.arange(rays.shape[1])
        walk = paths_numpy._Walk(self.grid, rays, per_depth, 0, going)
        walk.start_flights(going)
        events = np.zeros(4)
        while len(going):
            event = walk.advance(going)
            events += np.bincount(event, minlength=4)
            going = going[(event != paths_numpy.COLLIDED) & (event != paths_numpy.LEFT)]
        events /= rays.shape[1]
        return {
            "cells/ray": events[paths_numpy.CROSSED] + events[paths_numpy.LEFT],
            "particles/ray": events[paths_numpy.VIRTUAL] + events[paths_numpy.COLLIDED],
        }

    def stopped(self, per_depth):
        """The share of rays that collide."""
        count = RAYS // 16
        rays, indices = rays_through(self.grid, count), np.arange(count, dtype=np.uint32)
        distances, *_ = self.paths.free_paths(rays, indices, per_depth, 0, MOST_STEPS)
        return np.isfinite(distances).mean()

    def _seconds(self, count, per_depth, seed):
        # Every work-item takes some rays, or the device would wait for the longest of a few.
        group = 64 * self.units
        self.paths.items = min(self.most_items, max(1, count // (16 * group)) * group)
        rays, indices = rays_through(self.grid, count), np.arange(count, dtype=np.uint32)
        start = perf_counter()
        self.paths.free_paths(rays, indices, per_depth, seed, MOST_STEPS)
        return perf_counter() - start


# --- The head ------------------------------------------------------------------------------------


def per_depth_of(depth, mean):
    """For rays through the head, whose mean optical depth from face to face is `depth`."""
    return EDGE * mean / depth


def talks_depth(march, woodcock, mean):
    """The optical depth at which the two take times in the talk's proportion."""
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
    """Constant `Majorants` as linear ones. In super-voxels of 1 or 2 voxels an edge none are
    tighter: they must reach the largest voxel at the middle, where a linear one has its mean."""
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
        if sampler == "woodcock":  # at the end once more: far from 1 where the machine was busy
            again = woodcock.speed(per_depth_of(row["depth"], mean)).rays / 1e6
            row["again / first"] = again / speed
    return rows


def fits(sampler, size, found):
    """Whether the bound's values do: those of single voxels, with eight each, take gigabytes."""
    values = (8 if sampler == "supervoxel_linear" else 1) * (EDGE // size) ** 3
    return 4 * values < min(found.largest_buffer, found.memory / 3)


def of_head(point, cells, depths, mean):
    """The rows of one sampler, without the ratios to others."""
    grid, rows = point.grid, []
    bound = {"ray_march": mean, "woodcock": grid.global_majorant}.get(grid.sampler)
    for setting, depth in depths.items():
        speed = point.speed(per_depth_of(depth, mean))
        steps = point.steps(per_depth_of(depth, mean))
        rows.append(
            {
                "setting": setting,
                "depth": depth,
                "sampler": grid.sampler,
                "super-voxels": cells,
                "bound / density": (bound or grid.majorants.mean) / mean,
                "million rays/s": speed.rays / 1e6,
                **steps,
                "ns/step": 1e9 / speed.rays / sum(steps.values()),
                "rays": speed.batch,
            }
        )
    return rows


def step_costs(rows):
    """What crossing a super-voxel costs, in particles met, by kind of bound: a fit of seconds.

    Only super-voxels few enough to stay in the caches count.
    """
    for sampler in SUPERVOXELS:
        some = [r for r in rows if r["sampler"] == sampler and 4 <= r["super-voxels"] <= 64]
        steps = np.array([(r["cells/ray"], r["particles/ray"]) for r in some])
        times = np.array([1e3 / r["million rays/s"] for r in some])  # ns
        # Of equal relative weight.
        (cell, particle), *_ = np.linalg.lstsq(
            steps / times[:, None], np.ones(len(some)), rcond=None
        )
        yield {
            "sampler": sampler,
            "ns/cell": float(cell),
            "ns/particle": float(particle),
            "cell / particle": float(cell / particle),
        }


def head_summary(rows):
    """The fastest of the super-voxel samplers at each density, beside the talk's ratios, and
    how fast the default is, the linear bound with the size that is chosen."""
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


# --- Fractal noise -------------------------------------------------------------------------------


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
    """The rows of one noise, without the ratios; those of ray marching and Woodcock first."""
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
        # Of ray marching it would take minutes, and each step is a cell.
        steps = {} if sampler == "ray_march" else point.steps(grid.per_depth(0))
        yield {
            "resolution": resolution,
            "contrast": contrast,
            "largest / mean": largest / mean,
            "depth": depth,
            "sampler": sampler,
            "super-voxels": {"ray_march": resolution, "woodcock": 1}.get(sampler, grid.cells[0]),
            "automatic": "yes" if sampler in SUPERVOXELS and size is None else "",
            "bound / density": grid.majorants.mean / mean if grid.majorants else "",
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
    """What contrast and resolution do to each super-voxel sampler."""
    for cells in ("automatic", *GIVEN_CELLS):
        for sampler in SUPERVOXELS:
            some = {
                (row["resolution"], row["contrast"]): row
                for row in rows
                if row["sampler"] == sampler
                and ("automatic" if row["automatic"] else row["super-voxels"]) == cells
            }
            of_4096 = [some[4096, contrast] for contrast in NOISES[4096]]
            speeds = [row["million rays/s"] for row in of_4096]
            largest = some.get((32768, "strong"))
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


# --- For the documentation -----------------------------------------------------------------------


def markdown(rows):
    """Rows as a table to be pasted into docs/."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    lines = [columns, ["---"] * len(columns)]
    lines += [[rounded(row.get(column, "")) for column in columns] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def rounded(value):
    """A number with three digits or so, never with an exponent."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 0.001 else f"{value:.5f}"


def by_resolution(rows, setting):
    """The head's speeds, million rays/s, and bounds at one density: a line for each resolution."""
    some = {(row["sampler"], row["super-voxels"]): row for row in rows if row["setting"] == setting}
    for cells in sorted({cells for _, cells in some}):
        line = {"super-voxels": f"{cells}³"}
        for sampler in SUPERVOXELS:
            row = some.get((sampler, cells))
            kind = sampler.removeprefix("supervoxel_")
            mark = " (automatic)" if row and row["automatic"] else ""
            line[f"{kind}, bound / density"] = rounded(row["bound / density"]) if row else ""
            line[f"{kind}, million rays/s"] = rounded(row["million rays/s"]) + mark if row else ""
        yield line
    for sampler, cells in (("ray_march", EDGE), ("woodcock", 1)):
        row = some[sampler, cells]
        yield {
            "super-voxels": f"`{sampler}`",
            "constant, bound / density": row["bound / density"],
            "constant, million rays/s": row["million rays/s"],
        }


def by_noise(rows):
    """The speeds in noise, million rays/s, with a line for each noise."""
    lines = {}
    for row in rows:
        line = lines.setdefault(
            (row["resolution"], row["contrast"]),
            {
                "resolution": f"{row['resolution']}³",
                "contrast": row["contrast"],
                "largest / mean": row["largest / mean"],
                "optical depth": row["depth"],
            },
        )
        name = row["sampler"].replace("supervoxel_", "")
        chosen = f" ({row['super-voxels']}³)" if row["automatic"] else ""
        if row["sampler"] in SUPERVOXELS and not chosen:
            name += f", {row['super-voxels']}³"
        line[name] = rounded(row["million rays/s"]) + chosen
    return list(lines.values())


def main():
    found = device.choose()
    if found.kind == "NumPy":
        sys.exit("There is no OpenCL device to measure.")
    head = head_rows(found)
    tables = {"head": head, "head-best": list(head_summary(head))}
    tables |= {"head-steps": list(step_costs(head))}
    publish_all(tables, found)
    noise = list(noise_rows(found))
    of_noise = {"noise": noise, "noise-best": list(noise_summary(noise))}
    publish_all(of_noise, found)
    tables |= of_noise | {"head": list(by_resolution(head, TALK)), "noise": by_noise(noise)}
    print("\nFor docs/measurements/free-paths.md:\n")
    print("\n".join(markdown(rows) for rows in tables.values()))


def publish_all(tables, found):
    for name, rows in tables.items():
        publish(f"freepath-{name}", found.label, rows)


if __name__ == "__main__":
    main()
