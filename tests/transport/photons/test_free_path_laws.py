# SPDX-License-Identifier: GPL-3.0-or-later
"""Free paths obey the law exp(-optical depth), and a majorant that is too low is detected."""

from functools import cache
from itertools import product
from math import erf, exp, sqrt

import numpy as np
import pytest

from lb_lighting.errors import SolverError
from lb_lighting.transport import Medium
from lb_lighting.transport.photons.free_path import SAMPLERS
from lb_lighting.transport.photons.perlin import STRONG, WEAK
from tests.statistics import alike, sidak
from tests.transport.photons.laws import (
    FALSE_ALARM,
    FOUND,
    INTERPOLATIONS,
    ORIGIN,
    SHAPE,
    VIRTUAL,
    VOXEL,
    cloud,
    each_interpolation,
    head,
    law,
    law_of_rays,
    lowered,
    noise,
    optical_depth,
    prepare,
    random_rays,
    wild,
)

# Five laws along a line.

LENGTH = 2.0  # m
CELLS = 250

# Name: (integral of sigma from 0 to x, probability to get to LENGTH without a collision).
LAWS = {
    "ramp": (lambda x: x**2 / 2, 0.135335),
    "rising": (lambda x: (exp(2 * x) - 1) / 20, 0.0686),
    "falling": (lambda x: (1 - exp(-3 * x)) / 3, 0.7171),
    "peak": (lambda x: (erf((x - 1) / 0.05) + erf(20)) * 0.05 / sqrt(2), 0.931731),
    "hill": (lambda x: (erf(x - 1) + erf(1)) / sqrt(2), 0.303686),
}


@cache
def line(name):
    """The medium along x that has the law's depth at every face of a voxel."""
    integral, _ = LAWS[name]
    depth = np.array([integral(x) for x in np.linspace(0, LENGTH, CELLS + 1)])
    density = np.tile(np.diff(depth)[:, None, None] * CELLS / LENGTH, (1, 2, 3))
    return Medium(density, LENGTH / CELLS, 0.0, 1.0)


def depth_along_line(medium, interpolation, distances):
    """(n,) optical depth from x = 0 to `distances` m; beyond the medium as far as it goes."""
    place = np.clip(distances / medium.voxel_size, 0, CELLS)
    values = medium.density[:, 0, 0].astype(float)
    if interpolation == "constant":
        depth = np.interp(place, np.arange(CELLS + 1), [0, *np.cumsum(values)])
    else:
        nodes = np.pad(values, 1, mode="edge")  # half a voxel before the medium is the first
        whole = np.array([0, *np.cumsum((nodes[1:] + nodes[:-1]) / 2)])
        cell = np.minimum(np.floor(place + 0.5).astype(int), CELLS)
        share = place + 0.5 - cell
        slope = (nodes[1:] - nodes[:-1])[cell]
        depth = whole[cell] + share * (nodes[cell] + share * slope / 2) - nodes[0] / 2
    return depth * medium.voxel_size


def law_of_line(prepared, interpolation, count, seed):
    """The p-values of `law` for rays along x, and how many paths found their bound violated."""
    medium = prepared.grid.medium
    rng = np.random.default_rng(seed)
    rays = np.zeros((6, count), np.float32)
    rays[1:3] = rng.random((2, count)) * [[2], [3]]
    rays[:3] += prepared.grid.fine.lower
    rays[3] = 1
    per_depth = prepared.grid.per_depth(0)
    numbers = np.arange(count)
    lengths, _, violations = prepared.paths.free_paths(rays, numbers, per_depth, seed, 10**6)
    depths = depth_along_line(medium, interpolation, lengths * medium.voxel_size)
    depths[np.isinf(lengths)] = np.inf
    whole = depth_along_line(medium, interpolation, np.full(count, LENGTH))
    return law(depths, whole), violations


def test_media_have_the_laws_that_are_known():
    for name, (_, escape) in LAWS.items():
        for interpolation in INTERPOLATIONS:
            depth = depth_along_line(line(name), interpolation, np.array([LENGTH]))
            assert np.exp(-depth) == pytest.approx(escape, abs=1e-4)


def test_the_optical_depths_agree():
    """That of any ray, and that of the line."""
    distances = np.random.default_rng(0).uniform(0, 1.2 * LENGTH, 200)
    origins = np.tile([0, 0.5 * LENGTH / CELLS, 1.2 * LENGTH / CELLS], (200, 1))
    along = np.tile([3.0, 0, 0], (200, 1))
    for name, interpolation in product(LAWS, INTERPOLATIONS):
        general = optical_depth(line(name), interpolation, origins, along, distances)
        assert np.allclose(general, depth_along_line(line(name), interpolation, distances))


