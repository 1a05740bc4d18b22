# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed against accuracy: every setting in every medium, and the predictions of the planner.

    python -m tests.benchmarks.trade [dials planner bands]

measures all parts, or the given ones. planner-fixed, planner-random and planner-sparse are parts of
`planner`: the media of `dials`, random media, and mostly void media; with the suffix /3, every
third of them. Errors are relative L2 errors of all light against traced photons, whose noise is
subtracted (tests/references/trade.npz, made by `python -m tests.benchmarks.references`). Columns:

work          processor seconds, relative to the first solve of the run ("reference"): the default
              settings in the first medium
error         relative L2 of all light; in `planner`, of visible light (planning/visibility.py)
error +-      standard error of the error, from the noise of the reference
worst decile  mean |error| of the tenth of the voxels with the largest errors, over the mean of the
              reference, including noise
balance       |in - absorbed - out| / in
"""

import sys
from dataclasses import replace
from math import inf, prod
from time import perf_counter, process_time

import numpy as np

from lb_lighting.errors import LightingError
from lb_lighting.transport import Medium, Settings, device, paper_units, solve
from lb_lighting.transport.planning import planner, visibility
from tests.benchmarks.columns import all_light, cropped, imbalance, padded
from tests.benchmarks.media import SUN, cloud, random_cases, sparse_cases, trade_cases
from tests.benchmarks.references import References
from tests.benchmarks.table import publish

A_VOXEL = (4, 32, 256)  # photons
DEFAULT = Settings()
DIALS = {
    "resolution": [("8", {"merge": 4}), ("16", {"merge": 2}), ("32", {}), ("64", {"divide": 2})],
    "rays": [(f"{n:g}", {"rays": n}) for n in (0.5, 2.0)],
    "tolerance": [(f"{t:g}", {"tolerance": t}) for t in (0.1, 0.01, 0.001)],
    "handover": [(f"{t:g}", {"handover": t}) for t in (1.0, 2.0, 4.0)],
    "traced collisions": [("4", {"traced_collisions": 4})],
    "photons a voxel, T=2": [(f"{n}", {"handover": 2.0, "photons": n}) for n in A_VOXEL],
    "Monte Carlo, photons a voxel": [(f"{n}", {"handover": inf, "photons": n}) for n in A_VOXEL],
    "single scattering": [("", {"scattering": "single"})],
    "16 voxels and photons, T=2": [("64", {"merge": 2, "handover": 2.0})],
    "model": [("paper, scaled", {"model": "paper"})],
}
FINEST = ("cube 8, g 0.85, albedo 0.99", "cloud 20, g 0.85")  # solved in 128^3 voxels too
LONGEST = 60  # s, the longest predicted time of a solve that is tried
ENOUGH = 0.5  # processor seconds; a shorter solve is timed again


def settings_of(changes, medium):
    if "photons" in changes:
        changes = changes | {"photons": changes["photons"] * prod(medium.shape)}
    return replace(DEFAULT, **changes)


def timed(medium, lights, settings, found):
    """(Field, processor seconds); short solves are timed twice."""
    least = inf
    for _ in range(2):
        start = process_time()
        field = solve(medium, lights, settings, found.label)
        least = min(least, process_time() - start)
        if least > ENOUGH:
            break
    return field, least


def lit(case, settings, found):
    """(Field, processor seconds) of a case, in the voxels of the case."""
    if settings.model == "paper":
        field, seconds = timed(paper_units(padded(case.medium)), case.lights, settings, found)
        return cropped(field), seconds
    return timed(case.medium, case.lights, settings, found)


def measured(field, reference, scaled=False, weight=None):
    """Errors of a `Field`; weight (nx, ny, nz) is that of each voxel, or None for equal weights."""
    light, truth, noise = all_light(field), reference.light, reference.error
    if weight is None:
        weight = np.ones_like(truth)
    else:
        noise = reference.error if reference.error_seen is None else reference.error_seen
    if scaled:
        light = light * float((light * truth).sum() / (light**2).sum())
    size = (weight * truth**2).sum()
    squared = float((weight * (light - truth) ** 2).sum() / size) - noise**2
    # For n equal voxels the squared noise has a relative error of sqrt(2/n), and its product with
    # the error has the error 2 error noise / sqrt(n).
    of_one = noise * np.sqrt((weight**2).sum()) / weight.sum()
    spread = np.hypot(np.sqrt(2) * noise * of_one, 2 * max(squared, 0) ** 0.5 * of_one)
    error = max(squared, 0.0) ** 0.5
    largest = np.sort(np.abs(light - truth), axis=None)[-truth.size // 10 :]
    return {
        "error": error,
        "error +-": float(spread / (2 * error) if error > spread**0.5 else spread**0.5),
        "worst decile": float(largest.mean() / truth.mean()),
        "balance": imbalance(field),
        "MiB": field.report.bytes / 2**20,
        "steps": field.report.steps,
    }


def dials():
    references, found = References("trade"), device.choose()
    cases = list(trade_cases())
    solve(cases[0].medium, cases[0].lights, replace(DEFAULT, handover=1.0))  # programs are ready
    unit = timed(cases[0].medium, cases[0].lights, DEFAULT, found)[1]
    for case in cases:
        ways = [(dial, at, changes) for dial, some in DIALS.items() for at, changes in some]
        if case.name in FINEST:
            ways.append(("resolution", "128", {"divide": 4}))
        for dial, at, changes in ways:
            row = {"case": case.name, "dial": dial, "at": at}
            try:
                field, seconds = lit(case, settings_of(changes, case.medium), found)
            except LightingError as error:
                yield row | {"refused": str(error)}
                continue
            numbers = measured(field, references[case], scaled="model" in changes)
            yield row | {"work": seconds / unit} | numbers
        print(case.name, flush=True)


def planned(cases):
    """Every quality in some media, without solves that would take long."""
    references, found = References("trade"), device.choose()
    for case in cases:
        print(case.name, flush=True)  # some take a minute
        for quality, target in planner.TARGETS.items():
            shown = {"scattered": case.surfaces}
            plan = planner.plan(case.medium, case.lights, quality, found.label, **shown)
            row = {"kind": case.group, "case": case.name, "quality": quality, "target": target}
            if plan.seconds > LONGEST:
                yield row | {"not tried": plan.seconds}
                continue
            start = perf_counter()
            field = solve(case.medium, case.lights, plan.settings, found.label)
            seconds = perf_counter() - start
            weight = visibility.weights(case.medium, case.surfaces)[0]
            numbers = measured(field, references[case], weight=weight)
            s = plan.settings
            yield row | {
                "chosen": s.scattering if s.scattering == "single" else "lattice",
                "merge": s.merge,
                "handover": s.handover,
                "photons": s.photons or 0,
                "expected": plan.error,
                "error": numbers["error"],
                "error +-": numbers["error +-"],
                "met": numbers["error"] <= target,
                "reported": plan.meets_target,
                "planning": plan.spent,
                "seconds": seconds,
                "predicted": plan.seconds / seconds,
            }


def kept(kinds, every=1, name="planner"):
    rows = list(planned(case for kind in kinds for case in list(CASES[kind]())[::every]))
    yield name, rows
    yield f"{name}-summary", list(summary(rows))


def summary(rows):
    """By quality: how often the target was met, or the plan predicted a miss, and how often the
    predicted time was right within a factor of two."""
    for group, kind in KINDS.items():
        chosen = [row for row in rows if row["kind"] == kind]
        for quality in planner.TARGETS:
            some = [row for row in chosen if row["quality"] == quality and "error" in row]
            if not some:
                continue
            within = [0.5 <= row["predicted"] <= 2 for row in some]
            yield {
                "media": group,
                "quality": quality,
                "count": len(some),
                "not tried": sum(r["quality"] == quality and "not tried" in r for r in chosen),
                "met": sum(row["met"] for row in some),
                "reported": sum(not row["met"] and not row["reported"] for row in some),
                "worst error": max(row["error"] for row in some),
                "worst in": max(some, key=lambda row: row["error"])["case"],
                "time within 2x": float(np.mean(within)),
                "mean seconds": float(np.mean([row["seconds"] for row in some])),
                "mean planning": float(np.mean([row["planning"] for row in some])),
            }


def bands():
    """The cost of colour in a cloud: one band, three proportional bands, three different bands."""
    found, density = device.choose(), cloud(64)
    unit = None
    kinds = {
        "1 band": (0.99, 1.0),
        "3 bands alike": ((0.99,) * 3, (1.0, 0.8, 0.6)),
        "3 bands that differ": ((0.99, 0.98, 0.97), (1.0, 0.8, 0.6)),
    }
    for name, (albedo, color) in kinds.items():
        albedo = np.asarray(albedo)
        medium = Medium(density, 1 / 64, 40 * albedo, 40 * (1 - albedo), 0.5)
        field, seconds = timed(medium, [replace(SUN, irradiance=color)], DEFAULT, found)
        unit = unit or seconds
        yield {"bands": name, "solved": field.report.runs, "work": seconds / unit}


CASES = {"fixed": trade_cases, "random": random_cases, "sparse": sparse_cases}
KINDS = {"fixed": "trade", "random": "random", "sparse": "sparse"}  # groups of the media
PARTS = {
    "dials": lambda: [("trade", list(dials()))],
    "planner": lambda: kept(CASES),
    "bands": lambda: [("trade-bands", list(bands()))],
}


def tables(part):
    """[(name, rows)] of a part."""
    if part in PARTS:
        return PARTS[part]()
    name, _, every = part.partition("/")
    return kept([name.removeprefix("planner-")], int(every or 1), name)


def main(parts):
    found = device.choose()
    for part in parts or PARTS:
        for name, rows in tables(part):
            publish(name, found.label, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
