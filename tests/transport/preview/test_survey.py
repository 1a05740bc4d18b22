# SPDX-License-Identifier: GPL-3.0-or-later
"""What free paths tell of a medium, against what is known of it."""

import numpy as np
import pytest

from lb_lighting.errors import SettingsError
from lb_lighting.transport import FreePathSampler, Medium, PerlinMedium, device
from lb_lighting.transport.photons.free_path import SAMPLERS
from lb_lighting.transport.preview.survey import advice, histogram_picture, statistics
from tests.statistics import chi_square, normal

on_each_device = pytest.mark.parametrize(
    "found", device.devices(), ids=lambda found: found.platform.split(",")[0]
)

# Every statistical test here has this probability to fail by chance, had it another seed.
FALSE_ALARM = 1e-4
RAYS = 2**14


def even(depth, albedo=1.0, g=0.0, edge=16, **options):
    """A cube of 2 m, so deep from face to face."""
    sigma = depth / 2
    density = np.ones((edge,) * 3)
    return Medium(density, 2 / edge, albedo * sigma, (1 - albedo) * sigma, g, **options)


def patchy():
    rng = np.random.default_rng(1)
    density = np.where(rng.random((8, 5, 6)) < 0.4, 0, rng.random((8, 5, 6)))
    return Medium(density, 0.25, (2.0, 5.0), (1.0, 3.0), origin=(1, 2, 3))


@on_each_device
def test_an_even_medium_has_the_paths_that_are_known(found):
    medium = even(3.0, origin=(5, -7, 1))
    figures = statistics(medium, found, seed=3, rays=RAYS, samplers=())
    assert figures.counts.sum() == round(RAYS * (1 - figures.escaped))
    assert figures.even.sum() == pytest.approx(figures.counts.sum(), rel=0.02)
    # Exponential: of n collisions the mean is good to 1 / sqrt(n).
    error = figures.in_matter / np.sqrt(figures.counts.sum())
    assert figures.in_matter == pytest.approx(2 / 3)
    assert normal((figures.mean_free_path - figures.in_matter) / error) > FALSE_ALARM
    many = figures.even > 20
    assert many.sum() > 20
    assert chi_square(figures.counts[many], figures.even[many], 0) > FALSE_ALARM
    assert figures.edges[0] == 0
    assert 2 < figures.edges[-1] < 2 * np.sqrt(3)


def test_uneven_media_are_recognised():
    density = np.ones((16, 16, 16))
    density[4:12, 4:12, 4:12] = 0  # the first flights are short, and some are very long
    hollow = Medium(density, 1 / 8, 4.0, 0.0)
    figures = statistics(hollow, seed=3, rays=RAYS, samplers=())
    many = figures.even > 20
    assert chi_square(figures.counts[many], figures.even[many], 0) < FALSE_ALARM


def test_rays_start_where_matter_begins():
    """So that voids around it change nothing."""
    density = np.pad(np.ones((6, 4, 5)), 7)
    padded = statistics(Medium(density, 0.2, 3.0, 0.0, origin=(-1.4,) * 3), seed=4, samplers=())
    bare = statistics(Medium(np.ones((6, 4, 5)), 0.2, 3.0, 0.0), seed=4, samplers=())
    error = bare.mean_free_path / np.sqrt(bare.counts.sum() / 2)
    assert normal((padded.mean_free_path - bare.mean_free_path) / error) > FALSE_ALARM
    assert bare.void == 0
    assert padded.void == pytest.approx(1 - 120 / density.size)
    assert padded.depth_max == pytest.approx(bare.depth_max)


def test_depths_are_sums_over_voxels():
    medium = patchy()
    figures = statistics(medium, rays=64, samplers=())
    assert figures.band == 1  # the densest
    density = medium.density.astype(float)
    for axis in range(3):
        columns = 8 * 0.25 * density.sum(axis=axis)
        assert figures.depth_mean[axis] == pytest.approx(columns.mean(), rel=1e-6)
        assert figures.depth_max[axis] == pytest.approx(columns.max(), rel=1e-6)
    assert figures.voxel_depth_max == pytest.approx(8 * 0.25 * density.max())
    assert figures.void == np.mean(density == 0)
    assert figures.albedo == 5 / 8
    assert figures.voxels == 8


@on_each_device
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_particles_are_counted(found, sampler):
    """Rays through a void, then through matter. Under the one bound of Woodcock's sampler there
    are as many virtual particles in the void as it would be deep, and none in matter."""
    density = np.ones((8, 2, 2))
    density[:4] = 0
    depth = 1.2  # of each half
    medium = Medium(density, 0.5, depth / 2, 0.0)
    count = 20_000
    origins = np.column_stack([np.zeros(count), *np.random.default_rng(1).random((2, count))])
    prepared = FreePathSampler(medium, sampler, found, supervoxel=4)
    lengths, particles = prepared.count(origins, np.tile((1.0, 0, 0), (count, 1)), seed=2)
    real = np.count_nonzero(np.isfinite(lengths))
    met = -np.expm1(-depth)
    assert normal((real - count * met) / np.sqrt(count * met * (1 - met))) > FALSE_ALARM
    virtual = particles - real
    if sampler == "woodcock":
        assert normal((virtual - count * depth) / np.sqrt(count * depth)) > FALSE_ALARM
    else:
        assert virtual == 0


