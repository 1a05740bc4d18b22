# SPDX-License-Identifier: GPL-3.0-or-later
"""Fractal noise: its statistics, its bounds, and the same noise on every OpenCL device."""

from functools import cache
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

import lb_lighting
from lb_lighting.errors import MediumError
from lb_lighting.transport import Medium, device
from lb_lighting.transport.photons.perlin import FINEST, STRONG, WEAK, PerlinMedium

OPENCL = [found for found in device.devices() if found.kind != "NumPy"]
on_each_device = pytest.mark.parametrize(
    "found", OPENCL, ids=lambda found: found.platform.split(",")[0]
)
LOCAL_TERMS = ((), (0,), (1,), (2,), (0, 1), (1, 2), (2, 0), (0, 1, 2))  # 1 x y z xy yz zx xyz

EVALUATE = """
__kernel void evaluate(__global const float *point, __global const float *threshold,
                       __global float *noise, __global float *density, __global int *exceeds,
                       PERLIN_PARAMETERS)
{
    const int i = get_global_id(0);
    const float x = point[3 * i], y = point[3 * i + 1], z = point[3 * i + 2];
    noise[i] = perlin_noise(PERLIN, x, y, z);
    density[i] = perlin_density(PERLIN, x, y, z);
    exceeds[i] = perlin_exceeds(PERLIN, x, y, z, threshold[i]);
}
"""


def perlin(resolution=256, **noise):
    return PerlinMedium(resolution, 1.0, 1.0, 0.0, **noise)


# Between them: every kind of parameter, times between frames and before the first, the largest
# resolution, and one octave alone.
MEDIA = {
    "weak": perlin(256, **WEAK),
    "strong": perlin(4096, **STRONG, seed=1),
    "finest": perlin(FINEST, **STRONG, seed=2**32 - 1, persistence=0.7),
    "moving": perlin(1024, cutoff=0.3, power=1.7, time=3.37, seed=7),
    "past": perlin(FINEST, cutoff=0.45, power=1, time=-2.25, coarsest=1),
    "rough": perlin(96, cutoff=0.48, power=9.5, persistence=1, coarsest=3, seed=5),
    "steep": perlin(512, cutoff=0.62, power=64, seed=3),
    "smooth": perlin(8, **WEAK, coarsest=8, persistence=0),
}
each_medium = pytest.mark.parametrize("medium", MEDIA.values(), ids=MEDIA.keys())


# Drivers chat about how well they optimized.
pytestmark = pytest.mark.filterwarnings("ignore:Non-empty compiler output")


@cache
def evaluator(found):
    import pyopencl as cl

    kernels = Path(lb_lighting.__file__).parent / "kernels"
    needed = ("photons/random.cl", "photons/perlin.cl")
    source = "".join((kernels / name).read_text() for name in needed) + EVALUATE
    program = cl.Program(device.context(found), source).build(device._BUILD_OPTIONS.split())
    return cl.Kernel(program, "evaluate")


def on_device(found, medium, points, thresholds=None):
    """(noise, density, exceeds) at points (n, 3), as the kernels' functions have them."""
    import pyopencl as cl

    context, queue, flags = device.context(found), device.queue(found), cl.mem_flags
    count = len(points)
    thresholds = np.zeros(count) if thresholds is None else thresholds
    inputs = [np.ascontiguousarray(values, np.float32) for values in (points, thresholds)]
    outputs = [np.empty(count, kind) for kind in (np.float32, np.float32, np.int32)]
    copy = flags.READ_ONLY | flags.COPY_HOST_PTR
    buffers = [cl.Buffer(context, copy, hostbuf=values) for values in inputs]
    buffers += [cl.Buffer(context, flags.WRITE_ONLY, values.nbytes) for values in outputs]
    evaluator(found)(queue, (count,), None, *buffers, *medium.device_arguments)
    for values, buffer in zip(outputs, buffers[2:], strict=True):
        cl.enqueue_copy(queue, values, buffer)
    return outputs


