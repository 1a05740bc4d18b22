# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarser lattices: their kernels against the twin, what they leave alone, and what they save."""

import numpy as np
import pytest

from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.lattice.convergence import converge
from lb_lighting.transport.lattice.lattice_numpy import NumpyLattice, Source
from lb_lighting.transport.lattice.layout import WEIGHTS
from lb_lighting.transport.lattice.multigrid import Level, shapes
from tests.benchmarks.convergence import ByStepsAlone, converged, difference, medium, started
from tests.tracing import OPENCL, name

on_opencl = pytest.mark.parametrize("device", OPENCL, ids=name)
TOLERANCE, MANY = 1e-2, 20_000


def level_on(make, shape, occluded, seed=0):
    """A level of a patchy medium, lit and stepped once."""
    rng = np.random.default_rng(seed)
    depth = (rng.uniform(0, 3, shape) * (rng.random(shape) > 0.4)).astype(np.float32)
    opaque = (rng.random(shape) > 0.9) * rng.uniform(0.3, 1, shape) if occluded else None
    level = Level(make, depth, 0.97, 0.4, opaque, 0.6)
    reflected = rng.random(shape) if occluded else None
    level.lattice.start(Source(rng.random(shape), rng.random((3, *shape)), reflected))
    level.lattice.advance(1)
    return level


def assert_close(got, expected, relative):
    assert np.abs(got - expected).max() <= relative * np.abs(expected).max()


@on_opencl
@pytest.mark.parametrize("occluded", [False, True])
@pytest.mark.parametrize("shape", [(13, 9, 17), (8, 16, 12), (33, 1, 20)], ids=str)
def test_kernels_correct_as_their_twin_does(shape, occluded, device):
    """On light that lies either way in memory, through two and three levels."""
    kernel, twin = (
        level_on(how, shape, occluded) for how in (backend_of(device).lattice, NumpyLattice)
    )
    for between in (0, 1, 4):
        for level in (kernel, twin):
            level.lattice.advance(between)
            level.correct()
        assert_close(kernel.lattice.fluence(), twin.lattice.fluence(), 1e-5)
        assert_close(kernel.lattice.flux(), twin.lattice.flux(), 1e-5)


@pytest.mark.parametrize("device", [None, *OPENCL], ids=lambda d: name(d) if d else "NumPy")
def test_what_a_correction_added_can_be_taken_back(device):
    level = level_on(backend_of(device).lattice if device else NumpyLattice, (13, 9, 17), True)
    level.lattice.advance(2)
    plain = level.lattice.fluence()
    level.correct()
    corrected = level.lattice.fluence()
    level.take_back()
    again = level_on(backend_of(device).lattice if device else NumpyLattice, (13, 9, 17), True)
    again.lattice.advance(4)
    assert difference(corrected, plain) > 0.1
    assert_close(level.lattice.fluence(), again.lattice.fluence(), 1e-5)


def test_what_is_handed_down_is_all_that_flowed():
    """Power over the squared edge of twice the size, in a medium with an odd edge."""
    fine = level_on(NumpyLattice, (7, 6, 5), False)
    coarse = fine.coarser.lattice
    coarse.start_as_coarser()
    fine.lattice.restrict(coarse, 0.5)
    flowed = np.array(
        [
            np.roll(light, -step)
            for light, step in zip(fine.lattice.light, fine.lattice.steps, strict=True)
        ]
    )
    flowed = fine.lattice.cells.inside(flowed)
    assert coarse.given.sum() * 4 == pytest.approx(0.5 * flowed.sum(), rel=1e-12)


def test_even_light_is_taken_up_as_it_is():
    fine = level_on(NumpyLattice, (7, 6, 9), False)
    coarse = fine.coarser.lattice
    coarse.start_as_coarser()
    coarse.light[...] = WEIGHTS[:, None]
    fine.lattice.light[...] = 0
    fine.lattice.prolongate(coarse, 2.0)
    light = fine.lattice.cells.inside(fine.lattice.light)
    assert light == pytest.approx(
        np.broadcast_to(2 * WEIGHTS[:, None, None, None], light.shape), rel=1e-12
    )


def test_edges_are_halved_until_they_are_short():
    assert shapes((33, 8, 5)) == [(17, 4, 3), (9, 2, 2), (5, 1, 1)]
    assert shapes((8, 3, 2)) == []


@pytest.mark.parametrize("seed", range(40))
def test_random_media_settle_to_the_tolerance(seed):
    """`python -m tests.benchmarks.convergence` does the same with 200."""
    optics = medium(seed)
    light, residual = converged(OPENCL[0], optics)
    assert residual < 1e-5
    level = started(Level, OPENCL[0], optics)
    error, steps, _ = converge(level, TOLERANCE, MANY, lambda _error: None)
    assert error <= TOLERANCE
    assert steps < MANY
    assert difference(level.lattice.fluence().astype(float), light) <= 2 * TOLERANCE


def thick():
    """A white cube, 64 mean free paths deep, lit from above."""
    depth = np.full((32, 32, 32), 2.0)
    power = np.exp(-np.arange(32)[::-1] * 2.0) * np.ones(depth.shape)
    return depth, 1.0, 0.0, power


def test_thick_white_media_take_a_fifth_of_the_steps():
    steps = {}
    for kind in (ByStepsAlone, Level):
        level = started(kind, OPENCL[0], thick())
        error, steps[kind], _ = converge(level, TOLERANCE, MANY, lambda _error: None)
        assert error <= TOLERANCE
    assert steps[Level] < steps[ByStepsAlone] / 5


def test_corrections_that_make_it_worse_are_taken_back_and_given_up():
    """If the coarser lattice were wrong, corrections would hardly speed up convergence."""

    class Wrong(Level):
        def correct(self):
            steps = super().correct()
            self.lattice.prolongate(self.coarser.lattice, 9.0)
            return steps

        def take_back(self):
            self.lattice.prolongate(self.coarser.lattice, -10.0)

    light, _ = converged(OPENCL[0], thick())
    level = started(Wrong, OPENCL[0], thick())
    error, steps, corrections = converge(level, TOLERANCE, MANY, lambda _error: None)
    assert corrections == 1
    assert error <= TOLERANCE
    assert difference(level.lattice.fluence().astype(float), light) <= 2 * TOLERANCE
    alone = converge(
        started(ByStepsAlone, OPENCL[0], thick()), TOLERANCE, MANY, lambda _error: None
    )
    assert steps < 1.2 * alone[1]


def test_light_that_does_not_settle_says_how_far_it_is_off():
    level = started(ByStepsAlone, OPENCL[0], thick())
    error, steps, _ = converge(level, TOLERANCE, 40, lambda _error: None)
    assert steps == 40
    assert error > 0.1
