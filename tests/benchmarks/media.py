# SPDX-License-Identifier: GPL-3.0-or-later
"""The media and lights for measurements of accuracy: cubes, clouds, smoke, a head, a pillar.

All except the head are cubes of 1 m. A "mean depth" is the optical depth from face to face along an
axis, averaged over all such rays, including those through voids.
"""

from dataclasses import dataclass

import numpy as np

from lb_lighting.transport import Medium, PointLight, Sky, Sun
from tests.benchmarks.shapes import SHAPES
from tests.setup import heads

EDGE = 24  # voxels
TRADED = 32  # voxels of the media for the trade of speed against accuracy
SPARSE = range(48, 72)  # seeds of mostly void media, to which nothing was fitted
PLANTS = range(72, 76)  # seeds of small plants
RANDOM = range(24, 48)  # seeds; earlier ones were used for the design of the planner
COARSE = 12  # voxels of the media that are refined
SUN = Sun((0.3, 0.2, -0.93), 1.0)
DEPTHS = (2, 8, 32, 128)
ASYMMETRIES = (0, 0.85)
ALBEDOS = (0.9, 0.99, 0.999)
CLOUD_DEPTHS = (20, 80)
REFINED = {"cube 8, g 0": (8, 0), "cube 32, g .85": (32, 0.85)}


@dataclass(frozen=True)
class Case:
    """A medium of one band and its lights.

    group     the table that it belongs to
    surfaces  whether surfaces show the light, which lamps light in any case
    """

    name: str
    medium: Medium
    lights: tuple
    group: str = "main"
    surfaces: bool = False


def of_depth(density, depth, albedo, g, **rest):
    """A medium with an edge of 1 m along x and the given mean depth."""
    sigma_t = depth / float(density.mean(dtype=float))
    return Medium(density, 1 / len(density), sigma_t * albedo, sigma_t * (1 - albedo), g, **rest)


def cubes():
    density = np.ones((EDGE,) * 3)
    for depth in DEPTHS:
        for g in ASYMMETRIES:
            for albedo in ALBEDOS:
                name = f"cube {depth}, g {g:g}, albedo {albedo:g}"
                yield Case(name, of_depth(density, depth, albedo, g), (SUN,))


def clouds():
    density = cloud(EDGE)
    for depth in CLOUD_DEPTHS:
        for g in ASYMMETRIES:
            yield Case(f"cloud {depth}, g {g:g}", of_depth(density, depth, 0.99, g), (SUN,))
    medium = of_depth(density, 20, 0.99, 0.85)
    yield Case("cloud 20, g 0.85, even sky", medium, (Sky(1.0),))
    yield Case("cloud 20, g 0.85, bright zenith", medium, (Sky(bright_zenith),))


def smoke():
    """A plume with a hot glowing core, in the sun."""
    yield Case("smoke 4, g 0.6, hot core", plume(EDGE), (SUN,))


def plume(n):
    x, _, z = corners(n)
    density = cloud(n, seed=5) * np.exp(-z)
    core = np.exp(-((x / 0.4) ** 2 + ((z + 0.5) / 0.3) ** 2) / 2)
    return of_depth(density, 4, 0.8, 0.6, emission=20 * density * core)


def head():
    """A tomography in voxels of 8 mm; the densest voxels have 4 times the density of water."""
    size = np.multiply(heads.SLICES[::-1], (0.957, 0.957, 1.5))  # mm
    density = heads.resampled(heads.cranium(), tuple((size / 8).round().astype(int)))
    sigma_t = 50 / (density.mean(dtype=float) * size[0] / 1000)
    medium = Medium(density, 0.008, 0.99 * sigma_t, 0.01 * sigma_t, 0.85)
    yield Case("head 50, g 0.85", medium, (SUN,))


def pillar():
    """A cloud over opaque ground with an opaque pillar, both grey."""
    opaque = np.zeros((EDGE,) * 3)
    opaque[:, :, 0] = 1
    opaque[10:14, 6:10, :12] = 1
    medium = of_depth(cloud(EDGE), 8, 0.99, 0.5, occlusion=opaque, occlusion_albedo=0.5)
    yield Case("pillar in a cloud 8, g 0.5", medium, (SUN, Sky(0.1)))


def main_cases():
    return [*cubes(), *clouds(), *smoke(), *head(), *pillar()]


