# SPDX-License-Identifier: GPL-3.0-or-later
"""Free paths: every sampler draws the law exp(-optical depth), whatever the medium and the rays."""

import warnings
from copy import copy
from dataclasses import replace
from functools import cache
from itertools import product
from math import erf, exp, sqrt

import numpy as np
import pytest

from lb_lighting.errors import DeviceError, MediumError, SettingsError, SolverError
from lb_lighting.transport import Medium, device
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.photons import free_path
from lb_lighting.transport.photons.free_path import (
    SAMPLERS,
    FreePathSampler,
    path_grid,
    sample_free_paths,
)
from lb_lighting.transport.photons.perlin import STRONG, WEAK, PerlinMedium
from tests.statistics import alike, normal, sidak, uniform

# Every statistical test here has this probability to fail by chance, had it other seeds.
FALSE_ALARM = 1e-4

FOUND = device.devices()
each_sampler = pytest.mark.parametrize("sampler", SAMPLERS)
VIRTUAL = SAMPLERS[1:]  # those that fill up with virtual particles
INTERPOLATIONS = ("constant", "linear")
each_interpolation = pytest.mark.parametrize("interpolation", INTERPOLATIONS)

ORIGIN = (1.0, -2.0, 0.5)
VOXEL = 0.25  # m
SHAPE = (17, 11, 14)


# The law, in float64 and independent of what is tested.


def density_at(medium, interpolation, points):
    """The density at points (..., 3) in voxels; 0 outside."""
    inside = ((points >= 0) & (points < medium.shape)).all(axis=-1)
    if isinstance(medium, PerlinMedium):
        return np.where(inside, medium.density_at(np.clip(points, 0, medium.resolution)), 0)
    if interpolation == "constant":
        voxel = np.clip(points.astype(int), 0, np.subtract(medium.shape, 1))
        return np.where(inside, medium.density[tuple(np.moveaxis(voxel, -1, 0))], 0)
    place = np.clip(points - 0.5, 0, np.subtract(medium.shape, 1))
    low = np.floor(place).astype(int)
    share = np.moveaxis(place - low, -1, 0)
    density = 0
    for corner in product((0, 1), repeat=3):
        voxel = np.minimum(low + corner, np.subtract(medium.shape, 1))
        weight = np.prod([s if c else 1 - s for s, c in zip(share, corner, strict=True)], axis=0)
        density = density + weight * medium.density[tuple(np.moveaxis(voxel, -1, 0))]
    return np.where(inside, density, 0)


def optical_depth(medium, interpolation, origins, directions, distances, band=0):
    """(n,) along rays, up to `distances` m.

    Two points of Gauss and Legendre between any two planes: exact, as the density is a polynomial
    of the third degree there (for noise with a power of 1).
    """
    start = (origins - np.array(medium.origin)) / medium.voxel_size
    way = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    crossings = [np.zeros((len(start), 1)), distances[:, None] / medium.voxel_size]
    for axis, n in enumerate(medium.shape):
        planes = np.arange(n + 1.0)
        if interpolation == "linear":
            planes = np.array([0, *(planes[:-1] + 0.5), n])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings.append((planes - start[:, axis, None]) / way[:, axis, None])
    crossings = np.nan_to_num(np.concatenate(crossings, axis=1), nan=0, posinf=1e9, neginf=0)
    crossings = np.sort(np.clip(crossings, 0, crossings[:, 1:2]), axis=1)
    row, column = np.nonzero(np.diff(crossings))
    near, far = crossings[row, column], crossings[row, column + 1]
    integral = 0
    for place in (-1, 1):
        length = (near + far) / 2 + place * (far - near) / 2 / sqrt(3)
        points = start[row] + length[:, None] * way[row]
        integral = integral + density_at(medium, interpolation, points) * (far - near) / 2
    depth = np.bincount(row, integral, minlength=len(start))
    return depth * medium.sigma_t[band] * medium.voxel_size


def law(depths, whole):
    """Three p-values of sampled optical depths, infinite for rays that left, to be of the law.

    whole  (n,) optical depth of the rays to infinity
    How many collided, by the normal approximation; and where, if they did, by the tests of
    Kolmogorov and Smirnov and of chi-square: given a collision, (1 - exp(-depth)) / its
    probability is uniform.
    """
    probability = -np.expm1(-whole)
    hit = np.isfinite(depths)
    error = sqrt((probability * (1 - probability)).sum())
    excess = hit.sum() - probability.sum()
    count = normal(excess / error) if error else float(excess == 0)
    return [count, *uniform(-np.expm1(-depths[hit]) / probability[hit])]


