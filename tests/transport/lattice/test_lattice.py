# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice of the physical model: its kernels against their twin, and what must hold exactly."""

from dataclasses import replace
from functools import partial
from itertools import permutations, product

import numpy as np
import pytest

from lb_lighting.transport.lattice.boundary import REFLECTED, open_faces
from lb_lighting.transport.lattice.lattice_numpy import DIAGONAL_BLOCKING, NumpyLattice, Source
from lb_lighting.transport.lattice.layout import LENGTHS, MEAN_LENGTH, WEIGHTS
from lb_lighting.transport.lattice.multigrid import Level
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


def block(shape):
    """(depth, occlusion, its albedo): a box with flat faces in the void, on opaque ground."""
    depth, occlusion = np.zeros((2, *shape), np.float32)
    depth[1:-2, 2:-1, 2:-2] = 0.7
    occlusion[..., 0] = 0.8
    return depth, occlusion, 0.5


def power_of(lattice):
    """W/m^2, all light on its way; of what has left the domain, what comes back."""
    return np.sum(np.where(lattice.inside, 1, lattice.outside) * lattice.light)


MEDIA = {
    "clear": lambda shape: patchy(shape, False),
    "occluded": lambda shape: patchy(shape, True),
    "block": block,
}


def lattice_on(device, medium, albedo=0.9, g=0.6):
    depth, occlusion, occlusion_albedo = medium
    if device is None:
        return NumpyLattice(depth, albedo, g, occlusion, occlusion_albedo)
    from lb_lighting.transport.lattice.lattice_opencl import OpenclLattice

    return OpenclLattice(depth, albedo, g, occlusion, occlusion_albedo, device)


def lit(lattice, source, steps):
    lattice.start(source)
    lattice.advance(steps)
    return lattice


def assert_close(got, expected, relative):
    got, expected = np.asarray(got, float), np.asarray(expected, float)
    assert np.all(np.isfinite(got))
    assert np.abs(got - expected).max() <= relative * np.abs(expected).max()


@on_opencl
@pytest.mark.parametrize("kind", MEDIA)
@pytest.mark.parametrize(
    ("shape", "steps"), [(FLAT, 20), (SMALL, 20), (LONG, 6), (ODD, 6)], ids=str
)
def test_kernels_do_what_their_twin_does(shape, steps, kind, device):
    medium, source = MEDIA[kind](shape), some_source(shape)
    kernel, twin = (lit(lattice_on(d, medium), source, steps) for d in (device, None))
    assert_close(kernel.fluence(), twin.fluence(), 1e-5)
    assert_close(kernel.flux(), twin.flux(), 1e-5)
    (left, stopped), (twin_left, twin_stopped) = kernel.lost(), twin.lost()
    assert_close(left, twin_left, 1e-5)
    assert stopped == pytest.approx(twin_stopped, rel=1e-5)
    assert (stopped > 0) == (kind != "clear")


@on_opencl
@pytest.mark.parametrize(
    ("albedo", "g"), [(0.0, 0.0), (1 - 1e-7, 0.999), (1.0, -0.99), (0.5, -0.5)]
)
def test_kernels_do_so_for_all_optics(albedo, g, device):
    medium, source = patchy(SHAPE, True), some_source(SHAPE)
    kernel, twin = (lit(lattice_on(d, medium, albedo, g), source, 20) for d in (device, None))
    assert_close(kernel.fluence(), twin.fluence(), 1e-5)
    assert_close(kernel.flux(), twin.flux(), 1e-5)


@pytest.mark.parametrize("kind", MEDIA)
@pytest.mark.parametrize(("albedo", "g"), [(0.9, 0.6), (0.3, -0.8), (1.0, 0.99)])
def test_every_step_accounts_for_all_light(albedo, g, kind):
    """Light before + source = light after + absorbed + left + stopped, far from convergence too."""
    medium, source = MEDIA[kind](SHAPE), some_source(SHAPE)
    lattice, depth = lattice_on(None, medium, albedo, g), medium[0].astype(float)
    lattice.start(source)
    for _ in range(10):
        before, absorbed = power_of(lattice), (1 - albedo) * depth * lattice.fluence()
        lattice.advance(1)
        left, stopped = lattice.lost()
        gone = absorbed.sum() + left.sum() + stopped
        assert before + source.power.sum() == pytest.approx(power_of(lattice) + gone, rel=1e-12)


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
    lattice = lattice_on(None, (patchy(SHAPE, False)[0], occlusion, 1.0), albedo=1.0)
    even = np.multiply.outer(WEIGHTS, lattice.cells.flat(1 - occlusion))
    lattice.start(Source(np.zeros(SHAPE), np.zeros((3, *SHAPE))))
    lattice.light = even.copy()
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
    lattice.given[...] = 0
    lattice.emitted[...] = 0
    lattice.advance(60)
    assert lattice.light.sum() < 0.02


def ends_of(*boxes, shape=(9, 9, 9)):
    """`open_faces` of boxes of a scattering medium in the void."""
    depth = np.zeros(shape)
    for box in boxes:
        depth[box] = 1
    return open_faces(depth)


