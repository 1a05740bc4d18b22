# SPDX-License-Identifier: GPL-3.0-or-later
"""Output of the benchmarks: a table for people, a .json file for programs."""

import json
from pathlib import Path

BUILD = Path(__file__).parents[2] / "build" / "bench"


def publish(name, device, rows):
    """Print `rows`, a list of {column: value}, and write them to build/bench/NAME.json."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    cells = [columns] + [[_text(row.get(column, "")) for column in columns] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)))
    BUILD.mkdir(parents=True, exist_ok=True)
    path = BUILD / f"{name}.json"
    path.write_text(json.dumps({"name": name, "device": device, "rows": rows}, indent=1) + "\n")
    print(f"written to build/bench/{path.name}")


def _text(value):
    return f"{value:.3g}" if isinstance(value, float) else str(value)