def refined_cases():
    """Media that are constant in coarse voxels, so that finer voxels represent them exactly."""
    even = np.ones((COARSE,) * 3)
    for name, (depth, g) in REFINED.items():
        yield Case(name, of_depth(even, depth, 0.99, g), (SUN,), "refined")
    medium = of_depth(cloud(COARSE), 20, 0.99, 0.85)
    yield Case("cloud 20, g .85", medium, (SUN,), "refined")


def trade_cases():
    """The media in which all settings are measured, for the trade of speed against accuracy."""
    ones = np.ones((TRADED,) * 3)
    for depth in DEPTHS:
        for g in ASYMMETRIES:
            for albedo in ALBEDOS:
                name = f"cube {depth}, g {g:g}, albedo {albedo:g}"
                yield Case(name, of_depth(ones, depth, albedo, g), (SUN,), "trade")
    puffs = cloud(TRADED)
    yield Case("cloud 20, g 0.85", of_depth(puffs, 20, 0.99, 0.85), (SUN,), "trade")
    yield Case("cloud 80, g 0.85", of_depth(puffs, 80, 0.999, 0.85), (SUN,), "trade")
    yield Case("smoke 4, g 0.6, hot core", plume(TRADED), (SUN,), "trade")
    leaves, lights = crown(TRADED), (SUN, Sky(0.1))
    yield Case("crown of green leaves", of_depth(leaves, 1.5, 0.19, -0.02), lights, "trade")
    yield Case("crown of white leaves", of_depth(leaves, 1.5, 0.9, 0.0), lights, "trade")
    slab = np.zeros((TRADED,) * 3)
    slab[:, :, 12:20] = 1
    yield Case("slab 10, g 0.75", Medium(slab, 1 / TRADED, 39.6, 0.4, 0.75), (SUN,), "trade")


def random_cases():
    """Random media and lights, to which nothing was fitted."""
    for seed in RANDOM:
        rng = np.random.default_rng([seed, 7])
        medium = random_medium(rng)
        lights = RANDOM_LIGHTS[rng.integers(len(RANDOM_LIGHTS))](rng)
        yield Case(f"random {seed}", medium, lights, "random")


def sparse_cases():
    """Small plants, and media in a corner of a domain that is 50 to 99 % void; half of the media
    have a lamp inside or beside them."""
    for seed in SPARSE:
        rng = np.random.default_rng([seed, 7])
        density, lower, upper = sparse_density(rng)
        albedo = 1 - 10 ** rng.uniform(-4, -0.3)
        depth = 10 ** rng.uniform(-0.5, 1.7)  # mean of a line through the matter
        mean = float(density.sum() / np.prod(upper - lower))
        sigma_t = depth * EDGE / (mean * (upper - lower).max())
        medium = Medium(
            density,
            1 / EDGE,
            sigma_t * albedo,
            sigma_t * (1 - albedo),
            rng.uniform(-0.3, 0.9),
        )
        lights = SPARSE_LIGHTS[seed % len(SPARSE_LIGHTS)](rng, lower / EDGE, upper / EDGE)
        yield Case(f"sparse {seed}", medium, lights, "sparse")
    for seed in PLANTS:
        rng = np.random.default_rng([seed, 7])
        leaves = 10 ** rng.uniform(1.3, 2.3)  # in total, each in a random voxel of a ball
        inside = sum(x**2 for x in corners(EDGE)) < 0.8
        density = 1.0 * inside * rng.poisson(leaves / inside.sum(), inside.shape)
        albedo = rng.choice((0.2, 0.5, 0.9))
        medium = Medium(density, 1 / EDGE, 10 * albedo, 10 * (1 - albedo), -0.02)
        yield Case(f"plant {seed}", medium, random_sun_and_sky(rng), "sparse", surfaces=True)


def sparse_density(rng):
    """(density, the corners of the matter (3,) in voxels)."""
    while True:
        extent = rng.integers(5, EDGE, 3)
        lower = np.array([rng.integers(0, EDGE - n + 1) for n in extent])
        density = np.zeros((EDGE,) * 3)
        inside = tuple(slice(a, a + n) for a, n in zip(lower, extent, strict=True))
        density[inside] = SHAPES[rng.integers(len(SHAPES))](tuple(extent), rng)
        if 0.5 <= np.mean(density == 0) <= 0.99:
            return density, lower, lower + extent


