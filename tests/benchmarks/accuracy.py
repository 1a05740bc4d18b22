# SPDX-License-Identifier: GPL-3.0-or-later
"""Accuracy of the light: the cases of `media.py` against traced photons, and exact solutions.

    python -m tests.benchmarks.accuracy [cases margin slabs furnace spread refinement rotation]

measures all parts, or the given ones. Columns of the cases:

error         relative L2 of all light, uncollided and scattered, without the noise of the
              reference: the root of (raw error)^2 - (its standard error)^2. The noise of a hybrid
              is included
bias          the same, without the noise of the hybrid
ratio         mean of the light over the mean of the reference
worst decile  mean |error| of the tenth of the voxels with the largest errors, over the mean of the
              reference, including noise
balance       |in - absorbed - out| / in
noise         of the hybrid, as it reports it

Only the light of the paper's model is scaled, by the factor that fits best in L2, which is printed.
"""

import sys
from dataclasses import replace

import numpy as np

from lb_lighting.transport import device
from tests.benchmarks import grids, oracles
from tests.benchmarks.columns import (
    COLUMNS,
    all_light,
    cropped,
    imbalance,
    padded,
    refusal,
    relative_noise,
    solved,
)
from tests.benchmarks.media import cubes, main_cases
from tests.benchmarks.references import References
from tests.benchmarks.table import publish

REACH = {"deterministic": (0.05, 0.10), "hybrid T=4": (0.02, 0.06)}  # error: mean, worst
BALANCE = 1e-4


def case_rows():
    references = References()
    for case in main_cases():
        for column in COLUMNS:
            field, refused = refusal(case, column)
            row = {"case": case.name, "column": column}
            print(f"{case.name}, {column}", flush=True)  # some take a minute
            if refused:
                yield row | {"refused": refused}
            else:
                yield row | measured(field, references[case], scaled=column == "paper")


def measured(field, reference, scaled):
    """The columns of a row."""
    light, truth = all_light(field), reference.light
    scale = {}
    if scaled:
        scale["scale"] = float((light * truth).sum() / (light**2).sum())
        light = light * scale["scale"]
    size, noise = np.linalg.norm(truth), relative_noise(field)
    raw = float(np.linalg.norm(light - truth) / size)
    largest = np.sort(np.abs(light - truth), axis=None)[-truth.size // 10 :]
    return scale | {
        "error": without(raw, reference.error),
        "raw": raw,
        "bias": without(raw, np.hypot(reference.error, noise)),
        "ratio": float(light.mean() / truth.mean()),
        "worst decile": float(largest.mean() / truth.mean()),
        "balance": imbalance(field),
        "noise": noise,
        "converged": field.report.converged,
        "steps": field.report.steps,
        "seconds": sum(field.report.seconds.values()),
    }


def without(raw, noise):
    return float(np.sqrt(max(0.0, raw**2 - noise**2)))


def summary(rows):
    """A line for each column: its errors, and whether they are within the goals."""
    for column in COLUMNS:
        of_column = [row for row in rows if row["column"] == column]
        some = [row for row in of_column if "error" in row]
        if not some:
            continue
        errors = [row["error"] for row in some]
        worst = some[int(np.argmax(errors))]
        line = {
            "column": column,
            "cases": len(some),
            "refused": len(of_column) - len(some),
            "mean error": float(np.mean(errors)),
            "worst error": worst["error"],
            "in": worst["case"],
            "mean bias": float(np.mean([row["bias"] for row in some])),
            "worst bias": max(row["bias"] for row in some),
            "worst balance": max((row["balance"] or 0.0 for row in some), default=0.0),
            "seconds": float(np.mean([row["seconds"] for row in some])),
        }
        if column in REACH:
            mean, most = REACH[column]
            line["reach"] = f"{mean:g}, {most:g}"
            line["reached"] = line["mean error"] <= mean and line["worst error"] <= most
            line["balanced"] = line["worst balance"] <= BALANCE
        yield line


def cases():
    rows = list(case_rows())
    yield "cases", rows
    yield "summary", list(summary(rows))


def margin_rows():
    """Cubes with empty voxels around them, deterministic: the light inside should not change."""
    references = References()
    for case in cubes():
        margin = replace(case, medium=padded(case.medium))
        field = cropped(solved(margin, "deterministic"))
        yield {"case": case.name, **measured(field, references[case], scaled=False)}


PARTS = {
    "cases": cases,
    "margin": lambda: [("margin", list(margin_rows()))],
    "slabs": lambda: [("slabs", list(oracles.slab_rows()))],
    "furnace": lambda: [("furnace", list(oracles.furnace_rows()))],
    "spread": lambda: [("spread", list(oracles.spread_rows()))],
    "refinement": grids.refinement,
    "rotation": lambda: [("rotation", list(grids.rotation_rows()))],
}


def main(parts):
    found = device.choose()
    for part in parts or PARTS:
        for name, rows in PARTS[part]():
            publish(f"accuracy-{name}", found.label, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
