# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures against closed forms, and the kernel against its NumPy twin."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lb_lighting.errors import LightError, MediumError, SettingsError, SolverError
from lb_lighting.transport import Medium, PerlinMedium, PointLight, Sky, Sun, device
from lb_lighting.transport.preview import pictures as preview
from lb_lighting.transport.preview.pictures import View, _Camera, pictures
from tests.statistics import normal

NUMPY = device.devices()[-1]
OPENCL = device.devices()[:-1]
on_each_device = pytest.mark.parametrize(
    "found", device.devices(), ids=lambda found: found.platform.split(",")[0]
)
on_each_opencl = pytest.mark.parametrize(
    "found", OPENCL, ids=lambda found: found.platform.split(",")[0]
)

# Every statistical test here has this probability to fail by chance, had it another seed.
FALSE_ALARM = 1e-4

DOWN = (0, 0, -1)


def slab(depth, albedo, g=0.0, wide=101):
    """One layer of voxels of 1 m, `depth` deep; its middle is at the origin of x and y."""
    origin = (-wide / 2, -wide / 2, 0)
    return Medium(np.ones((wide, wide, 1)), 1.0, albedo * depth, (1 - albedo) * depth, g, origin)


def from_above(pixels=64, height=0.1):
    """A view of `height` m in the middle of a slab, far from its sides."""
    matrix = np.eye(4)
    matrix[2, 3] = 2
    return View(matrix, height, (pixels, pixels))


def patchy(**options):
    """(7, 5, 6) voxels with voids, in one band."""
    rng = np.random.default_rng(1)
    density = np.where(rng.random((7, 5, 6)) < 0.4, 0, rng.random((7, 5, 6)))
    options = {"sigma_s": 12.0, "sigma_a": 1.0, "g": 0.4, "origin": (1, -2, 0.5)} | options
    return Medium(density, 0.25, **options)


def whole(medium, lights, view, samples=1, **options):
    """The pixels of the picture that has so many samples in each."""
    *_, last = until(samples, pictures(medium, lights, view, **options))
    return last.pixels


def until(samples, running):
    """Pictures up to the one with so many samples in each pixel."""
    several = [next(running)]
    while several[-1].samples < samples:
        several.append(next(running))
    running.close()
    return several


def assert_mean(values, expected):
    """`values` are independent, one a path or more."""
    values = np.ravel(values).astype(float)
    error = values.std(ddof=1) / np.sqrt(values.size)
    assert error < 0.05 * expected  # the test can fail
    assert normal((values.mean() - expected) / error) > FALSE_ALARM, (values.mean(), expected)


@on_each_device
@pytest.mark.parametrize("sampler", ["ray_march", "woodcock", "supervoxel_linear"])
def test_single_scattering_of_a_slab(found, sampler):
    depth, albedo, g, cosine, irradiance = 1.5, 0.8, 0.5, 0.6, 2.0
    sun = Sun((0.8, 0, -cosine), irradiance)
    options = {"device": found, "sampler": sampler, "scatterings": 1, "seed": 3}
    pixels = whole(slab(depth, albedo, g), [sun], from_above(), **options)
    phase = (1 - g**2) / (4 * np.pi * (1 + g**2 + 2 * g * cosine) ** 1.5)
    through = 1 + 1 / cosine
    expected = albedo * phase * irradiance / through * -np.expm1(-depth * through)
    assert np.array_equal(pixels[..., 0], pixels[..., 2])
    assert_mean(pixels[..., 0], expected)
    assert_mean(pixels[..., 3], -np.expm1(-depth))


@pytest.mark.parametrize(
    ("g", "depth", "albedo", "reflected", "passed"),
    [
        (0.0, 1, 0.9, 0.267410, 0.591625),
        (0.0, 5, 0.99, 0.680078, 0.220628),
        (0.75, 2, 0.9, 0.097395, 0.660958),
        (0.85, 20, 0.99, 0.440926, 0.230122),
    ],
)
def test_all_scattering_of_a_slab_under_an_even_sky(g, depth, albedo, reflected, passed):
    """What is seen at the normal is, by reciprocity, what a beam at the normal gives back on both
    sides; that by adding and doubling, less the beam itself."""
    pixels = whole(slab(depth, albedo, g), [Sky(1.0)], from_above(), 4, seed=4)
    assert_mean(pixels[..., 1], reflected + passed - np.exp(-depth))


