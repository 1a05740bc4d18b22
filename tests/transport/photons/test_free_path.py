# SPDX-License-Identifier: GPL-3.0-or-later
"""Free paths along any ray: where they begin and end, what they depend on, and bad input."""

import warnings
from dataclasses import replace
from itertools import product
from math import sqrt

import numpy as np
import pytest

from lb_lighting.errors import DeviceError, MediumError, SettingsError
from lb_lighting.transport import Medium, device
from lb_lighting.transport.photons import free_path
from lb_lighting.transport.photons.free_path import (
    SAMPLERS,
    FreePathSampler,
    path_grid,
    sample_free_paths,
)
from lb_lighting.transport.photons.perlin import WEAK
from tests.transport.photons.laws import (
    FOUND,
    ORIGIN,
    SHAPE,
    VIRTUAL,
    VOXEL,
    cloud,
    density_at,
    each_interpolation,
    each_sampler,
    noise,
    prepare,
    random_rays,
    same,
    voxels,
)


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
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        distances = prepared.sample(origins, forward)
    lost = np.isnan(distances)
    if lost.any():
        assert [str(w.message).split(" rays")[0] for w in caught] == [f"{lost.sum()} of {count}"]
        assert caught[0].category is RuntimeWarning
    else:
        assert not caught
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
