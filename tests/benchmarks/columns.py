# SPDX-License-Identifier: GPL-3.0-or-later
"""The solvers whose accuracy is measured, and the quantities measured on a solved field."""

from dataclasses import replace

import numpy as np

from lb_lighting.errors import LightError, MediumError
from lb_lighting.transport import Medium, Settings, paper_units, solve

TOLERANCE = 3e-5  # far below the measured errors; energy balances to 1e-4
PAPER = Settings(model="paper")
DETERMINISTIC = Settings(model="physical", tolerance=TOLERANCE)
COLUMNS = {
    "paper": PAPER,
    "deterministic": DETERMINISTIC,
    "hybrid T=2": replace(DETERMINISTIC, handover=2.0),
    "hybrid T=4": replace(DETERMINISTIC, handover=4.0),
}
NOISE = 0.01  # of the light of a hybrid, relative L2
_PROBED, _MOST = 32, 1024  # photons per voxel


def solved(case, column):
    """The `Field` of a case. A hybrid traces enough photons for a noise below `NOISE`."""
    settings, medium = COLUMNS[column], case.medium
    if settings is PAPER:
        return cropped(solve(paper_units(padded(medium)), case.lights, settings))
    if settings.handover == 0:
        return solve(medium, case.lights, settings)
    probe = solve(medium, case.lights, replace(settings, photons=_PROBED * medium.density.size))
    wanted = min(_MOST, _PROBED * 1.1 * (relative_noise(probe) / NOISE) ** 2)
    return solve(medium, case.lights, replace(settings, photons=int(wanted * medium.density.size)))


def padded(medium):
    """The medium with an empty voxel around it: the boundary of the paper is outside the medium."""

    def grid(values):
        return (
            None if values is None else np.pad(values, [(0, 0)] * (values.ndim - 3) + [(1, 1)] * 3)
        )

    return Medium(
        grid(medium.density),
        medium.voxel_size,
        medium.sigma_s,
        medium.sigma_a,
        medium.g,
        emission=grid(medium.emission),
        occlusion=grid(medium.occlusion),
    )


def cropped(field):
    inner = (..., *[slice(1, -1)] * 3)
    return replace(field, fluence=field.fluence[inner], direct=field.direct[inner])


def refusal(case, column):
    """(field, None), or (None, the error message) if the case is refused."""
    try:
        return solved(case, column), None
    except (MediumError, LightError) as error:
        return None, str(error)


def all_light(field):
    """(nx, ny, nz) W/m^2 in the first band."""
    return (field.fluence + field.direct)[0].astype(float)


def relative_noise(field):
    """Relative standard error (L2) of all light; 0 for a deterministic solve."""
    if field.variance is None:
        return 0.0
    return float(np.sqrt(field.variance[0].sum(dtype=float)) / np.linalg.norm(all_light(field)))


def imbalance(field):
    """|in - absorbed - out| / in; None if the model does not count its energy."""
    energy = {what: np.sum(power) for what, power in field.report.energy.items()}
    if not energy:
        return None
    entered = energy.pop("entered")
    return float(abs(entered - sum(energy.values())) / entered)
