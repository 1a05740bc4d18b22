# SPDX-License-Identifier: GPL-3.0-or-later
"""The majorants of fractal noise: none is below the density, and finer ones are tighter."""

from math import sqrt

import numpy as np
import pytest

from lb_lighting.errors import MediumError
from lb_lighting.transport.photons.perlin import STRONG, WEAK
from tests.transport.photons.noise import MEDIA, OPENCL, on_device, on_each_device, perlin

LOCAL_TERMS = ((), (0,), (1,), (2,), (0, 1), (1, 2), (2, 0), (0, 1, 2))  # 1 x y z xy yz zx xyz
each_medium = pytest.mark.parametrize("medium", MEDIA.values(), ids=MEDIA.keys())


# Drivers report how well they optimized.
pytestmark = pytest.mark.filterwarnings("ignore:Non-empty compiler output")


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


@pytest.mark.parametrize("cells", [0, 2, 12, 512, 16.0])
def test_bounds_on_no_lattice_are_refused(cells):
    with pytest.raises(MediumError, match="number of super-voxels along an edge must be"):
        perlin(256).linear_majorants(cells)
