# SPDX-License-Identifier: GPL-3.0-or-later
"""Traced photons against numbers that are known without tracing any.

Each test would fail by chance for at most one seed in 10 000, see tests/tracing.py.
"""

from math import pi

import numpy as np
import pytest

from lb_lighting.transport import Medium, PointLight, Sky
from lb_lighting.transport.photons.free_path import SAMPLERS
from lb_lighting.transport.photons.trace import trace
from tests.tracing import OPENCL, Beam, assert_mean, name

# Slabs with matched boundaries, by adding-doubling, all digits stable: g, optical depth and albedo;
# what is reflected and transmitted, with the direct beam, of a normal beam and of diffuse light.
SLABS = [
    (0, 1, 0.9, 0.267410, 0.591625, 0.352712, 0.474746),
    (0, 1, 1, 0.341329, 0.658671, 0.446594, 0.553406),
    (0, 5, 0.99, 0.680078, 0.220628, 0.737507, 0.173152),
    (0, 10, 1, 0.853005, 0.146995, 0.883255, 0.116745),
    (0, 20, 1, 0.921627, 0.078373, 0.937755, 0.062245),
    (0.75, 2, 0.9, 0.097395, 0.660958, 0.191090, 0.501816),
    (0.75, 10, 0.99, 0.472571, 0.340012, 0.567883, 0.262702),
    (0.75, 10, 1, 0.568975, 0.431025, 0.660444, 0.339556),
    (0.85, 2, 1, 0.091018, 0.908982, 0.219396, 0.780604),
    (0.85, 10, 1, 0.422275, 0.577725, 0.544575, 0.455425),
    (0.85, 20, 0.99, 0.440926, 0.230122, 0.535070, 0.175789),
    (0.85, 20, 1, 0.617167, 0.382833, 0.698885, 0.301115),
]
# What a half space of isotropic scatterers reflects of a normal beam: 1 - sqrt(1 - a) H(1), with
# Chandrasekhar's H, by albedo a.
HALF_SPACES = {0.5: 0.115226, 0.8: 0.285255, 0.9: 0.414947, 0.95: 0.535541, 0.99: 0.752721}
HALF_SPACES[0.999] = 0.912845

PHOTONS = 65_536  # of a slab: no standard error is over .002
WIDTH = 63  # m, of slabs 1 m thick
MIDDLE = (WIDTH / 2, WIDTH / 2, 0)


def shares(tau, albedo, g, diffuse=False, **options):
    """(reflected, transmitted) shares of a beam on the middle of a slab."""
    medium = Medium(np.ones((WIDTH, WIDTH, 1)), 1.0, tau * albedo, tau * (1 - albedo), g)
    report = trace(medium, [Beam(MIDDLE, (0, 0, 1), diffuse)], PHOTONS, **options).report
    assert report.photons == PHOTONS
    assert report.lost == 0
    left = report.energy["left"][0]
    assert np.all(left[:4] == 0)  # the sides are over 30 free paths away
    assert report.energy["entered"][0] == pytest.approx(1, rel=1e-5)
    return left[4:]


def assert_shares(found, expected):
    """Each share is within 3 standard errors of what is expected; 1 seed in 370 would fail it."""
    expected = np.array(expected)
    # The spread of weights between 0 and 1 is at most that of 0 and 1 alone.
    error = np.sqrt(expected * (1 - expected) / PHOTONS)
    assert error.max() <= 0.002
    assert np.all(np.abs(found - expected) <= 3 * error)


@pytest.mark.parametrize("row", SLABS, ids=lambda row: "g{} depth{} albedo{}".format(*row[:3]))
def test_slab(row):
    g, tau, albedo, *expected = row
    found = np.concatenate([shares(tau, albedo, g), shares(tau, albedo, g, diffuse=True)])
    assert_shares(found, expected)


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("interpolation", ["constant", "linear"])
@pytest.mark.parametrize("found", OPENCL, ids=name)
def test_slab_by_every_sampler_on_every_device(found, interpolation, sampler):
    options = {"sampler": sampler, "interpolation": interpolation, "device": found.label}
    result = shares(2, 0.9, 0.75, **options)
    assert_shares(result, (0.097395, 0.660958))


