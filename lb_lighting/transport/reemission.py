# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that the medium absorbs in one band and emits again in another (fluorescence)."""

from collections.abc import Callable

import numpy as np

from .field import Field
from .medium import Medium

_MOST_EMISSIONS = 64  # rounds of emission: each is weaker than the one before
_NEGLIGIBLE = 1e-6  # share of the light that entered below which emission is neglected


def add_reemission(field: Field, medium: Medium, solve: Callable[[Medium], Field]) -> None:
    """Add to a field the light that the medium emits again in other bands.

    solve  returns the field of a medium in the light of its emission alone
    """
    assert medium.shift is not None
    volume = medium.voxel_size**3
    energy = field.report.energy
    energy["shifted"] = np.zeros(medium.bands)
    negligible = _NEGLIGIBLE * np.sum(energy["entered"])
    latest = field
    for _ in range(_MOST_EMISSIONS):
        light = latest.fluence + latest.direct
        absorbed = medium.sigma_a[:, None, None, None] * medium.density * light  # W/m^3
        emission = np.maximum(np.tensordot(medium.shift, absorbed, axes=1), 0)
        received = emission.sum(axis=(1, 2, 3)) * volume
        if received.sum() <= negligible:
            return
        shifted = medium.shift.sum(axis=0) * absorbed.sum(axis=(1, 2, 3)) * volume
        energy["shifted"] += received - shifted
        energy["absorbed"] -= shifted
        latest = solve(medium.altered(emission=emission))
        _add(field, latest)
    field.report.converged = False


def _add(field: Field, emitted: Field) -> None:
    """Add a field of emission; its energy did not enter from outside."""
    for name in ("fluence", "direct", "flux", "direct_flux"):
        getattr(field, name)[...] += getattr(emitted, name)
    report, added = field.report, emitted.report
    report.steps += added.steps
    report.residual = max(report.residual, added.residual)
    report.converged &= added.converged
    for where in ("absorbed", "left"):
        report.energy[where] += added.energy[where]
