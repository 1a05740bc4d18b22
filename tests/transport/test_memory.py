# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solve takes in memory against what it was planned to take."""

import sys

import pytest

from lb_lighting.transport import Settings, device, hybrid
from lb_lighting.transport.memory import Footprint
from tests.benchmarks.memory import PHYSICAL, plan_and_peak

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from Linux's /proc")
# What a graphics card holds is not in the memory of the process.
each_device = pytest.mark.parametrize(
    "found",
    [found for found in device.devices() if found.shares_memory],
    ids=lambda found: found.platform.split(",")[0],
)


@on_linux
@each_device
def test_a_solve_takes_what_was_planned(found):
    planned, peak = plan_and_peak(found.label, "final", 96)
    assert peak == pytest.approx(planned, rel=0.25)


@on_linux
@each_device
def test_a_physical_solve_takes_what_was_planned_at_most(found):
    edge = 40 if found.kind == "NumPy" else 80
    planned, peak = plan_and_peak(found.label, PHYSICAL, edge)
    assert planned / 2 < peak < 1.1 * planned


def test_work_at_different_times_shares_its_memory():
    rays, lattice = Footprint({"rays": 8}, {"casts": 2}), Footprint({"light": 5}, {"source": 3})
    assert rays.or_larger(lattice) == Footprint({"rays": 8}, {"source": 3})


def test_the_memory_of_a_graphics_card_holds_buffers_alone():
    card = device.Device("Card", "Test", "GPU", memory=10, largest_buffer=8)
    processor = device.Device("Processor", "Test", "CPU", memory=10, largest_buffer=8)
    footprint = Footprint({"light": 8}, {"field": 4})
    assert (footprint.on(card), footprint.on(processor)) == (8, 12)
    assert footprint.fits(card)
    assert not footprint.fits(processor)


def test_each_part_of_a_solve_has_a_name():
    footprint = hybrid.footprint((9, 8, 7), Settings(handover=1.0), device.numpy_device(), 3, True)
    assert footprint.host["opaque voxels"] == 8 * 9 * 8 * 7
    assert all(size > 0 for size in (*footprint.device.values(), *footprint.host.values()))
