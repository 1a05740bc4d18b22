# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice against what docs/theory/physics.md derives: how light diffuses on it, how
it is absorbed, and where it ends at the domain's faces. The paper's equation 4 is in
test_lattice.py.
"""

import numpy as np
import pytest

from lb_lighting.transport import Medium, Settings, solve
from lb_lighting.transport.lattice import boundary
from lb_lighting.transport.lattice.boundary import returned
from lb_lighting.transport.lattice.lattice_numpy import NumpyLattice, Source
from lb_lighting.transport.lattice.layout import LENGTHS, MEAN_LENGTH, MOVING, WEIGHTS
from lb_lighting.transport.uncollided.attenuation import attenuate

UNIT = MOVING / LENGTHS[:, None]
AXIS, FACE, CORNER, SKEW = (0, 0, 1), (1, 1, 0), (1, 1, 1), (1, 2, 0)


class Layers(NumpyLattice):
    """Layers of voxels without end, one behind the other along any normal.

    The layer `normal . place` of a voxel is its index along the last of three axes. Faces of the
    domain are where the layers end.
    """

    def __init__(self, count, depth, albedo, g=0.0, normal=AXIS):
        depth = np.full((1, 1, count), float(depth))
        super().__init__(depth, albedo, g)
        self.normal, self.steps = np.array(normal), MOVING @ normal
        self.outside = np.where(self.inside, 0, returned(depth, albedo, g)[0, 0, 0])
        self.within = {}
        farthest = int(self.steps.max())
        self.first, self.end = self.cells.first, self.cells.first + count
        self.used = slice(self.first - farthest, self.end + farthest)

    def converge(self, power, place=0.0, direction=0.0):
        """Go to what steps tend to, by linear algebra. Each (count,) W/m^2 along the normal:

        power, power times place from the voxel's centre in transport mean free paths, and power
        times mean direction after the collision.
        """
        drift = np.zeros((3, *self.shape))
        drift[:] = self.normal[:, None, None, None] * (place + direction)
        self.start(Source(np.broadcast_to(power, self.shape), drift))
        self.advance(1)
        given, columns = self.light[:, self.used].copy(), []
        for number in range(given.size):
            self.light = np.zeros_like(self.light)
            used = np.zeros(given.size)
            used[number] = 1
            self.light[:, self.used] = used.reshape(given.shape)
            self.advance(1)
            columns.append((self.light[:, self.used] - given).ravel())
        step = np.array(columns).T
        light = np.linalg.solve(np.eye(given.size) - step, given.ravel())
        self.light = np.zeros_like(self.light)
        self.light[:, self.used] = light.reshape(given.shape)
        return self

    def fluence_by_layer(self):
        return self.fluence()[0, 0]

    def flux_by_layer(self):
        """W/m^2 along the normal, whatever its length."""
        return self.normal @ self.flux()[:, 0, 0]

    def left(self):
        """(2,) W/m^2 through the first face, and through the last."""
        leaving = (1 - self.outside) * self.light
        return np.array([leaving[:, : self.first].sum(), leaving[:, self.end :].sum()])


def one_bright(count, number):
    power = np.zeros(count)
    power[number] = 1.0
    return power


# --- Diffusion -----------------------------------------------------------------------------------


def test_weights_and_lengths_have_the_moments_of_the_sphere():
    weights = WEIGHTS * LENGTHS / MEAN_LENGTH
    second = np.einsum("m,ma,mb->ab", weights, UNIT, UNIT)
    np.testing.assert_allclose(second, np.eye(3) / 3, atol=1e-15)
    fourth = np.einsum("m,ma,mb,mc,md->abcd", weights, UNIT, UNIT, UNIT, UNIT)
    pairs = [("ab", "cd"), ("ac", "bd"), ("ad", "bc")]
    even = sum(np.einsum(f"{i},{j}->abcd", np.eye(3), np.eye(3)) for i, j in pairs) / 15
    np.testing.assert_allclose(fourth, even, atol=1e-15)


@pytest.mark.parametrize(
    ("transport_depth", "g"), [(1.0, 0.0), (1.0, 0.85), (3.0, -0.5), (10.0, 0.0)]
)
@pytest.mark.parametrize("normal", [AXIS, FACE, CORNER, SKEW])
def test_light_diffuses_by_a_third_of_the_transport_mean_free_path(transport_depth, g, normal):
    """J = -grad(fluence) / (3 s_tr), where light goes from a bright layer to the last."""
    # Layers enough to be nine free paths from both; they lie 1 / |normal| voxels apart.
    distance = max(12, round(9 * np.linalg.norm(normal) / transport_depth))
    count = 2 * distance + 8
    depth = transport_depth / (1 - g)
    layers = Layers(count, depth, albedo=1.0, g=g, normal=normal).converge(one_bright(count, 4))
    n = count // 2 + 2
    slope = np.diff(layers.fluence_by_layer()[[n - 1, n + 1]])[0] / 2
    expected = -slope * (layers.normal @ layers.normal) / (3 * transport_depth)
    assert layers.flux_by_layer()[n] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("depth", "g"), [(2.0, 0.0), (2.0, -0.5), (20.0, 0.85), (6.0, 0.0)])
def test_a_pulse_spreads_by_the_mean_length_a_step(depth, g):
    """Its variance grows by 6 D a step, D = R / (3 s_tr): light that flies R voxels in a step."""
    n, steps = 29, 14
    lattice = NumpyLattice(np.full((n, n, n), depth), 1.0, g)
    axis = np.arange(n) - n // 2
    r2 = sum(np.meshgrid(axis**2, axis**2, axis**2, indexing="ij", sparse=True))
    dark = np.zeros((n, n, n))
    lattice.start(Source(dark, np.zeros((3, n, n, n))))
    lattice.light = np.multiply.outer(WEIGHTS, lattice.cells.flat(np.exp(-r2 / (2 * 1.5**2))))

    def variance():
        total = lattice.cells.inside(lattice.light.sum(axis=0))
        return (total * r2).sum() / total.sum()

    lattice.advance(10)  # past the start, where the fluxes form
    early = variance()
    lattice.advance(steps)
    measured = (variance() - early) / (6 * steps)
    assert measured == pytest.approx(MEAN_LENGTH / (3 * depth * (1 - g)), rel=0.01)


@pytest.mark.parametrize(("depth", "albedo", "g"), [(1, 0.9, 0.0), (2, 0.9, 0.5), (8, 0.99, 0.85)])
def test_light_of_a_layer_goes_as_far_on_the_lattice_as_in_nature(depth, albedo, g):
    """A third of <r^2> = 2 / (s_a s_tr) at absorption, counted between the layers' centres."""
    exact = 2 / (3 * depth**2 * (1 - albedo) * (1 - g * albedo))
    count = 2 * round(9 * np.sqrt(exact)) + 1
    layers = Layers(count, depth, albedo, g).converge(one_bright(count, count // 2))
    light = layers.fluence_by_layer()
    place = np.arange(count) - count // 2
    assert (light @ place**2) / light.sum() == pytest.approx(exact, rel=0.003)


def test_light_of_a_voxel_goes_as_far_as_in_nature():
    """<r^2> = 2 / (s_a s_tr) at absorption, to 1 %: what voxels ever smaller tend to.

    Light starts and ends anywhere in a voxel, so the squared distance of the centres is h^2 / 2
    more. The lattice takes it to be in the middle, which is an error of about that h^2 / 2.
    """
    albedo, exact = 0.9, 20.0
    sizes, found = (0.5, 0.4), []  # half of the box is 6.25 root mean squares
    for size in sizes:
        h, n = size * np.sqrt(exact), round(12.5 / size)
        n += 1 - n % 2
        emission = np.zeros((n, n, n))
        emission[n // 2, n // 2, n // 2] = h**-3
        origin = [-n * h / 2] * 3
        medium = Medium(np.ones((n, n, n)), h, albedo, 1 - albedo, 0.0, origin, emission)
        field = solve(medium, [], Settings(tolerance=1e-4, divide=1))
        light = (field.fluence + field.direct)[0].astype(float)
        squared = (medium.domain.centers() ** 2).sum(axis=-1)
        found.append(((light * squared).sum() / light.sum() - h**2 / 2) / exact)
    errors = 1 - np.array(found)
    assert np.all((errors > 0) & (errors < np.square(sizes) / 2))
    slope = np.diff(found)[0] / np.diff(np.square(sizes))[0]
    assert found[1] - slope * sizes[1] ** 2 == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(("n", "depth"), [(8, 2.0), (6, 6.0)])
def test_light_of_a_white_cube_dies_away_as_diffusion_says(n, depth):
    lattice = NumpyLattice(np.full((n, n, n), depth), 1.0, 0.0)
    dark = np.zeros(lattice.shape)
    lattice.start(Source(dark, np.zeros((3, *lattice.shape))))
    lattice.light = np.multiply.outer(WEIGHTS, lattice.cells.flat(np.ones(lattice.shape)))
    lattice.advance(4 * n * n)  # the slowest wave is left
    before = lattice.cells.inside(lattice.light).sum()
    lattice.advance(10)
    edge = n + 4 / (3 * depth)
    expected = np.pi**2 * MEAN_LENGTH / (depth * edge**2)
    after = lattice.cells.inside(lattice.light).sum()
    assert np.log(before / after) / 10 == pytest.approx(expected, rel=0.03)


# --- Absorption ----------------------------------------------------------------------------------


def decay_of_transport(albedo, g):
    """By how many e-foldings light decays over a mean free path, deep in a medium.

    The moments of the transfer equation are a continued fraction (docs/theory/physics.md).
    """
    order = np.arange(200)
    losses = (2 * order + 1) * (1 - albedo * g**order)

    def left_over(rate):
        rest = losses[-1]
        for n in order[-2::-1]:
            rest = losses[n] - (n + 1) ** 2 * rate**2 / rest
        return rest

    rates = np.linspace(0, 1, 2000, endpoint=False)[1:]
    above = rates[next(i for i, rate in enumerate(rates) if left_over(rate) < 0)]
    below = above - rates[0]
    for _ in range(40):
        middle = (above + below) / 2
        above, below = (above, middle) if left_over(middle) > 0 else (middle, below)
    return above


def decay_on_lattice(depth, albedo, g, normal):
    """The same of the wave, fading along a normal, that a step leaves as it is."""
    lattice = NumpyLattice(np.full((18, 1, 1), depth), albedo, g)
    lattice.start(Source(np.zeros(lattice.shape), np.zeros((3, *lattice.shape))))
    each = lattice.cells.flat(np.eye(18)[:, :, None, None])  # in a voxel of its own
    collision = lattice.cells.inside(lattice._collided(each))[:, :, 0, 0]
    along = MOVING @ np.divide(normal, np.linalg.norm(normal))
    none, all_of_it = 0.0, 2.0 * depth
    for _ in range(50):
        rate = (none + all_of_it) / 2  # e-foldings a voxel; light flows in from brighter ones
        grows = np.abs(np.linalg.eigvals(collision * np.exp(rate * along))).max() > 1
        none, all_of_it = (none, rate) if grows else (rate, all_of_it)
    return rate / depth


def test_transport_decays_as_is_known():
    """Case and Zweifel, Linear Transport Theory, 1967: isotropic scattering."""
    assert decay_of_transport(0.9, 0.0) == pytest.approx(0.525430, abs=2e-6)
    assert decay_of_transport(0.5, 0.0) == pytest.approx(0.957504, abs=2e-6)


@pytest.mark.parametrize(
    ("albedo", "g", "diffusion", "fine", "coarse", "half", "most"),
    [
        (0.99, 0.0, 0.4, 0.0, 0.2, 1.3, 6.9),
        (0.9, 0.0, 4.2, 0.3, 2.0, 1.4, 5.5),
        (0.7, 0.0, 14.5, 2.5, 7.4, 3.3, 6.9),
        (0.9, 0.5, 5.3, -0.6, 1.1, 1.4, 5.3),
        (0.99, 0.85, 1.4, 0.0, 0.0, 1.3, 5.4),
        (0.9, 0.85, 12.0, -3.3, -3.0, -2.3, 5.1),
    ],
)
def test_light_fades_nearly_as_in_nature(albedo, g, diffusion, fine, coarse, half, most):
    """Errors in percent: of diffusion, and of the lattice in voxels 1/4 and 1 free path thick, and
    of .45 and .9 e-foldings. The table of docs/theory/physics.md."""
    exact = decay_of_transport(albedo, g)
    by_diffusion = np.sqrt(3 * (1 - albedo) * (1 - albedo * g))

    def worst(depth):
        found = [decay_on_lattice(depth, albedo, g, n) / exact - 1 for n in (AXIS, FACE, CORNER)]
        return 100 * max(found, key=abs)

    depths = (0.25, 1.0, 0.45 / by_diffusion, 0.9 / by_diffusion)
    errors = [100 * (by_diffusion / exact - 1), *map(worst, depths)]
    np.testing.assert_allclose(errors, (diffusion, fine, coarse, half, most), atol=0.06)


def test_absorption_times_fluence_is_what_a_step_absorbs():
    """In each voxel, voids with them, from whatever light."""
    rng = np.random.default_rng(3)
    depth = rng.choice([0, 1e-6, 0.3, 2, 50], (5, 4, 6))
    lattice = NumpyLattice(depth, albedo=0.8, g=0.4)
    power = rng.random(depth.shape)
    lattice.start(Source(power, rng.standard_normal((3, *depth.shape))))
    lattice.light = rng.random(lattice.light.shape)
    arriving, leaving = (
        lattice.cells.inside(light.sum(axis=0))
        for light in (lattice.light, lattice._collided(lattice.light))
    )
    absorbed = 0.2 * depth * lattice.fluence()
    np.testing.assert_allclose(arriving + power - leaving, absorbed, atol=1e-12)


# --- Faces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("depth", "count"), [(0.25, 48), (0.5, 40), (1, 32), (5, 24), (20, 24)])
def test_light_from_the_depth_ends_two_thirds_of_a_free_path_outside(depth, count):
    """In Milne's problem, exactly .7104 transport mean free paths. That is not what is aimed at:
    see below."""
    layers = Layers(count, depth, albedo=1.0).converge(one_bright(count, count - 3))
    place = (np.arange(count) + 0.5) * depth
    line = slice(count // 3, 2 * count // 3)
    slope, start = np.polyfit(place[line], layers.fluence_by_layer()[line], 1)
    assert 0.665 < start / slope < 0.68


def slab(count, optical_depth, cosine, albedo=1.0, g=0.0):
    """(R, T, flux by layer) of a slab, by first collisions of light that enters.

    cosine  of the light's angle to the normal; all are shares of the light that enters
    """
    depth, peak = optical_depth / count, g * g  # delta-Eddington, for g >= 0
    less = depth * (1 - albedo * peak) / cosine
    transmittance, mean, _, place = attenuate(np.full(count, less))
    entering = np.exp(-less * np.arange(count))
    power = entering * (1 - transmittance) * albedo * (1 - peak) / (1 - albedo * peak)
    moved = power * (place - 0.5)
    turned = power * cosine * (g - peak) / (1 - peak)
    layers = Layers(count, depth, albedo, g)
    layers.converge(power, place=depth * (1 - albedo * g) * moved, direction=turned)
    reflected, transmitted = layers.left()
    flux = layers.flux_by_layer() - moved + entering * mean
    return reflected, transmitted + entering[-1] * transmittance[-1], flux


def diffuse_slab(count, optical_depth):
    """(R, T) for light that enters by Lambert's law."""
    node, weight = np.polynomial.legendre.leggauss(5)
    cosines, shares = (node + 1) / 2, weight / 2
    found = [slab(count, optical_depth, cosine)[:2] for cosine in cosines]
    return (2 * shares * cosines) @ np.array(found)


@pytest.mark.parametrize(
    ("optical_depth", "normal", "diffuse"),
    [(10, 0.146995, 0.116745), (20, 0.078373, 0.062245)],
)
def test_a_white_slab_lets_through_what_is_exact(optical_depth, normal, diffuse):
    """The exact numbers are those of tests/transport/photons/test_photon_oracles.py."""
    reflected, transmitted, _ = slab(16, optical_depth, cosine=1.0)
    assert transmitted == pytest.approx(normal, rel=0.004)
    assert reflected + transmitted == pytest.approx(1, abs=1e-12)
    assert diffuse_slab(16, optical_depth)[1] == pytest.approx(diffuse, rel=0.011)


def test_milnes_length_would_let_too_much_through(monkeypatch):
    slope = 6 * 0.7104 * boundary._OUTWARD / MEAN_LENGTH
    monkeypatch.setattr(boundary, "REFLECTED", (slope - 1) / (slope + 1))
    assert slab(16, 20, cosine=1.0)[1] / 0.078373 == pytest.approx(1.019, abs=0.001)
    assert diffuse_slab(16, 20)[1] / 0.062245 == pytest.approx(1.032, abs=0.001)


def test_a_thin_slab_that_scatters_forward_reflects_a_tenth_too_little():
    """What delta-Eddington neglects; exactly .097395."""
    reflected, transmitted, _ = slab(16, 2, cosine=1.0, albedo=0.9, g=0.75)
    assert reflected / 0.097395 == pytest.approx(0.885, abs=0.005)
    assert transmitted == pytest.approx(0.660958, rel=0.035)


@pytest.mark.parametrize(("cosine", "exact"), [(1.0, 0.6788), (0.5, 0.6621), (0.2, 0.6374)])
def test_light_from_outside_is_as_strong_in_the_depth_as_it_should_be(cosine, exact):
    """Deep in a half-space it is 3 mu (mu + z), with z = H(mu) / sqrt(3) - mu exactly."""
    count, depth, milne = 24, 1.0, 0.6765  # of the lattice, as above
    transmitted = slab(count, count * depth, cosine)[1]
    z = transmitted * (count * depth + 2 * milne) - cosine
    assert z == pytest.approx(0.667, abs=0.008)
    assert (cosine + z) / (cosine + exact) == pytest.approx(1, abs=0.04)


def test_the_flux_through_a_white_slab_is_the_same_everywhere():
    """So is that of an endless voxel, without the path from its centre to the collision source."""
    _, transmitted, flux = slab(12, 30, cosine=1.0)
    np.testing.assert_allclose(flux, transmitted, rtol=1e-10)


# --- Voids ---------------------------------------------------------------------------------------


def test_in_a_void_light_keeps_to_the_directions_of_the_lattice():
    """Ten voxels from a bright one it is 42 times too bright along an axis, and dark aside."""
    n = 23
    power = np.zeros((n, n, n))
    power[n // 2, n // 2, n // 2] = 1.0
    lattice = NumpyLattice(np.zeros((n, n, n)), 1.0, 0.0)
    lattice.start(Source(power, np.zeros((3, n, n, n))))
    lattice.advance(2 * n)
    fluence, center = lattice.fluence(), n // 2
    assert fluence[center, center, center + 10] * 4 * np.pi * 10**2 == pytest.approx(42, abs=0.5)
    assert fluence[center, center + 4, center + 9] == 0
