# SPDX-License-Identifier: GPL-3.0-or-later
"""`solve`: division, tolerance, progress, cancel, reports and refusals."""

import numpy as np
import pytest

from lb_lighting.errors import Cancelled, MediumError, SettingsError
from lb_lighting.transport import Medium, Settings, Sky, Sun, device, solve
from tests.transport.hybrid_media import SHAPE, H, cloud, difference, solved


def test_thick_voxels_are_divided():
    """To voxels of at most 3 transport mean free paths: 4 becomes 2 in each of two pieces."""
    thick = Medium(np.ones((4, 4, 4)), 1.0, 4.0, 0.0)
    divided, explicit = solved(thick), solved(thick, divide=2)
    np.testing.assert_array_equal(divided.fluence, explicit.fluence)
    assert difference(solved(thick, divide=1).fluence, divided.fluence) > 1e-3


@pytest.mark.parametrize("sigma", [30.0, 1e6])
def test_voxels_that_absorb_too_much_are_refused(sigma):
    with pytest.raises(
        MediumError, match=r"absorbs too strongly .* raise the resolution \d+ times"
    ):
        solved(Medium(np.ones(SHAPE), 1.0, sigma, sigma))


def test_steps_that_run_out_are_reported():
    field = solved(cloud(20, 0.0), most_steps=16, divide=1)
    assert field.report.steps == 16
    assert not field.report.converged
    assert field.report.residual > 0.01


@pytest.mark.parametrize("tolerance", [0.1, 1e-2, 1e-3])
def test_the_tolerance_is_met(tolerance):
    medium = Medium(np.ones((8, 8, 8)), 1.0, 1.0, 0.0)
    field, exact = (solved(medium, tolerance=t) for t in (tolerance, 1e-6))
    assert field.report.converged
    assert field.report.residual <= tolerance
    assert difference(field.fluence, exact.fluence) < tolerance
    assert field.report.steps < exact.report.steps


@pytest.mark.parametrize("transport_depth", [0.0, 2.0])
def test_progress_never_falls_and_reaches_one(transport_depth):
    heard = []
    solved(
        cloud((2.0, 1.0)),
        progress=lambda stage, share: heard.append(share),
        handover=transport_depth,
        photons=10_000,
    )
    assert heard == sorted(heard)
    assert heard[0] >= 0
    assert heard[-1] == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("calls", [0, 1, 5])
def test_cancel_ends_the_solve_at_the_next_look(calls):
    looked = []

    def cancel():
        looked.append(1)
        return len(looked) > calls

    with pytest.raises(Cancelled):
        solved(Medium(np.ones((8, 8, 8)), 1.0, 1.0, 0.0), cancel=cancel, tolerance=1e-5)
    assert len(looked) == calls + 1


def test_the_report_says_what_ran():
    report = solved(cloud((2.0, 1.0)), chosen="NumPy").report
    assert report.model == "physical"
    assert report.device == device.numpy_device().label
    assert report.runs == 2
    assert report.bytes > 0
    assert set(report.seconds) == {"prepare", "direct", "solve"}
    assert report.converged
    assert 0 < report.residual <= 1e-2
    shapes = {where: np.shape(power) for where, power in report.energy.items()}
    assert shapes == {"entered": (2,), "absorbed": (2,), "left": (2, 6)}


def test_a_suns_own_shadow_density_replaces_the_mediums():
    medium = Medium(np.full((6, 6, 6), 0.5), H, 1.0, 1.0)
    clear = Sun((0, 0, -1), 1.0, shadow_density=np.zeros(medium.shape))
    assert solved(medium, [clear]).direct == pytest.approx(1.0, rel=1e-5)
    denser = Sun((0, 0, -1), 1.0, shadow_density=medium.density * 2)
    twice = solved(medium.altered(density=medium.density * 2), [Sun((0, 0, -1), 1.0)])
    assert solved(medium, [denser]).direct == pytest.approx(twice.direct, rel=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        {"handover": -1.0},
        {"handover": float("nan")},
        {"tolerance": 0.0},
        {"tolerance": 1.0},
        {"most_steps": 0},
        {"photons": 0},
        {"divide": 65},
        {"traced_collisions": 0},
        {"rays": 0.0},
        {"rays": 17.0},
    ],
    ids=str,
)
def test_bad_settings_are_refused(settings):
    with pytest.raises(SettingsError):
        Settings(**settings)


def test_the_residual_is_reported_until_convergence():
    reports = []
    medium = Medium(np.ones((12, 12, 12)), 1.0, 0.5, 0.01)
    settings = Settings(tolerance=1e-3)
    field = solve(
        medium,
        [Sun((0, 0, -1), 1.0)],
        settings,
        "NumPy",
        progress=lambda stage, fraction: reports.append((stage, fraction)),
        residual=lambda error: reports.append(error),
    )
    errors = [error for error in reports if isinstance(error, float)]
    assert errors[0] == 1
    assert all(np.diff(errors) <= 0)
    assert field.report.residual <= settings.tolerance < errors[-1] < 0.2
    assert all(reports[reports.index(error) + 1][0] == "solve" for error in errors)


def test_the_papers_model_has_no_residual_to_tell():
    reports = []
    medium = Medium(np.ones((6, 6, 6)), 1.0, 0.5, 0.01)
    solve(medium, [Sun((0, 0, -1), 1.0)], Settings("paper"), "NumPy", residual=reports.append)
    assert reports == []


@pytest.mark.parametrize("handover", [0.0, 2.0])
def test_light_of_small_angles_is_kept_apart(handover):
    """It is what a medium of less extinction would let pass, over what this one does; through
    columns of constant depth both are known."""
    g, sigma_s, n = 0.8, 6.0, 12
    medium = Medium(np.ones((n,) * 3), 1 / n, sigma_s, 0.0, g)
    settings = Settings(handover=handover, photons=20_000)
    field = solve(medium, [Sun((0, 0, -1), 2.0), Sky(lambda d: 1.0 + d[..., 2])], settings)
    edges = np.linspace(1, 0, n + 1)  # m below the face, from the lowest voxel up
    passes = [
        2.0 * -np.diff(np.exp(-sigma * edges)) / (sigma / n) * -1
        for sigma in (sigma_s, (1 - g**2) * sigma_s)
    ]
    expected = np.abs(passes[1]) - np.abs(passes[0])
    np.testing.assert_allclose(field.forward[0, 0, 4, 5], expected, rtol=1e-4)
    np.testing.assert_allclose(field.by_light[0, 0, 4, 5], np.abs(passes[0]), rtol=1e-4)


def test_without_a_forward_peak_there_is_no_such_light():
    medium = Medium(np.ones((8,) * 3), 1.0, 1.0, 0.1, -0.3)
    assert not solve(medium, [Sun((0, 0, -1), 2.0)]).forward.any()
