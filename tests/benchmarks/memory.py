# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory that a solve is planned to take, and the most that it took, on every device.

    python -m tests.benchmarks.memory DEVICE KERNEL EDGE

measures one, in a process of its own, and prints it as JSON; without arguments it measures
all. The peak is the process's highest resident size (Linux) beyond what it had after a solve of
a tiny lattice, which loads the driver and builds its programs.
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
PHYSICAL = "physical"  # stands for a kernel: that of the physical model
SUN = Sun((0.3, 0.2, -0.93), 1.0)
LAMP = PointLight((-20, 3, 5), 1e5)  # its rays take more memory than a sun's layers
_ROOT = Path(__file__).parents[2]


def plan_and_peak(wanted, kernel, edge):
    """(planned, measured) bytes of a solve of edge^3 voxels in three bands that differ."""
    command = [sys.executable, "-m", __spec__.name, wanted, kernel, str(edge)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, cwd=_ROOT)
    return json.loads(done.stdout.splitlines()[-1])


def measure(wanted, kernel, edge):
    """The same for this process."""
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
    """Bytes. Not getrusage's: that begins with the size of the process which started this one."""
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