def lamp_beside(rng, lower, upper):
    """A lamp at a distance of a tenth to a third of the matter's size."""
    way = rng.normal(size=3)
    way /= np.abs(way).max()
    size = upper - lower
    place = (lower + upper) / 2 + way * size * rng.uniform(0.6, 0.83)
    return (PointLight(tuple(place), 10.0),)


def lamp_inside(rng, lower, upper):
    return (PointLight(tuple(rng.uniform(lower, upper)), 10.0), Sky(0.1))


SPARSE_LIGHTS = (
    lambda rng, *_: random_sun(rng),
    lamp_beside,
    lambda rng, *_: random_sun_and_sky(rng),
    lamp_inside,
)


def random_medium(rng):
    shape = SHAPES[rng.integers(len(SHAPES))]
    density = shape((TRADED,) * 3, rng)
    if not density.any():
        density[...] = 1
    albedo = 1 - 10 ** rng.uniform(-4, -0.3)
    return of_depth(density, 10 ** rng.uniform(-1.5, 2), albedo, rng.uniform(-0.3, 0.9))


def random_sun(rng):
    toward = rng.normal(size=3) * (1, 1, 0.3) - (0, 0, 1)
    return (Sun(tuple(toward), 1.0),)


def random_sun_and_sky(rng):
    return (*random_sun(rng), Sky(bright_zenith))


def random_lamp(rng):
    place = rng.normal(size=3)
    return (PointLight(tuple(0.5 + 1.2 * place / np.linalg.norm(place)), 10.0),)


RANDOM_LIGHTS = (random_sun, random_sun_and_sky, random_lamp)


# --- Shapes --------------------------------------------------------------------------------------


def corners(n):
    """Three (n, n, n) arrays: the centres of voxels in the cube from -1 to 1."""
    axis = (np.arange(n) + 0.5) * 2 / n - 1
    return np.meshgrid(axis, axis, axis, indexing="ij")


def cloud(n, seed=2):
    """(n, n, n) densities from 0 to 1.5: puffs on a flat base, roughened by noise; mostly void."""
    rng = np.random.default_rng(seed)
    x, y, z = corners(n)
    shape = np.full((n,) * 3, -np.inf)
    for _ in range(16):
        turn, out = rng.random(2) * (2 * np.pi, 0.7)
        center = out * np.cos(turn), out * np.sin(turn), rng.uniform(-0.5, 0.6 - 0.7 * out)
        radius = rng.uniform(0.35, 0.65)
        distance = np.sqrt(sum((a - b) ** 2 for a, b in zip((x, y, z), center, strict=True)))
        shape = np.maximum(shape, 1 - distance / radius)
    shape = np.minimum(shape, 4 * (z + 0.8))  # the base
    return np.clip(1.5 * shape + 0.4 * noise(n, rng), 0, 1.5)


def crown(n, seed=3):
    """(n, n, n) densities of leaves in clumps that fill a ball."""
    rng = np.random.default_rng(seed)
    places = np.stack(corners(n), axis=-1)
    density = np.zeros((n,) * 3)
    for _ in range(40):
        middle = rng.normal(size=3)
        middle *= 0.7 * rng.random() ** (1 / 3) / np.linalg.norm(middle)
        density += np.exp(-((places - middle) ** 2).sum(axis=-1) / (2 * 0.12**2))
    return density * (density > 0.05) * rng.gamma(4, 1 / 4, density.shape)


def noise(n, rng):
    """(n, n, n) of mean 0 and variance 1: turbulence, rough on every scale."""
    waves = np.meshgrid(*[np.fft.fftfreq(n, 1 / n)] * 3, indexing="ij")
    length = np.sqrt(sum(k**2 for k in waves))
    length[0, 0, 0] = np.inf
    # Kolmogorov's law: energy k^(-5/3) over shells of area k^2; the amplitude is its root.
    spectrum = np.fft.fftn(rng.standard_normal((n,) * 3)) * length ** (-11 / 6)
    values = np.fft.ifftn(spectrum).real
    return values / values.std()


def bright_zenith(towards):
    """W/(m^2 sr): a sky four times as bright overhead as at the horizon and below."""
    return 0.25 + 0.75 * np.maximum(towards[..., 2], 0)