def law_of_rays(prepared, interpolation, origins, directions, seed):
    """The p-values of `law` for what a FreePathSampler draws along any rays."""
    medium, band = prepared.grid.medium, prepared.band
    distances = prepared.sample(origins, directions, seed)
    rays = medium, interpolation, origins, directions
    whole = optical_depth(*rays, np.full(len(origins), np.inf), band)
    depths = np.full(len(origins), np.inf)
    hit = np.isfinite(distances)
    assert not np.any(hit[whole == 0])
    depths[hit] = optical_depth(*rays[:2], origins[hit], directions[hit], distances[hit], band)
    return law(depths[whole > 0], whole[whole > 0])


# Media and rays.


def voxels(density, sigma_t=4.0):
    return Medium(density, VOXEL, 0.0, sigma_t, origin=ORIGIN)


@cache
def cloud():
    """Smooth, of 40 % void."""
    x, y, z = np.meshgrid(*(np.arange(n) / n for n in SHAPE), indexing="ij")
    waves = np.sin(7 * x + 4 * y) + np.sin(9 * y - 5 * z + 1) + np.sin(8 * z + 6 * x + 2)
    return voxels(np.maximum(0, waves - np.quantile(waves, 0.4)))


@cache
def wild():
    """From 1e-6 to 1e6; the densest voxel is 25 mean free paths wide."""
    return voxels(10 ** np.random.default_rng(2).uniform(-6, 6, SHAPE), 1e-4)


@cache
def head():
    from tests.setup import heads

    try:
        values = heads.ch2better()
    except SystemExit as reason:
        pytest.skip(f"The head cannot be fetched: {reason}")
    return voxels(heads.resampled(values, (30, 37, 32)), 1.0)


def noise(resolution, parameters, depth):
    """Noise in a cube of 4 m; `depth` is that of an edge at density 1."""
    return PerlinMedium(resolution, 4.0, 0.0, depth / 4, origin=ORIGIN, **parameters)


def random_rays(medium, count, seed=0):
    """From in and around the medium, everywhere."""
    rng = np.random.default_rng(seed)
    extent = np.multiply(medium.shape, medium.voxel_size)
    origins = rng.uniform(-0.3, 1.3, (count, 3)) * extent + medium.origin
    target = rng.uniform(0, 1, (count, 3)) * extent + medium.origin
    return origins, (target - origins) * rng.uniform(0.01, 100, (count, 1))


def prepare(medium, sampler, interpolation="constant", size=4, found=None, **options):
    """A FreePathSampler; super-voxels of `size` that divides no edge, where it has any."""
    supervoxel = size if sampler.startswith("supervoxel") else None
    return FreePathSampler(
        *(medium, sampler, found),
        interpolation=interpolation,
        supervoxel=supervoxel,
        **options,
    )


def lowered(prepared, factor=0.9):
    """The same sampler with bounds that are too low."""
    grid = prepared.grid
    majorants = grid.majorants
    if majorants:
        majorants = replace(majorants, values=majorants.values * np.float32(factor))
    largest = grid.global_majorant * factor
    other = copy(prepared)
    other.grid = replace(grid, majorants=majorants, global_majorant=largest)
    other.paths = backend_of(prepared.device).paths(other.grid)
    return other


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
        with pytest.raises(SolverError, match="over its upper bound"):
            prepared.sample(*random_rays(cloud(), 10_000))


@pytest.mark.parametrize("sampler", VIRTUAL)
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.platform.split(",")[0])
def test_a_bound_of_noise_that_is_too_low_is_seen(sampler, found):
    medium = noise(32, WEAK, 20.0)
    rays = random_rays(medium, 5_000)
    prepared = prepare(medium, sampler, found=found)
    prepared.sample(*rays)
    with pytest.raises(SolverError, match="over its upper bound"):
        lowered(prepared, 0.5).sample(*rays)


def same(first, second, tolerance=1e-4):
    """The share of distances that differ by less than `tolerance` m, or are both infinite."""
    with np.errstate(invalid="ignore"):
        return np.mean((first == second) | (np.abs(first - second) < tolerance))


@each_interpolation
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.platform.split(",")[0])
def test_one_super_voxel_is_woodcock(interpolation, found):
    """Path by path: the same random numbers, in the same order, under the same bound."""
    rays = random_rays(cloud(), 2000)
    woodcock = prepare(cloud(), "woodcock", interpolation, found=found)
    constant = prepare(cloud(), "supervoxel_constant", interpolation, 32, found)
    smaller = prepare(cloud(), "supervoxel_constant", interpolation, 8, found)
    assert same(woodcock.sample(*rays), constant.sample(*rays)) > 0.998
    assert same(woodcock.sample(*rays), smaller.sample(*rays)) < 0.9


