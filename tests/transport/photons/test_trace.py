# SPDX-License-Identifier: GPL-3.0-or-later
"""What a trace returns: light by voxel, its variance, its energy, its collision source.

Each test would fail by chance for at most one seed in 10 000, see tests/tracing.py.
"""

from functools import cache
from statistics import NormalDist

import numpy as np
import pytest

from lb_lighting.transport import Medium, PointLight, Sky, Sun
from lb_lighting.transport.photons.free_path import SAMPLERS
from lb_lighting.transport.photons.perlin import PerlinMedium
from lb_lighting.transport.photons.trace import trace
from tests.tracing import FALSE_ALARM, Beam, assert_mean, assert_near, assert_same_light

SHAPE, H = (7, 6, 5), 0.2  # voxels, m
SUN = Sun((0.3, 0.2, -0.93), 2.0)


def patchy(sigma_s=1.5, sigma_a=0.5, g=0.4):
    """A third of the voxels void, the others 2 free paths thick at most."""
    rng = np.random.default_rng(4)
    density = rng.uniform(0.05, 5, SHAPE) * (rng.random(SHAPE) > 1 / 3)
    return Medium(density, H, sigma_s, sigma_a, g, origin=(-1, 0, 2))


@cache
def reference(interpolation="constant"):
    """The light of a patchy medium by marching through it."""
    lights = [SUN, Sky(0.1)]
    return trace(patchy(), lights, 200_000, "ray_march", 90, interpolation=interpolation)


@pytest.mark.parametrize("supervoxel", [1, 2, 3, None])
@pytest.mark.parametrize("sampler", SAMPLERS[1:])
def test_samplers_find_the_same_light(sampler, supervoxel):
    field = trace(patchy(), [SUN, Sky(0.1)], 100_000, sampler, 7, supervoxel=supervoxel)
    assert_same_light(field, reference())


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_interpolated_density_gives_the_same_light_by_every_sampler(sampler):
    field = trace(patchy(), [SUN, Sky(0.1)], 100_000, sampler, 2, interpolation="linear")
    assert_same_light(field, reference("linear"))
    with pytest.raises(AssertionError):  # as it is another medium
        assert_same_light(field, reference())


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("interpolation", ["constant", "linear"])
def test_homogeneous_absorber_attenuates_each_band(sampler, interpolation):
    """Voxels hold the mean of exp(-sigma z) over themselves."""
    sigma, power = np.array([0.0, 0.3, 2.0, 9.0]), (1.0, 3.0, 2.0, 5.0)
    medium = Medium(np.ones((3, 4, 8)), H, 0.0, sigma)
    beam, photons = Beam((0.25, 0.45, 0), (0, 0, 1), spectrum=power), 100_000
    options = {"sampler": sampler, "interpolation": interpolation}
    field = trace(medium, [beam], photons, seed=6, **options)
    assert not field.fluence.any()
    assert field.direct[:, 1, 2].sum() == pytest.approx(field.direct.sum())
    found = field.direct[:, 1, 2] * H**2 / np.reshape(power, (4, 1))

    borders = np.exp(-np.outer(sigma, np.arange(9) * H))
    expected = np.ones((4, 8))
    expected[1:] = (borders[1:, :-1] - borders[1:, 1:]) / (sigma[1:, None] * H)
    # A photon is scored once in each voxel that it lives to cross: that is Bernoulli's law.
    error = np.hypot(np.sqrt(expected * (1 - expected) / photons), 1e-6 * expected)
    assert_near(found - expected, error, photons)


