# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a first small solve in a fresh process, on every runtime, with cached binaries.

    python -m tests.benchmarks.startup

Prints the seconds of each part in the fastest of several fresh processes, which use the caches of
an earlier one: importing NumPy and the physics; choosing a device, which imports pyopencl and
queries the drivers; building programs; the remainder of a first solve, of 16^3 voxels under a sun;
and the sum. A second solve in the same process is printed for comparison. Writes
build/bench/startup.json.
"""

import json
import os
import subprocess
import sys
from time import perf_counter

from tests.benchmarks import quiet
from tests.benchmarks.table import publish

RUNS = 7


def first(runtime):
    """{part: seconds} of this process, which must not have imported anything yet."""
    clock = Clock()
    import numpy as np

    clock.stop("numpy")
    from lb_lighting.transport import Medium, Settings, Sun, device, solve

    clock.stop("physics")
    found = device.choose(runtime)
    clock.stop("device")
    build, built = device.program, []

    def timed(*arguments):
        begin = perf_counter()
        program = build(*arguments)
        built.append(perf_counter() - begin)
        return program

    device.program = timed  # before the modules that use it are imported
    medium = Medium(np.ones((16,) * 3), 0.1, 5.0, 0.05, 0.5)
    sun = Sun((0.3, 0.2, -0.93), 1.0)
    solve(medium, [sun], Settings(), found)
    clock.stop("rest")
    clock.parts["programs"] = sum(built)
    clock.parts["rest"] -= sum(built)
    total = sum(clock.parts.values())
    solve(medium, [sun], Settings(), found)
    clock.stop("second solve")
    return clock.parts | {"sum": total}


class Clock:
    """The seconds of parts, one after the other."""

    def __init__(self):
        self.parts, self.begun = {}, perf_counter()

    def stop(self, part):
        now = perf_counter()
        self.parts[part], self.begun = now - self.begun, now


def fresh(runtime):
    """`first` in a separate process."""
    quiet.wait(5)
    command = [sys.executable, "-m", "tests.benchmarks.startup", runtime]
    # An installed extension's modules are compiled once.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return json.loads(subprocess.check_output(command, text=True, env=environment))


def runtimes():
    """The platforms' names, from a separate process, because drivers cache their devices."""
    from lb_lighting.transport import device

    return [found.platform.split(",")[0] for found in device.devices()]


def rows():
    for runtime in runtimes():
        fresh(runtime)
        runs = [fresh(runtime) for _ in range(RUNS)]
        parts = min(runs, key=lambda run: run["sum"])
        yield {"runtime": runtime} | {
            name: parts[name]
            for name in ("numpy", "physics", "device", "programs", "rest", "sum", "second solve")
        }


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(first(sys.argv[1])))
    else:
        publish("startup", "every one", list(rows()))
