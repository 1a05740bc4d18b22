# SPDX-License-Identifier: GPL-3.0-or-later
"""Fractal noise: its statistics, the medium, and the same noise on every OpenCL device."""

from math import sqrt

import numpy as np
import pytest

from lb_lighting.errors import MediumError
from lb_lighting.transport import Medium
from lb_lighting.transport.photons.perlin import FINEST, STRONG, PerlinMedium
from tests.transport.photons.noise import MEDIA, on_device, on_each_device, perlin, random_points

# Drivers report how well they optimized.
pytestmark = pytest.mark.filterwarnings("ignore:Non-empty compiler output")


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