def random_points(medium, count, seed=0):
    """(count, 3) float32 in the domain, a third of their coordinates at lattice planes."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3)) * medium.resolution
    planes = np.round(points * rng.choice([1, 1 / 4, 1 / 64], points.shape))
    return np.where(rng.random(points.shape) < 1 / 3, planes, points).astype(np.float32)


# Devices


@on_each_device
def test_devices_have_the_same_noise(found):
    for name, medium in MEDIA.items():
        points = random_points(medium, 50_000)
        noise, density, _ = on_device(found, medium, points)
        expected = medium.noise(*points.T.astype(float))
        np.testing.assert_allclose(noise, expected, rtol=0, atol=1e-6, err_msg=name)
        # As much as what the noise may be off by, where T is steepest.
        allowed = 1e-6 * medium.power / (1 - medium.cutoff)
        expected = medium.density_at(points)
        np.testing.assert_allclose(density, expected, rtol=0, atol=allowed, err_msg=name)


@on_each_device
def test_lazy_comparison_is_the_full_one(found):
    """With thresholds as a sampler has them, at 0 and 1, and close to the density itself."""
    for name, medium in MEDIA.items():
        rng = np.random.default_rng(1)
        points = random_points(medium, 50_000, seed=1)
        noise = medium.noise(*points.T.astype(float))
        near = noise + 10.0 ** -rng.integers(1, 6, len(noise)) * rng.choice([-1, 1], len(noise))
        wanted = np.where(rng.random(len(noise)) < 0.5, near, rng.random(len(noise)))
        thresholds = medium._density(wanted)
        thresholds[:1000], thresholds[1000:2000] = 0, 1
        _, _, exceeds = on_device(found, medium, points, thresholds)
        wanted = medium.cutoff + (1 - medium.cutoff) * thresholds ** (1 / medium.power)
        # What float32 cannot tell: noise so close to the wanted one, thresholds that it has as 0.
        clear = (np.abs(noise - wanted) > 3e-6) & ((thresholds == 0) | (thresholds > 1e-36))
        assert clear.mean() > 0.5
        np.testing.assert_array_equal(exceeds[clear], (noise > wanted)[clear], err_msg=name)
        assert not exceeds[thresholds >= 1].any()


# Bounds


def bound_values(bound, cells, local):
    """A bound in float32 at local coordinates (n, 3) of its super-voxels cells (n, 3)."""
    values = bound.values[tuple(cells.T)]
    if values.ndim == 1:
        return values
    total = np.zeros(len(cells), np.float32)
    for coefficient, term in zip(values.T, LOCAL_TERMS, strict=True):
        total += coefficient * np.prod(local[:, term], axis=1, dtype=np.float32)
    return total


def points_in_cells(bound, count, seed):
    """Super-voxels (n, 3), local coordinates (n, 3) and points (n, 3); many on faces and edges."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, len(bound.values), (count, 3))
    local = rng.random((count, 3))
    fine = np.round(local * bound.size) / bound.size
    ends = np.round(local)
    local = np.choose(rng.integers(0, 4, local.shape), [local, local, fine, ends])
    points = ((cells + local) * bound.size).astype(np.float32)
    return (
        cells,
        (points - (cells * bound.size).astype(np.float32)) / np.float32(bound.size),
        points,
    )


def bounds_of(medium):
    """Every bound of up to 64 super-voxels along an edge."""
    cells = [1, *(medium.coarsest * 2**octave for octave in range(medium.octaves))]
    for count in {count for count in cells if count <= 64}:
        yield medium.constant_majorants(count)
        yield medium.linear_majorants(count)


def excess(density, bound):
    """By how much the density is over its bound, at most; negative where it is below."""
    return float(np.max(density - bound))


@each_medium
def test_no_density_exceeds_its_bound(medium):
    """In float32, as a sampler compares them: no tolerance. 3 million points in all."""
    for seed, bound in enumerate(bounds_of(medium)):
        cells, local, points = points_in_cells(bound, 30_000, seed)
        limit = bound_values(bound, cells, local)
        assert limit.min() >= 0
        for found in OPENCL:
            _, density, _ = on_device(found, medium, points)
            assert excess(density, limit) <= 0
        few = slice(0, 3000)
        assert excess(medium.density_at(points[few]), limit[few]) <= 0