@pytest.mark.parametrize(
    ("sampler", "interpolation"), [*product(SAMPLERS[2:], ["constant"]), (SAMPLERS[3], "linear")]
)
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.platform.split(",")[0])
def test_one_super_voxel_a_voxel_is_ray_marching(sampler, interpolation, found):
    """Path by path: the bound is the density, so the first particle that is met is a real one."""
    rays = random_rays(cloud(), 2000)
    march = prepare(cloud(), "ray_march", interpolation, found=found).sample(*rays)
    # Not all: a linear bound has a margin for rounding, which tells where there is next to nothing.
    assert same(march, prepare(cloud(), sampler, interpolation, 1, found).sample(*rays)) > 0.99
    assert same(march, prepare(cloud(), sampler, interpolation, 2, found).sample(*rays)) < 0.9


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


@each_sampler
def test_nothing_collides_in_a_void(sampler):
    rng = np.random.default_rng(4)
    medium = voxels(np.where(rng.random(SHAPE) < 0.4, 0, rng.random(SHAPE)))
    origins, directions = random_rays(medium, 5000)
    ways = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    for found in FOUND:
        distances = prepare(medium, sampler, found=found).sample(origins, directions)
        hit = np.isfinite(distances)
        assert hit.mean() > 0.5
        points = (origins + distances[:, None] * ways)[hit]
        points = (points - medium.origin) / VOXEL
        around = points + 1e-4 * np.array([*product((-1, 1), repeat=3)])[:, None]  # rounding
        assert np.all(density_at(medium, "constant", around).max(axis=0) > 0)


@each_sampler
@each_interpolation
def test_nothing_collides_where_nothing_is(sampler, interpolation):
    dense = cloud().density
    rays = random_rays(cloud(), 1000)
    empty = voxels(np.zeros(SHAPE)), voxels(dense, 0.0), voxels(dense, 1e-300)
    for medium, found in product(empty, FOUND):
        prepared = prepare(medium, sampler, interpolation, found=found)
        assert np.all(np.isposinf(prepared.sample(*rays)))


@each_sampler
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.platform.split(",")[0])
def test_no_loop_is_endless(sampler, found):
    """Where steps are shorter than what float32 tells apart."""
    count = 200
    before = -1, *np.multiply(SHAPE[1:], VOXEL / 2)
    origins = np.tile(np.add(ORIGIN, before), (count, 1))
    forward = np.tile([1.0, 0, 0], (count, 1))
    opaque = voxels(np.ones(SHAPE), 1e9 / VOXEL)
    distances = prepare(opaque, sampler, found=found).sample(origins, forward)
    assert distances == pytest.approx(1, abs=1e-5)

    behind = np.zeros(SHAPE)
    behind[-1] = 1
    prepared = prepare(voxels(behind, 1e9 / VOXEL), sampler, size=32, found=found, most_steps=300)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        distances = prepared.sample(origins, forward)
    lost = np.isnan(distances)
    if lost.any():
        assert [str(w.message).split(" rays")[0] for w in told] == [f"{lost.sum()} of {count}"]
        assert told[0].category is RuntimeWarning
    else:
        assert not told
    assert lost.all() == (sampler in VIRTUAL)
    wall = 1 + (SHAPE[0] - 1) * VOXEL
    assert distances[~lost] == pytest.approx(wall, abs=1e-5)


