# SPDX-License-Identifier: GPL-3.0-or-later
"""Random densities (nx, ny, nz), from a shape and a random generator."""

import numpy as np


def even(shape, _rng):
    return np.ones(shape)


def uneven(shape, rng):
    return 10 ** rng.uniform(-3, 3, shape)


def holes(shape, rng):
    return 1.0 * (rng.random(shape) > rng.uniform(0.1, 0.9))


def boxes(shape, rng):
    depth = np.zeros(shape)
    for _ in range(4):
        first = [rng.integers(0, n) for n in shape]
        last = [rng.integers(i, n) + 1 for i, n in zip(first, shape, strict=True)]
        inside = tuple(slice(*ends) for ends in zip(first, last, strict=True))
        depth[inside] = 10 ** rng.uniform(-2, 2)
    return depth


def puffs(shape, rng):
    places = np.stack(np.meshgrid(*[np.linspace(-1, 1, n) for n in shape], indexing="ij"))
    depth = np.zeros(shape)
    for _ in range(6):
        center, radius = rng.uniform(-0.7, 0.7, (3, 1, 1, 1)), rng.uniform(0.2, 0.6)
        distance = np.sqrt(((places - center) ** 2).sum(axis=0))
        depth += np.maximum(0, 1 - distance / radius)
    return depth


def turbulence(shape, rng):
    waves = np.meshgrid(*[np.fft.fftfreq(n) for n in shape], indexing="ij")
    length = np.sqrt(sum(k**2 for k in waves))
    length[0, 0, 0] = np.inf
    values = np.fft.ifftn(np.fft.fftn(rng.standard_normal(shape)) * length**-1.8).real
    return np.exp(values / values.std() * rng.uniform(1, 3))


SHAPES = (even, uneven, holes, boxes, puffs, turbulence)
