# SPDX-License-Identifier: GPL-3.0-or-later
"""Uncollided light at opaque voxels, at extremes, and over long ways."""

import numpy as np
import pytest

from lb_lighting.errors import Cancelled
from lb_lighting.transport import Light, Medium, PointLight, Sun
from lb_lighting.transport.lights.emission import Emission
from lb_lighting.transport.monitor import Monitor
from lb_lighting.transport.uncollided.casting import cast
from tests.transport.uncollided.beams import (
    SHAPE,
    SUN,
    H,
    accounted,
    on_every_device,
    on_opencl,
    parts,
    patchy,
)


@on_every_device
def test_opaque_voxels_stop_what_arrives_and_send_back_their_share(device):
    occlusion, albedo = np.zeros((3, 3, 4)), np.zeros((1, 3, 3, 4))
    occlusion[..., 0], albedo[..., 0] = 0.5, 0.4  # met from outside
    occlusion[..., 2], albedo[..., 2] = 1.0, 0.75
    medium = Medium(np.zeros((3, 3, 4)), H, 1, 0, occlusion=occlusion, occlusion_albedo=albedo)
    result = cast(medium, Sun((0, 0, 1), 2.0), 0, 1.0, device)
    assert result.direct == pytest.approx(np.tile([1.0, 1.0, 0, 0], (3, 3, 1)), abs=1e-6)
    back = 0.75 * H**2
    assert result.reflected == pytest.approx(np.tile([0, back, 0, 0], (3, 3, 1)), rel=1e-6)
    area = 9 * H**2
    assert result.left == pytest.approx(np.array([0, 0, 0, 0, 0.4 * area, 0]), rel=1e-6)
    assert result.stopped == pytest.approx(area * (0.6 + 0.25), rel=1e-6)


@on_every_device
def test_light_leaves_an_opaque_voxel_unhindered(device):
    occlusion = np.zeros((5, 5, 5))
    occlusion[2, 2, 2] = 1
    medium = Medium(np.zeros((5, 5, 5)), H, 1, 0, occlusion=occlusion, occlusion_albedo=0.5)
    result = cast(medium, PointLight((0.5, 0.51, 0.49), 3.0), 0, 1.0, device, per_edge=4)
    assert result.left.sum() == pytest.approx(3.0, rel=1e-5)
    assert result.stopped == 0
    assert not result.reflected.any()


@on_every_device
@pytest.mark.parametrize("irradiance", [1e-20, 1e20])
@pytest.mark.parametrize(
    "depths", [[1e-30], [1e-6], [1e4], [1e8], [0, 1e-45, 1e-30, 1e-6, 1e4, 1e8]]
)
@pytest.mark.parametrize("kind", ["sun", "emission"])
def test_extremes_are_finite_and_conserve_energy(kind, depths, irradiance, device):
    rng = np.random.default_rng(8)
    depth = rng.choice(depths, SHAPE)
    medium = Medium(depth, 1.0, 1.0, 0, emission=irradiance * rng.random(SHAPE))
    light = Sun(SUN.direction, irradiance) if kind == "sun" else Emission(medium)
    result = cast(medium, light, 0, 1.0, device, per_edge=3)
    for what, values in parts(result).items():
        assert np.all(np.isfinite(values)), what
    assert result.direct.min() >= 0
    assert result.collided.power.min() >= 0
    assert accounted(result) == pytest.approx(result.entered, rel=1e-5)
    # Digits are kept where next to nothing collides, and where next to nothing is uncollided.
    expected = medium.density.astype(float) * result.direct
    tiny = 1e-37
    assert result.collided.power == pytest.approx(expected, rel=1e-5, abs=tiny)
    moments = np.abs(result.collided.position).max(axis=0)
    assert np.all(moments <= (0.5 + 1e-6) * result.collided.power + tiny)


@on_opencl
@pytest.mark.parametrize("direction", [(1, 0.003, 0.001), (-1, 1, 1e-12), (-0.7, 0.02, -0.3)])
def test_long_ways_keep_their_digits(direction, device):
    rng = np.random.default_rng(2)
    medium = Medium(rng.random((512, 4, 4)), 0.1, 0.1, 0)
    sun = Sun(direction, 1.0)
    found, twin = (cast(medium, sun, 0, 0.1, used, per_edge=2) for used in (device, "NumPy"))
    assert found.left.sum() == pytest.approx(twin.left.sum(), rel=1e-5)
    assert np.abs(found.direct - twin.direct).max() <= 1e-5 * twin.direct.max()
    most = twin.collided.power.max()
    for kind, scale in (("power", 1), ("position", 0.1 / 2), ("direction", 1)):
        error = getattr(found.collided, kind) - getattr(twin.collided, kind)
        assert np.abs(error).max() <= 1e-5 * most * scale, kind


def test_a_cast_can_be_cancelled():
    with pytest.raises(Cancelled):
        cast(patchy(), SUN, 0, 1.0, per_edge=2, monitor=Monitor(cancel=lambda: True))


class Followed(Light):
    """A sun whose rays are followed one by one, from where its photons start."""

    def __init__(self, sun):
        self.sun = sun

    @property
    def spectrum(self):
        return self.sun.spectrum

    def emit(self, count, medium, rng, band):
        return self.sun.emit(count, medium, rng, band)


@pytest.mark.parametrize("occluded", [False, True])
@pytest.mark.parametrize(
    "direction",
    [(0, 0, 1), (0, -1, 0), (1, 1, 1), (0.3, 0.2, -0.93), (-0.7, 0.7, 0.1), (-0.2, -0.9, 0.5)],
)
def test_swept_light_is_that_of_rays_followed_one_by_one(direction, occluded):
    medium, sun = patchy(occluded), Sun(direction, 2.0)
    swept = parts(cast(medium, sun, 0, 2.0, "NumPy", 30))
    followed = parts(cast(medium, Followed(sun), 0, 2.0, "NumPy", 24))
    assert swept.keys() == followed.keys()
    for what in followed.keys() - {"left"}:
        # Few rays reach the few voxels that reflect, and places depend on each ray.
        allowed = 8e-3 if what in ("reflected", "position") else 2e-3
        difference = np.linalg.norm(swept[what] - followed[what])
        assert difference <= allowed * np.linalg.norm(followed[what]), what
    assert swept["left"] == pytest.approx(followed["left"], abs=2e-3 * followed["left"].sum())
    few = cast(medium, sun, 0, 2.0, "NumPy", 3)
    assert accounted(few) == pytest.approx(few.entered, rel=1e-6)
