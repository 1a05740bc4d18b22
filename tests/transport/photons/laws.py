# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of free paths, exp(-optical depth), in float64, with media and rays to test it on."""

from copy import copy
from dataclasses import replace
from functools import cache
from itertools import product
from math import sqrt

import numpy as np
import pytest

from lb_lighting.transport import Medium, device
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.photons.free_path import SAMPLERS, FreePathSampler
from lb_lighting.transport.photons.perlin import PerlinMedium
from tests.statistics import normal, uniform

# The probability that a statistical test fails by chance with other seeds.
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


def same(first, second, tolerance=1e-4):
    """The share of distances that differ by less than `tolerance` m, or are both infinite."""
    with np.errstate(invalid="ignore"):
        return np.mean((first == second) | (np.abs(first - second) < tolerance))
