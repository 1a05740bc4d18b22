# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons per second, compared with MCX-CL in the same media on the same OpenCL device.

Each case is run several times, the two programs in turn. MCX's time is the time that it reports for
its kernel alone, with the best of several numbers of threads. Ours is the time of the whole call
without building programs, which a first call does. Both must find the same fluence to within their
noise, which is estimated from the runs. The photons of the two programs are not equally
informative, so the time to equal noise is reported too.
"""

import sys
from time import perf_counter

import numpy as np

from lb_lighting.transport import Light, Medium, Sun, device
from lb_lighting.transport.photons.free_path import SAMPLERS
from lb_lighting.transport.photons.trace import trace
from tests.benchmarks.table import publish
from tests.setup import peers

EDGE, VOID, LEVELS = 128, 0.4, 255  # voxels, share of empty ones, densities
ALBEDO, G = 0.99, 0.9
# Mean optical depth from face to face; source; photons in a run.
CASES = [(10, "planar", 400_000), (100, "planar", 200_000), (10, "pencil", 200_000)]
RUNS = 5
THREADS = [(0, 0), (2, 1), (256, 8), (2048, 64), (16384, 64)]  # that are tried for MCX
BLOCK = 16  # edge, in voxels, of the blocks over which fluence is averaged for comparison
# The largest difference in units of its noise. The noise is estimated from a few runs, and for a
# pencil beam in a few blocks.
MOST_BEYOND_NOISE = 1.5


class Pencil(Light):
    """A beam of 1 W along +z into the middle of the face z = 0."""

    spectrum = 1.0

    def emit(self, count, medium, rng, band):
        origin, direction = (EDGE / 2, EDGE / 2, 0), (0, 0, 1.0)
        return (
            np.tile(origin, (count, 1)),
            np.tile(direction, (count, 1)),
            np.full(count, 1 / count),
        )


def source(name):
    """Our light of 1 W that corresponds to MCX's source of that name."""
    return Sun((0, 0, 1), EDGE**-2) if name == "planar" else Pencil()


def cloud():
    """(EDGE,)^3 uint8, 0 to LEVELS - 1: a sum of waves with a threshold; the share VOID is 0."""
    rng = np.random.default_rng(0)
    at = (np.arange(EDGE) + 0.5) / EDGE
    waves = np.zeros((EDGE,) * 3)
    for wave in 12 * rng.normal(size=(24, 3)):
        x, y, z = (np.exp(1j * k * at) for k in wave)
        phase = np.exp(2j * np.pi * rng.random())
        plane = phase * x[:, None, None] * y[:, None] * z
        waves += plane.real / (1 + np.linalg.norm(wave) / 12)
    waves = np.maximum(0, waves - np.quantile(waves, VOID))
    return np.round((LEVELS - 1) * waves / waves.max()).astype(np.uint8)


def blocks(fluence):
    """The means over blocks of BLOCK^3 voxels."""
    n = EDGE // BLOCK
    return fluence.reshape(n, BLOCK, n, BLOCK, n, BLOCK).mean(axis=(1, 3, 5))