@on_each_device
def test_bound_holds_where_rounding_decides_about_void(found):
    """The noise at the highest corner of a cell is the cutoff: a device may find it above."""
    corners = np.stack(np.indices((2, 2, 2)), axis=-1).reshape(-1, 3) + np.array([10, 11, 12])
    above = 0
    for seed in range(40):
        octaves = {"seed": seed, "persistence": 0.4 + seed / 100}
        noise = perlin(64, **octaves).density_at(corners)
        medium = perlin(64, **octaves, cutoff=noise.max())
        _, density, _ = on_device(found, medium, corners)
        above += density.max() > 0
        assert density.max() <= medium.constant_majorants(64).values[10, 11, 12]
    assert above > 5  # or nothing was tested


def test_too_low_a_bound_is_found_out():
    """The check above is worth something: it finds a bound that is lowered by a tenth."""
    medium = MEDIA["weak"]
    for bound in (medium.constant_majorants(64), medium.linear_majorants(64)):
        cells, local, points = points_in_cells(bound, 30_000, 0)
        limit = bound_values(bound, cells, local) * np.float32(0.9)
        assert excess(medium.density_at(points), limit) > 0


@pytest.mark.parametrize("noise", [WEAK, STRONG], ids=["weak", "strong"])
def test_bounds_tighten(noise):
    """From lattice to lattice; the global maximum is from a fine one, and may be under a coarse."""
    medium = perlin(256, **noise, seed=4)
    rng = np.random.default_rng(0)
    mean = medium.density_at(rng.random((100_000, 3)) * 256).mean()
    lattices = (4, 8, 16, 32, 64, 128)
    constant = [medium.constant_majorants(cells).mean for cells in lattices]
    linear = [medium.linear_majorants(cells).mean for cells in lattices]
    assert np.all(np.diff(constant) < 0)
    assert np.all(np.diff(linear) < 0)
    assert np.all(np.array(linear) < constant)
    assert mean < linear[-1] < 1.3 * mean  # the 1 / 256 of the finest octave is added everywhere


@pytest.mark.parametrize("cells", [4, 8, 16, 32])
def test_bounds_of_one_octave_are_its_own_values(cells):
    """Nothing is left out, so that the bounds are the noise but for the margins for rounding."""
    medium = perlin(cells, coarsest=cells, seed=9, time=0.5)
    corners = medium.lattice(0)
    linear, constant = medium.linear_majorants(cells), medium.constant_majorants(cells)
    assert linear.size == constant.size == 1
    np.testing.assert_allclose(linear.values[..., 0], corners[:-1, :-1, :-1], atol=2e-5)
    np.testing.assert_allclose(linear.values.sum(axis=-1), corners[1:, 1:, 1:], atol=2e-5)
    cells = np.array([[1, 2, 3]])
    largest = corners[1:3, 2:4, 3:5].max()
    assert constant.values[tuple(cells.T)] == pytest.approx(largest, abs=2e-5)
    local = np.random.default_rng(0).random((1000, 3)).astype(np.float32)
    cells = np.repeat(cells, len(local), axis=0)
    np.testing.assert_allclose(
        bound_values(linear, cells, local), medium.density_at(cells + local), atol=3e-5
    )


def test_mean_of_a_bound_is_its_mean():
    medium = perlin(256, **STRONG, seed=2)
    for bound in (medium.constant_majorants(16), medium.linear_majorants(16)):
        rng = np.random.default_rng(3)
        cells = rng.integers(0, 16, (200_000, 3))
        values = bound_values(bound, cells, rng.random((200_000, 3)).astype(np.float32))
        error = values.std() / sqrt(len(values))
        assert abs(values.mean() - bound.mean) < 5 * error  # false alarm: 6e-7 each


def test_void_has_a_bound_of_zero():
    medium = perlin(4096, **STRONG)
    constant, linear = medium.constant_majorants(64), medium.linear_majorants(64)
    void = constant.values == 0
    assert 0.2 < void.mean() < 0.8
    assert not linear.values[void].any()


# The noise


def chi_square(observed, expected):
    """In standard deviations from its mean, as Wilson and Hilferty's normal approximation."""
    freedom = observed.size - 1
    ratio = np.sum((observed - expected) ** 2 / expected) / freedom
    return (np.cbrt(ratio) - (1 - 2 / (9 * freedom))) / sqrt(2 / (9 * freedom))


def dependence(first, second, bins=24):
    """`chi_square` of the joint histogram of what should be independent uniform values."""
    observed, _, _ = np.histogram2d(first.ravel(), second.ravel(), bins, [(0, 1), (0, 1)])
    return chi_square(observed, first.size / bins**2)