def test_faces_of_a_block_in_the_void_are_open_as_those_of_the_domain():
    inside = (slice(2, 7),) * 3
    alone, within = ends_of(inside), open_faces(np.ones((5, 5, 5)))
    np.testing.assert_array_equal(alone[inside], within)
    middle = within[1:-1, 1:-1, 1:-1]
    assert not middle.any()
    assert [within[0, 2, 2], within[4, 2, 2], within[2, 0, 2], within[2, 4, 2]] == [1, 2, 4, 8]
    assert [within[2, 2, 0], within[2, 2, 4], within[4, 4, 4]] == [16, 32, 2 | 8 | 32]


def test_faces_that_face_matter_or_are_not_flat_are_not_open():
    wall, plate = np.s_[2:4], np.s_[2:4, 3:6, 3:6]
    assert not np.any(ends_of(wall, np.s_[6:8])[3] & 2)  # a gap between walls
    assert np.all(ends_of(wall)[3] & 2)
    pimple = ends_of(wall, np.s_[4, 4, 4])[3]
    assert not np.any(pimple[3:6, 3:6] & 2)
    shaded = ends_of(plate, np.s_[6:, :, 7:])[3]  # a diagonal through its face ends in matter
    assert not np.any(shaded[3:6, 4:6] & 2)
    opaque = np.zeros((9, 9, 9))
    opaque[3, 6, 4] = 1  # beside the face, where diagonals pass
    depth = np.zeros(opaque.shape)
    depth[plate] = 1
    assert not open_faces(depth, opaque)[3, 5, 4] & 2


def test_light_ends_at_a_block_in_the_void_as_at_the_domains_faces():
    """The same light inside, voxel by voxel, and through the domain's faces together, but for what
    goes over the block's edges on diagonals, of which nothing comes back.
    """
    # So thick that it does not tell how large the domain is (see `returned`).
    depth = np.random.default_rng(5).uniform(50, 200, SHAPE)
    source = some_source(SHAPE)
    margin = [(2, 2)] * 3
    wide = Source(np.pad(source.power, margin), np.pad(source.drift, [(0, 0), *margin]))
    alone = lit(lattice_on(None, (depth, None, 0.0)), source, 200)
    within = lit(lattice_on(None, (np.pad(depth, margin), None, 0.0)), wide, 200)
    inside = (slice(2, -2),) * 3
    assert_close(within.fluence()[inside], alone.fluence(), 2e-3)
    assert within.lost()[0].sum() == pytest.approx(alone.lost()[0].sum(), rel=4e-3)
    assert alone.outside[~alone.inside].min() == pytest.approx(REFLECTED, rel=0.01)


def test_straight_and_diagonal_light_meets_three_voxels_a_way_of_two():
    """As straight lines of all directions enter 3/2 voxels a voxel's edge."""
    share = WEIGHTS * LENGTHS / MEAN_LENGTH
    entered = np.where(LENGTHS == 1, 1, 2 + DIAGONAL_BLOCKING)
    assert np.sum(share * entered / LENGTHS) == pytest.approx(1.5)


@pytest.mark.parametrize("device", [None, *OPENCL], ids=lambda d: name(d) if d else "NumPy")
def test_what_the_ground_reflects_goes_up_from_it_and_not_along_it(device):
    """The flux is exact. The fluence over it is 2 above ground of Lambert's law; without the light
    that grazes the ground, which would fill one layer for as far as the domain goes, it is 1.35.
    """
    shape = (31, 31, 9)
    occlusion, reflected = np.zeros((2, *shape))
    occlusion[..., 0] = 1
    reflected[..., 1] = 1
    dark = np.zeros(shape)
    lattice = lattice_on(device, (dark, occlusion, 0.5))
    lit(lattice, Source(dark, np.zeros((3, *shape)), reflected), 40)
    middle = (15, 15, slice(1, None))
    assert lattice.flux()[2][middle] == pytest.approx(1.0, rel=1e-5)
    assert lattice.fluence()[middle] == pytest.approx(1.352, rel=1e-3)


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
def test_the_plan_names_all_memory(occluded, device, monkeypatch):
    """Bytes of all buffers that a lattice, coarser ones and the read-out make."""
    cl = pytest.importorskip("pyopencl")
    from lb_lighting.transport.lattice.lattice_opencl import OpenclLattice

    shape, made = (19, 9, 12), []
    make_buffer = cl.Buffer
    monkeypatch.setattr(
        cl, "Buffer", lambda *args, **named: made.append(make_buffer(*args, **named)) or made[-1]
    )
    depth, occlusion, albedo = patchy(shape, occluded)
    level = Level(partial(OpenclLattice, device=device), depth, 0.9, 0.6, occlusion, albedo)
    source = some_source(shape)
    lit(level.lattice, replace(source, reflected=source.power), 1)
    for _ in range(2):
        level.correct()
    level.lattice.fluence()
    level.lattice.flux()
    planned = OpenclLattice.buffers(shape, occluded)
    taken = sum(buffer.size for buffer in made)
    assert taken <= sum(planned.values()) <= 1.1 * taken
