# SPDX-License-Identifier: GPL-3.0-or-later
"""Media and lights that tests of the physical model share."""

import numpy as np

from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve

SHAPE, H = (6, 7, 5), 0.5  # voxels, m


SUN, SKY = Sun((0.3, 0.2, -0.93), 2.0), Sky(0.3)


INSIDE, OUTSIDE = PointLight((1.4, 1.8, 1.3), 5.0), PointLight((-2.0, 1.0, 4.0), 90.0)


def cloud(sigma_s=2.0, sigma_a=0.1, g=0.5, h=H, **extra):
    """A third of the voxels void, the others half a free path thick on average."""
    rng = np.random.default_rng(5)
    return Medium(rng.random(SHAPE) * (rng.random(SHAPE) > 1 / 3), h, sigma_s, sigma_a, g, **extra)


def solved(medium, lights=(SUN,), chosen=None, progress=None, cancel=None, **settings):
    return solve(medium, lights, Settings(**settings), chosen, progress, cancel)


def light_of(field):
    return (field.fluence + field.direct).astype(float)


def difference(one, other):
    """Relative L2."""
    return float(np.linalg.norm(np.subtract(one, other, dtype=float)) / np.linalg.norm(other))


def imbalance(field):
    """(bands,): what is absorbed and what leaves, less what came, over all that came."""
    energy = field.report.energy
    came = energy["entered"] + energy.get("shifted", 0)
    return (energy["absorbed"] + energy["left"].sum(axis=1) - came) / energy["entered"].sum()
