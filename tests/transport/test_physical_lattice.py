# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice of the physical model: its kernels against their twin, and what must hold exactly."""

from itertools import permutations, product

import numpy as np
import pytest

from lb_lighting.transport.physical_numpy import MEAN_LENGTH, WEIGHTS, NumpyLattice, Source
from tests.tracing import OPENCL, name

FLAT, SMALL, LONG, ODD = (1, 1, 64), (3, 3, 3), (512, 8, 8), (7, 31, 129)
SHAPE = (5, 6, 4)

on_opencl = pytest.mark.parametrize("device", OPENCL, ids=name)


def patchy(shape, occluded, seed=0):
    """(depth, occlusion, its albedo): a third void, and a fifth of the voxels opaque in part."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.05, 4, shape) * (rng.random(shape) > 1 / 3)
    depth = depth.astype(np.float32)
    if not occluded:
        return depth, None, 0.0
    occlusion = rng.random(shape) * (rng.random(shape) > 0.8)
    return depth, occlusion.astype(np.float32), rng.random(shape).astype(np.float32)


def some_source(shape, seed=1):
    rng = np.random.default_rng(seed)
    power = rng.random(shape) * (rng.random(shape) > 0.5)
    return Source(power, power * rng.uniform(-0.5, 0.5, (3, *shape)))


def lattice_on(device, medium, albedo=0.9, g=0.6):
    depth, occlusion, occlusion_albedo = medium
    if device is None:
        return NumpyLattice(depth, albedo, g, occlusion, occlusion_albedo)
    from lb_lighting.transport.physical_opencl import OpenCLLattice

    return OpenCLLattice(depth, albedo, g, occlusion, occlusion_albedo, device)


def lit(lattice, source, steps):
    lattice.start(source)
    lattice.advance(steps)
    return lattice


def assert_close(got, expected, relative):
    got, expected = np.asarray(got, float), np.asarray(expected, float)
    assert np.all(np.isfinite(got))
    assert np.abs(got - expected).max() <= relative * np.abs(expected).max()


@on_opencl
@pytest.mark.parametrize("occluded", [False, True], ids=["clear", "occluded"])
@pytest.mark.parametrize(
    ("shape", "steps"), [(FLAT, 20), (SMALL, 20), (LONG, 6), (ODD, 6)], ids=str
)
def test_kernels_do_what_their_twin_does(shape, steps, occluded, device):
    medium, source = patchy(shape, occluded), some_source(shape)
    kernel, twin = (lit(lattice_on(d, medium), source, steps) for d in (device, None))
    assert_close(kernel.fluence(), twin.fluence(), 1e-5)
    assert_close(kernel.flux(), twin.flux(), 1e-5)
    (left, stopped), (twin_left, twin_stopped) = kernel.lost(), twin.lost()
    assert_close(left, twin_left, 1e-5)
    assert stopped == pytest.approx(twin_stopped, rel=1e-5)
    assert (stopped > 0) == occluded


@on_opencl
@pytest.mark.parametrize(
    ("albedo", "g"), [(0.0, 0.0), (1 - 1e-7, 0.999), (1.0, -0.99), (0.5, -0.5)]
)
def test_kernels_do_so_for_all_optics(albedo, g, device):
    medium, source = patchy(SHAPE, True), some_source(SHAPE)
    kernel, twin = (lit(lattice_on(d, medium, albedo, g), source, 20) for d in (device, None))
    assert_close(kernel.fluence(), twin.fluence(), 1e-5)
    assert_close(kernel.flux(), twin.flux(), 1e-5)


@pytest.mark.parametrize("occluded", [False, True], ids=["clear", "occluded"])
@pytest.mark.parametrize(("albedo", "g"), [(0.9, 0.6), (0.3, -0.8), (1.0, 0.99)])
def test_every_step_accounts_for_all_light(albedo, g, occluded):
    """Light before + handed = light after + absorbed + left + stopped, far from convergence too."""
    medium, source = patchy(SHAPE, occluded), some_source(SHAPE)
    lattice, depth = lattice_on(None, medium, albedo, g), medium[0].astype(float)
    lattice.start(source)
    for _ in range(10):
        before, absorbed = lattice.light.sum(), (1 - albedo) * depth * lattice.fluence()
        left, stopped = lattice.lost()
        lattice.advance(1)
        gone = absorbed.sum() + left.sum() + stopped
        assert before + source.power.sum() == pytest.approx(lattice.light.sum() + gone, rel=1e-12)


@pytest.mark.parametrize("device", [None, *OPENCL], ids=lambda d: name(d) if d else "NumPy")
def test_once_converged_what_is_handed_is_what_goes(device):
    medium, source = patchy(SHAPE, True), some_source(SHAPE)
    lattice = lit(lattice_on(device, medium), source, 400)
    absorbed = (1 - 0.9) * medium[0].astype(float) * lattice.fluence()
    left, stopped = lattice.lost()
    gone = absorbed.sum() + left.sum() + stopped
    assert gone == pytest.approx(source.power.sum(), rel=1e-6 if device else 1e-12)


@pytest.mark.parametrize("partly", [0.0, 0.7])
def test_even_light_in_a_closed_white_box_stays_so(partly):
    """Scattering, streaming and white walls leave it; partly opaque voxels hold less of it."""
    rng = np.random.default_rng(2)
    occlusion = partly * (rng.random(SHAPE) > 0.5)
    walls = np.ones(SHAPE, bool)
    walls[1:-1, 1:-1, 1:-1] = False
    occlusion[walls] = 1
    even = WEIGHTS[:, None, None, None] * (1 - occlusion)
    lattice = lattice_on(None, (patchy(SHAPE, False)[0], occlusion, 1.0), albedo=1.0)
    lattice.start(Source(np.zeros(SHAPE), np.zeros((3, *SHAPE))))
    lattice.light = even
    lattice.advance(30)
    assert lattice.light == pytest.approx(even, abs=1e-14)
    assert lattice.fluence() == pytest.approx(MEAN_LENGTH * (1 - occlusion), abs=1e-14)


@pytest.mark.parametrize("opening", [0.0, 0.3])
def test_white_walls_trap_no_light_between_them(opening):
    """What walls reflect goes off in all directions, not to and fro: in a corridor between two
    it is gone as soon as it would be between the many walls of a labyrinth.
    """
    occlusion = np.zeros((5, 9, 9))
    occlusion[[0, 4]] = 1 - opening
    power = np.zeros(occlusion.shape)
    power[2, 4, 4] = 1
    lattice = lattice_on(None, (np.zeros(occlusion.shape), occlusion, 1.0))
    lattice.start(Source(power, np.zeros((3, *power.shape))))
    lattice.advance(1)
    lattice.emitted = 0 * lattice.emitted
    lattice.advance(60)
    assert lattice.light.sum() < 0.02


@pytest.mark.parametrize("device", [None, *OPENCL], ids=lambda d: name(d) if d else "NumPy")
def test_turned_and_mirrored_media_have_turned_and_mirrored_light(device):
    """All 48 ways to put a cube back in its place; one shape, one program."""
    shape = (4, 4, 4)
    medium, source = patchy(shape, True), some_source(shape)

    def light(turn=lambda grid: grid, swap=lambda vectors: vectors):
        turned = tuple(turn(grid) for grid in medium)
        drift = swap(np.stack([turn(part) for part in source.drift]))
        lattice = lit(lattice_on(device, turned), Source(turn(source.power), drift), 8)
        left, stopped = lattice.lost()
        return lattice.fluence(), lattice.flux(), left.sum(), stopped

    fluence, flux, *lost = light()
    near = 2e-6 if device else 1e-13
    for axes, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        order, sign = list(axes), np.array(signs)[:, None, None, None]

        def turn(grid, axes=axes, signs=signs):
            return np.ascontiguousarray(
                grid.transpose(axes)[tuple(slice(None, None, s) for s in signs)]
            )

        def swap(vectors, order=order, sign=sign):
            return sign * vectors[order]

        turned_fluence, turned_flux, *turned_lost = light(turn, swap)
        assert_close(turned_fluence, turn(fluence), near)
        assert_close(turned_flux, swap(np.stack([turn(part) for part in flux])), 5 * near)
        assert_close(turned_lost, lost, near)


@pytest.mark.parametrize("device", [None, *OPENCL], ids=lambda d: name(d) if d else "NumPy")
def test_light_of_two_sources_is_the_sum(device):
    first, second = some_source(SHAPE, 3), some_source(SHAPE, 4)
    both = Source(first.power - 2 * second.power, first.drift - 2 * second.drift)
    lattice, reads = lattice_on(device, patchy(SHAPE, True)), []
    for source in (first, second, both):
        lit(lattice, source, 12)
        reads.append((lattice.fluence(), lattice.flux(), lattice.lost()[0]))
    for one, other, all_of_it in zip(*reads, strict=True):
        assert_close(all_of_it, np.subtract(one, np.multiply(2, other)), 1e-5 if device else 1e-12)


@on_opencl
def test_a_lattice_starts_afresh_and_gives_the_same_bits(device):
    lattice, source = lattice_on(device, patchy(SHAPE, True)), some_source(SHAPE)
    reads = []
    for _ in range(2):
        lit(lattice, source, 9)
        reads.append((lattice.fluence(), lattice.flux(), *lattice.lost()))
        lit(lattice, some_source(SHAPE, 7), 4)
    for first, second in zip(*reads, strict=True):
        np.testing.assert_array_equal(first, second)


@on_opencl
@pytest.mark.parametrize("occluded", [False, True])
def test_the_plan_names_all_memory(occluded, device):
    """Bytes of all buffers that a lattice and its read-out make."""
    from lb_lighting.transport.physical_opencl import OpenCLLattice

    lattice, made = lattice_on(device, patchy(SHAPE, occluded)), []
    buffers = [*lattice.states, lattice.power, lattice.drift, lattice.depth]
    buffers += [lattice.occlusion, lattice.occlusion_albedo] if occluded else []
    make = lattice._buffer
    lattice._buffer = lambda floats: made.append(make(floats)) or made[-1]
    lit(lattice, some_source(SHAPE), 1).fluence()
    lattice.flux()
    planned = OpenCLLattice.buffers(SHAPE, occluded)
    assert sum(planned.values()) == sum(b.size for b in [*buffers, *made])
