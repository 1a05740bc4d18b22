# SPDX-License-Identifier: GPL-3.0-or-later
"""The NumPy update, against what the paper says of it and against a loop over nodes."""

import numpy as np

from lb_lighting.transport.lattice.d3q19 import DIRECTIONS, WEIGHTS
from lb_lighting.transport.paper.collision import collision_matrix
from lb_lighting.transport.paper.paper_numpy import set_initial_light, step

SHAPE = (6, 5, 7)
INFLOW = np.linspace(0, 1, 19)


def random_light(seed=0):
    return np.random.default_rng(seed).random((19, *SHAPE))


def initial_light(shape, inflow):
    f = np.empty((19, *shape))
    set_initial_light(f, inflow)
    return f


def test_step_is_equation_2_node_by_node():
    f, omega = random_light(), collision_matrix(0.7, 0.1, 0.4)
    density = np.random.default_rng(1).random(SHAPE)
    expected = f.copy()
    for node in np.ndindex(SHAPE):
        after = f[:, *node] + density[node] * (omega @ f[:, *node])
        for m, c in enumerate(DIRECTIONS):
            target = np.add(node, c)
            if np.all((target > 0) & (target < np.subtract(SHAPE, 1))):
                expected[m, *target] = after[m]
    np.testing.assert_allclose(step(f, omega, density, keep_absorbed=True), expected, rtol=1e-14)


def test_boundary_keeps_its_light_and_ignores_what_flows_in():
    f = initial_light(SHAPE, INFLOW)
    after = f
    for _ in range(5):
        after = step(after, collision_matrix(0.7, 0.1), np.ones(SHAPE))
    boundary = np.ones(SHAPE, bool)
    boundary[1:-1, 1:-1, 1:-1] = False
    np.testing.assert_array_equal(after[:, boundary], f[:, boundary])
    assert after[:, 1:-1, 1:-1, 1:-1].sum() > 0
    assert f[:, 1:-1, 1:-1, 1:-1].sum() == 0


def test_empty_medium_passes_light_straight_on():
    n = 9
    f = np.zeros((19, n, n, n))
    f[:, 4, 4, 4] = 1
    after = f
    for _ in range(3):
        after = step(after, collision_matrix(0.7, 0.1), np.zeros((n, n, n)), keep_absorbed=True)
    for m, c in enumerate(DIRECTIONS):
        assert after[m][tuple(4 + 3 * c)] == 1
    assert after.sum() == 19


def test_interior_light_is_conserved_when_absorbed_light_is_kept():
    n = 13
    f = np.zeros((19, n, n, n))
    f[:, 6, 6, 6] = WEIGHTS
    density = np.random.default_rng(2).random((n, n, n))
    for _ in range(4):  # not yet at the boundary
        f = step(f, collision_matrix(0.6, 0.3, 0.5), density, keep_absorbed=True)
    np.testing.assert_allclose(f.sum(), 1, rtol=1e-13)


def test_dropped_light_leaves_direction_0_empty():
    f = step(random_light(), collision_matrix(0.5, 0.4), np.ones(SHAPE))
    assert np.all(f[0, 1:-1, 1:-1, 1:-1] == 0)


def test_opaque_voxels_send_nothing_on():
    f, occlusion = random_light(), np.zeros(SHAPE)
    occlusion[3, 2, 3] = 1
    after = step(f, collision_matrix(0.5, 0.4), np.ones(SHAPE), occlusion)
    for m, c in enumerate(DIRECTIONS[1:], start=1):
        target = tuple(np.add((3, 2, 3), c))
        if np.all((np.array(target) > 0) & (np.array(target) < np.subtract(SHAPE, 1))):
            assert after[m][target] == 0


def test_closed_sky_is_a_white_furnace():
    """Without absorption the light of a uniform surrounding is the same everywhere."""
    f = initial_light(SHAPE, WEIGHTS)
    density = np.random.default_rng(3).random(SHAPE)
    for _ in range(200):
        f = step(f, collision_matrix(1, 0), density)
    np.testing.assert_allclose(f.sum(axis=0), 1, rtol=1e-9)
