# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solve takes in memory against what it was planned to take."""

import sys

import pytest

from lb_lighting.transport import device
from tests.benchmarks.memory import plan_and_peak


@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from Linux's /proc")
@pytest.mark.parametrize("found", device.devices(), ids=lambda found: found.platform.split(",")[0])
def test_a_solve_takes_what_was_planned(found):
    planned, peak = plan_and_peak(found.label, "final", 96)
    assert peak == pytest.approx(planned, rel=0.25)
