# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons among opaque voxels: shadows, reflections, and where the energy goes.

Each test would fail by chance for at most one seed in 10 000, see tests/tracing.py.
"""

from math import pi

import numpy as np
import pytest

from lb_lighting.transport import Medium, Sky, Sun
from lb_lighting.transport.photons.free_path import SAMPLERS
from lb_lighting.transport.photons.trace import trace
from tests.tracing import OPENCL, Beam, assert_mean, assert_same_light, name

H = 0.5  # m, the edge of a voxel
on_every_device = pytest.mark.parametrize("found", OPENCL, ids=name)


def void(occlusion, albedo=0.0):
    shape = np.shape(occlusion)
    return Medium(np.zeros(shape), H, 1.0, 0.0, occlusion=occlusion, occlusion_albedo=albedo)


def cube():
    """9 voxels an edge, the 3 in the middle opaque."""
    occlusion = np.zeros((9, 9, 9))
    occlusion[3:6, 3:6, 3:6] = 1
    return occlusion


def wall(axis=2, layer=5, shape=(6, 7, 8)):
    """A layer of opaque voxels, and nothing else."""
    occlusion = np.zeros(shape)
    np.moveaxis(occlusion, axis, 0)[layer] = 1
    return occlusion


@on_every_device
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_black_cube_casts_its_shadow_along_an_axis(found, axis, sign):
    expected = np.full((9, 9, 9), 2.0)
    shadow = np.moveaxis(expected, axis, 2)[..., ::sign]
    shadow[3:6, 3:6, 3:] = 0
    sun = Sun(sign * np.eye(3)[axis], 2.0)
    fields = [trace(void(cube()), [sun], 4096, seed=s, device=found.label) for s in range(16)]
    assert_mean([field.direct[0] for field in fields], expected)
    assert not any(field.fluence.any() for field in fields)
    energy = [field.report.energy for field in fields]
    behind = [e["left"][0, 2 * axis + (sign > 0)] for e in energy]
    assert_mean(behind, 2 * (9**2 - 3**2) * H**2)
    assert_mean([e["absorbed"][0] for e in energy], 2 * 3**2 * H**2)


@pytest.mark.parametrize(("x", "y"), [(0, 1), (1, 2), (2, 0)])
@pytest.mark.parametrize("sign", [-1, 1])
def test_black_cube_casts_its_shadow_across_voxels(x, y, sign):
    """Along a diagonal of their faces, voxels are in the shadow, in half of it, or outside."""
    direction = np.eye(3)[x] + sign * np.eye(3)[y]
    along, across = np.mgrid[:9, :9]
    off = np.abs(along - across)
    lit = np.where(off < 3, 0.0, np.where(off == 3, 0.5, 1.0))
    lit[np.minimum(along, across) < 3] = 1  # before the cube
    lit[3:6, 3:6] = 0
    expected = np.ones((9, 9, 9))
    plane = np.moveaxis(expected, (x, y), (0, 1))
    plane[:, ::sign, 3:6] = lit[:, :, None]
    seeds = range(24)
    fields = [trace(void(cube()), [Sun(direction, 1.0)], 8192, seed=s) for s in seeds]
    assert_mean([field.direct[0] for field in fields], expected)


@on_every_device
@pytest.mark.parametrize("density", [0.0, 2.0])
def test_white_furnace_has_the_light_of_what_is_not_opaque(found, density):
    """Where all is white, a voxel that lets in the share 1 - c has that share of the light.

    By detailed balance: c of the light from outside goes back, what is inside leaves unhindered.
    """
    rng = np.random.default_rng(8)
    occlusion = rng.choice([0, 0.3, 0.8, 1], (5, 4, 6), p=[0.5, 0.2, 0.15, 0.15])
    density = density * rng.uniform(0, 1, occlusion.shape)
    medium = Medium(density, H, 1.0, 0.0, 0.3, occlusion=occlusion, occlusion_albedo=1.0)
    light, seeds = [], range(24)
    for seed in seeds:
        field = trace(medium, [Sky(1 / (4 * pi))], 8192, seed=seed, device=found.label)
        light.append(field.fluence[0] + field.direct[0])
        energy = field.report.energy
        assert energy["left"].sum() == pytest.approx(energy["entered"][0], rel=1e-6)
    assert_mean(light, 1 - occlusion)
    with pytest.raises(AssertionError):
        assert_mean(light, occlusion < 1)


def solid_angle(points, width, height):
    """Of a rectangle from (0, 0, 0) to (width, height, 0), seen from points (..., 3) above it."""
    x, y, z = np.moveaxis(points, -1, 0)
    total = 0
    for a, sign_a in ((width - x, 1), (-x, -1)):
        for b, sign_b in ((height - y, 1), (-y, -1)):
            corner = np.arctan2(a * b, z * np.sqrt(a**2 + b**2 + z**2))
            total = total + sign_a * sign_b * corner
    return total


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (1, -1), (2, 1)])
def test_wall_reflects_by_the_cosine(axis, sign):
    """A sun on a grey wall in the void: its light above the wall is L times the solid angle."""
    irradiance, albedo, shape, layer = 3.0, 0.5, np.array((6, 7, 8)), 4
    medium = void(wall(axis, layer, shape), albedo)
    fluence, direct, behind = [], [], 2 * axis + (sign > 0)
    area = H**2 * shape.prod() / shape[axis]
    for seed in range(24):
        field = trace(medium, [Sun(sign * np.eye(3)[axis], irradiance)], 8192, seed=seed)
        energy = field.report.energy
        assert energy["entered"][0] == pytest.approx(irradiance * area, rel=1e-6)
        assert energy["absorbed"][0] == pytest.approx((1 - albedo) * irradiance * area, rel=1e-6)
        assert energy["left"].sum() == pytest.approx(albedo * irradiance * area, rel=1e-6)
        assert energy["left"][0, behind] == 0
        assert field.report.collisions[0] == 0
        fluence.append(np.moveaxis(field.fluence[0], axis, 2)[..., ::-sign])
        direct.append(np.moveaxis(field.direct[0], axis, 2)[..., ::-sign])

    n = fluence[0].shape
    first = n[2] - layer if sign > 0 else layer + 1  # the first layer above the wall
    place, weight = np.polynomial.legendre.leggauss(8)
    points = [(np.arange(m)[:, None] + (place + 1) / 2).ravel() for m in n]
    points[2] -= first
    radiance = albedo * irradiance / pi
    seen = radiance * solid_angle(np.stack(np.meshgrid(*points, indexing="ij"), -1), *n[:2])
    seen = seen.reshape(n[0], 8, n[1], 8, n[2], 8)
    seen = np.einsum("iajbkc,a,b,c->ijk", seen, *(weight / 2,) * 3)
    expected = np.zeros(n)
    expected[..., first:] = seen[..., first:]
    assert_mean(fluence, expected, rounding=1e-3)  # of 8 points an edge beside the wall's rim
    expected[..., first:] = irradiance
    expected[..., :first] = 0
    assert_mean(direct, expected)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_wall_at_the_domains_face_reflects_to_the_outside(axis, sign):
    shape = (3, 4, 5)
    layer = 0 if sign > 0 else shape[axis] - 1
    medium = void(0.8 * wall(axis, layer, shape), 0.25)
    field = trace(medium, [Sun(sign * np.eye(3)[axis], 2.0)], 4096)
    power = 2.0 * H**2 * np.prod(shape) / shape[axis]
    left, back = np.zeros(6), 2 * axis + (sign < 0)
    left[back], left[back ^ 1] = 0.2 * power, 0.2 * power
    assert np.allclose(field.report.energy["left"][0], left, 1e-6, 0)
    assert field.report.energy["absorbed"][0] == pytest.approx(0.6 * power, rel=1e-6)
    assert field.report.energy["entered"][0] == pytest.approx(power, rel=1e-6)
    assert not field.fluence.any()
    assert field.direct.mean() == pytest.approx(0.4, rel=1e-5)


def test_light_from_inside_leaves_an_opaque_voxel_unhindered():
    occlusion = np.ones((3, 3, 3))
    medium = void(occlusion, 0.5)
    middle = (1.5 * H,) * 3
    field = trace(medium, [Beam(middle, (1, 0, 0))], 1000)
    # Stopped at the voxel beside, and then at all sides of its own: half of it each time.
    energy = field.report.energy
    assert energy["absorbed"][0] == pytest.approx(1, rel=0.2)  # by a coin below a tenth
    assert np.flatnonzero(field.direct[0]).tolist() == [13]
    assert np.flatnonzero(field.fluence[0]).tolist() == [13]
    border = trace(medium, [Beam((H / 2, H / 2, H / 2), (-1, 0, 0))], 1000)
    assert border.report.energy["left"][0].tolist() == pytest.approx([1, 0, 0, 0, 0, 0])


def lumpy(albedo=1.0, sigma_a=0.5):
    rng = np.random.default_rng(3)
    density = rng.uniform(0, 5, (6, 5, 7)) * (rng.random((6, 5, 7)) > 1 / 3)
    occlusion = rng.choice([0, 0.5, 1], density.shape, p=[0.7, 0.15, 0.15])
    return Medium(
        density, H, 1.5, sigma_a, 0.4, occlusion=occlusion, occlusion_albedo=albedo
    )  # fmt: skip


@pytest.mark.parametrize("handover", [None, 2])
@pytest.mark.parametrize("albedo", [0.0, 0.6, 1.0])
def test_no_energy_is_lost_or_made(handover, albedo):
    medium, gaps = lumpy(albedo), []
    for seed in range(24):
        field = trace(medium, [Sky(1)], 4096, seed=seed, handover=handover)
        energy = {where: np.sum(power) for where, power in field.report.energy.items()}
        parts = energy["absorbed"] + energy["left"] + energy["handover"] + energy["lost"]
        assert parts == pytest.approx(energy["entered"], rel=1e-6)
        area = 2 * H**2 * (6 * 5 + 5 * 7 + 7 * 6)
        assert energy["entered"] == pytest.approx(pi * area, rel=1e-5)
        light = (field.fluence + field.direct)[0].astype(float)
        absorbed = medium.sigma_a[0] * (medium.density * light).sum() * H**3
        gaps.append(energy["absorbed"] / absorbed - 1)
    if albedo == 1:  # opaque voxels absorb nothing
        assert_mean(gaps, 0)
    else:
        assert np.mean(gaps) > 10 * np.std(gaps)


@pytest.mark.parametrize("sampler", SAMPLERS[1:])
def test_samplers_find_the_same_light(sampler):
    reference = trace(lumpy(0.7), [Sky(1)], 50_000, "ray_march", seed=1)
    field = trace(lumpy(0.7), [Sky(1)], 50_000, sampler, seed=2)
    assert_same_light(field, reference)
    with pytest.raises(AssertionError):
        assert_same_light(trace(lumpy(0.3), [Sky(1)], 50_000, sampler, seed=2), reference)


def test_reflection_is_no_collision():
    """A white wall reflects a beam, which enters the collision source where it collides."""
    occlusion = wall()
    density = np.zeros(occlusion.shape)
    density[..., :2] = 1e4
    medium = Medium(density, H, 1.0, 0.0, occlusion=occlusion, occlusion_albedo=1.0)
    beam = Beam((1.5, 1.75, 1.25), (0, 0, 1))
    field = trace(medium, [beam], 4096, handover=1)
    energy = field.report.energy
    assert energy["handover"][0] == pytest.approx(field.report.collisions[0] / field.report.photons)
    assert energy["handover"][0] + energy["left"].sum() == pytest.approx(1, rel=1e-6)
    assert energy["handover"][0] > 0.1
    # From above; and reflected light is not direct any more.
    assert np.all(field.collision_source.direction[0, 2] <= 0)
    assert field.direct.sum() * H**3 == pytest.approx(2.5 * H, rel=0.05)
    assert field.fluence.sum() > 0


def test_bands_whose_walls_differ_are_traced_apart():
    occlusion = wall()
    for albedo, runs in (([0.2, 0.2], 1), ([0.2, 0.4], 2)):
        medium = Medium(
            np.zeros(occlusion.shape), H, (1, 1), 0.0, occlusion=occlusion, occlusion_albedo=albedo
        )
        field = trace(medium, [Sun((0, 0, 1), 1.0)], 1024)
        assert field.report.runs == runs
        area = H**2 * 42
        expected = area * (1 - np.array(albedo))
        assert np.allclose(field.report.energy["absorbed"], expected, rtol=1e-6)
