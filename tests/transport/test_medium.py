# SPDX-License-Identifier: GPL-3.0-or-later
"""Media and domains: what they hold, and what they refuse."""

import numpy as np
import pytest

from lb_lighting.errors import MediumError
from lb_lighting.transport import Domain, Medium, paper_units

ONES = np.ones((3, 4, 5))


def test_scalars_become_one_band():
    medium = Medium(ONES, 0.5, 2.0, 1.0, 0.3, origin=(1, 2, 3))
    assert medium.bands == 1
    assert medium.shape == (3, 4, 5)
    assert medium.sigma_t == pytest.approx([3.0])
    assert medium.albedo == pytest.approx([2 / 3])
    assert medium.domain == Domain((1, 2, 3), 0.5, (3, 4, 5))


def test_bands_broadcast():
    medium = Medium(ONES, 1, (0.1, 0.2, 0.3), 0.0, g=0.5)
    assert medium.bands == 3
    np.testing.assert_array_equal(medium.g, [0.5] * 3)


def test_albedo_of_nothing_is_zero():
    assert Medium(ONES, 1, 0, 0).albedo == [0]


def spoiled(value, voxel=(1, 2, 3)):
    density = ONES.copy()
    density[voxel] = value
    return density


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"density": spoiled(np.nan)},
            "density is not finite in 1 of 60 voxels, first at .1, 2, 3",
        ),
        ({"density": spoiled(np.inf)}, "not finite"),
        ({"density": spoiled(1e39)}, "not finite"),
        ({"density": spoiled(-0.1)}, "negative in 1 of 60"),
        ({"density": np.ones((3, 4))}, "three dimensions"),
        ({"density": np.ones((0, 4, 5))}, "at least one voxel"),
        ({"voxel_size": 0}, "voxel size must be positive"),
        ({"voxel_size": np.nan}, "voxel size must be positive"),
        ({"voxel_size": np.inf}, "voxel size must be positive"),
        ({"sigma_s": (1, 1e39)}, "sigma_s must be between 0 and 3.4e.38; in band 1"),
        ({"sigma_s": -1}, "sigma_s must be between 0 and 3.4e.38; in band 0"),
        ({"sigma_a": (0, np.inf)}, "sigma_a must be between 0 and 3.4e.38; in band 1"),
        ({"g": 1}, "g must be between -1 and 1"),
        ({"g": np.nan}, "g must be between"),
        ({"sigma_s": (1, 1), "sigma_a": (1, 1, 1)}, "agree on the number of bands"),
        ({"origin": (0, np.nan, 0)}, "origin"),
        ({"emission": spoiled(1e39)}, "emission is not finite"),
        ({"emission": spoiled(-1)}, "emission is negative"),
        ({"emission": np.ones((2, 2, 2))}, "emission has shape"),
        ({"occlusion": ONES * 1.1}, "occlusion must be at most 1"),
        ({"occlusion": np.ones((2, 2, 2))}, "occlusion has shape"),
    ],
)
def test_bad_media_are_refused_with_what_and_where(change, words):
    arguments = {"density": ONES, "voxel_size": 1, "sigma_s": 1, "sigma_a": 0, **change}
    with pytest.raises(MediumError, match=words):
        Medium(**arguments)


def test_domain_holds_its_box_centred_with_padding():
    domain = Domain.around((-1, 0, 2), (1, 1, 2.5), resolution=20, padding=2)
    assert domain.voxel_size == pytest.approx(2 / 16)
    assert domain.shape == (20, 12, 8)
    np.testing.assert_allclose(np.add(domain.origin, domain.upper) / 2, (0, 0.5, 2.25))


def test_domain_edges_that_divide_evenly_gain_no_voxel():
    assert Domain.around((0, 0, 0), (0.3, 0.3, 0.3), 7, padding=2).shape == (7, 7, 7)


def test_flat_selection_still_gets_a_layer():
    assert Domain.around((0, 0, 0), (1, 1, 0), 14, padding=2).shape == (14, 14, 5)


@pytest.mark.parametrize("resolution", [0, -3, 6])
def test_too_low_a_resolution_is_refused(resolution):
    with pytest.raises(MediumError, match="use 7 or more"):
        Domain.around((0, 0, 0), (1, 1, 1), resolution, padding=2)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("corner", [0, np.nan, np.inf])
def test_box_without_extent_is_refused(corner):
    with pytest.raises(MediumError, match="no extent"):
        Domain.around((corner, 0, 0), (corner, 0, 0), 64)


def test_voxel_centres_are_integers():
    domain = Domain((1, 2, 3), 0.5, (2, 3, 4))
    indices = np.stack(np.indices((2, 3, 4)), axis=-1)
    np.testing.assert_allclose(domain.to_index(domain.centers()), indices, atol=1e-12)
    matrix = domain.index_to_world
    np.testing.assert_allclose(indices @ matrix[:3, :3].T + matrix[:3, 3], domain.centers())


def test_paper_units_are_collision_probabilities():
    density = np.array([0, 0.5, 40.0]).reshape(3, 1, 1)
    medium = paper_units(Medium(density, 0.2, (3.0, 1.0), (1.0, 0.5), (0.1, 0.2)))
    p = medium.density[:, 0, 0]
    np.testing.assert_allclose(p, 1 - np.exp(-4.0 * 0.2 * density[:, 0, 0]), rtol=1e-6)
    np.testing.assert_allclose(medium.sigma_t, (1.0, 1.5 / 4))
    np.testing.assert_allclose(medium.albedo, (0.75, 1 / 1.5))


@pytest.mark.filterwarnings("error")
def test_paper_units_of_extremes_are_certainties():
    density = np.array([0, 1e-3, 3e38]).reshape(3, 1, 1)
    medium = paper_units(Medium(density, 3e38, 3e38, 3e38))
    np.testing.assert_array_equal(medium.density[:, 0, 0], [0, 1, 1])


def test_paper_units_of_vacuum_are_vacuum():
    vacuum = Medium(ONES, 0.2, 0, 0)
    assert paper_units(vacuum) is vacuum