def test_all_scattering_of_a_sun_in_half_a_space():
    """Chandrasekhar, Radiative Transfer, 1950: L = a/4 E/pi H(1)^2 / 2 at the normal, under a sun
    there. H(1) is that of the reflectance 1 - sqrt(1 - a) H(1) = .414947."""
    albedo = 0.9
    h = (1 - 0.414947) / np.sqrt(1 - albedo)
    medium = slab(40, albedo)
    pixels = whole(medium, [Sun(DOWN, 1.0)], from_above(), 2, seed=2)
    assert_mean(pixels[..., 0], albedo / 8 / np.pi * h**2)


@on_each_device
@pytest.mark.parametrize("sky", [Sky(0.7), Sky(lambda towards: 0.7 + 0 * towards[..., 2])])
def test_white_furnace(found, sky):
    medium = patchy(sigma_a=0.0)
    view = View.onto(medium.domain, (1, 2, -1), size=(24, 20))
    pixels = whole(medium, [sky], view, device=found)
    assert 0.1 < pixels[..., 3].mean() < 0.9
    assert np.allclose(pixels[..., :3], 0.7 * pixels[..., 3:], rtol=1e-6, atol=0)


def test_white_furnace_of_noise():
    medium = PerlinMedium(64, 1.0, 40.0, 0.0, 0.3, cutoff=0.4, power=2.0)
    view = View.onto(medium.domain, (1, 2, -1), size=(48, 40))
    pixels = whole(medium, [Sky(0.7)], view)
    assert 0.1 < pixels[..., 3].mean() < 0.9
    assert np.allclose(pixels[..., :3], 0.7 * pixels[..., 3:], rtol=1e-6, atol=0)


def test_point_light_within():
    """Along one ray, at a distance b from the light: the integral of what scatters once."""
    sigma, power, b = 0.8, 5.0, 0.3
    shape = (41, 41, 3)
    medium = Medium(np.ones(shape), 1.0, sigma, 0.0, origin=(-20.5, -20.5, -1.5))
    light = PointLight((b, 0, 0), power)
    pixels = whole(medium, [light], from_above(height=1e-6), 4, scatterings=1, seed=5)
    z = (np.arange(20_000) + 0.5) / 20_000 * 3 - 1.5
    distance = np.hypot(z, b)
    along = sigma * np.exp(-sigma * (1.5 - z + distance)) / (4 * np.pi * distance) ** 2 * power
    assert_mean(pixels[..., 0], along.mean() * 3)


def test_a_point_light_far_away_is_a_sun():
    medium = patchy()
    center = np.add(medium.origin, 0.7)
    toward = np.array((0.6, 0, 0.8))
    lights = Sun(-toward, 3.0), PointLight(center + 1e4 * toward, 3.0 * 4 * np.pi * 1e8)
    view = View.onto(medium.domain, (1, 2, -1), size=(40, 30))
    sun, point = (whole(medium, [light], view)[..., 0] for light in lights)
    assert sun.max() > 0
    assert np.mean(np.isclose(sun, point, rtol=2e-3)) > 0.99


@pytest.mark.parametrize("sigma", [0.0, 1.7])
def test_emission_along_a_ray(sigma):
    """In a vacuum it adds up, and covers nothing."""
    medium = slab(sigma, 0.0, wide=5).altered(emission=np.full((5, 5, 1), 3.0))
    pixels = whole(medium, [], from_above(), seed=2)
    expected = 3 / (4 * np.pi) * (-np.expm1(-sigma) / sigma if sigma else 1)
    if sigma:
        assert_mean(pixels[..., 0], expected)
    else:
        assert np.allclose(pixels[..., 0], expected, rtol=1e-5)
        assert not pixels[..., 3].any()


def wall(**options):
    """A layer that is opaque under two that are not."""
    occlusion = np.zeros((9, 9, 3))
    occlusion[:, :, 0] = 1
    return Medium(
        np.zeros((9, 9, 3)),
        1.0,
        1.0,
        0.0,
        origin=(-4.5, -4.5, -2),
        occlusion=occlusion,
        occlusion_albedo=0.4,
        **options,
    )


