# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's tables 3 and 4, measured: NumPy and the three kernels on every runtime.

A solve takes 2N steps. A few of them are timed after a warm-up and scaled to 2N. The paper's
figures are printed for comparison, without its second of loading.
"""

from time import perf_counter

import numpy as np

from lb_lighting.transport import PRESETS, Medium, Sun, device
from lb_lighting.transport.paper.collision import collision_matrix
from lb_lighting.transport.paper.model import boundary_inflow
from lb_lighting.transport.paper.paper_numpy import PaperReference
from lb_lighting.transport.paper.paper_opencl import PaperLattice
from lb_lighting.transport.solver import KERNELS
from tests.benchmarks.table import publish

TABLES = {"table 3": (256, 128, 128), "table 4": (128, 128, 128)}
PAPER = {
    "table 3": {"CPU": 1169, "CPU, SSE, 4 threads": 99, "GTX 480 naive": 166, "GTX 480 final": 5},
    "table 4": {
        "CPU": 291.3,
        "CPU, SSE, 4 threads": 25.3,
        "GTX 480 naive": 40.3,
        "GTX 480 final": 1.3,
    },
}
TIMED_STEPS = {"NumPy": 1, "OpenCL": 4}


def cloud(shape):
    """A medium with the paper's cloud parameters, on which the cost of a step does not depend."""
    density = np.random.default_rng(0).random(shape, np.float32)
    optics = PRESETS["cloud"]
    return Medium(density, 1.0, optics.sigma_s, optics.sigma_a, optics.g)


def seconds_a_step(lattice, medium, steps):
    inflow = boundary_inflow([Sun((0.3, 0.2, -0.93), 1.0)], 1)[0]
    omega = collision_matrix(medium.sigma_s[0], medium.sigma_a[0], medium.g[0])
    lattice.start(inflow, omega)
    lattice.advance(1)
    start = perf_counter()
    lattice.advance(steps)
    return (perf_counter() - start) / steps


def rows(table, shape):
    medium = cloud(shape)
    for found in device.devices():
        if found.kind == "NumPy":
            lattices = [("NumPy", lambda: PaperReference(medium, False))]
        else:
            lattices = [
                (
                    kernel,
                    lambda found=found, kernel=kernel: PaperLattice(medium, False, found, kernel),
                )
                for kernel in KERNELS
            ]
        for kernel, make in lattices:
            steps = TIMED_STEPS["NumPy" if kernel == "NumPy" else "OpenCL"]
            each = seconds_a_step(make(), medium, steps)
            yield {
                "table": table,
                "grid": "x".join(map(str, shape)),
                "measured": "here",
                "platform": found.platform.split(",")[0],
                "kernel": kernel,
                "seconds": each * 2 * max(shape),
                "million updates/s": np.prod(shape) / each / 1e6,
            }
    for platform, seconds in PAPER[table].items():
        updates = np.prod(shape) * 2 * max(shape)
        yield {
            "table": table,
            "grid": "x".join(map(str, shape)),
            "measured": "paper",
            "platform": platform,
            "kernel": platform.split()[-1] if "GTX" in platform else "C",
            "seconds": float(seconds),
            "million updates/s": updates / seconds / 1e6,
        }


def main():
    found = device.choose()
    publish("kernels", found.label, [r for item in TABLES.items() for r in rows(*item)])


if __name__ == "__main__":
    main()
