# SPDX-License-Identifier: GPL-3.0-or-later
"""How much faster a step of the lattice is on all cores than on one, on every CPU runtime.

    python -m tests.benchmarks.cores

Prints for 128^3 voxels millions of voxels a second on one core, on all, and their ratio; writes
build/bench/cores.json. A process of its own is kept to one core before its runtime starts; it and
one that may use all take turns of a few steps, and the fastest turns count, when nothing else runs
if such a time comes.
"""

import os
import subprocess
import sys
from math import inf

from tests.benchmarks import quiet
from tests.benchmarks.table import publish

EDGE, STEPS, TURNS = 128, 4, 15


class Worker:
    """A process that steps the lattice of a runtime on these cores when asked."""

    def __init__(self, runtime, cores):
        command = [sys.executable, "-m", "tests.benchmarks.cores", runtime, *map(str, cores)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process, self.fastest = subprocess.Popen(command, **pipes), inf

    def turn(self):
        quiet.wait(3)
        print(file=self.process.stdin, flush=True)
        self.fastest = min(self.fastest, float(self.process.stdout.readline()))

    def close(self):
        """Millions of voxels a second."""
        self.process.stdin.close()
        self.process.wait()
        return EDGE**3 * STEPS / self.fastest / 1e6


def work(runtime, *cores):
    """Take a turn for each line that comes in, and print its seconds."""
    os.sched_setaffinity(0, map(int, cores))  # before the runtime counts them
    from lb_lighting.transport import device
    from tests.benchmarks.lbmpy_step import Ours

    ours = Ours(device.choose(runtime), EDGE)
    for _ in sys.stdin:
        print(ours.seconds(STEPS), flush=True)


def runtimes():
    """The platforms of processors; asked in a process of its own."""
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