def test_lattice_values_are_uniform_and_independent():
    """Of their neighbours, of far ones, and between octaves, seeds and frames.

    The limit of 5.5 standard deviations raises a false alarm in 4e-8 of cases, and there are 24 of
    them: 1e-6 in all. Pairs do not overlap.
    """
    values = perlin(64, coarsest=64).lattice(0)[:64, :64, :64]
    counts, _ = np.histogram(values, 1024, (0, 1))
    assert abs(chi_square(counts, values.size / 1024)) < 5.5
    assert abs(values.mean() - 0.5) < 5.5 / sqrt(12 * values.size)
    for bit in range(8):  # the coarsest bits of the 24, each on its own
        share = ((values * 2 ** (bit + 1)).astype(int) & 1).mean()
        assert abs(share - 0.5) < 5.5 * 0.5 / sqrt(values.size)
    for apart in (1, 2, 4, 32):
        for axis in range(3):
            halves = np.moveaxis(values, axis, 0).reshape(-1, 2, apart, 64, 64)
            assert abs(dependence(halves[:, 0], halves[:, 1])) < 5.5
    cubes = values.reshape(32, 2, 32, 2, 32, 2)
    assert abs(dependence(cubes[:, 0, :, 0, :, 0], cubes[:, 1, :, 1, :, 1])) < 5.5
    assert abs(dependence(cubes[:, 0, :, 1, :, 0], cubes[:, 1, :, 0, :, 0])) < 5.5
    others = (
        perlin(64, coarsest=64, seed=1),
        perlin(64, coarsest=64, time=1),
        perlin(128, coarsest=32),
    )
    for other in others:
        octave = other.octaves // 2  # that of 64 cells
        assert abs(dependence(values, other.lattice(octave)[:64, :64, :64])) < 5.5


def test_noise_is_the_same_along_all_axes():
    """The mean squared difference over a tenth of a finest cell, from 5 seeds' 60 000 points.

    The means of the axes differ by less than 5 standard errors: false alarm 2e-6 in all three.
    """
    squares = []
    for seed in range(5):
        medium = perlin(256, seed=seed, coarsest=64)
        points = np.random.default_rng(seed).random((60_000, 3)) * 255
        here = medium.density_at(points)
        squares.append([(medium.density_at(points + 0.1 * e) - here) ** 2 for e in np.eye(3)])
    squares = np.concatenate(squares, axis=1)
    difference = squares - np.roll(squares, 1, axis=0)
    error = difference.std(axis=1) / sqrt(difference.shape[1])
    assert np.all(np.abs(difference.mean(axis=1)) < 5 * error)


def test_mean_of_the_noise_is_a_half():
    """Over 200 seeds, as few lattice values make the mean of one vary; false alarm: 6e-7."""
    points = np.random.default_rng(0).random((100, 3)) * 8
    means = [perlin(8, seed=seed).density_at(points).mean() for seed in range(200)]
    assert abs(np.mean(means) - 0.5) < 5 * np.std(means) / sqrt(len(means))


def test_noise_is_its_lattice_values_at_lattice_points():
    medium = perlin(32, time=0.25, seed=3)
    points = np.stack(np.indices((33, 33, 33)), axis=-1)
    noise = medium.density_at(points)
    coarse = slice(None, None, 8)  # where the coarsest lattice has its points, all have theirs
    expected = sum(
        medium.amplitudes[octave] * medium.lattice(octave)[(slice(None, None, 2**octave),) * 3]
        for octave in range(medium.octaves)
    )
    np.testing.assert_allclose(noise[coarse, coarse, coarse], expected, atol=1e-12)


def test_noise_is_trilinear_in_its_finest_cells():
    medium = perlin(64, seed=3)
    low = np.array([17.0, 40.0, 3.0])
    local = np.random.default_rng(0).random((100, 3))
    corners = np.stack(np.indices((2, 2, 2)), axis=-1).reshape(-1, 3)
    shares = np.prod(np.where(corners, local[:, None], 1 - local[:, None]), axis=-1)
    expected = shares @ medium.density_at(low + corners)
    np.testing.assert_allclose(medium.density_at(low + local), expected, atol=1e-12)


