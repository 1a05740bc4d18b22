# SPDX-License-Identifier: GPL-3.0-or-later
"""At the extremes light stays finite, never negative, and never more than came.

Two things are shown. The step of the physical lattice enlarges no light, in any medium: not in the
norm sum f^2 / w, w the light that is spread evenly, and so its spectral radius is at most 1. And
whole solves in float32 hold to that where the numbers are as large and as small as they get.
"""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve
from lb_lighting.transport.lattice.lattice_numpy import NumpyLattice, Source
from lb_lighting.transport.lattice.layout import WEIGHTS
from lb_lighting.transport.paper.collision import collision_matrix
from lb_lighting.transport.paper.paper_numpy import PaperReference
from tests.tracing import OPENCL, name

DEPTHS = (0.0, 1e-30, 1e-6, 1e4, 1e8)
ALBEDOS = (0.0, 0.5, 1 - 1e-7, 1.0)
COSINES = (0.0, 0.5, -0.5, 0.99, -0.99, 0.999, -0.999)
ROUNDING = 1e-6

# ---- the step, in float64 ----


@st.composite
def lattices(draw):
    """Any optics; any depths, a third of them 0; in half of the lattices opaque voxels."""
    shape = draw(st.sampled_from([(1, 1, 7), (2, 2, 3), (3, 3, 3), (4, 1, 3)]))
    albedo = draw(st.sampled_from(ALBEDOS) | st.floats(0, 1))
    g = draw(st.sampled_from(COSINES) | st.floats(-0.999, 0.999))
    lowest, highest = sorted(draw(st.tuples(*[st.floats(-30, 8)] * 2)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    depth = 10 ** rng.uniform(lowest, highest, shape)
    if draw(st.booleans()):
        depth = depth * (rng.random(shape) > 0.3)
    else:
        depth = in_boxes(np.pad(depth, 1), rng)
    shape = depth.shape
    if not draw(st.booleans()):
        return NumpyLattice(depth, albedo, g)
    # Not wholly opaque: what holds no even light has no place in the norm.
    occlusion = rng.choice((0, 0.5, 0.999), shape)
    lattice = NumpyLattice(depth, albedo, g, occlusion, rng.choice((0, 0.7, 1), shape))
    lattice.opaque = occlusion
    return lattice


def in_boxes(depth, rng):
    """Three boxes of it, in one another's way or not, and nothing around: their faces are flat."""
    filled = np.zeros(depth.shape, bool)
    for _ in range(3):
        first = rng.integers(0, depth.shape)
        last = rng.integers(first, depth.shape)
        filled[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))] = True
    return depth * filled


def without_source(lattice):
    lattice.start(Source(np.zeros(lattice.shape), np.zeros((3, *lattice.shape))))
    return lattice


def size(lattice):
    """The norm of its light; of what has left the domain, of what comes back.

    Light counts by how much of its voxel is open, and what has left a voxel by how much of that one
    is: there it comes back to.
    """
    even = WEIGHTS[:, None]
    if lattice.occluders is not None:
        clear = 1 - lattice.cells.flat(lattice.opaque)
        left = np.stack([np.roll(clear, step) for step in lattice.steps])
        even = even * np.where(lattice.inside, clear, left)
    light = np.where(lattice.inside, 1, lattice.outside) * lattice.light
    return float(np.sqrt(np.sum(light**2 / even)))


@settings(max_examples=250, derandomize=True, deadline=None, database=None)
@given(lattices(), st.integers(0, 2**32 - 1))
def test_no_step_enlarges_the_light(lattice, seed):
    """Power iteration: from any light, the growth of each step is at most the spectral radius
    in the end, and the norm of the step at once. Neither may exceed 1; but the norm may at inner
    open faces, where a little more than what comes is let out, for good.
    """
    without_source(lattice)
    lattice.light = np.random.default_rng(seed).standard_normal(lattice.light.shape)
    sizes, ends_inside = [size(lattice)], any(len(at) for at, _ in lattice.within.values())
    for _ in range(60):
        lattice.advance(1)
        sizes.append(size(lattice))
        if sizes[-1] < 1e-200:
            return
        assert ends_inside or sizes[-1] <= sizes[-2] * (1 + ROUNDING)
    assert (sizes[-1] / sizes[20]) ** (1 / 40) <= 1 + ROUNDING


