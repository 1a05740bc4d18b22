# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of paths: random numbers, kernels against their NumPy twin, and bounds along rays."""

from copy import copy
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from lb_lighting.transport import Medium, device
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.photons.free_path import SAMPLERS, FreePathSampler
from lb_lighting.transport.photons.path_grid import enter
from lb_lighting.transport.photons.perlin import STRONG, WEAK, PerlinMedium
from lb_lighting.transport.photons.random import RandomStreams
from tests.statistics import chi_square, sidak, uniform

NUMPY = device.devices()[-1]
OPENCL = device.devices()[:-1]
on_each_device = pytest.mark.parametrize(
    "found", OPENCL, ids=lambda found: found.platform.split(",")[0]
)
each_sampler = pytest.mark.parametrize("sampler", SAMPLERS)
SUPERVOXELS = ("supervoxel_constant", "supervoxel_linear")
INTERPOLATIONS = ("constant", "linear")

SHAPE = (13, 7, 10)
SIZE = 4  # of super-voxels; it divides none of the edges
ORIGIN = (1.0, -2.0, 0.5)
VOXEL = 0.25  # m
CELLS = 32  # along an edge of the noise

# Every statistical test here has this probability to fail by chance, had it another seed.
FALSE_ALARM = 1e-4

DRAW = """
__kernel void draw(const uint seed, __global const uint *indices, const int count,
                   __global float *numbers)
{
    const int stream = get_global_id(0);
    Random random = random_stream(seed, indices[stream]);
    for (int n = 0; n < count; n++)
        numbers[stream * count + n] = random_next(&random);
}

__kernel void ends(__global float *numbers)
{
    Random least = {0, 1, 0, 0}, largest = {0xffffffffu, 1, 0, 1};
    numbers[0] = random_next(&least);
    numbers[1] = random_next(&largest);
}
"""

# Follows rays from super-voxel to super-voxel, in a vacuum. `far` is how far outside their
# super-voxel the ends of a stretch are, in fine cells; `points` on it, its ends among them, are
# held to the bound that a path has there, with the tolerance that paths have.
FOLLOW = """
__kernel void follow(GRID_PARAMETERS, __global const float *rays, const int count,
                     const int points, __global float *lengths, __global float *far,
                     __global int *over)
{
    const Grid g = GRID;
    const int ray = get_global_id(0);
    Path p;
    enter(&p, g, rays, count, ray);
    Random random = random_stream(0, ray);
    start_flight(&p, g, &random);
    float furthest = 0.0f;
    int found = 0, event = CROSSED;
    while (event == CROSSED) {
        const float begin = p.t, middle = g.size * 0.5f;
        Path ahead = p;
        event = advance(&p, g, &random);
        const float length = p.t - begin;
#ifdef POLYNOMIAL
        const Cubic cubic = bound_ahead(&ahead, g);
#endif
        for (int n = 0; n < points; n++) {
            const float step = length * n / (points - 1);
            ahead.t = begin + step;
            const float x = ahead.ox + ahead.t * ahead.dx - (ahead.i * g.size + middle);
            const float y = ahead.oy + ahead.t * ahead.dy - (ahead.j * g.size + middle);
            const float z = ahead.oz + ahead.t * ahead.dz - (ahead.k * g.size + middle);
            furthest = fmax(furthest, fmax(fabs(x), fmax(fabs(y), fabs(z))) - middle);
#ifdef POLYNOMIAL
            const float limit = cubic_value(cubic, step);
#else
            const float limit = ahead.limit;
#endif
            found += denser(&ahead, g, limit * 1.0001f, INFINITY);
        }
    }
    lengths[ray] = p.t;
    far[ray] = furthest;
    over[ray] = found;
}
"""


def densities():
    """{name: density}: with voids, and over twelve orders of magnitude."""
    rng = np.random.default_rng(1)
    void = rng.random(SHAPE) < 0.4
    return {
        "voids": np.where(void, 0, rng.random(SHAPE)),
        "wild": 10 ** rng.uniform(-6, 6, SHAPE),
    }


def voxels(density, depth=2.0):
    """The medium of a density; `depth` is the optical depth of its densest voxel."""
    return Medium(density, VOXEL, 0.0, depth / VOXEL / density.max(), origin=ORIGIN)


# Noise: its parameters, and its optical depth along an edge at density 1.
NOISE = {"weak": (WEAK, 4.0), "strong": (STRONG, 500.0)}


