# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice against the paper's appendix."""

import numpy as np
import pytest

from lb_lighting.errors import MediumError
from lb_lighting.transport.lattice.d3q19 import (
    AXIAL,
    DIAGONAL,
    DIRECTIONS,
    UNIT,
    WEIGHTS,
)
from lb_lighting.transport.medium import PRESETS
from lb_lighting.transport.paper.collision import collision_matrix, diffusion_coefficient
from lb_lighting.transport.paper.paper_numpy import step


def test_directions_are_the_19_nearest():
    assert len({tuple(c) for c in DIRECTIONS}) == 19
    assert np.all(DIRECTIONS[0] == 0)
    assert np.all(np.abs(DIRECTIONS[AXIAL]).sum(axis=1) == 1)
    assert np.all(np.abs(DIRECTIONS[DIAGONAL]).sum(axis=1) == 2)
    assert WEIGHTS.sum() == pytest.approx(1)


def test_second_moment_is_isotropic():
    moment = np.einsum("m,ma,mb->ab", WEIGHTS, DIRECTIONS, DIRECTIONS)
    np.testing.assert_allclose(moment, np.eye(3) / 2, atol=1e-15)


@pytest.mark.parametrize("g", [-1, -0.75, 0, 0.3, 0.9, 1])
@pytest.mark.parametrize(("sigma_s", "sigma_a"), [(1, 0), (0.792, 0.008), (0.3, 0.5), (0, 0.7)])
def test_collision_conserves_light(sigma_s, sigma_a, g):
    """Columns sum to zero: what leaves a direction arrives in others, or is absorbed into 0."""
    omega = collision_matrix(sigma_s, sigma_a, g)
    np.testing.assert_allclose(omega.sum(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose(omega[0, 1:], sigma_a)
    assert np.all(omega[~np.eye(19, dtype=bool)] >= 0)


@pytest.mark.parametrize(("sigma_s", "sigma_a"), [(0.792, 0.008), (0.3, 0.5), (1, 0)])
def test_isotropic_equilibrium_spans_the_null_space(sigma_s, sigma_a):
    omega = collision_matrix(sigma_s, sigma_a)
    equilibrium = WEIGHTS.copy()
    equilibrium[0] = sigma_a
    np.testing.assert_allclose(omega @ equilibrium, 0, atol=1e-15)
    assert np.linalg.matrix_rank(omega, tol=1e-10) == 18


def test_lattice_directions_are_eigenvectors():
    sigma_s, sigma_a = 0.6, 0.15
    omega = collision_matrix(sigma_s, sigma_a)
    weighted = WEIGHTS[:, None] * DIRECTIONS
    for vector in (*DIRECTIONS.T.astype(float), *weighted.T):
        np.testing.assert_allclose(omega @ vector, -(sigma_s + sigma_a) * vector, atol=1e-14)


def test_pure_forward_scattering_is_a_pass_through():
    np.testing.assert_allclose(collision_matrix(0.9, 0, g=1)[1:, 1:], 0, atol=1e-15)


def test_pure_backward_scattering_turns_light_round():
    omega = collision_matrix(1, 0, g=-1)
    for m, c in enumerate(DIRECTIONS[1:], start=1):
        back = int(np.flatnonzero(np.all(-c == DIRECTIONS, axis=1))[0])
        assert omega[back, m] == pytest.approx(1)
        assert omega[m, m] == pytest.approx(-1)


@pytest.mark.parametrize(
    ("g", "low", "high"), [(0.2, 0.19, 0.21), (0.5, 0.49, 0.6), (0.9, 0.985, 1)]
)
def test_mean_cosine_is_g_for_mild_g_and_more_for_strong(g, low, high):
    """18 directions leave no room for small angles, so strong scattering is too much forward."""
    scattered = collision_matrix(1, 0, g)[1:, 1:] + np.eye(18)
    cosine = (UNIT[1:].T @ scattered * UNIT[1:].T).sum(axis=0)
    assert np.all((cosine > low) & (cosine < high))


@pytest.mark.parametrize("g", [-1.01, 1.5, float("nan")])
def test_g_out_of_range_is_refused(g):
    with pytest.raises(MediumError, match="g must lie between -1 and 1"):
        collision_matrix(1, 0, g)


def test_presets_are_the_papers():
    cloud, plant, pmma = PRESETS["cloud"], PRESETS["plant"], PRESETS["pmma"]
    assert (cloud.sigma_s, cloud.sigma_a, cloud.g) == (0.792, 0.008, 0.9)
    assert plant.g == (-0.231, 0.103, -0.750)
    assert plant.sigma_a == (0.109, 0.091, 0.118)
    assert plant.sigma_s == (0.891, 0.909, 0.882)
    assert pmma.g == (0.80, -0.88, -0.88)
    assert pmma.sigma_a == (0.01,) * 3
    assert pmma.sigma_s == (0.99,) * 3


@pytest.mark.parametrize(("sigma_s", "sigma_a"), [(0.8, 0.0), (0.5, 0.0), (0.7, 0.1), (1.4, 0.0)])
def test_a_pulse_spreads_as_equation_4_says(sigma_s, sigma_a):
    """The variance of a pulse in equilibrium grows by 6 D a step, absorbed light kept."""
    n, steps = 61, 20
    equilibrium = WEIGHTS.copy()
    equilibrium[0] = sigma_a
    f = np.zeros((19, n, n, n))
    # A smooth pulse: the limit that the equation describes.
    axis = np.arange(n) - n // 2
    r2 = sum(np.meshgrid(axis**2, axis**2, axis**2, indexing="ij", sparse=True))
    f += equilibrium[:, None, None, None] * np.exp(-r2 / (2 * 2.5**2))
    omega, density = collision_matrix(sigma_s, sigma_a), np.ones((n, n, n))

    def variance(light):
        total = light.sum(axis=0)
        return (total * r2).sum() / total.sum()

    for _ in range(10):  # past the start, where the fluxes form
        f = step(f, omega, density, keep_absorbed=True)
    early = variance(f)
    for _ in range(steps):
        f = step(f, omega, density, keep_absorbed=True)
    measured = (variance(f) - early) / (6 * steps)
    assert measured == pytest.approx(diffusion_coefficient(sigma_s, sigma_a), rel=0.01)