def step_matrix(lattice):
    """The step as a matrix, column by column, of the light that there can be."""
    without_source(lattice)
    near = sum(np.roll(lattice.inside, step) for step in lattice.steps) > 0
    cells = np.flatnonzero(near | lattice.inside)
    columns = []
    for m in range(18):
        for cell in cells:
            lattice.light = np.zeros_like(lattice.light)
            lattice.light[m, cell] = 1
            lattice.advance(1)
            columns.append(lattice.light[:, cells].ravel())
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("opaque", [None, 0.5, 1.0])
@pytest.mark.parametrize("albedo", ALBEDOS)
def test_no_eigenvalue_lies_outside_the_unit_circle(albedo, opaque):
    """All of them, in small lattices; with wholly opaque voxels, too."""
    rng = np.random.default_rng(8)
    shape = (1, 2, 3)
    for g in (0.0, 0.99, -0.999):
        depth = rng.choice(DEPTHS, shape) * rng.uniform(0.1, 1, shape)
        occlusion = None if opaque is None else opaque * (rng.random(shape) > 0.6)
        matrix = step_matrix(NumpyLattice(depth, albedo, g, occlusion, 1.0))
        assert np.abs(np.linalg.eigvals(matrix)).max() <= 1 + ROUNDING


def test_the_estimate_sees_a_step_that_enlarges_light():
    """Were even light relaxed by more than twice its deviation, both would tell."""
    lattice = NumpyLattice(np.full((3, 3, 3), 1e4), 1.0, 0.0)
    lattice.even = np.full_like(lattice.even, 4.0)
    assert np.abs(np.linalg.eigvals(step_matrix(lattice))).max() > 1 + ROUNDING
    lattice.light = np.random.default_rng(1).standard_normal(lattice.light.shape)
    before = size(lattice)
    lattice.advance(1)
    assert size(lattice) > before


# ---- the paper's lattice ----


@pytest.mark.parametrize(("thickness", "grows"), [(0.9, False), (1.9, False), (2.1, True)])
def test_the_papers_light_explodes_above_2_per_voxel(thickness, grows):
    """Its diffusion coefficient is negative there (equation 4). `solve` refuses such media."""
    medium = Medium(np.ones((10, 10, 10)), 1.0, thickness, 0.0)
    lattice = PaperReference(medium, keep_absorbed=False)
    lattice.start(np.full(19, 1 / 18), collision_matrix(thickness, 0.0))
    sizes = []
    for _ in range(3):
        lattice.advance(100)
        sizes.append(np.abs(lattice.f).max())
    assert (sizes[2] > 10 * sizes[1] > 100 * sizes[0]) == grows
    assert (sizes[2] < 1) != grows


@pytest.mark.parametrize(("thickness", "below_zero"), [(0.9, False), (1.5, True)])
def test_the_papers_light_falls_below_zero_above_1_per_voxel(thickness, below_zero):
    """A collision takes more light from a direction than is there, so light that enters a sunlit
    medium alternates from step to step before it converges."""
    medium = Medium(np.ones((10, 10, 10)), 1.0, thickness, 0.0)
    lattice = PaperReference(medium, keep_absorbed=False)
    inflow = np.zeros(19)
    inflow[5] = 1.0
    lattice.start(inflow, collision_matrix(thickness, 0.0))
    lowest = 0.0
    for _ in range(20):
        lattice.advance(1)
        lowest = min(lowest, lattice.f.min())
    assert (lowest < -1e-3) == below_zero


# ---- whole solves, in float32 ----

EXTREMES = {
    "depth": (*DEPTHS, "mixed"),
    "albedo": ALBEDOS,
    "g": COSINES,
    "power": (1e-42, 1e-20, 1.0, 1e20),
    "device": OPENCL,
}
# A sun takes few rays where there are many voxels.
SMALL = EXTREMES | {
    "shape": ((1, 1, 64), (3, 3, 3)),
    "light": ("sun", "point", "emission", "dome"),
}
LARGE = EXTREMES | {
    "g": (0.0, 0.999, -0.999),
    "shape": ((512, 8, 8), (7, 31, 129)),
    "light": ("sun",),
}


