# SPDX-License-Identifier: GPL-3.0-or-later
"""Upper limits of the speed on graphics cards, and a plot of them with measurements on CPUs.

    python -m tests.benchmarks.roofline

Counts the bytes and operations per cell of a lattice step in its assembly for NVIDIA (offline.py).
Prints for several cards the voxels per second and the seconds of a solve of 128^3 voxels that their
published bandwidth and arithmetic allow. These are computed, not measured. Writes
build/bench/roofline.json, and docs/measurements/performance/roofline.webp, whose measured points
are read from build/bench/speed-steps.json (`make bench-speed`).
"""

import json
from math import prod
from pathlib import Path

import matplotlib
import numpy as np

from lb_lighting.transport.lattice.layout import Cells
from tests.benchmarks.offline import of_a_cell
from tests.benchmarks.table import BUILD, publish

matplotlib.use("Agg")
from matplotlib import pyplot as plt

DOCS = Path(__file__).parents[2] / "docs" / "measurements" / "performance"
EDGE, STEPS = 128, 176  # a solve of a cloud to 1 %, as speed.py prints
CELLS = Cells((EDGE,) * 3).count / EDGE**3  # per voxel, including the vacuum around the medium
ROOF_BYTES = CELLS * 2 * 18 * 4  # read and written per voxel without collisions
# GB/s and FP32 TFLOP/s published by the makers; typed in from memory, not looked up.
CARDS = {
    "GeForce RTX 4090": (1008, 82.6),
    "Radeon RX 7900 XTX": (960, 61.4),
    "Radeon RX 6800": (512, 16.2),
    "GeForce RTX 3060": (360, 12.7),
    "Apple M2": (100, 3.6),
    "GeForce GTX 480, the paper's": (177, 1.35),
}
COLORS = {"Intel(R) OpenCL": "#1d6fa5", "Portable Computing Language": "#d99a2b"}


def of_a_voxel():
    """Bytes and flops per voxel of a step."""
    there, here = of_a_cell("step_there"), of_a_cell("step_here")
    moved = (here["read"] + here["written"] + there["read"] + there["written"]) / 2
    return CELLS * moved, CELLS * (here["flops"] + there["flops"]) / 2


def rows(moved, flops):
    for card, (bandwidth, arithmetic) in CARDS.items():
        by_memory, by_arithmetic = 1e9 * bandwidth / moved, 1e12 * arithmetic / flops
        speed = min(by_memory, by_arithmetic)
        yield {
            "card (computed)": card,
            "GB/s": bandwidth,
            "TFLOP/s": arithmetic,
            "million voxels/s by memory": by_memory / 1e6,
            "by arithmetic": by_arithmetic / 1e6,
            "s of a solve of 128^3": STEPS * prod((EDGE,) * 3) / speed,
        }


def measured():
    """The rows of speed.py of this size; empty before `make bench-speed`."""
    path = BUILD / "speed-steps.json"
    if not path.exists():
        return []
    return [row for row in json.loads(path.read_text())["rows"] if row["voxels"] == EDGE]


def draw(moved, flops):
    figure, panel = plt.subplots(figsize=(7.5, 4))
    intensity = np.logspace(-1, 2, 300)
    for number, (card, (bandwidth, arithmetic)) in enumerate(CARDS.items()):
        attained = np.minimum(bandwidth * intensity, 1000 * arithmetic)
        panel.plot(intensity, attained, lw=1, ls="--", color="#9a9a9a")
        label = f"{card} (computed)"
        side = "top" if number % 2 else "bottom"
        panel.annotate(label, (100, attained[-1]), fontsize=6, va=side, ha="right")
    for row in measured():
        color = COLORS.get(row["platform"], "#444444")
        roof = ROOF_BYTES * row["roof"] / 1000 * intensity
        panel.plot(intensity[roof < 500], roof[roof < 500], lw=1.2, color=color)
        label = f"two cores, {row['platform']}: {row['ours']:.0f} million voxels/s (measured)"
        panel.plot(flops / moved, row["ours"] * flops / 1000, "o", ms=5, color=color, label=label)
    panel.axvline(flops / moved, lw=0.8, color="#c44536")
    note = f" a step: {flops:.0f} flops,\n {moved:.0f} B a voxel"
    panel.annotate(note, (flops / moved, 4), fontsize=7, color="#c44536")
    panel.set(xscale="log", yscale="log", xlim=(0.1, 100), ylim=(3, 2e5))
    panel.set_xlabel("flops a byte", fontsize=8)
    panel.set_ylabel("GFLOP/s", fontsize=8)
    panel.tick_params(labelsize=7)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(fontsize=7, frameon=False, loc="upper left")
    figure.tight_layout()
    DOCS.mkdir(parents=True, exist_ok=True)
    figure.savefig(DOCS / "roofline.webp", dpi=110, pil_kwargs={"quality": 80})
    print("written to docs/measurements/performance/roofline.webp")


def main():
    moved, flops = of_a_voxel()
    print(f"A step reads and writes {moved:.0f} B a voxel and computes {flops:.0f} flops.")
    publish("roofline", "computed", list(rows(moved, flops)))
    draw(moved, flops)


if __name__ == "__main__":
    main()