def test_acceptance_is_the_mean_over_the_bound():
    """In thin media, where particles are met everywhere alike; half of this one is void."""
    density = np.random.default_rng(3).permutation(np.repeat((0.0, 1.0), 16**3 // 2))
    medium = Medium(density.reshape(16, 16, 16), 1 / 16, 0.06, 0.0)
    samplers = statistics(medium, seed=2, rays=2**18).samplers
    assert list(samplers) == list(SAMPLERS)
    assert samplers["ray_march"].acceptance == 1
    # Some 2^18 * .06 * 2/3 particles if all rays were taken; the slowest machine takes fewer.
    assert samplers["woodcock"].acceptance == pytest.approx(0.5, abs=0.1)
    for sampling in samplers.values():
        assert 100 < sampling.rays_a_second < 1e9
        assert 0 <= sampling.preparation < 10


def test_noise_has_statistics():
    medium = PerlinMedium(256, 2.0, 9.0, 1.0, cutoff=0.4, power=2.0, seed=5)
    figures = statistics(medium, rays=RAYS, samplers=("woodcock",))
    voxels = medium.voxels(64).density.astype(float)
    assert figures.depth_mean[0] == pytest.approx(10 * 2 * voxels.mean())
    acceptance = figures.samplers["woodcock"].acceptance
    largest = float(medium.constant_majorants(1).values.max())
    assert acceptance == pytest.approx(voxels.mean() / largest, rel=0.3)
    assert "bake it" in advice(figures, 64)


def figures_of(medium):
    return statistics(medium, rays=64, samplers=())


@pytest.mark.parametrize(
    ("medium", "said"),
    [
        (even(0.0), "nothing that light could meet"),
        (Medium(np.zeros((4, 4, 4)), 1.0, 1.0, 0.0), "nothing that light could meet"),
        (even(0.04), "Optically thin, optical depth 0.04: single scattering is enough"),
        (even(0.4, albedo=0.1), "Optically thin"),
        (even(50.0, albedo=0.01), "Dark, albedo 0.01: single scattering is enough"),
        (even(2.0), "Moderate, optical depth 2: bake it, 64 voxels resolve"),
        (even(30.0), "Dense, optical depth 30: bake it, 64 voxels resolve"),
        (even(48.0), "Dense, optical depth 48: 96 voxels resolve it, 64 give its smooth"),
        (even(48.0, g=0.85), "64 voxels resolve its light"),
        (even(190.0, edge=8), "Dense, optical depth 190: 384 voxels resolve it, 64 give"),
        (even(191.0, edge=4), "384 voxels resolve it"),
        (even(300.0), "64 voxels are too thick for its light, use 104"),
        (even(100.0, albedo=0.5), "64 voxels are too thick for its light, use 72"),
        (even(5000.0), "As good as solid"),
    ],
)
def test_advice(medium, said):
    sentence = advice(figures_of(medium), 64)
    assert said in sentence
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert len(sentence) < 110


def test_advice_depends_on_the_resolution_of_the_bake():
    figures = figures_of(even(48.0))
    assert "96 voxels resolve its light" in advice(figures, 96)
    assert "use 48" not in advice(figures, 64)
    assert "32 give its smooth light" in advice(figures, 32)


def test_bars_are_as_high_as_counts():
    figures = statistics(even(3.0), seed=1, rays=RAYS, samplers=())
    bins, each, height = len(figures.counts), 5, 200
    picture = histogram_picture(figures, bins * each, height)
    assert picture.shape == (height, bins * each, 4)
    assert picture.dtype == np.float32
    assert picture.min() >= 0
    assert picture.max() <= 1
    blue = (picture[..., 2] > 0.7) & (picture[..., 0] < 0.5) & (picture[..., 3] > 0.5)
    highest = np.where(blue.any(axis=0), height - np.argmax(blue[::-1], axis=0), 0)
    top = highest.reshape(bins, each)[:, 1:-1].max(axis=1)
    scale = (height - 2) / max(figures.counts.max(), figures.even.max())
    high = figures.counts * scale > 15  # over the line of what is to be expected, or about there
    assert high.sum() > 15
    assert np.abs(top - figures.counts * scale)[high].max() < 8
    assert picture[-1, -1, 3] == 0  # the background shows
    line = (picture[..., 0] > 0.9) & (picture[..., 3] > 0.5)
    assert line.any(axis=0).mean() > 0.95
    middle = np.array([np.flatnonzero(column).mean() for column in line[:, 2::each].T])
    assert np.abs(middle + 0.5 - figures.even * scale)[1:-1].max() < 4


def test_what_is_no_number_of_rays_is_refused():
    with pytest.raises(SettingsError, match="number of rays"):
        statistics(even(1.0), rays=0)
