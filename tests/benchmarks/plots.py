# SPDX-License-Identifier: GPL-3.0-or-later
"""Plots of free-path sampling for docs/: speeds from build/bench/freepath-head.json, and majorants
along rays, which are computed here."""

import json
from pathlib import Path

import matplotlib
import numpy as np

from lb_lighting.transport.photons.linear_majorants import linear_majorants
from lb_lighting.transport.photons.majorants import constant_majorants
from lb_lighting.transport.photons.perlin import PerlinMedium
from tests.benchmarks.freepath_noise import CONTRASTS
from tests.benchmarks.freepath_timing import SUPERVOXELS
from tests.benchmarks.table import BUILD
from tests.setup import heads

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import LogLocator, NullLocator

DOCS = Path(__file__).parents[2] / "docs" / "measurements" / "free-paths"
COLORS = {
    "density": "#9a9a9a",
    "constant": "#c44536",
    "linear": "#1d6fa5",
    "ray_march": "#444444",
    "woodcock": "#d99a2b",
}
NAMES = {
    "supervoxel_constant": "constant majorant",
    "supervoxel_linear": "linear majorant",
    "ray_march": "ray marching",
    "woodcock": "Woodcock",
}
HEAD_SIZE = 20  # voxels along an edge of a super-voxel: about 16^3 of them
HEAD_AT = (0.45, 0.5)  # position of the ray, as shares of the head's height and width
NOISE = {"resolution": 4096, "coarsest": 4, "seed": 1, **CONTRASTS["middle"]}
NOISE_CELLS = 32
SAMPLES = 2000  # along a ray


# --- Speed ---------------------------------------------------------------------------------------


def speed():
    """Speed against the resolution of the super-voxels, a panel for each density."""
    rows = json.loads((BUILD / "freepath-head.json").read_text())["rows"]
    settings = list(dict.fromkeys(row["setting"] for row in rows))
    figure, panels = plt.subplots(1, len(settings), figsize=(9, 3.2), sharey=True)
    for panel, setting in zip(panels, settings, strict=True):
        of_setting = [row for row in rows if row["setting"] == setting]
        draw_speeds(panel, of_setting)
        panel.set_title(f"{setting}: optical depth {of_setting[0]['depth']:.0f}", fontsize=9)
    panels[0].set_ylabel("million rays/s", fontsize=8)
    panels[0].legend(fontsize=7, frameon=False)
    save(figure, "speed")


def draw_speeds(panel, rows):
    for sampler in SUPERVOXELS:
        kind = sampler.removeprefix("supervoxel_")
        some = sorted(
            (row["super-voxels"], row["million rays/s"])
            for row in rows
            if row["sampler"] == sampler
        )
        panel.plot(*zip(*some, strict=True), "o-", ms=3, color=COLORS[kind], label=NAMES[sampler])
    for sampler in ("ray_march", "woodcock"):
        level = next(row["million rays/s"] for row in rows if row["sampler"] == sampler)
        panel.axhline(level, ls="--", lw=1, color=COLORS[sampler], label=NAMES[sampler])
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_locator(NullLocator())
    cells = sorted({row["super-voxels"] for row in rows if row["sampler"] in SUPERVOXELS})
    panel.set_xticks(cells[::3], [f"{n}³" for n in cells[::3]])
    panel.set_xlabel("super-voxels", fontsize=8)
    panel.tick_params(labelsize=7)


# --- Bounds along a ray --------------------------------------------------------------------------


def bound_along(bound, points):
    """The values (n,) of a `Majorants` at points (n, 3) in fine cells."""
    cell = np.minimum((points // bound.size).astype(int), np.array(bound.values.shape[:3]) - 1)
    value = bound.values[tuple(cell.T)]
    if value.ndim == 1:
        return value
    x, y, z = (points / bound.size - cell).T
    return (np.stack([x * 0 + 1, x, y, z, x * y, y * z, z * x, x * y * z]) * value.T).sum(axis=0)


def line(begin, end):
    """Points (SAMPLES, 3) along the line, without its ends."""
    share = (np.arange(SAMPLES)[:, None] + 0.5) / SAMPLES
    return np.asarray(begin) + share * np.subtract(end, begin)


def head_panel(panel):
    density = heads.ch2better()
    nx, ny, nz = density.shape
    y, z = ny * HEAD_AT[0], nz * HEAD_AT[1]
    points = line((0, y, z), (nx, y + ny / 20, z - nz / 20))
    bounds = [make(density, HEAD_SIZE) for make in (constant_majorants, linear_majorants)]
    values = density[tuple(points.astype(int).T)]
    draw_bounds(panel, values, *(bound_along(bound, points) for bound in bounds))
    panel.set_title("a head, 16³ super-voxels", fontsize=9)


def noise_panel(panel):
    medium = PerlinMedium(size=1.0, sigma_s=0, sigma_a=1, **NOISE)
    n = medium.resolution
    coarse = medium.voxels(NOISE_CELLS).density
    _, j, k = np.unravel_index(coarse.argmax(), coarse.shape)
    y, z = (np.array((j, k)) + 0.5) * (n / NOISE_CELLS)
    points = line((0, y, z), (n, y, z))
    bounds = [make(NOISE_CELLS) for make in (medium.constant_majorants, medium.linear_majorants)]
    values = medium.density_at(points)
    draw_bounds(panel, values, *(bound_along(bound, points) for bound in bounds))
    panel.set_title(f"noise of {n}³, {NOISE_CELLS}³ super-voxels", fontsize=9)


def draw_bounds(panel, density, constant, linear):
    way = (np.arange(SAMPLES) + 0.5) / SAMPLES
    panel.fill_between(way, density, color=COLORS["density"], lw=0, label="density")
    panel.plot(way, constant, lw=1, color=COLORS["constant"], label="constant majorant")
    panel.plot(way, linear, lw=1.2, color=COLORS["linear"], label="linear majorant")
    panel.set_xlim(0, 1)
    panel.set_ylim(0)
    panel.tick_params(labelsize=7)
    panel.set_xlabel("along the ray", fontsize=8)


def bounds_along_rays():
    figure, panels = plt.subplots(1, 2, figsize=(9, 3))
    head_panel(panels[0])
    noise_panel(panels[1])
    panels[0].legend(fontsize=7, frameon=False, loc="upper left")
    save(figure, "bounds")


def save(figure, name):
    for panel in figure.axes:
        panel.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    DOCS.mkdir(parents=True, exist_ok=True)
    path = DOCS / f"{name}.webp"
    figure.savefig(path, dpi=110, pil_kwargs={"quality": 80})
    print(f"written to docs/measurements/free-paths/{path.name}")


if __name__ == "__main__":
    speed()
    bounds_along_rays()
