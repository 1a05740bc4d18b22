# SPDX-License-Identifier: GPL-3.0-or-later
"""Light counts by what is seen of it: where it is scattered, or falls on what reflects."""

import numpy as np
import pytest

from lb_lighting.transport import Medium
from lb_lighting.transport.planning import visibility


def test_light_counts_by_what_scatters_it():
    density = np.zeros((4, 4, 4))
    density[1, 1, 1], density[2, 2, 2] = 1, 3
    weight = visibility.weights(Medium(density, 0.1, (2.0, 1.0), 0.5))
    assert weight.shape == (2, 4, 4, 4)
    assert weight[0, 2, 2, 2] == 1
    assert weight[0, 1, 1, 1] == pytest.approx(1 / 3)
    assert weight[1, 2, 2, 2] == 0.5
    assert np.count_nonzero(weight) == 4


def test_light_in_empty_voxels_does_not_count():
    density = np.zeros((8, 8, 8))
    density[4, 4, 4] = 1
    weight = visibility.weights(Medium(density, 0.1, 2.0, 0.5))
    light = np.full((1, 8, 8, 8), 1e6, np.float32)
    light[0, 4, 4, 4] = 3
    assert visibility.size(light, weight) == 3
    assert visibility.mean_share(0.5 * light, light, weight) == 0.5


def test_nothing_is_seen_of_what_only_absorbs():
    medium = Medium(np.ones((3, 3, 3)), 0.1, 0.0, 1.0)
    weight, light = visibility.weights(medium), np.ones((1, 3, 3, 3), np.float32)
    assert not weight.any()
    assert visibility.size(light, weight) == visibility.mean_share(light, light, weight) == 0


def test_densities_of_any_size_are_weighed():
    weight = visibility.weights(Medium(np.full((3, 3, 3), 1e38), 1e-3, 1e38, 0.0))
    assert np.all(weight == 1)


def test_what_lies_before_opaque_voxels_counts_where_surfaces_show_light():
    density, opaque = np.zeros((2, 5, 5, 5))
    density[2, 2, 4] = 1
    opaque[:, :, 0] = 1
    arguments = (0.1, 5.0, 0.0)
    rest = {"occlusion": opaque, "occlusion_albedo": 0.5}
    shown = visibility.weights(Medium(density, *arguments, **rest), surfaces=True)[0]
    assert np.all(shown[:, :, 0] == 0)
    assert np.all(shown[:, :, 1] == shown[2, 2, 4])  # .5 a voxel of .1 m, as 5 a metre
    hidden = visibility.weights(Medium(density, *arguments, **rest))[0]
    assert np.count_nonzero(hidden) == 1
    alone = visibility.weights(Medium(0 * density, *arguments, **rest))[0]
    assert np.all(alone[:, :, 1] == 1)
