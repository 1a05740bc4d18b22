# SPDX-License-Identifier: GPL-3.0-or-later
"""Reference light of each case of `media.py`, by traced photons.

    python -m tests.benchmarks.references [NAME ...]

traces the references that are missing or have changed (or the given ones), and stores them in
tests/references/accuracy.npz and trade.npz, which takes many minutes. Benchmarks only read them.

In the media for the trade of speed against accuracy only scattered light is traced. Uncollided
light is computed with many rays (docs/theory/physics.md compares rays with photons): the noise of
photons has patterns there, and such noise cannot be subtracted from an error.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from lb_lighting.transport import device, trace
from lb_lighting.transport.lights.distant import Sky
from lb_lighting.transport.lights.emission import Emission
from lb_lighting.transport.planning import visibility
from lb_lighting.transport.uncollided import casting
from tests.benchmarks.media import (
    main_cases,
    random_cases,
    refined_cases,
    sparse_cases,
    trade_cases,
)

STORES = Path(__file__).parents[1] / "references"
# Relative standard error, in L2; for the trade it is subtracted from errors of 2 % and more.
TARGETS = {"main": 0.0098, "refined": 0.004, "trade": 0.02, "random": 0.02, "sparse": 0.02}
RAYS, RAYS_OF_SKY = 24, 16  # along a voxel's edge: four times as many as in `solve`
PHOTONS = {"main": 400_000, "refined": 200_000}  # per seed
PHOTONS |= dict.fromkeys(("trade", "random", "sparse"), 100_000)
# The simplest sampler, except for densities so uneven that it hardly advances.
SAMPLERS = dict.fromkeys(TARGETS, "woodcock")
SAMPLERS |= dict.fromkeys(("random", "sparse"), "supervoxel_constant")
FEWEST_SEEDS = 8  # for a standard error accurate to a few percent
MOST_SEEDS = 100
# Stored bits of a number: relative precision 1 / 4000 and 1 / 250, far below the error.
DIGITS = {"accuracy": 11, "trade": 7}


@dataclass(frozen=True)
class Reference:
    """All light, (nx, ny, nz) W/m^2, and its relative standard error in L2; and the error of the
    light as it is seen, None if it was not stored."""

    light: np.ndarray
    error: float
    error_seen: float | None = None


class References:
    """The stored references: the traced light of each case, and how it was traced."""

    def __init__(self, name="accuracy"):
        self.name, self.path = name, STORES / f"{name}.npz"
        self.light, self.about = {}, {}
        if self.path.exists():
            with np.load(self.path) as file:
                self.about = json.loads(str(file["about"]))
                self.light = {name: file[name] for name in self.about}

    def __getitem__(self, case):
        """The `Reference` of a case; KeyError if it is not stored, or if the medium has changed."""
        if not self.holds(case):
            raise KeyError(f"{case.name}: run python -m tests.benchmarks.references")
        about = self.about[case.name]
        return Reference(
            self.light[case.name].astype(float), about["error"], about.get("error seen")
        )

    def holds(self, case):
        about = self.about.get(case.name)
        return about is not None and np.allclose(about["medium"], facts(case.medium), rtol=1e-5)

    def add(self, case, light, about):
        if case.group in ("random", "sparse"):  # only the visible light of these is used
            light = light * (visibility.weights(case.medium)[0] > 0)
        self.light[case.name] = rounded(light, DIGITS[self.name])
        self.about[case.name] = about | {"medium": facts(case.medium)}

    def store(self):
        partial = self.path.with_name("partial.npz")  # so that nobody reads an incomplete file
        np.savez_compressed(partial, about=json.dumps(self.about), **self.light)
        partial.replace(self.path)


def facts(medium):
    """Numbers that identify the medium that was traced."""
    somewhere = np.linspace(0, 1, medium.density.size)  # the order of voxels matters
    grids = (medium.density, medium.emission, medium.occlusion)
    sums = [0.0 if grid is None else float(somewhere @ grid.ravel()) for grid in grids]
    return [*sums, float(medium.sigma_s[0]), float(medium.sigma_a[0]), float(medium.g[0])]


def measure(case):
    """All light (nx, ny, nz) of a case, with enough seeds for the target error, and a report."""
    start, seeds = perf_counter(), 0
    exact = None if case.group in ("main", "refined") else uncollided(case)
    weight = visibility.weights(case.medium)[0]
    total, squares, error = 0.0, 0.0, np.inf
    while seeds < FEWEST_SEEDS or (error > TARGETS[case.group] and seeds < MOST_SEEDS):
        field = trace(
            case.medium,
            case.lights,
            PHOTONS[case.group],
            sampler=SAMPLERS[case.group],
            seed=seeds,
            spacing=0.5,
            direct=exact is None,
            flux=False,
        )
        light = (field.fluence[0] + (field.direct[0] if exact is None else exact)).astype(float)
        seeds += 1
        total, squares = total + light, squares + light**2
        if seeds > 1:
            variance = (squares - total**2 / seeds) / (seeds - 1)
            everywhere, as_seen = (
                float(np.sqrt((weights * variance).sum() * seeds / (weights * total**2).sum()))
                for weights in (np.ones_like(weight), weight)
            )
            error = as_seen if case.group == "sparse" else everywhere
    return total / seeds, {
        "error": everywhere,
        "error seen": as_seen,
        "photons": PHOTONS[case.group] * seeds,
        "seeds": f"0 to {seeds - 1}",
        "seconds": perf_counter() - start,
    }


def uncollided(case):
    """(nx, ny, nz) W/m^2 of uncollided light, by rays."""
    medium, found, total = case.medium, device.choose(), 0.0
    glow = [] if medium.emission is None else [Emission(medium)]
    for light in [*case.lights, *glow]:
        rays = RAYS_OF_SKY if isinstance(light, (Sky, Emission)) else RAYS
        total = total + casting.cast(medium, light, 0, medium.sigma_t[0], found, rays).direct
    return total


def rounded(light, digits):
    """(...) float32 rounded to `bits`: further bits are noise, which does not compress."""
    mantissa, exponent = np.frexp(light)
    return np.ldexp(np.round(mantissa * 2**digits) / 2**digits, exponent).astype(np.float32)


def main(names):
    stores = {
        "accuracy": (main_cases, refined_cases),
        "trade": (trade_cases, random_cases, sparse_cases),
    }
    for name, kinds in stores.items():
        references = References(name)
        for case in [case for kind in kinds for case in kind()]:
            if case.name in names or not references.holds(case):
                light, about = measure(case)
                references.add(case, light, about)
                references.store()
                print(f"{case.name}: {about}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