def test_same_seed_same_noise():
    points = random_points(MEDIA["moving"], 1000)
    again = perlin(1024, cutoff=0.3, power=1.7, time=3.37, seed=7)
    other = perlin(1024, cutoff=0.3, power=1.7, time=3.37, seed=8)
    density = MEDIA["moving"].density_at(points)
    np.testing.assert_array_equal(again.density_at(points), density)
    assert np.mean(other.density_at(points) == density) < 0.01


def test_time_runs_from_frame_to_frame():
    points = random_points(perlin(), 1000)
    frames = [perlin(time=time).density_at(points) for time in (0.0, 0.25, 1.0)]
    between = perlin(time=1 - 1e-9).density_at(points)
    np.testing.assert_allclose(frames[1], 0.75 * frames[0] + 0.25 * frames[2], atol=1e-12)
    np.testing.assert_allclose(between, frames[2], atol=1e-8)
    assert np.abs(frames[2] - frames[0]).max() > 0.1
    assert np.array_equal(perlin(time=1).lattice(2), perlin(time=1.0).lattice(2))


def test_higher_resolution_only_adds_detail():
    """Octaves do not depend on the resolution."""
    coarse, fine = perlin(64), perlin(4096)
    for octave in range(3):
        np.testing.assert_array_equal(coarse.lattice(octave), fine.lattice(octave))


# The medium


def test_it_is_a_medium():
    medium = PerlinMedium(512, 4.0, (3.0, 1.0), 1.0, 0.3, origin=(1, 2, 3))
    assert medium.bands == 2
    assert medium.shape == (512, 512, 512)
    assert medium.voxel_size == 4 / 512
    assert medium.domain.upper == (5, 6, 7)
    assert medium.sigma_t == pytest.approx([4.0, 2.0])
    assert medium.albedo == pytest.approx([3 / 4, 1 / 2])


def test_voxels_are_an_ordinary_medium():
    perlin_medium = PerlinMedium(64, 4.0, (3.0, 1.0), 1.0, 0.3, origin=(1, 2, 3), **STRONG)
    medium = perlin_medium.voxels(10)
    assert isinstance(medium, Medium)
    assert medium.shape == (10, 10, 10)
    assert medium.domain.upper == pytest.approx(perlin_medium.domain.upper)
    np.testing.assert_array_equal(medium.sigma_t, perlin_medium.sigma_t)
    points = (medium.domain.centers() - perlin_medium.origin) / perlin_medium.voxel_size
    np.testing.assert_allclose(medium.density, perlin_medium.density_at(points), rtol=1e-6)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"resolution": 100}, "resolution must be the coarsest lattice, 4, times a power of two"),
        ({"resolution": 2 * FINEST}, "resolution must be a whole number from 4 to 32768"),
        ({"resolution": 2}, "resolution must be a whole number from 4"),
        ({"resolution": 64.0}, "resolution must be a whole number"),
        ({"coarsest": 0}, "coarsest lattice must be a whole number from 1"),
        ({"seed": -1}, "seed must be a whole number from 0 to 4294967295"),
        ({"cutoff": 1}, "cutoff must be between 0 and 0.999; it is 1"),
        ({"cutoff": np.nan}, "cutoff must be between"),
        ({"power": 0.5}, "power must be between 1 and 64; it is 0.5"),
        ({"persistence": 1.5}, "persistence must be between 0 and 1"),
        ({"time": np.inf}, "time must be between"),
        ({"size": 0}, "size must be positive"),
        ({"size": np.nan}, "size must be positive"),
        ({"origin": (0, np.nan, 0)}, "origin must be three finite coordinates"),
        ({"sigma_s": -1}, "sigma_s must be between"),
        ({"g": 1}, "g must be between -1 and 1"),
    ],
)
def test_bad_noise_is_refused(change, words):
    arguments = {"resolution": 64, "size": 1, "sigma_s": 1, "sigma_a": 0, **change}
    with pytest.raises(MediumError, match=words):
        PerlinMedium(**arguments)


@pytest.mark.parametrize("cells", [0, 2, 12, 512, 16.0])
def test_bounds_on_no_lattice_are_refused(cells):
    with pytest.raises(MediumError, match="number of super-voxels along an edge must be"):
        perlin(256).linear_majorants(cells)
