# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of traced photons share: a light, and how results of chance are judged.

Each judgement would fail by chance for at most one seed in 1 / FALSE_ALARM.
"""

from dataclasses import dataclass

import numpy as np

from lb_lighting.transport import device
from lb_lighting.transport.lights.base import Light, by_band
from tests.statistics import normal, sidak

FALSE_ALARM = 1e-4
OPENCL = [found for found in device.devices() if found.kind != "NumPy"]
BATCHES = 32  # that a trace finds its variance from


def name(found):
    """What pytest calls a device."""
    return found.platform.split(",")[0]


@dataclass(frozen=True)
class Beam(Light):
    """Light that comes from a point: along `direction`, or `diffuse` about it, by the cosine.

    The photons are drawn one by one, and so are independent.
    """

    position: tuple
    direction: tuple
    diffuse: bool = False
    spectrum: tuple | float = 1.0  # W

    def emit(self, count, medium, rng, band):
        along = np.divide(self.direction, np.linalg.norm(self.direction))
        directions = np.tile(along, (count, 1))
        if self.diffuse:  # Lambert: a point of the sphere on the end of the direction
            directions += _on_sphere(count, rng)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        power = by_band(self.spectrum, medium.bands)[band]
        origins = np.tile(np.asarray(self.position, float), (count, 1))
        return origins, directions, np.full(count, power / count)


def _on_sphere(count, rng):
    points = rng.standard_normal((count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def assert_mean(samples, expected, rounding=1e-6):
    """Independent samples (n, ...) have the mean `expected` (...), by Student's test."""
    samples, expected = np.asarray(samples, float), np.asarray(expected, float)
    n = len(samples)
    error = np.hypot(samples.std(axis=0, ddof=1) / np.sqrt(n), rounding * np.abs(expected))
    assert_near(samples.mean(axis=0) - expected, error, n - 1)


def assert_same_light(first, second, scale=1.0):
    """Two fields have the same scattered light, within what they say of their variance."""
    error = np.sqrt(first.variance + scale**2 * second.variance)
    assert_near(first.fluence - scale * second.fluence, error, BATCHES - 1)


def assert_near(difference, error, freedom):
    """Differences are 0 as far as their errors, of so many degrees of freedom, can tell."""
    assert np.all(np.isfinite(error))
    t = np.divide(difference, error, out=np.zeros(np.shape(difference)), where=error > 0)
    assert np.all(np.asarray(difference)[error == 0] == 0)
    # Student's law to the normal one (Wallace 1959).
    factor = (8 * freedom + 1) / (8 * freedom + 3)
    z = factor * np.sqrt(freedom * np.log1p(t**2 / freedom))
    assert sidak([normal(value) for value in np.ravel(z)]) > FALSE_ALARM
