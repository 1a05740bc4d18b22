# SPDX-License-Identifier: GPL-3.0-or-later
"""Every kernel on every OpenCL device against the NumPy update in float64."""

import numpy as np
import pytest

from lb_lighting.errors import DeviceError
from lb_lighting.transport import Medium, Settings, Sky, Sun, device, solve
from lb_lighting.transport.memory import Footprint, require_memory
from lb_lighting.transport.paper.collision import collision_matrix
from lb_lighting.transport.paper.paper_numpy import PaperReference
from lb_lighting.transport.paper.paper_opencl import PaperLattice
from lb_lighting.transport.solver import KERNELS

OPENCL = [found for found in device.devices() if found.kind != "NumPy"]
SHAPES = [(23, 14, 37), (5, 31, 9), (3, 3, 50)]


def relative(values, expected):
    return np.linalg.norm(values - expected) / np.linalg.norm(expected)


def random_medium(shape, seed=0, occluded=False):
    """Voids, thin and dense voxels; with `occluded`, some opaque ones."""
    rng = np.random.default_rng(seed)
    density = rng.random(shape) * (rng.random(shape) > 0.3)
    occlusion = (rng.random(shape) < 0.05) * rng.random(shape) if occluded else None
    return Medium(density, 1.0, 0.792, 0.108, 0.6, occlusion=occlusion)


def test_both_runtimes_are_tested():
    """The environment brings two independent implementations; a lost one would go unnoticed."""
    platforms = " ".join(found.platform for found in OPENCL)
    assert "Intel" in platforms
    assert "PoCL" in platforms


@pytest.mark.parametrize("found", OPENCL, ids=lambda found: found.platform.split(",")[0])
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("keep_absorbed", "occluded"), [(False, False), (True, True)])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_kernel_follows_the_reference(found, kernel, keep_absorbed, occluded, shape):
    medium = random_medium(shape, occluded=occluded)
    inflow, omega = np.linspace(0, 1, 19), collision_matrix(0.792, 0.108, 0.6)
    lattices = (
        PaperReference(medium, keep_absorbed),
        PaperLattice(medium, keep_absorbed, found, kernel),
    )
    for lattice in lattices:
        lattice.start(inflow, omega)
        lattice.advance(50)
    for previous in (False, True):
        reference, paper = (lattice.read(previous) for lattice in lattices)
        with reference as expected, paper as values:
            assert relative(values, expected) <= 1e-5


@pytest.mark.parametrize("found", OPENCL, ids=lambda found: found.platform.split(",")[0])
def test_device_asked_for_is_the_device_used(found):
    field = solve(random_medium((5, 6, 7)), [Sky(1)], Settings("paper"), device=found.label)
    assert field.report.device == found.label


@pytest.mark.parametrize("found", OPENCL, ids=lambda found: found.platform.split(",")[0])
def test_whole_solve_agrees_with_numpy(found):
    medium, lights = random_medium((12, 9, 17)), [Sun((0.3, 0.2, -0.9), 3.0), Sky(0.1)]
    expected = solve(medium, lights, Settings("paper"), device="NumPy")
    field = solve(medium, lights, Settings("paper", kernel="coalesced"), device=found.label)
    assert relative(field.fluence, expected.fluence) <= 1e-5
    assert relative(field.flux, expected.flux) <= 1e-5


def test_too_large_a_grid_is_refused_before_allocation():
    small = device.Device("Small", "Test", "CPU", memory=10 * 2**20, largest_buffer=4 * 2**20)

    def footprint(shape):
        return Footprint(PaperLattice.buffers(shape, "final", occluded=False))

    with pytest.raises(DeviceError, match=r"largest resolution that fits is (\d+)\.") as refusal:
        require_memory(small, (80, 60, 40), footprint)
    largest = int(str(refusal.value).rsplit(" ", 1)[1].rstrip("."))

    def at(resolution):
        return [max(1, -(-n * resolution // 80)) for n in (80, 60, 40)]

    assert require_memory(small, at(largest), footprint) <= small.memory
    with pytest.raises(DeviceError):
        require_memory(small, at(largest + 1), footprint)


@pytest.mark.parametrize("found", OPENCL, ids=lambda found: found.platform.split(",")[0])
def test_stripes_too_long_for_the_device(found):
    """The final kernel copes with them; the coalesced one, which needs them whole, says so."""
    longest = device.queue(found).device.max_work_group_size
    medium = random_medium((3, 3, longest + 8))
    field = solve(medium, [Sky(1)], Settings("paper", steps=3), device=found.label)
    expected = solve(medium, [Sky(1)], Settings("paper", steps=3), device="NumPy")
    assert relative(field.fluence, expected.fluence) <= 1e-5
    with pytest.raises(DeviceError, match="use the final kernel"):
        solve(medium, [Sky(1)], Settings("paper", steps=3, kernel="coalesced"), device=found.label)
