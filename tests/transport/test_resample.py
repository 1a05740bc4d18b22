# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of the light: uncollided light alone, and scattered light in larger voxels."""

import numpy as np
import pytest

from lb_lighting.errors import SettingsError
from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve
from lb_lighting.transport.medium import merged
from lb_lighting.transport.solver import require_memory
from tests.tracing import OPENCL, name

SUN = Sun((0.3, 0.2, -0.93), 2.0)
each_device = pytest.mark.parametrize("found", [None, *OPENCL], ids=lambda d: d and name(d))


def cloud(n=16, **changes):
    axis = (np.arange(n) + 0.5) / n * 2 - 1
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = np.maximum(0, 0.8 - x**2 - y**2 - z**2) * (1 + 0.3 * np.sin(9 * x))
    return Medium(density, 1 / n, **{"sigma_s": 9.9, "sigma_a": 0.1, "g": 0.5} | changes)


def total(energy):
    return {name: np.sum(power) for name, power in energy.items()}


@each_device
@pytest.mark.parametrize("lights", [[SUN], [Sky(1.0)], [PointLight((0.5, 0.4, 1.2), 5.0)]])
def test_single_scattering_is_the_unscattered_light_of_a_whole_solve(lights, found):
    medium = cloud()
    whole = solve(medium, lights, device=found and found.label)
    single = solve(medium, lights, Settings(scattering="single"), found and found.label)
    assert not single.fluence.any()
    assert not single.flux.any()
    np.testing.assert_allclose(single.by_light, whole.by_light, rtol=2e-6)
    np.testing.assert_allclose(single.direct_flux, whole.direct_flux, rtol=2e-6, atol=1e-6)
    assert single.report.steps == 0
    assert "solve" not in single.report.seconds
    energy = total(single.report.energy)
    assert energy["scattered"] > 0.1 * energy["entered"]
    parts = energy["absorbed"] + energy["left"] + energy["scattered"]
    assert parts == pytest.approx(energy["entered"], rel=1e-5)


def test_single_scattering_counts_what_opaque_voxels_reflect():
    occlusion = np.zeros((12,) * 3)
    occlusion[4:8, 4:8, 2:4] = 1
    medium = cloud(12, occlusion=occlusion, occlusion_albedo=0.5)
    energy = total(solve(medium, [SUN], Settings(scattering="single")).report.energy)
    parts = energy["absorbed"] + energy["left"] + energy["scattered"]
    assert parts == pytest.approx(energy["entered"], rel=1e-5)


def test_merged_voxels_keep_matter_where_edges_do_not_divide():
    density = np.random.default_rng(1).random((7, 4, 5))
    medium = Medium(density, 0.5, (1.0, 2.0), 0.1, origin=(1, 2, 3), emission=density)
    large = medium.merged(3)
    assert large.shape == (3, 2, 2)
    assert large.voxel_size == 1.5
    assert large.origin == (1, 2, 3)
    assert large.density.sum() * 27 == pytest.approx(density.sum(), rel=1e-6)
    assert large.emission[1].sum() * 27 == pytest.approx(density.sum(), rel=1e-6)
    assert large.density[0, 0, 0] == pytest.approx(density[:3, :3, :3].mean(), rel=1e-6)


def test_merged_opaque_voxels_reflect_what_they_did():
    rng = np.random.default_rng(2)
    occlusion, albedo = rng.random((4, 4, 4)), rng.random((1, 4, 4, 4))
    occlusion[:2, :2, :2] = 0
    medium = Medium(np.ones((4, 4, 4)), 1, 1, 0, occlusion=occlusion, occlusion_albedo=albedo)
    large = medium.merged(2)
    reflected = merged(occlusion * albedo[0], 2)
    np.testing.assert_allclose(large.occlusion * large.occlusion_albedo[0], reflected, rtol=1e-5)


@each_device
def test_merged_light_is_near_that_of_all_voxels(found):
    """Unscattered light stays exact; scattered light comes from an eighth of the voxels."""
    medium = cloud(24)
    whole = solve(medium, [SUN], device=found and found.label)
    large = solve(medium, [SUN], Settings(merge=2), found and found.label)
    np.testing.assert_allclose(large.direct, whole.direct, rtol=2e-6)
    error = np.linalg.norm(large.fluence - whole.fluence) / np.linalg.norm(whole.fluence)
    assert 1e-3 < error < 0.06
    assert large.fluence.mean() == pytest.approx(whole.fluence.mean(), rel=0.03)
    energy = total(large.report.energy)
    assert energy["absorbed"] + energy["left"] == pytest.approx(energy["entered"], rel=1e-3)


def test_merged_light_is_linear_between_large_voxels():
    """In a thin slab, where a solve in the large voxels gives the scattered light of each."""
    medium = cloud(20).altered(density=np.random.default_rng(3).random((20, 20, 9)))
    large = solve(medium.merged(3), [SUN]).fluence[0]
    fine = solve(medium, [SUN], Settings(merge=3)).fluence[0]
    assert fine.shape == (20, 20, 9)
    np.testing.assert_allclose(fine[1::3, 1::3, 1::3], large[..., :3], rtol=1e-6)
    third = (2 * large[0, 1, 1] + large[1, 1, 1]) / 3
    assert fine[2, 4, 4] == pytest.approx(third, rel=1e-5)
    assert fine[0, 0, 0] == pytest.approx(large[0, 0, 0], rel=1e-6)


def test_merged_photons_tell_their_noise():
    field = solve(cloud(), [SUN], Settings(merge=2, handover=1.0, photons=20_000))
    assert field.variance.shape == field.fluence.shape
    assert field.variance.max() > 0


def test_media_that_shift_light_between_bands_are_not_merged():
    shift = [[0, 0.5], [0, 0]]
    medium = cloud(12, sigma_a=(0.1, 0.5), shift=shift)
    whole, large = (solve(medium, [SUN], Settings(merge=m)) for m in (1, 2))
    np.testing.assert_array_equal(whole.fluence, large.fluence)


@pytest.mark.parametrize("pieces", [0, 65, 1.5])
def test_unfit_numbers_are_refused(pieces):
    with pytest.raises(SettingsError, match="merged along an edge"):
        Settings(merge=pieces)


def test_less_than_everything_is_planned_to_take_no_more_memory():
    whole, large, single = (
        require_memory((160,) * 3, settings)
        for settings in (Settings(), Settings(merge=2), Settings(scattering="single"))
    )
    assert single <= large <= whole