@on_each_device
def test_opaque_voxels_reflect_by_the_cosine(found):
    pixels = whole(wall(), [Sun((0.8, 0, -0.6), 5.0)], from_above(16), device=found)
    assert np.allclose(pixels[..., :3], 0.4 * 5 * 0.6 / np.pi, rtol=1e-5)
    assert np.all(pixels[..., 3] == 1)
    behind = whole(wall(), [Sun((0.8, 0, 0.6), 5.0)], from_above(16), device=found)
    assert not behind[..., :3].any()
    lit = whole(wall(), [Sky(2.0)], from_above(16), device=found)
    assert np.allclose(lit[..., :3], 0.4 * 2, rtol=1e-5)


def test_scenes_of_the_twins_have_all_that_can_be():
    """So that the next test compares it."""
    look = scene("voxels", NUMPY)
    assert look.eye.emission.any()
    assert look.eye.opaque[0].any()
    assert len(look.eye.lights) == 2


def scene(name, found, scatterings=2**30):
    if name == "noise":
        medium = PerlinMedium(32, 1.5, 30.0, 2.0, 0.3, cutoff=0.4, power=2.0, origin=(1, -2, 0))
    else:
        occlusion = np.zeros((7, 5, 6))
        occlusion[2:4, 2, 1:3], occlusion[5] = 1, 0.3
        emission = np.zeros((7, 5, 6))
        emission[4, 1:3, 3] = 2.0
        medium = patchy(occlusion=occlusion, occlusion_albedo=0.5, emission=emission)
    lights = [Sun((0.3, 0.2, -0.9), 2.0), PointLight((1.8, -1.4, 1.5), 3.0), Sky(0.2)]
    view = View.onto(medium.domain, (1, 2, -1), size=(40, 30))
    return _Camera(medium, lights, view, found, "supervoxel_constant", scatterings)


@cache
def looks(name, found, scatterings, stream=7):
    """(1200, 4): what the pixels of a scene see."""
    within = np.random.default_rng(2).random((1200, 2))
    return scene(name, found, scatterings)(np.arange(1200), within, stream)


@on_each_opencl
@pytest.mark.parametrize("name", ["voxels", "noise"])
@pytest.mark.parametrize("scatterings", [2, 2**30])
def test_kernel_does_as_its_twin(found, name, scatterings):
    """Path by path, as both draw the same numbers; float32 turns a decision now and then, and the
    more collisions a path has, the more of them."""
    first, second = looks(name, found, scatterings), looks(name, NUMPY, scatterings)
    assert 0.2 < second[:, 3].mean() < 0.9
    same = np.isclose(first, second, rtol=5e-3, atol=1e-4).all(axis=1)
    assert same[second[:, 3] > 0].mean() > 0.97
    other = looks(name, found, scatterings, stream=8)
    assert np.isclose(other, second, rtol=5e-3, atol=1e-4).all(axis=1).mean() < 0.9


def test_bands_are_those_of_media_of_one():
    """Light that scattered once: no roulette, which the brightest band decides."""
    sigma_s, sigma_a, g = (9.0, 5.0, 9.0), (1.0, 4.0, 1.0), (0.5, -0.2, 0.5)
    colors = (1.0, 0.5, 0.2)
    medium = patchy(sigma_s=sigma_s, sigma_a=sigma_a, g=g)
    view = View.onto(medium.domain, (1, 2, -1), size=(24, 20))
    lights = [Sun((0.3, 0.2, -0.9), colors), Sky(colors)]
    together = whole(medium, lights, view, scatterings=1, seed=9)
    assert together[..., 1].any()
    met = 0
    for n in range(3):
        alone = patchy(sigma_s=sigma_s[n], sigma_a=sigma_a[n], g=g[n])
        lights = [Sun((0.3, 0.2, -0.9), colors[n]), Sky(colors[n])]
        picture = whole(alone, lights, view, scatterings=1, seed=9)
        assert np.allclose(together[..., n], picture[..., 0], rtol=1e-6)
        met = met + picture[..., 3] / 3
    assert np.allclose(together[..., 3], met, rtol=1e-6)