def test_noise_has_the_light_of_its_voxels():
    noise = PerlinMedium(8, 1.0, 6.0, 1.0, 0.3, cutoff=0.3, power=2.0, seed=3)
    voxels = noise.voxels(32)  # within a cell of the noise four samples an edge follow it

    def light(medium, seed, **options):
        field = trace(medium, [SUN, Sky(0.2)], 20_000, seed=seed, **options)
        blocks = (field.fluence + field.direct)[0].reshape((4, len(field.direct[0]) // 4) * 3)
        return blocks.mean(axis=(1, 3, 5))

    first = np.array([light(noise, seed, tallied=8) for seed in range(10)], float)
    second = np.array([light(voxels, seed) for seed in range(20, 30)], float)
    error = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / 10)
    error = np.hypot(error, 2e-3 * first.mean(axis=0))  # what voxels make of noise
    assert_near(first.mean(axis=0) - second.mean(axis=0), error, 9)
    assert np.all(error < 0.03 * first.mean(axis=0))


@pytest.mark.parametrize("spacing", [0.3, 5.0])
def test_spacing_of_scores_changes_nothing_but_the_noise(spacing):
    field = trace(patchy(), [SUN, Sky(0.1)], 100_000, seed=5, spacing=spacing)
    assert_same_light(field, reference())
    # Scored at most once, .3 times on average: .5 % for so many photons, and five times that.
    assert field.direct.sum() == pytest.approx(reference().direct.sum(), rel=0.025)
    other = trace(patchy(), [SUN, Sky(0.1)], 100_000, seed=5)
    assert (field.variance.mean() < other.variance.mean()) == (spacing < 1)


def test_direct_light_can_be_left_out():
    """The escaped light is the same, and so is the collision source."""
    field = trace(patchy(), [SUN, Sky(0.1)], 100_000, seed=3, direct=False)
    assert_same_light(field, reference())
    assert not field.direct.any()
    assert field.report.photons == pytest.approx(100_000, rel=0.01)
    fields = [
        [trace(patchy(), [SUN], 4096, seed=seed, direct=direct, handover=2) for seed in seeds]
        for direct, seeds in ((False, range(24)), (True, range(30, 54)))
    ]
    one, other = (np.array([f.collision_source.power[0] for f in of], float) for of in fields)
    error = np.sqrt((one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / 24)
    assert_near(one.mean(axis=0) - other.mean(axis=0), error, 23)
    assert field.report.bytes < reference().report.bytes


@pytest.mark.parametrize("direct", [True, False])
def test_variance_is_that_of_other_seeds(direct):
    """The spread of independent traces over the mean of the variances they tell: chi^2."""
    medium, seeds = patchy(), 60
    fields = [trace(medium, [SUN], 1024, seed=seed, direct=direct) for seed in range(seeds)]
    spread = np.var([field.fluence for field in fields], axis=0, ddof=1)
    ratio = spread / np.mean([field.variance for field in fields], axis=0, dtype=float)
    # Wilson and Hilferty 1931; Bonferroni, as voxels that share photons depend on each other.
    freedom = seeds - 1
    z = (np.cbrt(ratio) - (1 - 2 / (9 * freedom))) / np.sqrt(2 / (9 * freedom))
    assert np.abs(z).max() < NormalDist().inv_cdf(1 - FALSE_ALARM / 2 / z.size)
    # All voxels together tell smaller errors; two standard deviations of one are five of all.
    assert abs(ratio.mean() - 1) < np.sqrt(2 / freedom)


def test_one_photon_tells_no_variance():
    field = trace(patchy(), [SUN], 1)
    assert field.report.photons == 1
    assert np.all(np.isinf(field.variance))


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.parametrize("photons", [1, 2, 31, 33, 1000])
def test_any_number_of_photons_carries_all_power(photons, direct):
    report = trace(patchy(), [Sky(0.5)], photons, direct=direct).report
    # Without direct light every batch has four paths or more.
    assert abs(report.photons - photons) <= (16 if direct else 4 * 32)
    edges = np.multiply(SHAPE, H)
    entered = np.pi * 0.5 * 2 * (edges.prod() / edges).sum()
    assert report.energy["entered"][0] == pytest.approx(entered, rel=1e-5)


def test_light_is_linear_in_its_power():
    one, two, three = (
        trace(patchy(), [Sun(SUN.direction, power)], 2000, seed=3) for power in (1, 2, 3)
    )
    for kind in ("fluence", "direct", "flux"):
        assert np.array_equal(getattr(two, kind), 2 * getattr(one, kind))
        largest = one.fluence.max()
        assert np.allclose(getattr(three, kind), 3 * getattr(one, kind), 1e-5, 1e-5 * largest)
    assert np.allclose(two.variance, 4 * one.variance, rtol=1e-6)


@pytest.mark.parametrize("handover", [None, 2])
def test_no_energy_is_lost_or_made(handover):
    medium, edges = patchy(), np.multiply(SHAPE, H)
    gaps = []
    for seed in range(24):
        field = trace(medium, [SUN], 4096, seed=seed, handover=handover)
        energy = {where: np.sum(power) for where, power in field.report.energy.items()}
        toward = np.abs(SUN.direction) / np.linalg.norm(SUN.direction)
        assert energy["entered"] == pytest.approx(2 * toward @ (edges.prod() / edges), rel=1e-5)
        parts = energy["absorbed"] + energy["left"] + energy["handover"] + energy["lost"]
        assert parts == pytest.approx(energy["entered"], rel=1e-6)
        assert energy["lost"] == field.report.lost == 0
        assert (energy["handover"] > 0) == (handover is not None)
        light = (field.fluence + field.direct)[0].astype(float)
        absorbed = medium.sigma_a[0] * (medium.density * light).sum() * H**3
        gaps.append(absorbed / energy["absorbed"] - 1)
    assert_mean(gaps, 0)
    assert np.std(gaps) < 0.03


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_flux_is_the_energy_that_flows(axis, sign):
    """Through every layer of a slab flows what leaves it behind and is absorbed in between."""
    width, layers, h = 31, 4, 0.5
    shape = np.full(3, width)
    shape[axis] = layers
    direction = sign * np.eye(3)[axis]
    medium = Medium(np.ones(shape), h, 2.5, 0.5, 0.6)
    start = shape * h / 2
    start[axis] = 0 if sign > 0 else layers * h
    across = tuple(n for n in range(3) if n != axis)
    gaps, sideways = [], []
    for seed in range(24):
        field = trace(medium, [Beam(tuple(start), tuple(direction))], 2048, seed=seed)
        left = field.report.energy["left"][0].reshape(3, 2)
        assert left[across, :].sum() < 1e-3
        flow = field.flux[0].astype(float)
        flow[axis] += sign * field.direct[0]
        along = sign * flow[axis].sum(axis=across)[::sign] * h**2
        light = (field.fluence + field.direct)[0].sum(axis=across, dtype=float)[::sign]
        absorbed = medium.sigma_a[0] * light * h**3
        behind = np.cumsum(absorbed[::-1])[::-1] - absorbed / 2
        gaps.append(along - behind - left[axis, int(sign > 0)])
        sideways.append([flow[n].sum() * h**2 for n in across])
    # Half a layer does not absorb quite half of what the layer does: at most .2 % of the power.
    error = np.hypot(np.std(gaps, axis=0, ddof=1) / np.sqrt(24), 2e-3)
    assert_near(np.mean(gaps, axis=0), error, 23)
    assert_mean(sideways, np.zeros(2))
    assert np.std(gaps, axis=0).max() < 0.05


def thick(albedo, half=12, g=0.0):
    """What no light of a point in its middle leaves: 24 free paths to every side."""
    n = 2 * half + 1
    return Medium(np.ones((n,) * 3), 2.0, albedo, 1 - albedo, g, [-n] * 3)


@pytest.mark.parametrize("last", [1, 2, 5])
def test_so_many_collisions_before_the_handover(last):
    """Every collision keeps the albedo, and the light between two of them is one free path."""
    albedo, fluence = 0.8, []
    for seed in range(12):
        field = trace(thick(albedo), [PointLight((0, 0, 0), 3)], 4096, seed=seed, handover=last)
        energy = field.report.energy
        assert energy["handover"] == pytest.approx(3 * albedo**last, rel=1e-5)
        assert energy["absorbed"] == pytest.approx(3 * (1 - albedo**last), rel=1e-5)
        assert field.collision_source.power.sum(dtype=float) == pytest.approx(
            energy["handover"][0], rel=1e-5
        )
        assert field.report.collisions[0] == last * field.report.photons
        fluence.append([field.direct.sum(dtype=float) * 8, field.fluence.sum(dtype=float) * 8])
    assert_mean(fluence, 3 * np.array([1, sum(albedo**n for n in range(1, last))]))


@pytest.mark.parametrize("direction", [(0, 0, 1), (0.48, -0.6, 0.64)])
def test_first_collisions_are_handed_over_where_they_are(direction):
    sigma, albedo, irradiance = 3.0, 0.7, 2.0
    medium = Medium(np.ones((3, 4, 6)), 0.25, sigma * albedo, sigma * (1 - albedo), 0.5)
    sun = Sun(direction, irradiance)
    power, position = [], []
    for seed in range(24):
        field = trace(medium, [sun], 8192, seed=seed, handover=1)
        assert not field.fluence.any()
        assert not field.flux.any()
        source = field.collision_source
        power.append(source.power[0])
        position.append(source.position[0])
        assert np.all(np.abs(source.position[0]) <= 0.125001 * source.power[0])
        toward = np.reshape(direction, (3, 1, 1, 1)) * source.power[0]
        assert np.allclose(source.direction[0], toward, rtol=1e-4, atol=1e-6 * toward.max())
    # What collides is what the track lengths of direct light say, traced alone.
    direct = [trace(medium, [sun], 8192, seed=seed).direct[0] for seed in range(30, 54)]
    first, second = np.array(power, float), sigma * albedo * 0.25**3 * np.array(direct, float)
    error = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / 24)
    assert_near(first.mean(axis=0) - second.mean(axis=0), error, 23)
    if direction == (0, 0, 1):
        # Its mean place in a layer: where exp(-sigma z) has its mean.
        depth = sigma * 0.25
        place = 0.25 * (1 / depth - 1 / np.expm1(depth) - 0.5)
        layers = np.exp(-depth * np.arange(6)) * -np.expm1(-depth) * irradiance * albedo * 0.25**2
        assert_mean(power, np.broadcast_to(layers, (3, 4, 6)))
        expected = np.zeros((3, 3, 4, 6))
        expected[2] = place * layers
        assert_mean(position, expected)


def test_handover_of_what_never_absorbs_conserves_energy():
    medium = patchy(sigma_a=0)
    report = trace(medium, [Sky(1)], 10_000, handover=3).report
    energy = report.energy
    assert energy["absorbed"][0] == 0
    left = energy["left"].sum()
    assert energy["handover"][0] + left == pytest.approx(energy["entered"][0], rel=1e-6)
    assert energy["handover"][0] > 0.05 * left
