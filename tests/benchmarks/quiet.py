# SPDX-License-Identifier: GPL-3.0-or-later
"""Waiting for the other processes of a shared machine, so that both of a pair have all cores."""

import os
from time import monotonic, sleep

LOOK, IDLE = 0.1, 0.9  # s; the share of it that a quiet machine is idle
LONGEST = 60  # s


def wait(longest=LONGEST):
    """Return when nothing else runs, or after so many seconds; at once where none can tell."""
    until = monotonic() + longest
    while monotonic() < until:
        before = _idle()
        if before is None:
            return
        sleep(LOOK)
        if _idle() - before > IDLE * LOOK * os.cpu_count():
            return


def _idle():
    """Seconds that all cores have been idle in sum, where the system counts them."""
    try:
        with open("/proc/stat") as lines:
            return int(next(lines).split()[4]) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return None