def test_pictures_are_coarse_first_and_the_same_for_a_seed():
    medium = patchy()
    view = View.onto(medium.domain, (1, 2, -1), size=(40, 30))
    lights = [Sun(DOWN, 1.0)]
    several = until(2, pictures(medium, lights, view, seed=6))
    first = several[0]
    assert first.samples == pytest.approx(1 / 64, rel=0.25)
    assert np.array_equal(first.pixels[1:8, 1:8], np.broadcast_to(first.pixels[0, 0], (7, 7, 4)))
    samples = [picture.samples for picture in several]
    assert sorted(set(samples)) == samples
    assert {1, 2} <= set(samples)
    assert several[-1].lost == 0
    one, again, other = (whole(medium, lights, view, 2, seed=seed) for seed in (6, 6, 7))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert np.array_equal(several[-1].pixels, one)


def test_pictures_go_on():
    """However quick they are."""
    medium = patchy()
    running = pictures(medium, [], View.onto(medium.domain, DOWN, size=(2, 2)), seed=1)
    assert until(600, running)[-1].samples == 600


def test_pictures_can_be_stopped():
    running = pictures(patchy(), [Sky(1.0)], View.onto(patchy().domain, DOWN, size=(8, 8)))
    next(running)
    running.close()
    with pytest.raises(StopIteration):
        next(running)


def test_views_show_all_of_a_domain_the_right_way_up():
    """The lower row comes first; the camera looks north, so that east is to the right."""
    density = np.zeros((4, 4, 4))
    density[3, :, 0] = 1  # east, at the bottom
    medium = Medium(density, 1.0, 0.0, 1e6)
    for view in (
        View.onto(medium.domain, (0, 1, 0), size=(4, 4)),
        View([[1, 0, 0, 2], [0, 0, -1, -1e4], [0, 1, 0, 2]], 4e-4, (4, 4), perspective=True),
    ):
        seen = whole(medium, [], view)[..., 3]
        expected = np.zeros((4, 4))
        expected[0, 3] = 1
        assert np.array_equal(seen, expected)
    for direction in [(1, 2, -1), DOWN, (0, 0, 1), (-1, 0, 0)]:
        full = Medium(np.ones((6, 3, 4)), 1.0, 0.0, 1e6, origin=(5, 5, 5))
        view = View.onto(full.domain, direction, size=(60, 40))
        seen = whole(full, [], view)[..., 3]
        area = np.abs(np.divide(direction, np.linalg.norm(direction))) @ (12, 24, 18)
        assert seen.sum() * (view.height / 40) ** 2 == pytest.approx(area, rel=0.05)


def test_what_cannot_be_shown_is_refused():
    medium = patchy()
    view = View.onto(medium.domain, DOWN)
    two = patchy(sigma_s=(1.0, 2.0))
    with pytest.raises(MediumError, match="one band or three"):
        next(pictures(two, [], view))
    with pytest.raises(LightError, match="suns, skies and point lights"):
        next(pictures(medium, ["lamp"], view))
    with pytest.raises(SettingsError, match="scatterings"):
        next(pictures(medium, [], view, scatterings=0))
    with pytest.raises(SettingsError, match="matrix"):
        View(np.eye(3), 1.0)
    with pytest.raises(SettingsError, match="pixels"):
        View(np.eye(4), 1.0, (0, 4))


def test_bounds_that_do_not_hold_are_refused():
    look = scene("voxels", NUMPY)
    lowered = replace(look.grid.majorants, values=look.grid.majorants.values / 2)
    look.eye.grid = replace(look.grid, majorants=lowered)
    with pytest.raises(SolverError, match="above its majorant"):
        look(np.arange(1200), np.full((1200, 2), 0.5), 1)


@on_each_device
def test_paths_that_take_too_many_steps_are_counted(found, monkeypatch):
    """A ray crosses three super-voxels of one voxel here, and leaves in the third step."""
    medium = Medium(np.zeros((3, 3, 3)), 1.0, 1.0, 0.0)
    for most, lost in ((4, 0), (3, 1), (1, 1)):
        monkeypatch.setattr(preview, "_MOST_STEPS", most)
        options = {"device": found, "sampler": "ray_march"}
        view = View.onto(medium.domain, DOWN, size=(16, 16))
        *_, last = until(1, pictures(medium, [Sky(1.0)], view, **options))
        assert last.lost == lost
        assert not last.pixels.any()
