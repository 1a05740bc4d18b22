# SPDX-License-Identifier: GPL-3.0-or-later
"""The plots of docs/theory/physics.md, from build/bench/accuracy-cases.json and accuracy-
refinement.json.

python -m tests.benchmarks.accuracy_plots
"""

import json

import matplotlib

from tests.benchmarks.accuracy import REACH
from tests.benchmarks.figures import write_small
from tests.benchmarks.table import BUILD

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import NullLocator

COLORS = {
    "paper": "#9a9a9a",
    "deterministic": "#c44536",
    "hybrid T=2": "#d99a2b",
    "hybrid T=4": "#1d6fa5",
}
NAMES = {"paper": "paper, scaled to fit best"}
LEAST = 0.001  # smaller errors are drawn here


def rows_of(name):
    return json.loads((BUILD / f"accuracy-{name}.json").read_text())["rows"]


def cases():
    """The error of each case in each column; a refused case is a cross at the right edge."""
    rows = rows_of("cases")
    names = list(dict.fromkeys(row["case"] for row in rows))
    figure, panel = plt.subplots(figsize=(8, 0.19 * len(names) + 1))
    for column, color in COLORS.items():
        some = [row for row in rows if row["column"] == column]
        solved = [row for row in some if "error" in row]
        panel.plot(
            [max(LEAST, row["error"]) for row in solved],
            [names.index(row["case"]) for row in solved],
            "o",
            ms=4.5,
            color=color,
            label=NAMES.get(column, column),
        )
        panel.plot(
            [1] * (len(some) - len(solved)),
            [names.index(row["case"]) for row in some if "error" not in row],
            "x",
            ms=5,
            color=color,
        )
        if column in REACH:
            panel.axvline(REACH[column][1], lw=1, ls="--", color=color)
    panel.set_xscale("log")
    panel.set_xlim(LEAST * 0.9, 1.1)
    ticks = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1)
    panel.set_xticks(ticks, [f"{100 * tick:g} %" for tick in ticks])
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xlabel("relative L2 error of all light", fontsize=8)
    panel.set_yticks(range(len(names)), names)
    panel.invert_yaxis()
    panel.grid(axis="y", lw=0.4, color="#dddddd")
    panel.set_axisbelow(True)
    panel.legend(fontsize=7, frameon=False, ncols=4, loc="lower left", bbox_to_anchor=(0, 1))
    write_small(figure, "theory/physics", "accuracy")


def refinement():
    """The error of a medium by the size of its voxels."""
    rows = rows_of("refinement")
    figure, panel = plt.subplots(figsize=(5, 3.2))
    for name in dict.fromkeys(row["case"] for row in rows):
        some = [(row["voxels"], row["error"]) for row in rows if row["case"] == name]
        panel.plot(*zip(*some, strict=True), "o-", ms=3.5, label=name)
    panel.set_xscale("log")
    panel.set_ylim(0, 0.07)
    voxels = sorted({row["voxels"] for row in rows})
    panel.set_xticks(voxels, voxels)
    panel.xaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_major_formatter(lambda value, _: f"{100 * value:g} %")
    panel.set_xlabel("voxels along an edge", fontsize=8)
    panel.set_ylabel("relative L2 error", fontsize=8)
    panel.legend(fontsize=7, frameon=False)
    write_small(figure, "theory/physics", "refinement")


if __name__ == "__main__":
    cases()
    refinement()
