# SPDX-License-Identifier: GPL-3.0-or-later
"""Error of light before and after source iteration, by the number of iterations, and their cost.

    python -m tests.benchmarks.source_iteration

Errors are relative (L2), of all light where there is matter, against the stored references of the
media in which speed and accuracy are traded; seconds are over those of the solve.
"""

from time import perf_counter

import numpy as np

from lb_lighting.transport import Settings, device, solve
from lb_lighting.transport.ordinates.source_iteration import MIN_ANISOTROPY, iterate, seconds
from tests.benchmarks.media import trade_cases
from tests.benchmarks.references import References
from tests.benchmarks.table import publish

TIMES = 1, 2, 3, 4, 6, 8


def timed(action):
    start = perf_counter()
    return action(), perf_counter() - start


def row(case, wanted):
    medium, lights, matter = case.medium, case.lights, case.medium.density > 0
    settings = Settings(tolerance=1e-3)
    solve(medium, lights, settings)  # which makes programs ready
    field, solving = timed(lambda: solve(medium, lights, settings))
    predicted = seconds(medium, lights)

    def error(fluence):
        difference = fluence + field.direct[0] - wanted.light
        return float(np.linalg.norm(difference[matter]) / np.linalg.norm(wanted.light[matter]))

    found = {"medium": case.name, "reference": wanted.error, "lattice": error(field.fluence[0])}
    for times in TIMES:
        scattered, taken = timed(lambda n=times: iterate(medium, lights, field, iterations=n))
        lobes = scattered.lobes[:, 0].sum(axis=0)
        found[f"x {times}"] = error(np.sqrt(4 * np.pi) * scattered.moments[0, 0] + lobes)
        if times == 4:
            found["seconds x 4"] = taken / solving
            found["predicted / taken"] = predicted / taken
    return found


if __name__ == "__main__":
    known = References("trade")
    cases = [case for case in trade_cases() if case.medium.g[0] >= MIN_ANISOTROPY]
    publish("source_iteration", device.choose().label, [row(case, known[case]) for case in cases])
