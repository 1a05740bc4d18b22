# SPDX-License-Identifier: GPL-3.0-or-later
"""Source iteration with discrete ordinates: against integrals, photons, and the NumPy twin."""

import numpy as np
import pytest

from lb_lighting.errors import Cancelled
from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve
from lb_lighting.transport.box import Box
from lb_lighting.transport.device import devices
from lb_lighting.transport.lights.sampling import rank_1
from lb_lighting.transport.ordinates import source_iteration
from lb_lighting.transport.ordinates.moments import beside_beams, lobes_of, of_lobes, way_of
from lb_lighting.transport.ordinates.quadrature import directions_for, harmonics, phase_function
from lb_lighting.transport.ordinates.source_iteration import is_worthwhile, iterate, seconds
from lb_lighting.transport.uncollided.sweep import Beam, NumpyGlow, Turn
from tests.tracing import OPENCL, name

SUN = Sun((0.8, 0.3, -0.5), 2.0)
G = 0.85

on_opencl = pytest.mark.parametrize("device", OPENCL, ids=name)
on_every_device = pytest.mark.parametrize("device", devices(), ids=name)


def way(light):
    return np.array(light.direction) / np.linalg.norm(light.direction)


def sphere(count=40_000):
    """(count, 3) directions, evenly."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


# --- Directions ----------------------------------------------------------------------------------


def test_harmonics_are_orthonormal():
    basis = harmonics(sphere().T)
    found = 4 * np.pi * basis @ basis.T / basis.shape[1]
    assert found == pytest.approx(np.eye(9), abs=1e-3)


@pytest.mark.parametrize(
    "suns",
    [[], [(0, 0, -1)], [(0.8, 0.3, -0.5), (-0.6, -0.5, -0.6), (0.1, 1, 0)]],
    ids=["no sun", "one", "three"],
)
def test_directions_integrate_what_is_smooth_and_what_suns_are_scattered_to(suns):
    suns = [np.divide(sun, np.linalg.norm(sun)) for sun in suns]
    directions, weights = directions_for(suns, G)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1)
    assert weights.min() > 0
    basis = harmonics(directions.T)
    assert (basis * weights) @ basis.T == pytest.approx(np.eye(9), abs=1e-9)
    for sun in suns:
        cosine = directions @ sun
        scattered = weights * phase_function(cosine, G)
        assert scattered.sum() == pytest.approx(1)
        assert scattered @ cosine == pytest.approx(G)
        assert scattered @ (5 * cosine**3 - 3 * cosine) / 2 == pytest.approx(G**3)


def test_a_lobe_keeps_the_fluence_and_the_flux_times_g():
    flux = np.array([0.3, -0.2, 0.5]).reshape(3, 1, 1, 1)
    moments = of_lobes(np.full((1, 1, 1), 2.0), flux, G)[:, 0, 0, 0]
    assert moments[0] * np.sqrt(4 * np.pi) == pytest.approx(2.0)
    assert moments[1:4] * np.sqrt(4 * np.pi / 3) == pytest.approx(G * flux.ravel())
    assert not of_lobes(np.zeros((1, 1, 1)), 0 * flux, G).any()


def fluence_of(scattered):
    """(nx, ny, nz) W/m^2, of the first band."""
    return scattered.moments[0, 0] * np.sqrt(4 * np.pi) + scattered.lobes[:, 0].sum(axis=0)


# --- Light ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("axis", range(3))
@on_opencl
def test_beams_gain_the_same_emission_as_the_twins(axis, backward, device):
    rng, shape = np.random.default_rng(axis), (7, 6, 8)
    turn = Turn(axis, shape, Box.all(shape))
    depth = rng.uniform(0, 3, turn.shape) * (rng.random(turn.shape) > 0.3)
    sides = rng.uniform(-0.7, 0.7, (3, 3))
    sides[:, axis] = -1 if backward else 1
    beams = [
        Beam(side / np.linalg.norm(side), 1.0, turn, (rank_1(4) + 0.1 * n) % 1)
        for n, side in enumerate(sides)
    ]
    glows = rng.random((3, *turn.shape))
    from lb_lighting.transport.uncollided.sweep_opencl import OpenclGlow  # needs pyopencl

    found = OpenclGlow(turn, depth, device).run(beams, glows)
    expected = NumpyGlow(turn, depth).run(beams, glows)
    assert found.shape == expected.shape == (3, *turn.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


def once_scattered(depth, albedo, count=40_000):
    """(9,) W/m^2: moments in the middle of a cube of some optical depth of light that fell on its
    top straight down, 1 W/m^2, and has scattered once."""
    towards, half = sphere(count), depth / 2
    # Back along a direction it is so far to the nearest face.
    with np.errstate(divide="ignore"):
        length = (half / np.abs(towards)).min(axis=1)
    # The sun is attenuated by exp(-(half + s z)) there, and light to the middle by exp(-s).
    rate = 1 + towards[:, 2]
    gained = albedo * np.exp(-half) * -np.expm1(-rate * length) / rate
    radiance = gained * phase_function(-towards[:, 2], G)
    return 4 * np.pi * (harmonics(towards.T) * radiance).mean(axis=1)


@on_every_device
@pytest.mark.parametrize("depth", [0.5, 4.0])
def test_light_that_scattered_once_has_the_moments_of_its_integral(depth, device):
    """Of in-scattered light, with the moments of the lobes, which are kept apart, added back."""
    n, albedo = 15, 0.9
    medium = Medium(np.ones((n,) * 3), 1 / n, depth * albedo, depth * (1 - albedo), G)
    lights = [Sun((0, 0, -1), 1.0)]
    field = solve(medium, lights, device=device)
    field.fluence[...] = field.flux[...] = field.forward[...] = 0
    found = iterate(medium, lights, field, device, iterations=1)
    middle = (..., n // 2, n // 2, n // 2)
    lobe = found.lobes[0, 0][middle] * harmonics(np.array([0, 0, -1.0]))
    degrees = np.repeat(np.arange(3), (1, 3, 5))
    moments = found.moments[0][middle] + lobe * found.g[0] ** degrees
    expected = once_scattered(depth, albedo) * G**degrees
    assert moments == pytest.approx(expected, abs=0.01 * expected[0])


@on_opencl
def test_iterated_light_is_closer_to_photons_than_the_lattices(device):
    """A cube of 8 optical depths, of which the lattice's light is some 5 % off, in L2; the noise
    of the photons' two halves drops out."""
    n = 16
    medium = Medium(np.ones((n,) * 3), 1 / n, 8 * 0.99, 8 * 0.01, G)
    lattice = solve(medium, [SUN], device=device)
    found = iterate(medium, [SUN], lattice, device)
    photons = [
        solve(medium, [SUN], Settings(handover=np.inf, photons=2_000_000, seed=seed), device)
        for seed in (1, 2)
    ]
    first, second = (field.fluence[0].astype(float) for field in photons)

    def error(light):
        square = np.mean((light - first) * (light - second)) / np.mean(first * second)
        return np.sqrt(max(0.0, square))

    assert error(fluence_of(found)) < 0.6 * error(lattice.fluence[0])