class Rival:
    """MCX on one problem, with the fastest number of threads."""

    name = "MCX-CL"

    def __init__(self, problem):
        self.problem = problem
        trial = peers.run(
            "mcx_run",
            **problem | {"photons": problem["photons"] // 4},
            seeds=np.ones(len(THREADS), int),
            threads=THREADS,
        )
        self.threads = THREADS[int(np.argmin(trial["kernel"]))]

    def run(self, seed):
        """(fluence, s)"""
        result = peers.run("mcx_run", **self.problem, seeds=[seed], threads=[self.threads])
        return result["fluence"], result["kernel"][0]


class Ours:
    """One of our samplers on the same problem."""

    def __init__(self, sampler, medium, light, photons):
        self.name = sampler
        self.arguments = (medium, [light], photons, sampler)
        trace(*self.arguments[:2], 1000, sampler, flux=False)  # builds the programs

    def run(self, seed):
        """(fluence, s)"""
        start = perf_counter()
        field = trace(*self.arguments, seed=seed, flux=False)  # MCX computes none
        seconds = perf_counter() - start
        return (field.fluence + field.direct)[0], seconds


class Summary:
    """Several runs of one program: photons/s of the fastest, the mean fluence, its noise."""

    def __init__(self, photons, runs):
        fluences, seconds = (np.array(values) for values in zip(*runs, strict=True))
        self.speed = photons / seconds.min()
        self.mean = fluences.mean(axis=0)
        self.noise = np.sqrt((fluences.var(axis=0, ddof=1) / len(runs)).sum())
        # Seconds for a fluence with a relative noise (L2) of 1 %.
        self.to_one_percent = seconds.min() * len(runs) * (self.relative_noise / 0.01) ** 2

    @property
    def relative_noise(self):
        return self.noise / np.linalg.norm(self.mean)


def rows(depth, name, photons):
    levels = cloud()
    density = np.arange(LEVELS) / (LEVELS - 1)
    sigma_t = depth / (density[levels].mean() * EDGE)
    sigma_s, sigma_a = sigma_t * ALBEDO, sigma_t * (1 - ALBEDO)
    problem = {
        "levels": levels,
        "sigma_s": sigma_s * density,
        "sigma_a": sigma_a * density,
        "g": G,
        "source": name,
        "photons": photons,
    }
    medium = Medium(density[levels], 1.0, sigma_s, sigma_a, G)
    rival = Rival(problem)
    runners = [rival, *(Ours(sampler, medium, source(name), photons) for sampler in SAMPLERS)]
    runs = {runner.name: [] for runner in runners}
    for seed in range(1, RUNS + 1):
        for runner in runners:
            fluence, seconds = runner.run(seed)
            runs[runner.name].append((blocks(fluence), seconds))
    summaries = {name: Summary(photons, made) for name, made in runs.items()}
    theirs = summaries[rival.name]
    for runner, ours in summaries.items():
        difference = np.linalg.norm(ours.mean - theirs.mean)
        yield {
            "depth": depth,
            "source": name,
            "by": runner,
            "photons/s": ours.speed,
            "times MCX-CL": ours.speed / theirs.speed,
            "s to 1 % noise": ours.to_one_percent,
            "difference": difference / np.linalg.norm(theirs.mean),
            "difference / noise": difference / np.hypot(ours.noise, theirs.noise),
        }


def profile(depth, name, photons):
    """The time of one of our collisions, complete and with parts left out."""
    density = cloud() / (LEVELS - 1)
    sigma_t = depth / (density.mean() * EDGE)
    coefficients = (sigma_t * ALBEDO, sigma_t * (1 - ALBEDO), G)
    cloudy = Medium(density, 1.0, *coefficients)
    even = Medium(np.full_like(density, density.mean()), 1.0, *coefficients)
    for what, medium, options in (
        ("all", cloudy, {}),
        ("without scores", cloudy, {"spacing": 1e9}),
        ("in uniform density under one majorant", even, {"spacing": 1e9, "supervoxel": EDGE}),
    ):
        arguments = (medium, [source(name)])
        options = {"sampler": "supervoxel_constant", "flux": False, **options}
        fixed = min(trace(*arguments, 100, **options).report.seconds["trace"] for _ in range(3))
        report = trace(*arguments, photons, **options).report
        seconds = report.seconds["trace"] - fixed
        yield {
            "depth": depth,
            "profile": what,
            "collisions/photon": float(report.collisions[0] / report.photons),
            "ns/collision": 1e9 * seconds / int(report.collisions[0]),
        }


def main():
    publish("mcx-profile", device.choose().label, [row for c in CASES[:2] for row in profile(*c)])
    found = [row for case in CASES for row in rows(*case)]
    publish("mcx", device.choose().label, found)
    if any(row["difference / noise"] > MOST_BEYOND_NOISE for row in found):
        sys.exit("Not the same fluence: a difference is more than noise.")


if __name__ == "__main__":
    main()