def medium_of(name):
    if name in NOISE:
        parameters, depth = NOISE[name]
        return PerlinMedium(CELLS, 2.0, 0.0, depth / 2, origin=ORIGIN, coarsest=2, **parameters)
    return voxels(densities()[name])


def rays(medium, count, seed=0):
    """Origins around and in the medium, and directions, each (count, 3).

    A quarter start at corners of voxels and go along voxels' edges, their faces' diagonals or
    their own, forwards or backwards.
    """
    rng = np.random.default_rng(seed)
    extent = np.multiply(medium.shape, medium.voxel_size)
    origins = rng.uniform(-0.5, 1.5, (count, 3)) * extent
    directions = rng.normal(size=(count, 3))
    few = count // 4
    corners = rng.integers(0, medium.shape, (few, 3)) * medium.voxel_size
    ways = np.array([way for way in product((-1, 0, 1), repeat=3) if any(way)])
    origins[:few], directions[:few] = corners, ways[rng.integers(len(ways), size=few)]
    return origins + medium.origin, directions


@pytest.fixture(scope="session")
def kernels(tmp_path_factory):
    """Function of a device or an engine and a source: the program of it, behind ours."""

    @cache
    def written(text):
        path = tmp_path_factory.mktemp("kernels") / "test.cl"
        path.write_text(text)
        return str(path)

    def program(found, text):
        if isinstance(found, device.Device):
            return device.program(found, ("photons/random.cl", written(text)), ())
        return found.program(written(text))

    return program


def streams(seed, indices, count):
    """(streams, count) of the twin's numbers."""
    twin = RandomStreams(seed, indices)
    return np.stack([twin.next(np.arange(len(indices))) for _ in range(count)], axis=1)


def outputs(found, count, *kinds):
    """[(buffer, array to read it into)]"""
    import pyopencl as cl

    arrays = [np.empty(count, kind) for kind in kinds]
    context, write = device.context(found), cl.mem_flags.WRITE_ONLY
    return [(cl.Buffer(context, write, array.nbytes), array) for array in arrays]


def read(found, pairs):
    import pyopencl as cl

    for buffer, array in pairs:
        cl.enqueue_copy(device.queue(found), array, buffer)
    return [array for _, array in pairs]


@on_each_device
@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1])
def test_random_numbers_are_the_twins_bit_for_bit(found, seed, kernels):
    import pyopencl as cl

    count = 50
    indices = np.array([*range(200), 2**31, 2**32 - 1], np.uint32)
    copy = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    uploaded = cl.Buffer(device.context(found), copy, hostbuf=indices)
    pair = outputs(found, len(indices) * count, np.float32)
    draw = cl.Kernel(kernels(found, DRAW), "draw")
    draw(
        *(device.queue(found), (len(indices),), None, np.uint32(seed), uploaded),
        *(np.int32(count), pair[0][0]),
    )
    (numbers,) = read(found, pair)
    twin = streams(seed, indices, count)
    assert np.array_equal(numbers.reshape(twin.shape).astype(float), twin)
    assert len(np.unique(twin[:, :4], axis=0)) == len(indices)


@on_each_device
def test_random_numbers_reach_neither_0_nor_1(found, kernels):
    import pyopencl as cl

    pair = outputs(found, 2, np.float32)
    cl.Kernel(kernels(found, DRAW), "ends")(device.queue(found), (1,), None, pair[0][0])
    (numbers,) = read(found, pair)
    assert numbers.tolist() == [2.0**-24, 1 - 2.0**-24]
    twin = RandomStreams(0, [0, 1])
    twin.state[:] = [[0, 2**32 - 1], [1, 1], [0, 0], [0, 1]]
    assert np.array_equal(twin.next(np.arange(2)), numbers)


def test_random_numbers_are_uniform_and_independent():
    """Along a stream, across the streams of neighbours, and across seeds."""
    first, second = (streams(seed, np.arange(20_000), 6) for seed in (0, 1))
    p_values = [p for draw in first.T for p in uniform(draw)]
    pairs = [(first[:, n], first[:, n + 1]) for n in range(5)]
    pairs += [(first[:-1, 0], first[1:, 0]), (first[:, 0], second[:, 0])]
    for one, other in pairs:
        counts, _, _ = np.histogram2d(one, other, bins=16, range=((0, 1), (0, 1)))
        p_values.append(chi_square(counts, np.full(counts.shape, len(one) / counts.size)))
    assert sidak(p_values) > FALSE_ALARM