def pairwise(factors, tries=40):
    """Rows with one value of each factor; any two values of two factors are in one of the rows."""
    rng = np.random.default_rng(0)

    def pairs(row):
        return set(combinations(enumerate(row), 2))

    sizes = [len(values) for values in factors]
    missing = {
        ((i, a), (k, b))
        for i, k in combinations(range(len(sizes)), 2)
        for a in range(sizes[i])
        for b in range(sizes[k])
    }
    while missing:
        candidates = rng.integers(0, sizes, (tries, len(sizes)))
        (i, a), (k, b) = min(missing)
        candidates[:, [i, k]] = a, b
        best = max(map(tuple, candidates), key=lambda row: len(pairs(row) & missing))
        missing -= pairs(best)
        yield tuple(values[n] for values, n in zip(factors, best, strict=True))


CASES = [*pairwise(list(SMALL.values())), *pairwise(list(LARGE.values()))]


def extreme_medium(depth, albedo, g, shape, power, light, occluded):
    """A medium of voxels of 1 m; 30 % of those of mixed depth are void."""
    rng = np.random.default_rng(9)
    density, sigma_t = np.ones(shape), depth
    if depth == "mixed":
        density = rng.choice([0, *DEPTHS], shape, p=(0.3, *[0.14] * 5)) / 1e8
        sigma_t = 1e8
    extra = {"emission": np.full(shape, power)} if light == "emission" else {}
    if occluded:
        extra["occlusion"] = rng.choice((0, 0.5, 1), shape, p=(0.8, 0.1, 0.1))
        extra["occlusion_albedo"] = 0.7
    return Medium(density, 1.0, sigma_t * albedo, sigma_t * (1 - albedo), g, **extra)


def lamp(kind, power, shape):
    inside = tuple(0.4 * n for n in shape)
    return {
        "sun": [Sun((0.3, 0.2, -0.93), power)],
        "point": [PointLight(inside, power)],
        "emission": [],
        "dome": [Sky(lambda towards: power * (towards[..., 2] > 0))],
    }[kind]


def case_name(case):
    return "-".join(str(v) if not hasattr(v, "platform") else name(v)[:5] for v in case)


@pytest.mark.parametrize("case", CASES, ids=case_name)
def test_extremes(case):
    depth, albedo, g, power, device, shape, light = case
    occluded = CASES.index(case) % 3 == 0
    medium = extreme_medium(depth, albedo, g, shape, power, light, occluded)
    capped = Settings(divide=1, most_steps=64)
    fields = [solve(medium, lamp(light, power, shape), capped, device) for _ in range(2)]
    for field in fields:
        assert_physical(field)
        assert field.report.converged == (field.report.residual <= capped.tolerance)
        assert field.report.converged or field.report.steps == capped.most_steps
    for what in ("fluence", "direct", "flux"):
        np.testing.assert_array_equal(*(getattr(field, what) for field in fields))


def assert_physical(field):
    for light in (field.fluence, field.direct):
        assert np.all(np.isfinite(light))
        assert light.min() >= 0
    assert np.all(np.isfinite(field.flux))
    energy = field.report.energy
    gone = energy["absorbed"] + energy["left"].sum(axis=1)
    assert np.all(np.isfinite(gone))
    # What a voxel receives is in float32, and so a whole number of its smallest ones.
    grain = 2 * field.fluence.size * float(np.finfo(np.float32).smallest_subnormal)
    # Of light that leaves, -6 % are still to come back, and count only then.
    early = 0.06 * field.report.residual
    assert np.all(gone <= energy["entered"] * (1 + 1e-4 + early) + grain)
    if field.report.converged:
        assert np.all(gone >= energy["entered"] * (1 - 2e-2) - grain)


@pytest.mark.parametrize("device", OPENCL, ids=name)
@pytest.mark.parametrize("power", [1e-42, 1e-20, 1e20])
@pytest.mark.parametrize("albedo", ALBEDOS)
def test_a_uniform_sky_lights_nothing_brighter_than_itself(albedo, power, device):
    """Not before it has converged, either."""
    medium = extreme_medium("mixed", albedo, 0.99, (4, 5, 6), power, "sky", occluded=False)
    field = solve(medium, [Sky(power)], Settings(divide=1, most_steps=48), device)
    light = field.fluence.astype(float) + field.direct
    assert np.all(np.isfinite(light))
    assert light.min() >= 0
    brightest = 4 * np.pi * power * 1.05  # what rays and the lattice are off in single voxels
    assert light.max() <= max(brightest, 1e-37)
