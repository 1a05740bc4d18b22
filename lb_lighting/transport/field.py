# SPDX-License-Identifier: GPL-3.0-or-later
"""What a solver returns: light in every voxel, and how it was found."""

from dataclasses import dataclass, field

import numpy as np

from .medium import Domain


@dataclass
class Report:
    """How a field was found.

    model     which model solved it
    device    the device that ran, as shown to the user
    steps     lattice steps taken
    residual  relative change (L2) of the total light in the last step, the largest of the bands
    seconds   {stage: seconds}
    bytes     memory that the solver allocated, bytes
    runs      bands that were really solved; the others are multiples of them
    """

    model: str
    device: str
    steps: int = 0
    residual: float = 0.0
    seconds: dict = field(default_factory=dict)
    bytes: int = 0
    runs: int = 0


@dataclass
class Field:
    """Light in a domain.

    domain    where the voxels are
    fluence   (bands, nx, ny, nz) W/m^2, scattered light; in the paper's model all light
    direct    (bands, nx, ny, nz) W/m^2, unscattered light; in the paper's model zero
    flux      (bands, 3, nx, ny, nz) W/m^2, net flux of what `fluence` counts
    variance  (bands, nx, ny, nz) of the fluence, (W/m^2)^2, where the solver is random, else None
    report    a `Report`
    """

    domain: Domain
    fluence: np.ndarray
    direct: np.ndarray
    flux: np.ndarray
    report: Report
    variance: np.ndarray | None = None

    def mean_radiance(self):
        """(bands, nx, ny, nz) W/(m^2 sr): all light, averaged over directions."""
        return (self.fluence + self.direct) / np.float32(4 * np.pi)