@on_opencl
def test_bands_lamps_and_a_sky_together_are_as_one_by_one(device):
    """Bands with the same optics have the same result; light adds up."""
    medium = Medium(np.ones((8, 9, 10)), 0.2, [5.0, 5.0], [0.1, 0.1], G)
    lamp = PointLight((-1.0, 0.5, 2.5), (3.0, 6.0))
    lights = [lamp, Sky(0.2), SUN]
    found = iterate(medium, lights, solve(medium, lights, device=device), device)
    assert found.moments.shape == (2, 9, 8, 9, 10)
    assert found.lobes.shape == (2, 2, 8, 9, 10)
    assert found.g == pytest.approx(G**3)
    assert np.isfinite(found.moments).all()
    alone = [lamp]
    found = iterate(medium, alone, solve(medium, alone, device=device), device)
    np.testing.assert_allclose(found.moments[1], 2 * found.moments[0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(found.lobes[:, 1], 2 * found.lobes[:, 0], rtol=1e-3, atol=1e-4)


@on_opencl
def test_empty_space_around_changes_nothing(device, monkeypatch):
    """Except for the places of rays in voxels, which matter less where there are many rays."""
    monkeypatch.setattr(source_iteration, "rank_1", lambda _least: rank_1(16))
    shape, margin, lights = (8, 9, 10), (3, 2), [SUN, PointLight((3.0, -1.0, 2.0), 50.0)]
    near = Medium(np.ones(shape), 0.2, 3.0, 0.1, G)
    far = Medium(np.pad(near.density, margin), 0.2, 3.0, 0.1, G, origin=(-0.2 * margin[0],) * 3)
    own = (..., *(slice(margin[0], margin[0] + n) for n in shape))
    of_near, of_far = (solve(medium, lights, device=device) for medium in (near, far))
    # Of the same light: what the lattice and rays are off by is another thing.
    for grid in ("fluence", "flux", "direct", "direct_flux", "by_light", "forward"):
        getattr(of_far, grid)[own] = getattr(of_near, grid)
    expected = iterate(near, lights, of_near, device, iterations=1)
    found = iterate(far, lights, of_far, device, iterations=1)
    for values, wanted in (
        (found.moments[own], expected.moments),
        (found.lobes[own], expected.lobes),
    ):
        assert np.linalg.norm(values - wanted) < 0.01 * np.linalg.norm(wanted)
    assert not found.moments[:, :, 0].any()


def test_radiance_is_nowhere_negative(monkeypatch):
    """In the directions of the quadrature; without the limiter, moments of one-sided light are."""
    medium = Medium(np.random.default_rng(0).random((6, 7, 8)) ** 3, 0.2, 20.0, 0.1, G)
    field = solve(medium, [SUN], device="NumPy")
    towards, _weights = directions_for([way(SUN)], G)
    lobe = phase_function(towards @ way(SUN), G**3)

    def least():
        found = iterate(medium, [SUN], field, "NumPy", iterations=1)
        smooth = np.tensordot(harmonics(towards.T).T, found.moments[0], axes=1)
        light = smooth + np.multiply.outer(lobe, found.lobes[0, 0])
        return light.min() / light.max()

    assert least() > -1e-5
    monkeypatch.setattr(source_iteration._Ordinates, "limiter", lambda *_: 1)
    assert least() < -1e-3


@on_opencl
def test_media_of_many_voxels_are_iterated_in_merged_ones(device, monkeypatch):
    """Also where these do not divide the edges evenly; but not where they would be too thick."""
    shape = (20, 21, 23)
    axes = (np.sin(np.pi * (np.arange(n) + 0.5) / n) for n in shape)
    density = np.prod(np.meshgrid(*axes, indexing="ij"), axis=0)
    medium = Medium(density, 1 / 20, [10.0], [0.1], G)
    field = solve(medium, [SUN], device=device)
    expected = iterate(medium, [SUN], field, device)
    monkeypatch.setattr(source_iteration, "_MOST", 12)
    found = iterate(medium, [SUN], field, device)
    assert found.moments.shape == expected.moments.shape
    assert found.lobes.shape == expected.lobes.shape
    wanted = density * fluence_of(expected)
    error = np.linalg.norm(density * fluence_of(found) - wanted) / np.linalg.norm(wanted)
    assert error < 0.05  # measured: .033
    thick = medium.altered(voxel_size=1.0)
    assert source_iteration._pieces(medium) == 2
    assert source_iteration._pieces(thick) == 1
    large = Medium(np.ones((321, 4, 4)), 1.0, 10.0, 0.1, G)
    assert source_iteration._pieces(large) == 3


def test_lobes_follow_from_their_third_moments():
    rng = np.random.default_rng(0)
    ways = [v.reshape(3, 1, 1, 1) / np.linalg.norm(v) for v in np.eye(3) + 0.3]
    lobes = rng.random((3, 2, 3, 4))
    cosines = [[np.sum(a * b, axis=0) for b in ways] for a in ways]
    thirds = [
        sum((5 * c**3 - 3 * c) / 2 * own for c, own in zip(row, lobes, strict=True))
        for row in cosines
    ]
    np.testing.assert_allclose(lobes_of(np.array(thirds), ways), lobes, rtol=1e-5)
    # Beams of the same direction share a lobe.
    same = lobes_of(np.array([lobes[0]] * 2), ways[:1] * 2)
    np.testing.assert_allclose(same.sum(axis=0), lobes[0], rtol=1e-5)


@pytest.mark.parametrize("power", [1e-30, 1e30])
def test_light_may_be_as_dim_or_bright_as_one_likes(power):
    medium = Medium(np.ones((5,) * 3), 0.2, 5.0, 0.1, [G, 0.0])
    usual, other = (
        iterate(medium, lights, solve(medium, lights, device="NumPy"), "NumPy", iterations=1)
        for lights in ([Sun((0, 0, -1), 1.0)], [Sun((0, 0, -1), power)])
    )
    np.testing.assert_allclose(other.moments / np.float32(power), usual.moments, atol=1e-4)
    np.testing.assert_allclose(other.lobes / np.float32(power), usual.lobes, atol=1e-4)
    assert not usual.lobes[:, 1].any()
    assert not usual.moments[1, 1:].any()  # what scatters evenly goes everywhere


def test_progress_is_reported_and_iterations_can_be_cancelled():
    medium, fractions = Medium(np.ones((5,) * 3), 0.2, 5.0, 0.1, [G, 0.7]), []
    lights = [SUN]
    field = solve(medium, lights, device="NumPy")
    iterate(medium, lights, field, "NumPy", iterations=2, progress=fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1)
    with pytest.raises(Cancelled):
        iterate(medium, lights, field, "NumPy", cancel=lambda: True)
    assert 0 < seconds(medium, lights, "NumPy") < 60


@pytest.mark.parametrize(
    ("g", "depth", "lights", "occluded", "expected"),
    [
        (0.85, 1.0, [SUN], False, True),
        (0.5, 1.0, [SUN], False, False),
        (0.85, 4.0, [SUN], False, False),
        (0.85, 1.0, [Sky(1.0)], False, False),
        (0.85, 1.0, [Sky(1.0), PointLight((0, 0, 9), 1.0)], False, True),
        (0.85, 1.0, [SUN], True, False),
    ],
)
def test_is_worthwhile_only_for_beams_in_thin_forward_scattering_voxels(
    g, depth, lights, occluded, expected
):
    occlusion = np.ones((4,) * 3) if occluded else None
    medium = Medium(np.ones((4,) * 3), 1.0, depth, 0.0, g, occlusion=occlusion)
    assert is_worthwhile(medium, lights) is expected


def test_uncollided_light_of_other_lights_is_all_but_that_of_beams():
    medium = Medium(np.ones((5,) * 3), 0.2, 1.0, 0.1, G)
    lights = [Sky(1.0), SUN]
    field = solve(medium, lights, device="NumPy")
    box = Box.all(medium.shape)
    along = [way_of(SUN, medium.domain)]
    fluence, flux = beside_beams(field, 0, [1], along, box)
    np.testing.assert_allclose(fluence, field.by_light[0, 0], rtol=1e-4)
    sun = solve(medium, [SUN], device="NumPy")
    np.testing.assert_allclose(flux, (field.direct_flux - sun.direct_flux)[0], atol=1e-4)
