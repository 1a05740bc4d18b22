# SPDX-License-Identifier: GPL-3.0-or-later
"""Random media, thin to 1e4 mean free paths a voxel: does the lattice settle, and how soon?

    python -m tests.benchmarks.settling [MEDIA]

solves each (200) by steps alone and with coarser lattices, to an error of 1 %, and prints what it
truly is, against light stepped and corrected until it hardly changes, and the work. A correction
counts as so many steps as it takes as long as at 128^3 voxels (`speed`, part "corrections").
"""

import sys

import numpy as np

from lb_lighting.transport import device
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.lattice.convergence import converge
from lb_lighting.transport.lattice.lattice_numpy import Source
from lb_lighting.transport.lattice.multigrid import Level
from tests.benchmarks.shapes import SHAPES
from tests.benchmarks.table import publish

MEDIA, TOLERANCE, MOST_STEPS = 200, 1e-2, 20_000
WORK = 24  # steps that a correction takes as long as
_SETTLED, _MOST_LOOKS, _MOST_BETWEEN = 3e-7, 60, 512
ALBEDOS, COSINES = (0.5, 0.9, 0.99, 0.999, 1 - 1e-5, 1.0), (0, 0.5, 0.85, -0.5)


class ByStepsAlone(Level):
    is_coarsest = True


def medium(seed):
    """(depth, albedo, g, power)."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(12, 34, 3))
    depth = SHAPES[rng.integers(len(SHAPES))](shape, rng)
    if not depth.any():
        depth[0, 0, 0] = 1
    most = 10 ** rng.uniform(-2, 4)  # of a voxel, or through the domain
    if rng.random() < 0.5:
        depth *= most / depth.max()
    else:
        depth *= min(most / (depth.mean() * shape[0]), 1e4 / depth.max())
    albedo, g = rng.choice(ALBEDOS), rng.choice(COSINES)
    power = SOURCES[rng.integers(len(SOURCES))](depth, albedo, rng)
    power = power if power.any() else depth
    return depth, albedo, g, power / power.max()


def from_above(depth, albedo, _rng):
    below = np.cumsum(depth[..., ::-1], axis=2)[..., ::-1]
    return albedo * (np.exp(depth - below) - np.exp(-below))


def glowing(depth, _albedo, rng):
    return rng.random(depth.shape) * depth / (1 + depth)


def one_voxel(depth, _albedo, rng):
    power = np.zeros(depth.shape)
    power[tuple(rng.integers(0, n) for n in depth.shape)] = 1
    return power


SOURCES = (from_above, glowing, one_voxel)


def started(kind, found, optics):
    *optics, power = optics
    level = kind(backend_of(found).lattice, *optics)
    level.lattice.start(Source(power, np.zeros((3, *power.shape))))
    return level


def settled(found, optics):
    """(the fluence that a medium tends to, its last relative change)."""
    level, best, light = started(Level, found, optics), (np.inf, None), 0.0
    between = 32
    for look in range(_MOST_LOOKS):
        level.lattice.advance(between // 2)
        level.correct()
        level.lattice.advance(between // 2)
        before, light = light, level.lattice.fluence().astype(float)
        change = difference(before, light)
        best = min(best, (change, light), key=lambda found: found[0])
        if change < _SETTLED:
            break
        if look > 8 and change > 1e-3:  # corrections do not help here
            between = min(2 * between, _MOST_BETWEEN)
    return best[1], best[0]


def difference(light, expected):
    return float(np.linalg.norm(light - expected) / np.linalg.norm(expected))


def rows(found, media):
    for seed in range(media):
        optics = medium(seed)
        light, unsettled = settled(found, optics)
        row = {"medium": seed, "voxels": optics[0].size, "unsettled": unsettled}
        for name, kind in (("alone", ByStepsAlone), ("helped", Level)):
            level = started(kind, found, optics)
            error, steps, corrections = converge(level, TOLERANCE, MOST_STEPS, lambda _error: None)
            true = difference(level.lattice.fluence().astype(float), light)
            row |= {f"{name}, estimate": error, f"{name}, error": true}
            row |= {f"{name}, work": steps + (WORK - 2) * corrections}
        yield row


def summary(rows):
    """By how many steps it takes without help."""
    for low, high in ((0, 64), (64, 256), (256, 1024), (1024, MOST_STEPS)):
        some = [row for row in rows if low <= row["alone, work"] < high]
        ratios = np.array([row["helped, work"] / row["alone, work"] for row in some])
        wrong = [row for row in some if row["helped, error"] > 2 * TOLERANCE]
        yield {
            "steps alone": f"{low} to {high}",
            "media": len(some),
            "least work": ratios.min(),
            "mean": ratios.mean(),
            "most": ratios.max(),
            "above 1.2": int(np.sum(ratios > 1.2)),
            "error above 2 %": len(wrong),
            "the same alone": sum(row["alone, error"] > 2 * TOLERANCE for row in some),
        }


def main(media=MEDIA):
    found = device.choose()
    found_rows = list(rows(found, int(media)))
    publish("settling-media", found.label, found_rows)
    publish("settling", found.label, list(summary(found_rows)))
    left = [row["medium"] for row in found_rows if row["alone, work"] >= MOST_STEPS]
    print(f"not settled within {MOST_STEPS} steps alone: {left}")


if __name__ == "__main__":
    main(*sys.argv[1:])
