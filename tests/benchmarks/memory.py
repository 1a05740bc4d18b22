# SPDX-License-Identifier: GPL-3.0-or-later
"""Planned memory and measured peak memory of a solve, on every device.

    python -m tests.benchmarks.memory DEVICE KERNEL EDGE

measures one solve in a separate process and prints it as JSON; without arguments it measures all.
The peak is the highest resident size of the process (Linux) minus its size after a solve of a tiny
lattice, which loads the driver and builds the programs.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from lb_lighting.transport import PRESETS, Medium, PointLight, Settings, Sun, device, solve
from lb_lighting.transport.solver import KERNELS
from tests.benchmarks.table import publish

EDGES = (96, 160)  # voxels
PHYSICAL = "physical"  # in place of a kernel of the paper: the physical model
SUN = Sun((0.3, 0.2, -0.93), 1.0)
LAMP = PointLight((-20, 3, 5), 1e5)  # its rays need more memory than a sun's layers
_ROOT = Path(__file__).parents[2]


def plan_and_peak(wanted, kernel, edge):
    """(planned, measured) bytes of a solve of edge^3 voxels in three different bands."""
    command = [sys.executable, "-m", __spec__.name, wanted, kernel, str(edge)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, cwd=_ROOT)
    return json.loads(done.stdout.splitlines()[-1])


def measure(wanted, kernel, edge):
    """The same, measured in this process."""
    if kernel == PHYSICAL:
        settings, light = Settings(most_steps=2, divide=1), LAMP
    else:
        settings, light = Settings("paper", steps=2, kernel=kernel), SUN
    _solve(8, settings, light, wanted)
    before = _peak_memory()
    field = _solve(edge, settings, light, wanted)
    return field.report.bytes, _peak_memory() - before


def _solve(edge, settings, light, wanted):
    density = np.full((edge,) * 3, 0.5, np.float32)
    plant = PRESETS["plant"]
    medium = Medium(density, 1.0, plant.sigma_s, plant.sigma_a, plant.g)
    return solve(medium, [light], settings, wanted)


def _peak_memory():
    """Bytes, not from getrusage, which starts at the size of the parent process."""
    with open("/proc/self/status") as lines:
        fields = dict(line.split(":", 1) for line in lines)
    return int(fields["VmHWM"].split()[0]) * 1024


def rows():
    for found in device.devices():
        for kernel in (PHYSICAL, *(("final",) if found.kind == "NumPy" else KERNELS)):
            for edge in EDGES:
                planned, peak = plan_and_peak(found.label, kernel, edge)
                yield {
                    "device": found.label,
                    "kernel": "NumPy" if (found.kind, kernel) == ("NumPy", "final") else kernel,
                    "grid": "x".join([str(edge)] * 3),
                    "planned MiB": planned / 2**20,
                    "peak MiB": peak / 2**20,
                    "peak / plan": peak / planned,
                }


if __name__ == "__main__":
    if sys.argv[1:]:
        name, kernel, edge = sys.argv[1:]
        print(json.dumps(measure(name, kernel, int(edge))))
    else:
        publish("memory", "all", list(rows()))
