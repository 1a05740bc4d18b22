# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise reduction for hybrids: ways to trace their photons, and a filter for the result.

    python -m tests.benchmarks.noise [trace filter]

Seconds are processor time of all threads, which depends less on other processes. Each round goes
through all ways in turn, and ratios are computed within a round.
"""

import sys
from dataclasses import dataclass, field
from time import process_time
from unittest.mock import patch

import numpy as np

from lb_lighting.transport import Settings, device, solve, trace
from lb_lighting.transport.lights import distant, lamps
from lb_lighting.transport.lights.sampling import r_sequence
from tests.benchmarks.columns import all_light
from tests.benchmarks.media import main_cases
from tests.benchmarks.table import publish

CASES = ("cube 8, g 0, albedo 0.99", "cube 32, g 0.85, albedo 0.99", "cloud 20, g 0.85")
HANDOVER = 4.0
PHOTONS = 2**18
ROUNDS = 5

SEEDS = 4  # of each solve that is filtered
A_VOXEL = (64, 256)  # photons


def chosen():
    return [case for case in main_cases() if case.name in CASES]


# --- Ways to trace -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Way:
    """A way to trace: arguments of `trace`, and whether photons enter at low-discrepancy points."""

    name: str
    arguments: dict = field(default_factory=dict)
    even: bool = True


HYBRID = {"direct": False, "spacing": 0.5, "sampler": "supervoxel_constant"}  # the solver's own
WAYS = (
    Way("plain"),
    Way("uncollided light by rays", {"direct": False}),
    Way("and scores half a voxel apart", {"direct": False, "spacing": 0.5}),
    Way("and constant bounds: the hybrid's", HYBRID),
    Way("the hybrid's, scores 1/4 voxel apart", HYBRID | {"spacing": 0.25}),
    Way("the hybrid's, scores 1 voxel apart", HYBRID | {"spacing": 1.0}),
    Way("the hybrid's, scores 2 voxels apart", HYBRID | {"spacing": 2.0}),
    Way("the hybrid's, without flux", HYBRID | {"flux": False}),
    Way("the hybrid's, photons enter at random", HYBRID, even=False),
)


def trace_rows(case):
    """A row for each way: its noise, its time, and its efficiency relative to the plain way."""
    for way in WAYS:  # builds the programs
        traced(case, way, photons=2**12, seed=0)
    found = np.array([[traced(case, way, PHOTONS, s) for way in WAYS] for s in range(ROUNDS)])
    noise, seconds = found[..., 0], found[..., 1]
    cost = noise**2 * seconds  # does not depend on the number of photons
    for i, way in enumerate(WAYS):
        gains = cost[:, 0] / cost[:, i]
        yield {
            "case": case.name,
            "way": way.name,
            "noise": float(np.sqrt(np.mean(noise[:, i] ** 2))),
            "seconds": float(np.median(seconds[:, i])),
            "efficiency": float(np.median(gains)),
            "from": float(gains.min()),
            "to": float(gains.max()),
        }


def traced(case, way, photons, seed):
    """(relative noise of the scattered light in L2, seconds of the processor) of a trace."""
    last = 1 + round(HANDOVER / (1 - float(case.medium.albedo[0] * case.medium.g[0])))
    draw = r_sequence if way.even else at_random
    with patch.object(lamps, "r_sequence", draw), patch.object(distant, "r_sequence", draw):
        start = process_time()
        result = trace(case.medium, case.lights, photons, seed=seed, handover=last, **way.arguments)
        seconds = process_time() - start
    deviation = np.sqrt(result.variance.sum(dtype=float))
    return deviation / np.linalg.norm(result.fluence), seconds


def at_random(count, dimensions, rng):
    """As `sampling.r_sequence`, but independent points. They ascend as those do, for the caches."""
    points = rng.random((dimensions, count))
    points[0].sort()
    return points


# --- A filter ------------------------------------------------------------------------------------


def shifted(light, guide, _variance):
    """The smooth part of light: the guide, which has its edges, plus the smoothed difference."""
    return guide + smooth(light - guide)


def fitted(light, guide, variance):
    """The smooth part of light: the best linear function of the guide around each voxel.

    Its slope falls to zero where the guide varies less than the light's own noise.
    Source: K. He, J. Sun, X. Tang, "Guided image filtering", 2010.
    """
    mean, mean_guide = smooth(light), smooth(guide)
    together = smooth(guide * light) - mean_guide * mean
    slope = together / (smooth(guide**2) - mean_guide**2 + smooth(variance))
    return smooth(slope) * guide + smooth(mean - slope * mean_guide)


# {name: (function for the smooth part, trust in the variance)}
FILTERS = {
    "none": (shifted, 0.0),
    "shifted": (shifted, 1.0),
    "shifted, all smooth": (shifted, 1e9),
    "fitted": (fitted, 1.0),
    "fitted, all smooth": (fitted, 1e9),
}


def filtered(hybrid, deterministic, smooth_part, trust):
    """The hybrid's scattered light, (nx, ny, nz) float64, smoothed as far as it may be noise.

    The share of the rough part that the variance, times the trust in it, does not explain, is
    added back.
    """
    light, guide, variance = (
        values[0].astype(float)
        for values in (hybrid.fluence, deterministic.fluence, hybrid.variance)
    )
    even = smooth_part(light, guide, variance)
    rough = light - even
    kept = np.maximum(0, 1 - trust * smooth(variance) / smooth(rough**2))
    return even + kept * rough


def smooth(values):
    """[1 2 1] / 4 along each axis; the outermost voxels are repeated beyond the border."""
    for axis in range(3):
        around = np.pad(values, [(int(axis == a),) * 2 for a in range(3)], mode="edge")
        low, middle, high = (
            np.take(around, range(first, first + values.shape[axis]), axis) for first in range(3)
        )
        values = (low + 2 * middle + high) / 4
    return values


def filter_rows(case):
    """Noise and error of a hybrid and of its filtered light, for each number of photons.

    The expected light of a solve is the mean over the other seeds, whose noise is subtracted: the
    error consists of noise and of damage by the filter, but not of the model error of the hybrid.
    Imbalance is the change of the absorbed power by the filter, over the power that entered.
    """
    solved(case, 0.0)  # builds the programs
    deterministic, extra = solved(case, 0.0)
    for a_voxel in A_VOXEL:
        runs = [solved(case, HANDOVER, a_voxel, seed) for seed in range(SEEDS)]
        size = np.linalg.norm(np.mean([all_light(run) for run, _ in runs], axis=0))
        plain = np.array([run.fluence[0] for run, _ in runs], float)
        entered = runs[0][0].report.energy["entered"][0]
        absorbs = case.medium.sigma_a[0] * case.medium.voxel_size**3 / entered * case.medium.density
        own, seconds = noise(plain), float(np.median([taken for _, taken in runs]))
        for name, (smooth_part, trust) in FILTERS.items():
            light = np.array([filtered(run, deterministic, smooth_part, trust) for run, _ in runs])
            off, longer = error(light, plain), seconds + extra * (trust > 0)
            yield {
                "case": case.name,
                "photons a voxel": a_voxel,
                "filter": name,
                "noise": noise(light) / size,
                "error": off / size,
                "of the unfiltered": off / own,
                "imbalance": float(np.sum(absorbs * (light - plain).mean(axis=0))),
                "seconds": longer,
                "efficiency": (own / off) ** 2 * seconds / longer,
            }


def solved(case, handover, a_voxel=None, seed=0):
    """(Field, processor seconds)."""
    photons = a_voxel and a_voxel * case.medium.density.size
    start = process_time()
    result = solve(
        case.medium, case.lights, Settings(handover=handover, photons=photons, seed=seed)
    )
    return result, process_time() - start


def noise(light):
    """Standard deviation of the lights (seeds, nx, ny, nz), in L2."""
    return float(np.sqrt(light.var(axis=0, ddof=1).sum()))


def error(light, plain):
    """Error of the lights (seeds, nx, ny, nz), in L2, against the mean of the unfiltered others."""
    others = (plain.sum(axis=0) - plain) / (len(plain) - 1)
    raw = ((light - others) ** 2).sum() / len(light)
    return float(np.sqrt(max(0.0, raw - noise(plain) ** 2 / (len(plain) - 1))))


PARTS = {"trace": trace_rows, "filter": filter_rows}


def main(parts):
    for part in parts or PARTS:
        rows = []
        for case in chosen():
            print(case.name, flush=True)  # some take a minute
            rows += PARTS[part](case)
        publish(f"noise-{part}", device.choose().label, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