def entry_cases():
    """[(what, origin from the lower corner, direction, m to the medium)]"""
    size = np.multiply(SHAPE, VOXEL)
    x, y, z = size / 2
    oblique = np.array([1.0, -2.0, 3.0]) / sqrt(14)
    back = float(min(size / 2 / abs(oblique)))
    return [
        ("towards it", (-1, y, z), (1, 0, 0), 1),
        ("away from it", (-1, y, z), (-1, 0, 0), np.inf),
        ("past it", (-1, -1, z), (1, 0, 0), np.inf),
        ("past an edge", (-1, 0.99, z), (1, -1, 0), np.inf),
        ("touching an edge", (-1, 1, z), (1, -1, 0), np.inf),
        ("in it", (x, y, z), oblique, 0),
        ("on the lower face, in", (0, y, z), (1, 0, 0), 0),
        ("on the lower face, out", (0, y, z), (-1, 0, 0), np.inf),
        ("on the upper face, in", (size[0], y, z), (-1, 0, 0), 0),
        ("on the upper face, out", (size[0], y, z), (1, 0, 0), np.inf),
        ("along the lower face", (-1, 0, z), (1, 0, 0), 1),
        ("along the upper face", (-1, size[1], z), (1, 0, 0), np.inf),
        ("along an edge", (x, -2, 0), (0, 1, 0), 2),
        ("along voxels' faces", (2 * VOXEL, 3 * VOXEL, size[2] + 1), (0, 0, -1), 1),
        ("along voxels' diagonals", (-1, -1, VOXEL), (1, 1, 0), sqrt(2)),
        ("zeros of either sign", (-1, y, z), (1, -0.0, 0.0), 1),
        ("backwards", (x, y, size[2] + 1), (-0.0, -0.0, -1), 1),
        ("nearly along an axis", (-1, y, z), (1, 1e-30, -1e-30), 1),
        ("as nearly as can be", (-1, y, z), (1, 1e-310, -5e-324), 1),
        ("into a corner", (-1, -1, -1), (1, 1, 1), sqrt(3)),
        ("into the other corner", size + 1, (-1, -1, -1), sqrt(3)),
        ("from far away", (-1e6, y, z), (1, 0, 0), 1e6),
        ("obliquely from far away", size / 2 - 1e6 * oblique, oblique, 1e6 - back),
        ("a short direction", (-1, y, z), (1e-100, 0, 0), 1),
        ("a long direction", (x, y + 1e5, z), (0, -1e100, 0), 1e5 - y),
    ]


@each_sampler
@each_interpolation
def test_distances_are_from_the_origin_of_the_ray(sampler, interpolation):
    """In an opaque medium, that is to where the ray enters it; in a clear one there is none."""
    what, origins, directions, entries = zip(*entry_cases(), strict=True)
    origins = np.array(origins) + ORIGIN
    opaque, clear = voxels(np.ones(SHAPE), 1e6), voxels(np.ones(SHAPE), 1e-12)
    for found in FOUND:
        prepared = prepare(opaque, sampler, interpolation, found=found)
        distances = prepared.sample(origins, directions)
        close = np.isclose(distances, entries, rtol=0, atol=1e-4)
        assert not [name for name, good in zip(what, close, strict=True) if not good]
        prepared = prepare(clear, sampler, interpolation, found=found)
        assert np.all(np.isposinf(prepared.sample(origins, directions)))


@pytest.mark.parametrize("sampler", SAMPLERS[:3])  # the linear bound breaks ties by axis
@each_interpolation
def test_axes_are_alike(sampler, interpolation):
    """Path by path, in the medium and its image with the axes in reverse order."""
    medium = cloud()
    image = Medium(medium.density.T, VOXEL, 0.0, medium.sigma_t, origin=ORIGIN[::-1])
    origins, directions = random_rays(medium, 2000)
    distances = prepare(medium, sampler, interpolation).sample(origins, directions)
    reverse = prepare(image, sampler, interpolation)
    assert same(distances, reverse.sample(origins[:, ::-1], directions[:, ::-1])) > 0.998


@pytest.mark.parametrize("sampler", SAMPLERS[:2])  # super-voxels are counted from the lower end
@each_interpolation
def test_forwards_is_like_backwards(sampler, interpolation):
    """Path by path, in the medium and its mirror image."""
    medium = cloud()
    origin = -np.array(medium.domain.upper)
    image = Medium(medium.density[::-1, ::-1, ::-1], VOXEL, 0.0, medium.sigma_t, origin=origin)
    origins, directions = random_rays(medium, 2000)
    distances = prepare(medium, sampler, interpolation).sample(origins, directions)
    mirror = prepare(image, sampler, interpolation)
    assert same(distances, mirror.sample(-origins, -directions)) > 0.998


@each_sampler
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.platform.split(",")[0])
def test_a_ray_draws_by_its_number_and_the_seed(sampler, found):
    origins, directions = random_rays(cloud(), 3000)
    prepared = prepare(cloud(), sampler, found=found)
    distances = prepared.sample(origins, directions, seed=7)
    assert np.array_equal(distances, prepared.sample(origins, directions, seed=7))
    assert same(distances, prepared.sample(origins, directions, seed=8)) < 0.9
    assert np.array_equal(distances[:100], prepared.sample(origins[:100], directions[:100], 7))
    # Others may miss, or collide elsewhere.
    other = origins.copy()
    other[::2] += 1e3
    assert np.array_equal(distances[1::2], prepared.sample(other, directions, seed=7)[1::2])


