# SPDX-License-Identifier: GPL-3.0-or-later
"""The plots and the table of docs/measurements/speed-and-accuracy.md, from build/bench/trade*.json.

python -m tests.benchmarks.trade_plots
"""

import json

import matplotlib

from tests.benchmarks.figures import write_small
from tests.benchmarks.table import BUILD

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import NullLocator

KINDS = {
    "lattice, 8 to 128 voxels": ("resolution", "#c44536"),
    "other tolerances": ("tolerance", "#e8a598"),
    "half and twice the rays": ("rays", "#8c6d5a"),
    "photons, then the lattice": ("handover", "#d99a2b"),
    "of other numbers": ("photons a voxel, T=2", "#f0d39a"),
    "and merged voxels": ("16 voxels and photons, T=2", "#7a4fa3"),
    "photons alone": ("Monte Carlo, photons a voxel", "#1d6fa5"),
    "single scattering": ("single scattering", "#3a8f55"),
    "paper, scaled to fit best": ("model", "#9a9a9a"),
}
LEAST = 0.003  # smaller errors are drawn here
COLUMNS = 5


def rows_of(name):
    return json.loads((BUILD / f"{name}.json").read_text())["rows"]


def front(rows):
    """The Pareto front: rows for which no other row is both faster and more accurate, by work."""
    best, found = float("inf"), []
    for row in sorted(rows, key=lambda row: row["work"]):
        if row["error"] < best:
            best = row["error"]
            found.append(row)
    return found


def way(row):
    """A short label of a row."""
    return f"{row['dial']} {row['at']}".strip()


def fronts():
    """Error against work in each medium, and the Pareto front."""
    rows = [row for row in rows_of("trade") if "error" in row]
    names = list(dict.fromkeys(row["case"] for row in rows))
    lines = -(-len(names) // COLUMNS)
    figure, panels = plt.subplots(
        lines, COLUMNS, figsize=(11, 1.75 * lines), sharex=True, sharey=True
    )
    for panel in panels.flat[len(names) :]:
        panel.set_visible(False)
    for panel, name in zip(panels.flat, names, strict=False):
        own = [row for row in rows if row["case"] == name]
        for label, (dial, color) in KINDS.items():
            some = [row for row in own if row["dial"] == dial]
            errors = [max(row["error"], LEAST) for row in some]
            panel.plot([row["work"] for row in some], errors, "o", ms=3, color=color, label=label)
        best = front(own)
        errors = [max(row["error"], LEAST) for row in best]
        panel.step([row["work"] for row in best], errors, where="post", lw=0.8, color="#444444")
        panel.set_title(name, fontsize=7)
        panel.set_xscale("log")
        panel.set_yscale("log")
        ticks = (0.01, 0.1, 1)
        panel.set_yticks(ticks, [f"{100 * tick:g} %" for tick in ticks])
        panel.yaxis.set_minor_locator(NullLocator())
        panel.grid(lw=0.4, color="#e4e4e4")
        panel.set_axisbelow(True)
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=7, frameon=False, ncols=4, loc="lower center")
    figure.text(0.5, 0.05, "work: processor time, over that of the default settings", ha="center")
    write_small(figure, "measurements/speed-and-accuracy", "fronts", bottom=0.07)


def kept():
    """Predictions of the planner against measurements: error and seconds."""
    rows = [row for row in rows_of("planner") if "error" in row]
    figure, (errors, seconds) = plt.subplots(1, 2, figsize=(8, 3.8))
    for quality, color in zip(
        ("preview", "draft", "final", "reference"),
        ("#9a9a9a", "#d99a2b", "#c44536", "#1d6fa5"),
        strict=True,
    ):
        some = [row for row in rows if row["quality"] == quality]
        errors.plot(
            [row["expected"] for row in some],
            [max(row["error"], LEAST) for row in some],
            "o",
            ms=3,
            color=color,
            label=quality,
        )
        errors.axhline(some[0]["target"], lw=0.8, ls="--", color=color)
        predicted = [row["predicted"] * row["seconds"] for row in some]
        seconds.plot(predicted, [row["seconds"] for row in some], "o", ms=3, color=color)
    for panel, name, ends in ((errors, "error", (LEAST, 0.4)), (seconds, "s", (0.03, 100))):
        panel.plot(ends, ends, lw=0.8, color="#444444")
        panel.set(xscale="log", yscale="log", xlabel=f"{name}, predicted", ylabel=f"{name}, found")
        panel.grid(lw=0.4, color="#e4e4e4")
    for factor in (0.5, 2):
        seconds.plot((0.03, 100), (0.03 * factor, 100 * factor), lw=0.6, ls="--", color="#444444")
    errors.legend(fontsize=7, frameon=False)
    write_small(figure, "measurements/speed-and-accuracy", "planner")


def table():
    """Markdown: the rows on the front of each medium."""
    rows = [row for row in rows_of("trade") if "error" in row]
    print("| medium | from fastest to most accurate: work, error |\n|---|---|")
    for name in dict.fromkeys(row["case"] for row in rows):
        steps = (
            f"{way(row)}: {row['work']:.2g}, {100 * row['error']:.1f} %"
            for row in front([row for row in rows if row["case"] == name])
        )
        print(f"| {name} | {'; '.join(steps)} |")


if __name__ == "__main__":
    fronts()
    kept()
    table()
