# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solve takes in memory against what it was planned to take."""

import sys

import pytest

from lb_lighting.transport import device
from tests.benchmarks.memory import PHYSICAL, plan_and_peak

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the peak is read from Linux's /proc"
)
# What a graphics card holds is not in the memory of the process.
each_device = pytest.mark.parametrize(
    "found",
    [found for found in device.devices() if found.shares_memory],
    ids=lambda found: found.platform.split(",")[0],
)


@each_device
def test_a_solve_takes_what_was_planned(found):
    planned, peak = plan_and_peak(found.label, "final", 96)
    assert peak == pytest.approx(planned, rel=0.25)


@each_device
def test_a_physical_solve_takes_what_was_planned_at_most(found):
    edge = 40 if found.kind == "NumPy" else 80
    planned, peak = plan_and_peak(found.label, PHYSICAL, edge)
    assert planned / 2 < peak < 1.1 * planned
