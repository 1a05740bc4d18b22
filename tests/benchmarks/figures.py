# SPDX-License-Identifier: GPL-3.0-or-later
"""Style and files of the plots of docs/."""

from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def write(figure, page, name):
    """Write a figure to docs/PAGE/NAME.webp."""
    path = DOCS / page / f"{name}.webp"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, pil_kwargs={"quality": 80})
    print(f"written to docs/{page}/{name}.webp")


def write_small(figure, page, name, bottom=0.0):
    """Write panels with small ticks and two axes; `bottom` is the share reserved for a legend."""
    for panel in figure.axes:
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=7)
    figure.tight_layout(rect=(0, bottom, 1, 1))
    write(figure, page, name)