@cache
def twins(name, sampler, interpolation, seed=5):
    """A medium, rays, and what the twin makes of them."""
    medium = medium_of(name)
    origins, directions = rays(medium, 1000 if name in NOISE else 4000)
    twin = prepared(medium, sampler, NUMPY, interpolation)
    return twin, origins, directions, twin.sample(origins, directions, seed)


def prepared(medium, sampler, found, interpolation, size=SIZE):
    return FreePathSampler(
        *(medium, sampler, found),
        interpolation=interpolation,
        supervoxel=size if sampler in SUPERVOXELS else None,
    )


def agreement(first, second, tolerance):
    """The share of distances that are the same; float32 turns a decision now and then."""
    with np.errstate(invalid="ignore"):
        return np.mean((first == second) | (np.abs(first - second) <= tolerance))


@on_each_device
@each_sampler
@pytest.mark.parametrize(
    ("name", "interpolation"),
    [*product(densities(), INTERPOLATIONS), *product(NOISE, ["constant"])],
)
def test_kernels_do_as_their_twin(found, sampler, name, interpolation):
    twin, origins, directions, expected = twins(name, sampler, interpolation)
    assert 0.05 < np.mean(np.isfinite(expected)) < 0.95
    kernel = copy(twin)  # bounds may differ by what makes them
    kernel.paths = backend_of(found).paths(twin.grid)
    tolerance = 1e-3 * twin.grid.medium.voxel_size
    assert agreement(kernel.sample(origins, directions, 5), expected, tolerance) >= 0.999
    assert agreement(kernel.sample(origins, directions, 6), expected, tolerance) < 0.9


# By how much a bound is lowered for densities to be over it; that of noise is loose, as only the
# coarse octaves are known.
LOWERED = {"weak": 0.7, "strong": 0.05}


@pytest.mark.parametrize("sampler", SUPERVOXELS)
@pytest.mark.parametrize("size", [1, SIZE, 16])
@pytest.mark.parametrize(
    ("name", "interpolation"),
    [*product(densities(), INTERPOLATIONS), *product(NOISE, ["constant"])],
)
def test_rays_stay_under_the_bounds(sampler, name, interpolation, size, kernels):
    """Stretches are in their super-voxel, cover the ray, and no density is over its bound.

    Millions of points in all, in float32 as kernels compute it, on each device.
    """
    medium = medium_of(name)
    for found in OPENCL:
        prepared_sampler = prepared(medium, sampler, found, interpolation, size)
        paths, grid = prepared_sampler.paths, prepared_sampler.grid
        inside, directions, exits = entering(grid, *rays(medium, 2000, seed=2))
        lengths, far, over = follow(paths, inside, directions, kernels)
        largest = max(medium.shape)
        assert np.abs(lengths - exits).max() < 4e-6 * largest
        assert far.max() < 2e-6 * largest
        assert over.sum() == 0
        if size > 1:  # the check can fail
            values = grid.majorants.values * np.float32(LOWERED.get(name, 0.9))
            lowered = replace(grid, majorants=replace(grid.majorants, values=values))
            assert (
                follow(backend_of(found).paths(lowered), inside, directions, kernels)[2].sum() > 0
            )


def entering(grid, origins, directions):
    """Rays that hit: where they enter, their directions, and how far they go, in fine cells."""
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    _, inside, hit = enter(grid, origins, directions)
    inside, directions = inside[hit].astype(np.float32), directions[hit].astype(np.float32)
    end = np.where(directions >= 0, grid.fine.upper, grid.fine.lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = np.where(directions == 0, np.inf, (end - inside) / directions.astype(float))
    return inside, directions, exits.min(axis=1)


def follow(paths, inside, directions, kernels):
    """(lengths, far, over) of FOLLOW, each (rays,)."""
    import pyopencl as cl

    vacuum, points = np.float32(np.inf), 8 * paths.grid.size + 1
    packed = np.ascontiguousarray(np.concatenate([inside, directions], axis=1).T)
    count = len(inside)
    pairs = outputs(paths.device, count, np.float32, np.float32, np.int32)
    cl.Kernel(kernels(paths, FOLLOW), "follow")(
        *(paths.queue, (count,), None, *paths.arguments, vacuum, paths.upload(packed)),
        *(np.int32(count), np.int32(points), *(buffer for buffer, _ in pairs)),
    )
    return read(paths.device, pairs)