ONE_RAY = [[0.0, 0, 0]], [[1.0, 0, 0]]


def test_one_call_does_it_all():
    origins, directions = random_rays(cloud(), 300)
    prepared = FreePathSampler(cloud(), interpolation="linear", supervoxel=5)
    expected = prepared.sample(origins, directions, 3)
    distances = sample_free_paths(
        cloud(), origins, directions, seed=3, interpolation="linear", supervoxel=5
    )
    assert np.array_equal(distances, expected)
    assert distances.dtype == np.float64
    for found in FOUND:
        assert sample_free_paths(cloud(), [[0, 0, 0]], [[0, 0, 1]], device=found.label).shape == (
            1,
        )
        assert prepare(cloud(), "woodcock", found=found).sample(*np.empty((2, 0, 3))).shape == (0,)
    # Lists, whole numbers and read-only arrays are as good.
    origins.flags.writeable = directions.flags.writeable = False
    assert np.array_equal(prepared.sample(origins.tolist(), directions, 3), expected)


@pytest.mark.parametrize(
    ("origins", "directions", "sentence"),
    [
        ([[np.nan, 0, 0]], [[1, 0, 0]], "1 of 1 rays have an origin that is not finite"),
        ([[0, np.inf, 0]], [[1, 0, 0]], "not finite"),
        ([[0, 0, 0]] * 2, [[1, 0, 0], [0, -0.0, 0]], "the first is ray 1"),
        ([[0, 0, 0]], [[1, np.nan, 0]], "no length"),
        ([[0, 0, 0]], [[1, np.inf, 0]], "no length"),
        ([0, 0, 0], [1, 0, 0], r"one shape \(n, 3\)"),
        ([[0, 0]], [[1, 0]], r"one shape \(n, 3\)"),
        ([[0, 0, 0]] * 2, [[1, 0, 0]], r"\(2, 3\) and \(1, 3\)"),
    ],
)
def test_rays_that_are_none_are_refused(origins, directions, sentence):
    with pytest.raises(SettingsError, match=sentence):
        sample_free_paths(cloud(), origins, directions)


@pytest.mark.parametrize(
    ("settings", "error", "sentence"),
    [
        ({"sampler": "fast"}, SettingsError, "no sampler called 'fast'; choose one of: ray_march,"),
        ({"interpolation": "cubic"}, SettingsError, "no interpolation called 'cubic'"),
        ({"band": 1}, SettingsError, "no band 1; it has 1"),
        ({"band": -1}, SettingsError, "no band -1"),
        ({"device": "abacus"}, DeviceError, "no device called 'abacus'"),
        ({"supervoxel": 0}, SettingsError, "super-voxel.* whole number .* it is 0"),
        ({"supervoxel": 2.5}, SettingsError, "super-voxel.* whole number .* it is 2.5"),
        ({"seed": -1}, SettingsError, "seed must be a whole number from 0 to .* it is -1"),
        ({"seed": 2**32}, SettingsError, "seed must be a whole number"),
        ({"seed": 1.5}, SettingsError, "it is 1.5"),
        ({"supervoxel": -3}, SettingsError, "super-voxel.* whole number .* it is -3"),
    ],
)
def test_settings_that_are_none_are_refused(settings, error, sentence):
    with pytest.raises(error, match=sentence):
        sample_free_paths(cloud(), *ONE_RAY, **settings)


def test_super_voxels_of_noise_are_cells_of_its_lattices():
    for size in (3, 17, 33):
        with pytest.raises(SettingsError, match="do not fill 32"):
            path_grid(noise(32, WEAK, 1.0), supervoxel=size)
    assert path_grid(noise(32, WEAK, 1.0), supervoxel=2).cells == (16, 16, 16)


def test_density_that_is_not_a_number_is_refused():
    with pytest.raises(MediumError, match="not finite in 1 of"):
        voxels(np.where(np.arange(8).reshape(2, 2, 2) == 3, np.nan, 1.0))


def test_medium_that_does_not_fit_is_refused():
    small = replace(device.devices()[0], memory=1000, largest_buffer=1000)
    with pytest.raises(DeviceError, match="largest resolution that fits"):
        sample_free_paths(cloud(), *ONE_RAY, device=small)


def test_medium_of_more_voxels_than_kernels_can_number_is_refused(monkeypatch):
    monkeypatch.setattr(free_path, "_MOST_VALUES", 10)
    with pytest.raises(MediumError, match="lower its resolution"):
        path_grid(cloud())
