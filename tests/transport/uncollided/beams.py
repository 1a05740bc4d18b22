# SPDX-License-Identifier: GPL-3.0-or-later
"""Media and lights that tests of uncollided light share."""

import numpy as np
import pytest

from lb_lighting.transport import Medium, Sun
from lb_lighting.transport.device import devices
from tests.tracing import OPENCL, name

SHAPE, H = (7, 6, 5), 0.2  # voxels, m


SUN = Sun((0.3, 0.2, -0.93), 2.0)


on_every_device = pytest.mark.parametrize("device", devices(), ids=name)


on_opencl = pytest.mark.parametrize("device", OPENCL, ids=name)


def patchy(occluded=True, sigma_s=1.5, sigma_a=0.5):
    """A third of the voxels are void, the others at most 2 free paths thick; some are opaque."""
    rng = np.random.default_rng(4)
    density = rng.uniform(0.05, 5, SHAPE) * (rng.random(SHAPE) > 1 / 3)
    emission, options = rng.random(SHAPE), {}
    if occluded:
        occlusion = rng.random(SHAPE) * (rng.random(SHAPE) > 0.8)
        options = {"occlusion": occlusion, "occlusion_albedo": rng.random((1, *SHAPE))}
    return Medium(density, H, sigma_s, sigma_a, origin=(-1, 0, 2), emission=emission, **options)


def parts(result):
    """All arrays of a cast by name."""
    arrays = {what: getattr(result, what) for what in ("direct", "flux", "left", "reflected")}
    arrays |= {what: getattr(result.collided, what) for what in ("power", "position", "direction")}
    return {what: array for what, array in arrays.items() if array is not None}


def accounted(result):
    reflected = 0 if result.reflected is None else result.reflected.sum(dtype=float)
    collided = result.collided.power.sum(dtype=float)
    return collided + reflected + result.left.sum() + result.stopped