def test_samplers_draw_the_laws():
    """120 p-values in one: five laws, four samplers, two interpolations, three tests each."""
    p_values = {}
    for n, case in enumerate(product(LAWS, SAMPLERS, INTERPOLATIONS)):
        name, sampler, interpolation = case
        prepared = prepare(line(name), sampler, interpolation, size=12)
        p_values[case], violations = law_of_line(prepared, interpolation, 30_000, seed=n)
        assert violations == 0
    assert sidak([*p_values.values()]) > FALSE_ALARM, p_values


@pytest.mark.parametrize("sampler", VIRTUAL)
@each_interpolation
def test_a_bound_that_is_too_low_is_seen(sampler, interpolation):
    """In the law, and by the samplers themselves, on every device."""
    p_values, violations = [], 0
    for n, name in enumerate(LAWS):
        prepared = lowered(prepare(line(name), sampler, interpolation, size=12))
        p, violated = law_of_line(prepared, interpolation, 60_000, seed=n)
        p_values += p
        violations += violated
    assert sidak(p_values) < FALSE_ALARM
    assert violations > 0
    for found in FOUND:
        prepared = lowered(prepare(cloud(), sampler, interpolation, found=found))
        with pytest.raises(SolverError, match="above its majorant"):
            prepared.sample(*random_rays(cloud(), 10_000))


@pytest.mark.parametrize("sampler", VIRTUAL)
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.platform.split(",")[0])
def test_a_bound_of_noise_that_is_too_low_is_seen(sampler, found):
    medium = noise(32, WEAK, 20.0)
    rays = random_rays(medium, 5_000)
    prepared = prepare(medium, sampler, found=found)
    prepared.sample(*rays)
    with pytest.raises(SolverError, match="above its majorant"):
        lowered(prepared, 0.5).sample(*rays)


@each_interpolation
def test_homogeneous_media_have_the_exponential_law(interpolation):
    """In each band, whose sigma_t differ, of a grid of one density."""
    sigma_t, density, count = (0.5, 3.0), 0.7, 20_000
    medium = Medium(np.full(SHAPE, density), VOXEL, 0.0, sigma_t, origin=ORIGIN)
    rng = np.random.default_rng(3)
    origins = rng.uniform(0, 1, (count, 3)) * (0, *medium.shape[1:]) * VOXEL + ORIGIN
    p_values = []
    for sampler, band in product(SAMPLERS, range(2)):
        prepared = prepare(medium, sampler, interpolation, band=band)
        distances = prepared.sample(origins, np.tile([2.0, 0, 0], (count, 1)), seed=len(p_values))
        scale = sigma_t[band] * density
        p_values += law(distances * scale, np.full(count, SHAPE[0] * VOXEL * scale))
    assert sidak(p_values) > FALSE_ALARM


@pytest.mark.parametrize("medium", [cloud, wild, head])
def test_samplers_agree(medium):
    """With the law along each ray and with each other; super-voxels of the size that is chosen."""
    medium = medium()
    p_values = []
    for interpolation in INTERPOLATIONS:
        drawn = []
        for sampler in SAMPLERS:
            prepared = prepare(medium, sampler, interpolation, size=None)
            rays = random_rays(medium, 2000)
            p_values += law_of_rays(prepared, interpolation, *rays, seed=len(p_values))
            rays = random_rays(medium, 20_000, seed=1)
            drawn.append(prepared.sample(*rays, seed=len(p_values)))
        p_values += [alike(drawn[0], other) for other in drawn[1:]]
    assert sidak(p_values) > FALSE_ALARM, p_values


def test_samplers_agree_in_noise():
    """With the law, and in fine and inhomogeneous noise with each other."""
    p_values = []
    weak, strong = noise(32, WEAK, 4.0), noise(256, STRONG, 700.0)
    drawn = []
    for sampler in SAMPLERS:
        prepared = prepare(weak, sampler)
        p_values += law_of_rays(prepared, "constant", *random_rays(weak, 2000), len(p_values))
        prepared = prepare(strong, sampler, size=None)
        drawn.append(prepared.sample(*random_rays(strong, 8000, seed=1), seed=len(p_values)))
    p_values += [alike(drawn[0], other) for other in drawn[1:]]
    assert sidak(p_values) > FALSE_ALARM, p_values
