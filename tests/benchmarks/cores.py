# SPDX-License-Identifier: GPL-3.0-or-later
"""Speedup of a lattice step on all cores over one core, on every CPU runtime.

    python -m tests.benchmarks.cores

Prints for 128^3 voxels the million voxels per second on one core and on all, and their ratio;
writes build/bench/cores.json. A separate process is bound to one core before its runtime starts. It
alternates with a process on all cores, a few steps each, and the fastest turn of each counts. Turns
wait for an idle machine, but not for long.
"""

import os
import subprocess
import sys
from math import inf

from tests.benchmarks import quiet
from tests.benchmarks.table import publish

EDGE, STEPS, TURNS = 128, 4, 15


class Worker:
    """A process that steps the lattice of a runtime on the given cores on request."""

    def __init__(self, runtime, cores):
        command = [sys.executable, "-m", "tests.benchmarks.cores", runtime, *map(str, cores)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process, self.fastest = subprocess.Popen(command, **pipes), inf

    def turn(self):
        quiet.wait(3)
        print(file=self.process.stdin, flush=True)
        self.fastest = min(self.fastest, float(self.process.stdout.readline()))

    def close(self):
        """Million voxels per second."""
        self.process.stdin.close()
        self.process.wait()
        return EDGE**3 * STEPS / self.fastest / 1e6


def work(runtime, *cores):
    """Take a turn for each input line, and print its seconds."""
    os.sched_setaffinity(0, map(int, cores))  # before the runtime counts them
    from lb_lighting.transport import device
    from tests.benchmarks.lbmpy_step import Ours

    ours = Ours(device.choose(runtime), EDGE)
    for _ in sys.stdin:
        print(ours.seconds(STEPS), flush=True)


def runtimes():
    """The platforms with CPUs, listed by a separate process."""
    from lb_lighting.transport import device

    return [found.platform.split(",")[0] for found in device.devices() if found.kind == "CPU"]


def rows():
    cores = sorted(os.sched_getaffinity(0))
    for runtime in runtimes():
        one, all_cores = Worker(runtime, cores[:1]), Worker(runtime, cores)
        for _ in range(TURNS):
            one.turn()
            all_cores.turn()
        slow, fast = one.close(), all_cores.close()
        yield {
            "runtime": runtime,
            "cores": len(cores),
            "on one": slow,
            "on all": fast,
            "ratio": fast / slow,
        }


if __name__ == "__main__":
    if len(sys.argv) > 1:
        work(*sys.argv[1:])
    else:
        publish("cores", "processors", list(rows()))
