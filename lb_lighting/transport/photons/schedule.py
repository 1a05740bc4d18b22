# SPDX-License-Identifier: GPL-3.0-or-later
"""The schedule of a trace: runs of one light and band each, with photons by power, in batches."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Floats
from ..lights.base import Light, darkness, multiple
from ..lights.emission import Emission
from ..medium import Medium
from .perlin import PerlinMedium

# Batches have the same size, and the differences between them give the variance: 32 batches give it
# to within a quarter. With few photons there are fewer, as reading the voxels would take longer.
_FEWEST_BATCHES, _MOST_BATCHES, _PHOTONS_A_VOXEL = 8, 32, 1 / 128
_PROBE = 1024  # photons that measure how bright a light is
AT_ONCE = 2**18  # photons, at most, that a light emits in a batch
# Paths of each photon without uncollided light: drawing a photon costs as much as collisions.
COPIES = 4


@dataclass(frozen=True)
class Run:
    """The tracing of one light in one band, and the bands whose light is a multiple of it.

    multiples  {band: factor}
    photons    that the light emits in a batch
    copies     paths of each photon
    power      W of a path of weight 1
    """

    light: Light
    number: int
    band: int
    multiples: dict[int, float]
    photons: int
    copies: int
    power: float


def batches_of(photons: int, voxels: int) -> int:
    """The number of batches in which the photons are traced."""
    worthwhile = int(photons / (_PHOTONS_A_VOXEL * voxels))
    batches = min(photons, max(_FEWEST_BATCHES, min(worthwhile, _MOST_BATCHES)))
    return max(batches, -(-photons // AT_ONCE))


def runs_of(
    medium: Medium | PerlinMedium,
    lights: Iterable[Light],
    photons: int,
    batches: int,
    copies: int,
    seed: int,
) -> list[Run]:
    """The `Run`s of a medium: one for each light that is not dark, in each distinct band."""
    lights = list(lights)
    if medium.emission is not None:
        lights.append(Emission(medium))
    runs: list[Run] = []
    for band, multiples in _distinct(medium, lights):
        probes = [_probe(light, medium, band, seed) for light in lights]
        whole = sum(probe.sum() for probe in probes)
        for number, (light, probe) in enumerate(zip(lights, probes, strict=True)):
            if probe.any():
                count = max(1, round(photons * probe.sum() / whole / (batches * copies)))
                power = float(probe.max()) * _PROBE / (count * copies)
            elif callable(light.spectrum):  # the probe may have missed its bright parts
                count = max(1, photons // (len(lights) * batches * copies))
                power = 1 / (count * copies)
            else:
                continue
            runs.append(Run(light, number, band, multiples[number], count, copies, power))
    if not runs:
        raise darkness(lights)
    return runs


def _distinct(
    medium: Medium | PerlinMedium, lights: Sequence[Light]
) -> list[tuple[int, list[dict[int, float]]]]:
    """[(band, [{band: its multiple} for each light])]: equivalent bands are traced once."""
    distinct: list[tuple[int, list[dict[int, float]]]] = []
    for band in range(medium.bands):
        for base, multiples in distinct:
            optics = [medium.sigma_s, medium.sigma_a, medium.g]
            if medium.occlusion is not None:
                optics.append(medium.occlusion_albedo)
            alike = all(np.array_equal(v[band], v[base]) for v in optics)
            factors = [multiple([light], medium, band, base) for light in lights]
            if alike and None not in factors:
                for bands, factor in zip(multiples, factors, strict=True):
                    assert factor is not None
                    bands[band] = factor
                break
        else:
            distinct.append((band, [{band: 1.0} for _ in lights]))
    return distinct


def _probe(light: Light, medium: Medium | PerlinMedium, band: int, seed: int) -> Floats:
    """(_PROBE,) W carried by each of _PROBE photons of a light, to measure its brightness."""
    return light.emit(_PROBE, medium, np.random.default_rng([seed, 0]), band)[2]
