# SPDX-License-Identifier: GPL-3.0-or-later
"""Media and lights in which there is little or nothing to find."""

import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.transport import (
    AreaLight,
    Medium,
    PointLight,
    Settings,
    Sky,
    SpotLight,
    Sun,
    plan,
    solve,
    trace,
)
from lb_lighting.transport.device import devices, queue, upload
from lb_lighting.transport.ordinates import source_iteration
from tests.tracing import OPENCL, name

on_every_device = pytest.mark.parametrize("device", devices(), ids=name)
EDGE = 6
EVERYWHERE = np.ones((EDGE,) * 3)
CLOUD = np.zeros_like(EVERYWHERE)
CLOUD[2:4, 2:4, 2:4] = 1
BOX = EVERYWHERE.copy()  # closed, and empty but for the cloud
BOX[1:-1, 1:-1, 1:-1] = 0
SUN = Sun((0.1, 0.2, -1), 2.0)
CENTER, ABOVE = (0.3, 0.3, 0.31), (0.3, 0.3, 2.0)
SINGLE = Settings(scattering="single")
DARK = {  # lights of which none reaches the medium
    "faces away": AreaLight((5, 0, 0), (0, 1, 0), (0, 0, 1), 10.0),
    "shines down below": AreaLight((0.3, 0.3, -2), (0, 1, 0), (1, 0, 0), 10.0),
    "narrow, beside": AreaLight((2, 0.3, 3), (1, 0, 0), (0, -1, 0), 10.0, spread=0.2),
    "spot, beside": SpotLight((2, 0.3, 3), (0, 0, -1), 10.0, 0.2),
    "spot, away": SpotLight(ABOVE, (0, 0, 1), 10.0, 0.2),
}


def medium(density=CLOUD, occlusion=None, **more):
    return Medium(density, 0.1, 5.0, 0.1, 0.7, occlusion=occlusion, **more)


@on_every_device
def test_occluders_elsewhere_change_nothing(device):
    """All of the grid is clear where what is opaque lies outside of the domain."""
    there, without = (solve(medium(EVERYWHERE, o), [SUN], None, device) for o in (0 * BOX, None))
    for what in ("fluence", "direct", "flux"):
        expected = getattr(without, what)
        np.testing.assert_allclose(getattr(there, what), expected, atol=1e-5 * expected.max())


@on_every_device
@pytest.mark.parametrize("occlusion", [BOX, EVERYWHERE], ids=["in a box", "opaque"])
@pytest.mark.parametrize("light", [SUN, PointLight(ABOVE, 5.0)], ids=["sun", "point"])
def test_what_is_walled_in_is_dark(device, occlusion, light):
    walled, inside = medium(occlusion=occlusion), CLOUD > 0
    for found in (solve(walled, [light], None, device), trace(walled, [light], 100, device=device)):
        assert np.all((found.fluence + found.direct)[:, inside] == 0)
        energy = found.report.energy
        received = energy["absorbed"] + energy["left"].sum(axis=-1)
        np.testing.assert_allclose(received, energy["entered"], rtol=1e-5)


@pytest.mark.parametrize("dark", [medium(occlusion=BOX), medium(0 * CLOUD)], ids=["box", "void"])
def test_media_in_which_nothing_collides_are_planned_for(dark):
    planned = plan(dark, [SUN], "draft", "NumPy")
    assert np.isfinite([planned.error, planned.seconds]).all()
    assert planned.settings.handover == 0


@on_every_device
def test_a_lamp_in_a_closed_box_lights_what_is_in_it(device):
    found = solve(medium(occlusion=BOX), [PointLight(CENTER, 5.0)], None, device)
    energy = found.report.energy
    assert found.fluence[:, CLOUD > 0].min() > 0
    assert np.all(found.direct[:, BOX > 0] <= found.direct.max())
    assert energy["left"].sum() <= 1e-6 * energy["entered"].sum()
    np.testing.assert_allclose(energy["absorbed"], energy["entered"], rtol=0.02)


@on_every_device
def test_lamps_that_shine_elsewhere(device):
    """Beside a sun they change nothing; alone they are refused."""
    lights = [*DARK.values(), SUN]
    both, sun = (solve(medium(), some, SINGLE, device) for some in (lights, [SUN]))
    assert np.array_equal(both.direct, sun.direct)
    assert not both.by_light[:-1].any()
    with pytest.raises(LightError, match=r"^There is no light on what is to be lit: no lamp"):
        solve(medium(), lights[:-1], SINGLE, device)


@on_every_device
def test_lamps_without_power_beside_a_sun(device):
    dark = [
        Sun((1, 0, 0), 0.0),
        Sky(0.0),
        PointLight(CENTER, 0.0),
        AreaLight(ABOVE, (0, 1, 0), (1, 0, 0), 0.0),
    ]
    found = solve(medium(), [*dark, SUN], SINGLE, device)
    assert np.array_equal(found.direct, solve(medium(), [SUN], SINGLE, device).direct)


@on_every_device
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 4, 3)], ids=str)
@pytest.mark.parametrize("density", [0.0, 1.0])
def test_few_voxels_and_empty_ones(device, shape, density):
    emission = np.ones((1, *shape))
    found = solve(medium(np.full(shape, density), emission=emission), [], None, device)
    energy = found.report.energy
    assert energy["entered"].sum() == pytest.approx(0.1**3 * np.prod(shape), rel=1e-4)
    received = energy["absorbed"] + energy["left"].sum()
    np.testing.assert_allclose(received, energy["entered"], rtol=0.02)


@on_every_device
def test_gathering_without_beams(device):
    lit = solve(medium(), [Sky(1.0)], Settings(), device)
    found = source_iteration.iterate(medium(), [Sky(1.0)], lit, device, 1)
    assert found.lobes.shape[0] == 0
    assert np.isfinite(found.moments).all()
    assert found.moments[0, 0].max() > 0


@pytest.mark.parametrize("device", OPENCL, ids=name)
def test_nothing_can_be_uploaded(device):
    assert upload(queue(device), np.empty((7, 0))).size > 0
