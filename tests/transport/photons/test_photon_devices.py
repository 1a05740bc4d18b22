# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons on every device: the same as in NumPy, the same again, and what is refused.

Single paths part from those in float64 where rounding decides for another collision; the tests
say how many may.
"""

from dataclasses import replace

import numpy as np
import pytest

from lb_lighting.errors import (
    Cancelled,
    DeviceError,
    LightError,
    MediumError,
    SettingsError,
    SolverError,
)
from lb_lighting.transport import Medium, PointLight, Sky, Sun, device
from lb_lighting.transport.photons import schedule
from lb_lighting.transport.photons import trace as photons
from lb_lighting.transport.photons.free_path import SAMPLERS, path_grid
from lb_lighting.transport.photons.perlin import PerlinMedium
from lb_lighting.transport.photons.trace import trace
from tests.tracing import OPENCL, name

SHAPE, H = (7, 5, 6), 0.3
LIGHTS = [Sun((0.3, -0.5, -0.8), 2.0), Sky(0.2), PointLight((0.7, 0.5, 0.4), 1.0)]
on_every_device = pytest.mark.parametrize("found", OPENCL, ids=name)
KINDS = ("fluence", "direct", "flux")


def lumpy(seed=0, shape=SHAPE, **options):
    rng = np.random.default_rng(seed)
    density = rng.uniform(0, 3, shape) * (rng.random(shape) > 0.3)
    return Medium(density, H, 1.6, 0.4, 0.7, origin=(-0.5, -0.2, -0.3), **options)


def among_opaque():
    """Lumpy, with voxels that stop some light or all of it and reflect from none to all of it."""
    rng = np.random.default_rng(7)
    occlusion = rng.choice([0, 0.4, 1], SHAPE, p=[0.6, 0.25, 0.15])
    albedo = rng.choice([0, 0.5, 1], (1, *SHAPE))
    return lumpy(occlusion=occlusion, occlusion_albedo=albedo)


def noise(**options):
    return PerlinMedium(16, 1.5, 4.0, 1.0, -0.5, cutoff=0.3, **options)


def off(values, expected):
    """The mean difference as a share of the mean; 0 where both are nothing."""
    difference = np.abs(values - expected).sum()
    return difference / np.abs(expected).sum() if difference else 0.0


@pytest.fixture
def assert_twins(monkeypatch):
    """The same seed gives the same paths in NumPy, but for those that rounding parts."""
    # Few batches, as NumPy takes its time for each; and the bound of one device for all, as their
    # own differ by rounding.
    monkeypatch.setattr(schedule, "_MOST_BATCHES", 2)
    monkeypatch.setattr(schedule, "_FEWEST_BATCHES", 2)
    grid = photons.path_grid
    monkeypatch.setattr(photons, "path_grid", lambda *options: grid(*options[:-1], OPENCL[0]))

    def compare(medium, found, lights=LIGHTS, parted=0.02, **options):
        one, other = (
            trace(medium, lights, 2000, seed=5, device=where, **options)
            for where in (found.label, "NumPy")
        )
        for kind in KINDS:
            assert off(getattr(one, kind), getattr(other, kind)) < parted
        assert off(np.sqrt(one.variance), np.sqrt(other.variance)) < parted
        for kind in ("power", "position", "direction") if one.collision_source else ():
            assert (
                off(getattr(one.collision_source, kind), getattr(other.collision_source, kind))
                < parted
            )
        first, second = one.report, other.report
        assert (first.photons, first.lost) == (second.photons, second.lost)
        assert first.collisions[0] == pytest.approx(second.collisions[0], rel=parted)
        for where, power in first.energy.items():
            assert np.allclose(power, second.energy[where], 0, parted * first.energy["entered"][0])
        # And nearly all paths do not part at all.
        assert np.isclose(one.fluence, other.fluence, 1e-4, 1e-6).mean() > 0.9

    return compare


@on_every_device
@pytest.mark.parametrize("interpolation", ["constant", "linear"])
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_kernel_follows_its_twin(found, sampler, interpolation, assert_twins):
    assert_twins(lumpy(), found, sampler=sampler, interpolation=interpolation, supervoxel=3)


@on_every_device
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_kernel_follows_its_twin_in_noise(found, sampler, assert_twins):
    assert_twins(noise(), found, LIGHTS[:1], sampler=sampler, tallied=5)


@on_every_device
@pytest.mark.parametrize(
    "options",
    [{"handover": 1}, {"handover": 2}, {"spacing": 0.37}, {"most_steps": 3}, {"direct": False}],
    ids=str,
)
def test_kernel_follows_its_twin_to_the_end(found, options, assert_twins):
    assert_twins(lumpy(), found, **options)


@on_every_device
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_kernel_follows_its_twin_among_opaque_voxels(found, sampler, assert_twins):
    assert_twins(among_opaque(), found, sampler=sampler, supervoxel=3)


@on_every_device
@pytest.mark.parametrize("options", [{"handover": 2, "direct": False}, {"most_steps": 3}], ids=str)
def test_kernel_follows_its_twin_to_the_end_among_opaque_voxels(found, options, assert_twins):
    assert_twins(among_opaque(), found, **options)


@on_every_device
@pytest.mark.parametrize(
    "optics", [(2.0, 0.0, 0.0), (0.0, 2.0, 0.3), (0.02, 2.0, -0.9), (2.0, 0.1, 5e-4)], ids=str
)
def test_kernel_follows_its_twin_in_every_material(found, optics, assert_twins):
    assert_twins(Medium(lumpy().density, H, *optics), found, LIGHTS[1:2])


@on_every_device
@pytest.mark.parametrize("handover", [None, 1])
def test_seed_gives_the_same_field_again(found, handover):
    first, again, other = (
        trace(lumpy(), LIGHTS, 20_000, seed=seed, device=found.label, handover=handover)
        for seed in (3, 3, 4)
    )
    for kind in (*KINDS, "variance"):
        assert np.array_equal(getattr(first, kind), getattr(again, kind))
    assert not np.array_equal(first.direct, other.direct)
    if handover:
        assert np.array_equal(first.collision_source.position, again.collision_source.position)
        assert not np.array_equal(first.collision_source.position, other.collision_source.position)
    else:
        assert not np.array_equal(first.fluence, other.fluence)


@on_every_device
def test_new_densities_and_noises_need_no_new_program(found):
    options = {"photons": 100, "device": found.label}
    trace(lumpy(), LIGHTS, **options)
    trace(noise(), LIGHTS, **options)
    trace(among_opaque(), LIGHTS, **options)
    built = device.program.cache_info().misses
    trace(lumpy(seed=1), LIGHTS, **options)
    trace(lumpy(seed=2, shape=(4, 9, 3)), LIGHTS, **options)
    trace(lumpy(), LIGHTS[:1], seed=8, spacing=0.5, handover=2, most_steps=99, **options)
    walls = np.eye(5)[:, :, None] * np.ones(4)
    trace(Medium(walls, H, 1.0, 1.0, occlusion=walls / 2, occlusion_albedo=0.3), LIGHTS, **options)
    for changed in ({"time": 0.5}, {"time": 7.0}, {"seed": 9}):
        trace(noise(**changed), LIGHTS, **options)
    trace(PerlinMedium(32, 9.0, (1.0, 3.0), 0.5, 0.2, power=3.0), LIGHTS, **options)
    assert device.program.cache_info().misses == built


@on_every_device
def test_endless_paths_are_given_up_and_counted(found):
    medium = Medium(np.full((3, 3, 3), 1e6), 1.0, 1.0, 0.0)
    report = trace(medium, [Sky(1)], 320, device=found.label, most_steps=1000).report
    assert 0 < report.lost <= report.photons
    entered = report.energy["entered"][0]
    assert report.energy["lost"][0] == pytest.approx(entered * report.lost / report.photons)
    assert report.energy["lost"][0] + report.energy["left"].sum() == pytest.approx(entered)
    assert trace(lumpy(), [Sky(1)], 320, device=found.label).report.lost == 0


@pytest.mark.parametrize(
    "options",
    [
        {"photons": 0},
        {"photons": -5},
        {"handover": 0},
        {"handover": -1},
        {"spacing": 0.0},
        {"spacing": 1e-9},
        {"most_steps": 0},
        {"most_steps": 2**31},
        {"spacing": -1.0},
        {"spacing": np.nan},
        {"spacing": np.inf},
        {"sampler": "teleport"},
        {"interpolation": "cubic"},
        {"supervoxel": 0},
    ],
    ids=str,
)
def test_senseless_settings_are_refused(options):
    with pytest.raises(SettingsError):
        trace(lumpy(), LIGHTS, **{"photons": 10, **options})


@pytest.mark.parametrize("tallied", [-1, 0, 2.5, 17, 10**9])
def test_field_of_noise_has_a_sensible_resolution(tallied):
    with pytest.raises(SettingsError, match="whole number from 1 to 16"):
        trace(noise(), LIGHTS, 10, tallied=tallied)


def test_field_of_noise_has_the_resolution_asked_for():
    for tallied, edge in ((None, 16), (1, 1), (7, 7)):
        field = trace(noise(), LIGHTS, 100, tallied=tallied)
        assert field.fluence.shape == (1, edge, edge, edge)
        assert field.domain.voxel_size * edge == pytest.approx(1.5)


@pytest.mark.parametrize("found", device.devices(), ids=name)
def test_bound_that_is_too_low_is_refused(found, monkeypatch):
    def lowered(*options):
        grid = path_grid(*options)
        values = grid.majorants.values * np.float32(0.9)
        return replace(grid, majorants=replace(grid.majorants, values=values))

    monkeypatch.setattr(photons, "path_grid", lowered)
    with pytest.raises(SolverError, match="above its majorant"):
        trace(lumpy(), LIGHTS, 1000, device=found)


def test_interpolated_density_among_opaque_voxels_is_refused():
    with pytest.raises(MediumError, match="interpolat"):
        trace(among_opaque(), LIGHTS, 10, interpolation="linear")


def test_no_lights_are_refused():
    with pytest.raises(LightError):
        trace(lumpy(), [], 10)


def test_unknown_device_is_refused():
    with pytest.raises(DeviceError, match="no device called 'abacus'"):
        trace(lumpy(), LIGHTS, 10, device="abacus")


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("limits", [{"memory": 10**6}, {"largest_buffer": 10**5}], ids=str)
def test_too_small_a_device_is_refused_before_anything_is_allocated(sampler, limits, monkeypatch):
    small = replace(OPENCL[0], **limits)
    monkeypatch.setattr(device, "context", None)  # nobody may ask for it
    with pytest.raises(DeviceError, match="largest resolution that fits"):
        trace(lumpy(shape=(40, 40, 40)), LIGHTS, 10, sampler, device=small)


def test_flux_can_be_left_out():
    whole, less = (trace(lumpy(), LIGHTS, 1000, flux=flux, seed=1) for flux in (True, False))
    assert less.flux is None
    assert np.array_equal(whole.fluence, less.fluence)
    assert np.array_equal(whole.variance, less.variance)
    assert less.report.bytes < whole.report.bytes


def test_bytes_are_those_of_the_plan():
    few, many = (trace(lumpy(), LIGHTS, 10, handover=last).report.bytes for last in (None, 1))
    assert 0 < few < many


@on_every_device
def test_progress_rises_to_the_end(found):
    reports = []
    trace(lumpy(), LIGHTS, 3200, device=found.label, progress=lambda *stage: reports.append(stage))
    fractions = [fraction for _, fraction in reports]
    assert {stage for stage, _ in reports} == {"trace"}
    assert fractions == sorted(fractions)
    assert 0 < fractions[0] < 0.1
    assert fractions[-1] == 1


@on_every_device
def test_cancelled_at_once(found):
    calls = []

    def cancel():
        calls.append(None)
        return len(calls) == 3

    with pytest.raises(Cancelled):
        trace(lumpy(), LIGHTS, 10**7, device=found.label, cancel=cancel)
    assert len(calls) == 3
