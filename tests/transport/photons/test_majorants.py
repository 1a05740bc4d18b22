# SPDX-License-Identifier: GPL-3.0-or-later
"""Upper bounds: above the density at every point, as tight as a trilinear function can be."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from lb_lighting.errors import SettingsError
from lb_lighting.transport import device
from lb_lighting.transport.photons.linear_majorants import linear_majorants
from lb_lighting.transport.photons.majorants import (
    Majorants,
    choose_size,
    constant_majorants,
    fine_cells,
    sizes,
)

DEVICES = device.devices()
SHAPE = (37, 22, 41)
SIZES = (1, 2, 5, 16, 64)
POINTS = 50_000  # for each of 200 bounds: 10 million in all
INTERPOLATIONS = ("constant", "linear")


def names(found):
    return found.platform.split(",")[0]


@cache
def media():
    """{name: density}: smooth, with voids, wild, the same everywhere, and one voxel alone."""
    rng = np.random.default_rng(0)
    x, y, z = (np.arange(n) + 0.5 for n in SHAPE)
    blobs = np.zeros(SHAPE)
    for _ in range(12):
        center, radius = rng.uniform(0, SHAPE), rng.uniform(4, 12)
        away = np.add.outer(
            np.add.outer((x - center[0]) ** 2, (y - center[1]) ** 2), (z - center[2]) ** 2
        )
        blobs += np.exp(-away / radius**2)
    coarse = rng.random([-(-n // 6) for n in SHAPE]) < 0.4
    void = np.kron(coarse, np.ones((6, 6, 6)))[tuple(map(slice, SHAPE))] > 0
    spike = np.zeros(SHAPE)
    spike[20, 7, 31] = 3.7
    wild = 10 ** rng.uniform(-6, 6, SHAPE)
    found = {
        "blobs": blobs,
        "voids": np.where(void, 0, blobs * rng.uniform(0.5, 1, SHAPE)),
        "wild": wild,
        "constant": np.full(SHAPE, 0.3),
        "spike": spike,
    }
    return {name: density.astype(np.float32) for name, density in found.items()}


def points(grid, size, seed=0):
    """Super-voxels (POINTS, 3), positions in them (POINTS, 3), and the density there (POINTS,).

    Anywhere, and an eighth around the largest value; half of them on faces of fine cells, edges
    or corners, where the density of either side has to be below that side's bound.
    """
    rng = np.random.default_rng(seed)
    shape = np.array(grid.shape)
    position = rng.random((POINTS, 3)) * shape
    peak = np.unravel_index(grid.values.argmax(), grid.values.shape)
    position[: POINTS // 8] = peak + rng.uniform(-1, 1, (POINTS // 8, 3))
    snapped = rng.random((POINTS, 3)) < rng.choice([0, 0.5, 1], (POINTS, 1), p=[0.5, 0.25, 0.25])
    position = np.clip(np.where(snapped, np.round(position), position), 0, shape)
    position = position.astype(np.float32)
    below = snapped & (rng.random((POINTS, 3)) < 0.5)
    fine = np.clip(np.floor(position).astype(int) - below, 0, shape - 1)
    return fine // size, position, density_at(grid, position, fine)


def density_at(grid, position, fine):
    """float32, as a kernel would compute it."""
    if grid.values.shape == grid.shape:
        return grid.values[tuple(fine.T)]
    fraction = (position - fine.astype(np.float32)).T
    values = {corner: grid.values[tuple((fine + corner).T)] for corner in product((0, 1), repeat=3)}
    for axis in (2, 1, 0):  # between the two that differ in the last index left
        values = {
            rest: values[(*rest, 0)] + fraction[axis] * (values[(*rest, 1)] - values[(*rest, 0)])
            for rest in product((0, 1), repeat=axis)
        }
    return values[()]


def bound_at(bound, cell, position):
    """float32, as a kernel would compute it."""
    values = bound.values[tuple(cell.T)]
    if values.ndim == 1:
        return values
    begin = (cell * bound.size).astype(np.float32)
    x, y, z = ((position - begin) * np.float32(1 / bound.size)).T
    terms = (np.float32(1), x, y, z, x * y, y * z, z * x, x * y * z)
    total = values[:, 0]
    for m in range(1, 8):
        total = total + values[:, m] * terms[m]
    assert total.dtype == np.float32
    return total


def below(bound, sample):
    """How many of the points have a bound below their density."""
    cell, position, density = sample
    return int((bound_at(bound, cell, position) < density).sum())


def scaled(bound, factor):
    return Majorants(bound.size, bound.values * np.float32(factor), bound.mean * factor)


def volume(size, grid):
    """(mx, my, mz): the fine cells that each super-voxel has."""
    lengths = [np.diff(np.append(np.arange(0, n, size), n)) for n in grid.shape]
    return np.einsum("i,j,k->ijk", *lengths)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("name", media())
def test_no_density_exceeds_its_bound(name, interpolation):
    density = media()[name]
    grid = fine_cells(density, interpolation)
    for size in SIZES:
        sample = points(grid, size)
        constant = constant_majorants(density, size, interpolation)
        linear = [linear_majorants(density, size, interpolation, found) for found in DEVICES]
        for bound in (constant, *linear):
            assert bound.values.dtype == np.float32
            assert below(bound, sample) == 0
            if size <= 32:  # it touches the density: the check can fail
                assert below(scaled(bound, 0.9), sample) > 0
            assert bound.mean <= constant.mean * (1 + 1e-6)  # a rounding of the sum


@pytest.mark.parametrize("found", DEVICES, ids=names)
def test_densities_at_the_limits_of_float32(found):
    """Denormal ones, too, which OpenCL devices take for 0."""
    for largest in (3e38, 1e-37, 1e-42):
        density = (media()["blobs"] / media()["blobs"].max() * largest).astype(np.float32)
        bound = linear_majorants(density, 5, device=found)
        assert np.isfinite(bound.values).all()
        assert below(bound, points(fine_cells(density), 5)) == 0


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("found", DEVICES, ids=names)
def test_empty_super_voxels_are_exactly_empty(found, interpolation):
    for name in ("voids", "spike"):
        density = media()[name]
        constant = constant_majorants(density, 5, interpolation)
        linear = linear_majorants(density, 5, interpolation, found)
        assert (constant.values == 0).any()
        assert not linear.values[constant.values == 0].any()
        assert linear.values[constant.values > 0].any(axis=-1).all()


@pytest.mark.parametrize("found", DEVICES, ids=names)
def test_size_one_is_the_density(found):
    for density in media().values():
        mean = density.mean(dtype=float)
        assert np.array_equal(constant_majorants(density, 1).values, density)
        voxels = linear_majorants(density, 1, device=found)
        assert np.array_equal(voxels.values[..., 0], density)
        assert not voxels.values[..., 1:].any()
        assert voxels.mean == pytest.approx(mean, rel=1e-6)

        cell, position, true = points(fine_cells(density, "linear"), 1)
        linear = linear_majorants(density, 1, "linear", found)
        excess = bound_at(linear, cell, position) - true
        largest = constant_majorants(density, 1, "linear").values[tuple(cell.T)]
        # The margin: 32 roundings of 14 largest values, the most that 8 coefficients add up to.
        assert np.all(excess <= 32 * 2.0**-24 * 15 * largest)
        # A density that repeats its edges has the mean of its voxels.
        assert linear.mean == pytest.approx(mean, rel=2e-4)


@pytest.mark.parametrize("found", DEVICES, ids=names)
@pytest.mark.parametrize("size", [5, 8])
def test_a_trilinear_density_is_its_own_bound(found, size):
    """It is bent by the flat outer half voxels, but not along an axis where it is flat anyway:
    there the super-voxels that stick out are exact, too."""
    for flat in range(3):
        u, v = (i for axis, i in enumerate(np.ogrid[tuple(map(slice, SHAPE))]) if axis != flat)
        density = np.broadcast_to(40.0 - u / 2 + v + u * v / 10, SHAPE).astype(np.float32)
        grid = fine_cells(density, "linear")
        cell, position, true = points(grid, size)
        bound = linear_majorants(density, size, "linear", found)
        whole = (cell > 0) & ((cell + 1) * size < grid.shape)
        whole[:, flat] = True
        whole = whole.all(axis=1)
        excess = bound_at(bound, cell, position)[whole] / true[whole] - 1
        assert (cell[whole, flat] == cell[:, flat].max()).sum() > 50
        assert excess.max() < 2e-3


@pytest.mark.parametrize("found", DEVICES, ids=names)
def test_a_spike_has_the_least_mean_that_is_possible(found):
    """By duality: (1, ..., 1) / 8 = y * weights + multipliers of the empty corners, all of them
    at least 0, for y up to 1 / (8 * largest weight), and the least mean is y * height."""
    size, height = 4, 2.5
    for node in product(range(size + 1), repeat=3):
        density = np.zeros((12, 12, 12), np.float32)  # node i of the middle one is voxel 3 + i
        density[tuple(3 + i for i in node)] = height
        bound = linear_majorants(density, size, "linear", found)
        weight = np.prod([max(i, size - i) / size for i in node])
        coefficients = bound.values[1, 1, 1].astype(float)
        mean = coefficients @ [1, 0.5, 0.5, 0.5, 0.25, 0.25, 0.25, 0.125]
        assert mean == pytest.approx(height / (8 * weight), rel=1e-3)


@pytest.mark.parametrize("found", DEVICES, ids=names)
def test_linear_bounds_of_smooth_media_are_tighter(found):
    """Measured: of what the constant bound has above the density they keep .12, .21 and .41."""
    density = media()["blobs"]
    mean = density.mean(dtype=float)
    for size, kept in ((4, 0.15), (8, 0.25), (16, 0.45)):
        constant = constant_majorants(density, size, "linear").mean - mean
        linear = linear_majorants(density, size, "linear", found).mean - mean
        assert 0 < linear <= kept * constant


def means(bound, grid):
    """The mean of a linear bound in each super-voxel, over what there is of it."""
    lengths = [
        np.minimum(1, n / bound.size - np.arange(m))
        for n, m in zip(grid.shape, bound.values.shape, strict=False)
    ]
    x, y, z = np.meshgrid(*(length / 2 for length in lengths), indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, x * y * z], axis=-1)
    return (bound.values * terms).sum(axis=-1)


@pytest.mark.parametrize("found", DEVICES[:-1], ids=names)
@pytest.mark.parametrize("name", media())
def test_kernel_follows_its_twin(found, name):
    """Each stops within 0.1 % of the same optimum, though perhaps at another function."""
    density = media()[name]
    for size, interpolation in product((2, 5, 16), INTERPOLATIONS):
        grid = fine_cells(density, interpolation)
        kernel, twin = (
            means(linear_majorants(density, size, interpolation, each), grid)
            for each in (found, DEVICES[-1])
        )
        np.testing.assert_allclose(kernel, twin, rtol=1.1e-3)


def test_a_problem_in_several_slabs_is_the_same(monkeypatch):
    density = media()["blobs"]
    for found in DEVICES:
        whole = linear_majorants(density, 5, "linear", found).values
        with monkeypatch.context() as patch:
            patch.setattr("lb_lighting.transport.photons.majorants._SCRATCH", 1)
            patch.setattr("lb_lighting.transport.photons.majorants_numpy._BATCH", 1)
            pieces = linear_majorants(density, 5, "linear", found).values
        np.testing.assert_allclose(pieces, whole, rtol=1e-5, atol=1e-5 * density.max())


def test_mean_counts_what_lies_in_the_domain():
    density = media()["wild"]
    bound = constant_majorants(density, 5)
    weights = volume(5, fine_cells(density))
    assert bound.mean == pytest.approx(np.average(bound.values, weights=weights), rel=1e-6)
    for size, interpolation in product((3, 64), INTERPOLATIONS):
        assert constant_majorants(media()["constant"], size, interpolation).mean == pytest.approx(
            0.3, rel=4e-6
        )


def test_sizes_reach_the_whole_domain():
    assert sizes((1, 1, 1)) == [1]
    assert sizes((5, 8, 3)) == [1, 2, 4, 8]
    assert sizes((9, 1, 1)) == [1, 2, 4, 8, 16]


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("kind", ["constant", "linear"])
def test_chosen_size_follows_the_medium(kind, interpolation):
    rng = np.random.default_rng(1)
    shape = (32, 20, 27)
    wild = np.where(rng.random(shape) < 0.5, 1e-6, 1e6)
    even = rng.uniform(0.999, 1, shape)
    assert choose_size(wild, 1.0, kind, interpolation) == 1
    whole = 32 if interpolation == "constant" else 64
    assert choose_size(even, 1.0, kind, interpolation) == whole
    blobs = media()["blobs"]
    chosen = [choose_size(blobs, depth, kind, interpolation) for depth in (1e-4, 1e-2, 1, 100)]
    assert chosen == sorted(chosen, reverse=True)
    assert chosen[0] >= 32 > 4 >= chosen[-1]
    assert choose_size(np.zeros(shape), 1.0, kind, interpolation) >= 32


def test_what_has_no_majorants_is_refused():
    density = np.ones((3, 3, 3), np.float32)
    for make in (constant_majorants, linear_majorants):
        with pytest.raises(SettingsError, match="1 fine cell or more an edge, not 0"):
            make(density, 0)
        with pytest.raises(SettingsError, match="no interpolation called 'cubic'"):
            make(density, 1, "cubic")
    with pytest.raises(SettingsError, match="no kind of majorant called 'cubic'"):
        choose_size(density, 1.0, "cubic")
