# SPDX-License-Identifier: GPL-3.0-or-later
"""Waits for other processes of a shared machine, so that a measured pair has all cores."""

import os
from time import monotonic, sleep

INTERVAL, IDLE = 0.1, 0.9  # s; idle share of it on a quiet machine
LONGEST = 60  # s


def wait(longest=LONGEST):
    """Return when no other process runs, or after `longest` seconds; at once if this is unknown."""
    until = monotonic() + longest
    while monotonic() < until:
        before = _idle()
        if before is None:
            return
        sleep(INTERVAL)
        if _idle() - before > IDLE * INTERVAL * os.cpu_count():
            return


def _idle():
    """Idle seconds summed over all cores, or None if the system does not count them."""
    try:
        with open("/proc/stat") as lines:
            return int(next(lines).split()[4]) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return None
