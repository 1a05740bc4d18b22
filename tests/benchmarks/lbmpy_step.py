# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of our lattice beside lbmpy's fastest one of D3Q19, on the same cores, FP32.

    python -m tests.benchmarks.lbmpy_step

Prints for 64^3 and 128^3 and every runtime millions of cells a second of ours, of lbmpy's and their
ratio, and which of lbmpy's it is; writes build/bench/lbmpy_step.json. lbmpy's steps are generated
and compiled first, by the machine's C++ compiler, and tried; then the fastest and ours run in turn,
a few steps each, and the fastest turn of each counts, when nothing else runs if such a time comes.

What a step reads and writes is not the same: 152 B a cell by lbmpy, 164 B by ours, of which 20 B
are the medium and its source; and each of our cells has rates of its own, where all of lbmpy's
fluid has one.
"""

import json
import os
import subprocess
import sys
from math import prod
from time import perf_counter

import numpy as np

from lb_lighting.transport import device
from tests.benchmarks import quiet
from tests.benchmarks.speed import our_level, stepped
from tests.benchmarks.table import publish
from tests.setup import peers

EDGES = (64, 128)
TRIALS, TURNS = 4, 30
CELLS = 2**23  # that a turn updates


class Peer:
    """lbmpy in a process of its own."""

    def __init__(self, edge):
        self.edge = edge
        command = [peers.python(), peers.SCRIPTS / "lbmpy_run.py", str(edge), str(os.cpu_count())]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        # Threads that wait must not take the cores from ours.
        environment = os.environ | {"OMP_WAIT_POLICY": "passive"}
        self.process = subprocess.Popen(command, **pipes, env=environment)
        self.names = json.loads(self._line())
        best = dict.fromkeys(range(len(self.names)), np.inf)
        for _ in range(TRIALS):
            for index in best:
                quiet.wait(1)
                best[index] = min(best[index], self.seconds(steps(edge), index))
        self.tried = {self.names[index]: speed(edge, time) for index, time in best.items()}
        self.chosen = min(best, key=best.get)

    def seconds(self, count, index=None):
        """Of so many steps, after two that do not count, of the fastest candidate or another."""
        index = self.chosen if index is None else index
        for number in (2, count):
            print(index, number, file=self.process.stdin, flush=True)
            seconds = float(self._line())
        return seconds

    def _line(self):
        line = self.process.stdout.readline()
        if not line:
            sys.exit("lbmpy ended; see above. It needs a C++ compiler with OpenMP.")
        return line

    def close(self):
        self.process.stdin.close()
        self.process.wait()


class Ours:
    """Our lattice on a device."""

    def __init__(self, found, edge):
        self.platform = found.platform.split(",")[0]
        self.lattice = our_level(found, (edge,) * 3).lattice

    def seconds(self, count):
        """Of so many steps, after two that do not count."""
        stepped(self.lattice, 2)
        begin = perf_counter()
        stepped(self.lattice, count)
        return perf_counter() - begin


def steps(edge):
    """Of a turn: an even number."""
    return 2 * (CELLS // edge**3 // 2)


def speed(edge, seconds):
    """Millions of cells a second of a turn."""
    return prod((edge,) * 3) * steps(edge) / seconds / 1e6


def rows(edge):
    peer = Peer(edge)
    ours = [Ours(found, edge) for found in device.devices() if found.kind == "CPU"]
    best = dict.fromkeys([peer, *ours], np.inf)
    for _ in range(TURNS):
        for one in best:
            quiet.wait(3)
            best[one] = min(best[one], one.seconds(steps(edge)))
    peer.close()
    for one in ours:
        yield {
            "voxels": edge,
            "runtime": one.platform,
            "ours": speed(edge, best[one]),
            "lbmpy": speed(edge, best[peer]),
            "ours / lbmpy": best[peer] / best[one],
            "lbmpy's": peer.names[peer.chosen],
            "tried": " ".join(f"{value:.0f}" for value in peer.tried.values()),
        }


def main():
    publish("lbmpy_step", device.choose().label, [row for edge in EDGES for row in rows(edge)])


if __name__ == "__main__":
    main()
