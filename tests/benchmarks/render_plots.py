# SPDX-License-Identifier: GPL-3.0-or-later
"""The curves and pictures of docs/measurements/renders.md, from the output of `make bench-render`
in build/bench.

python -m tests.benchmarks.render_plots
"""

import json
from pathlib import Path

import matplotlib
import numpy as np

from tests.benchmarks import pictures
from tests.benchmarks.figures import write
from tests.benchmarks.table import BUILD

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import NullLocator
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs" / "measurements" / "renders"
GROUPS = "clouds", "trees", "smoke", "teapot"
TARGET = 0.06
SHOWN = 16  # samples of our picture
COLORS = ("#1d6fa5", "#d99a2b", "#7a9a5a")  # Cycles: all bounces, and fewer bounces
OURS = "#c44536"
TICKS = 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1
SCALE = 2  # pixels of the drawing per pixel of a picture


def rows_of(group):
    """{scene: [row]} of the measured scenes."""
    path = BUILD / f"render-{group}.json"
    found = {}
    for row in json.loads(path.read_text())["rows"] if path.exists() else ():
        found.setdefault(row["scene"], []).append(row)
    return found


# --- Curves --------------------------------------------------------------------------------------


def curves(group, scenes):
    """Error against processor time, a panel for each scene."""
    columns = min(2, len(scenes))
    lines = -(-len(scenes) // columns)
    size = (4.2 * columns, 3 * lines + 0.4)
    figure, panels = plt.subplots(lines, columns, figsize=size, squeeze=False)
    for panel, (scene, rows) in zip(panels.ravel(), scenes.items(), strict=False):
        draw(panel, rows)
        panel.set_title(scene, fontsize=8)
    for panel in panels.ravel()[len(scenes) :]:
        panel.set_axis_off()
    for panel in panels.ravel()[: len(scenes)][-columns:]:
        panel.set_xlabel("processor time, s", fontsize=8)
    for panel in panels[:, 0]:
        panel.set_ylabel("error", fontsize=8)
    figure.tight_layout(rect=(0, 0.12 / lines, 1, 1))
    handles = panels[0, 0].get_legend_handles_labels()
    figure.legend(*handles, fontsize=6, frameon=False, loc="lower center", ncols=2 * columns)
    save(figure, f"curves-{group}")


def draw(panel, rows):
    lights = dict.fromkeys(row["light"] for row in rows)
    bounces = list(dict.fromkeys(light.split(",")[0] for light in lights if light != "ours"))
    for light in lights:
        some = [row for row in rows if row["light"] == light]
        error = [row["error"] for row in some]
        seconds = np.array([row["processor s"] for row in some])
        if light == "ours":
            bake = some[0]["bake, processor s"]
            panel.plot(seconds + bake, error, "o-", ms=3.5, color=OURS, label="ours, with bake")
            panel.plot(seconds + bake / 24, error, "o:", ms=3.5, color=OURS, label="ours, 24 views")
            continue
        color = COLORS[bounces.index(light.split(",")[0])]
        style = "s--" if "denoised" in light else "o-"
        panel.plot(seconds, error, style, ms=3, color=color, label=f"Cycles, {light}")
    panel.axhline(TARGET, lw=0.8, color="#999999")
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_yticks(TICKS, [f"{100 * tick:g} %" for tick in TICKS])
    panel.yaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_minor_formatter("")
    panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=7)


def save(figure, name):
    write(figure, "measurements/renders", name)
    plt.close(figure)


# --- Pictures ------------------------------------------------------------------------------------


def side_by_side(scene, rows):
    """Reference, Cycles and denoised Cycles in about our time, ours; below, four times the
    differences. Returns the rows of the three."""
    with np.load(BUILD / "render" / f"{scene}.npz") as file:
        wanted, images = file["reference"].astype(float).mean(axis=0), file["images"].astype(float)
    ours = next(i for i, r in enumerate(rows) if r["light"] == "ours" and r["samples"] == SHOWN)
    spent = rows[ours]["processor s"] + rows[ours]["bake, processor s"]
    most = next(row["light"] for row in rows)
    chosen = [nearest(rows, light, spent) for light in (most, f"{most}, denoised")] + [ours]
    white = np.percentile(wanted, 99.5)
    upper = [pictures.graded(image, white) for image in (wanted, *images[chosen])]
    lower = [pictures.difference(image, wanted, white) for image in (wanted, *images[chosen])]
    lower[0] = np.ones_like(wanted)  # paper
    both = np.concatenate([np.concatenate(row, axis=1)[::-1] for row in (upper, lower)])
    large = np.repeat(np.repeat(both, SCALE, axis=0), SCALE, axis=1)
    DOCS.mkdir(parents=True, exist_ok=True)
    name = slug(scene)
    Image.fromarray((255 * large).round().astype(np.uint8)).save(DOCS / f"{name}.webp", quality=80)
    print(f"written to docs/measurements/renders/{name}.webp")
    for index in chosen:
        row = rows[index]
        baking = row.get("bake, processor s", 0)
        print(
            f"  {row['light']}, {row['samples']} samples: {row['processor s'] + baking:.1f} s, "
            f"error {row['error']:.3f}, FLIP {row['FLIP']:.3f}"
        )


def nearest(rows, light, seconds):
    """The index of the row of `light` whose time is closest to `seconds`."""
    some = [i for i, row in enumerate(rows) if row["light"] == light]
    return min(some, key=lambda i: abs(np.log(rows[i]["processor s"] / seconds)))


def slug(scene):
    return scene.replace(",", "").replace(" ", "-")


def main():
    for group in GROUPS:
        scenes = rows_of(group)
        if scenes:
            curves(group, scenes)
        for scene, rows in scenes.items():
            side_by_side(scene, rows)


if __name__ == "__main__":
    main()
