# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of our lattice, compared with lbmpy's fastest D3Q19 step on the same cores, FP32.

    python -m tests.benchmarks.lbmpy_step

Prints for 64^3 and 128^3 cells and every runtime the million cells per second of ours and of lbmpy,
their ratio, and the name of lbmpy's step; writes build/bench/lbmpy_step.json. lbmpy's steps are
generated, compiled by the machine's C++ compiler and timed. Then the fastest and ours alternate, a
few steps each, and the fastest turn of each counts. Turns wait for an idle machine, but not long.

The memory traffic of a step differs: 152 B per cell in lbmpy and 164 B in ours, of which 20 B are
the medium and its source. Each of our cells has individual rates; lbmpy's fluid has one rate.
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
CELLS = 2**23  # updates per turn


class Peer:
    """lbmpy in a separate process."""

    def __init__(self, edge):
        self.edge = edge
        command = [peers.python(), peers.SCRIPTS / "lbmpy_run.py", str(edge), str(os.cpu_count())]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        # Waiting threads must not occupy the cores.
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
        """Of the given steps of the fastest candidate, or of another, after two untimed steps."""
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
        """Of the given steps, after two untimed steps."""
        stepped(self.lattice, 2)
        begin = perf_counter()
        stepped(self.lattice, count)
        return perf_counter() - begin


def steps(edge):
    """The steps of a turn, an even number."""
    return 2 * (CELLS // edge**3 // 2)


def speed(edge, seconds):
    """Million cells per second in a turn."""
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
