# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons against pictures that Mitsuba renders of the same medium.

Under a sky of radiance 1 everywhere, a picture shows the radiance that reaches the camera along
its rays; by reciprocity that is the share of the power of photons sent backwards along those rays
that leaves the medium again. So each pixel is one number that both must find.
"""

from statistics import NormalDist

import numpy as np
import pytest

from lb_lighting.transport import Light, Medium
from lb_lighting.transport.photons.trace import trace
from tests.setup import peers

EDGE, SIZE = 16, 2.0  # voxels, m
SIGMA_T, ALBEDO, G = (1.2, 0.8, 2.0), (0.98, 0.9, 0.6), (0.5, 0.85, 0.0)
DIRECTION = (0.3, 0.2, -0.93)
PIXELS, WIDTH = 5, 1.3  # the camera's square, 1.3 m wide, is filled by the box of 2 m
PHOTONS = 30_000  # a pixel and band

# How often the test may fail though the two agree: once in a thousand seeds.
FALSE_ALARM = 1e-3


def blobs():
    """Blobs in vacuum, a quarter of their voxels empty: (EDGE,)^3 of mean 1, most of it 0 to 4."""
    rng = np.random.default_rng(3)
    at = (np.arange(EDGE) + 0.5) / EDGE
    places = np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1)
    density = np.zeros((EDGE,) * 3)
    for center in rng.uniform(0.15, 0.85, (7, 3)):
        density += np.exp(-np.sum((places - center) ** 2, axis=-1) / 0.03)
    density[density < 0.1] = 0
    density *= rng.random(density.shape) > 0.25
    return density / density.mean()


class Pixel(Light):
    """The rays of a pixel as a light of 1 W: evenly from a parallelogram, all along DIRECTION."""

    spectrum = 1.0

    def __init__(self, origin, right, down):
        self.origin, self.edges = origin, np.array([right, down])

    def emit(self, count, medium, rng, band):
        origins = self.origin + rng.random((count, 2)) @ self.edges
        directions = np.tile(np.divide(DIRECTION, np.linalg.norm(DIRECTION)), (count, 1))
        return origins, directions, np.full(count, 1 / count)


def mitsuba(density, albedo, samples):
    """Mitsuba's picture, see tests/peers/mitsuba_image.py."""
    return peers.run(
        "mitsuba_image",
        density=density,
        lower=np.full(3, -SIZE / 2),
        upper=np.full(3, SIZE / 2),
        sigma_t=SIGMA_T,
        albedo=albedo,
        g=G,
        direction=DIRECTION,
        width=WIDTH,
        pixels=PIXELS,
        samples=samples,
        seed=1,
    )


@pytest.fixture(scope="module")
def picture():
    return mitsuba(blobs(), ALBEDO, samples=8192)


def escaping(picture, sigma_t=SIGMA_T, albedo=ALBEDO, g=G):
    """(mean, error), each (bands, pixels, pixels): the share that leaves, by our photons."""
    sigma_s = np.multiply(sigma_t, albedo)
    medium = Medium(blobs(), SIZE / EDGE, sigma_s, sigma_t - sigma_s, g, [-SIZE / 2] * 3)
    mean = np.empty_like(picture["mean"])
    for row, column in np.ndindex(PIXELS, PIXELS):
        light = Pixel(picture["origins"][row, column], picture["right"], picture["down"])
        energy = trace(medium, [light], PHOTONS, seed=row * PIXELS + column).report.energy
        mean[:, row, column] = energy["left"].sum(axis=1) / energy["entered"]
    # The spread of weights between 0 and 1 is at most that of 0 and 1 alone.
    return mean, np.sqrt(mean * (1 - mean) / PHOTONS)


def differences(picture, mean, error):
    """z by band, of every pixel and of the whole picture, as one row."""
    difference, variance = mean - picture["mean"], error**2 + picture["error"] ** 2
    whole = difference.sum(axis=(1, 2)) / np.sqrt(variance.sum(axis=(1, 2)))
    return np.append(difference / np.sqrt(variance), whole)


def tolerated(tests):
    """The |z| that one of so many independent tests exceeds with FALSE_ALARM (Šidák)."""
    return NormalDist().inv_cdf(1 - (1 - (1 - FALSE_ALARM) ** (1 / tests)) / 2)


def test_peer_sees_the_medium_we_mean():
    """Where all that collides is lost, Mitsuba's picture is the transmittance of the pixels."""
    density, samples = blobs(), 2048
    picture = mitsuba(density, (0, 0, 0), samples)
    step, direction = 0.004, np.divide(DIRECTION, np.linalg.norm(DIRECTION))
    inner = (np.arange(8) + 0.5) / 8
    starts = (
        picture["origins"][:, :, None, None]
        + inner[:, None, None] * picture["right"]
        + inner[:, None] * picture["down"]
    )
    length = np.zeros(starts.shape[:-1])
    padded = np.pad(density, 1)
    for distance in np.arange(0, 8, step) + step / 2:
        voxel = np.floor((starts + distance * direction) / SIZE * EDGE + EDGE / 2).astype(int)
        length += step * padded[tuple(np.moveaxis(np.clip(voxel + 1, 0, EDGE + 1), -1, 0))]
    expected = np.exp(-length * np.reshape(SIGMA_T, (3, 1, 1, 1, 1))).mean(axis=(3, 4))
    z = (picture["mean"] - expected) / np.sqrt(expected * (1 - expected) / samples)
    seen = expected > 0.02  # where counts are near enough to normal: 40 samples or more
    assert seen.mean() > 0.5
    assert np.abs(z[seen]).max() < tolerated(seen.sum())


def test_photons_make_the_picture_that_mitsuba_renders(picture):
    """Tried with our medium changed: 5 % in g, 3 % in sigma_t or .01 in the albedo make it fail."""
    z = differences(picture, *escaping(picture))
    assert np.abs(z).max() < tolerated(z.size)