@pytest.mark.parametrize("albedo", HALF_SPACES)
def test_half_space(albedo):
    """So thick a slab that what gets through it, and so what the slab lacks, is under 1e-4."""
    tau = 12 / np.sqrt(1 - albedo) if albedo < 0.999 else 250
    reflected, transmitted = shares(tau, albedo, 0)
    assert transmitted < 1e-4
    assert_shares(reflected, HALF_SPACES[albedo])


@pytest.mark.parametrize(
    ("g", "albedo"), [(0, 0.9), (0, 0.5), (0.75, 0.9), (-0.5, 0.8), (0.9, 0.7)]
)
def test_light_of_a_point_spreads_as_far_as_it_must(g, albedo):
    """The mean squared distance at absorption is 2 / (sigma_a (sigma_t - g sigma_s)).

    Light is known by voxel alone. The centre of its voxel is off by an error that is uniform and
    independent of where the light is from the lamp, as the lamp is put anywhere in a voxel: that
    adds an h^2 / 12 for each axis, exactly (dithering).
    """
    expected = 2 / ((1 - albedo) * (1 - g * albedo))
    h, n, seeds = 0.3 * np.sqrt(expected), 41, 12  # to 6 times the root of it
    medium = Medium(np.ones((n,) * 3), h, albedo, 1 - albedo, g, [-n * h / 2] * 3)
    lamps = np.random.default_rng(8).uniform(-h / 2, h / 2, (seeds, 3))
    squares, absorbed, leaking = [], [], []
    for seed, lamp in enumerate(lamps):
        field = trace(medium, [PointLight(lamp, 1)], 16_384, seed=seed)
        light = (field.fluence + field.direct)[0].astype(float)
        distance = ((medium.domain.centers() - lamp) ** 2).sum(axis=-1)
        squares.append((light * distance).sum() * (1 - albedo) * h**3 - h**2 / 4)
        absorbed.append((1 - albedo) * light.sum() * h**3)
        leaking.append(field.report.energy["left"].sum())
    # What leaves would have gone further, over 36 times the mean square.
    assert np.mean(leaking) < 1e-4
    assert_mean(squares, expected, rounding=4e-3)
    assert_mean(absorbed, 1, rounding=1e-4)
    assert np.std(squares) / np.sqrt(seeds) < 0.006 * expected


def wild_density(shape):
    """Over six decades, and two fifths of it void."""
    rng = np.random.default_rng(5)
    return 10 ** rng.uniform(-3, 3, shape) * (rng.random(shape) > 0.4)


@pytest.mark.parametrize(("sampler", "g"), [*zip(SAMPLERS, (0, 0.75, 0, 0.75), strict=True)])
def test_uniform_light_stays_uniform(sampler, g):
    """Whatever scatters: mean path 4 V / S, (4 / S) integral of sigma collisions, fluence 4 pi L.

    Voxels of 20 free paths at most: where light hardly enters, the fluence has long tails.
    """
    shape, h, radiance, seeds = (6, 5, 4), 0.02, 0.7, 24
    medium = Medium(wild_density(shape), h, 1.0, 0.0, g, origin=(1, -2, 3))
    edges = np.multiply(shape, h)
    surface = 2 * (edges.prod() / edges).sum()
    paths, collisions, fluence = [], [], []
    for seed in range(seeds):
        field = trace(medium, [Sky(radiance)], 4096, sampler, seed)
        light = (field.fluence + field.direct)[0].astype(float)
        entered = field.report.energy["entered"][0]
        assert entered == pytest.approx(pi * radiance * surface, rel=1e-5)
        assert field.report.energy["left"][0].sum() == pytest.approx(entered, rel=1e-6)
        paths.append(light.sum() * h**3 / entered)
        collisions.append(field.report.collisions[0] / field.report.photons)
        fluence.append(light)
    assert_mean(paths, 4 * edges.prod() / surface)
    assert_mean(collisions, 4 / surface * medium.density.sum(dtype=float) * h**3)
    assert_mean(fluence, np.full(shape, 4 * pi * radiance))
    assert np.std(paths) < 0.05 * np.mean(paths)
