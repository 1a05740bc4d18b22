# SPDX-License-Identifier: GPL-3.0-or-later
"""The grid that paths step through, and where they enter it."""

from dataclasses import dataclass

import numpy as np

from ...arrays import Booleans, Floats, Vector
from ..medium import Medium
from .majorants import FineGrid, Majorants
from .perlin import PerlinMedium


@dataclass(frozen=True)
class PathGrid:
    """The grid that paths step through; lengths are in fine cells, see `majorants`.

    sampler   one of SAMPLERS
    medium    the `Medium` or `PerlinMedium`
    linear    whether the density is linear between voxel centres, not constant in voxels
    fine      `FineGrid`; it has no values where the density is a function
    majorants  `Majorants` of super-voxels; None for samplers without super-voxels
    global_majorant  majorant of the whole domain, for Woodcock's sampler; else 0
    """

    sampler: str
    medium: Medium | PerlinMedium
    linear: bool
    fine: FineGrid
    majorants: Majorants | None
    global_majorant: float

    @property
    def procedural(self) -> bool:
        return isinstance(self.medium, PerlinMedium)

    @property
    def noise(self) -> PerlinMedium:
        """The medium of a procedural grid."""
        assert isinstance(self.medium, PerlinMedium)
        return self.medium

    @property
    def size(self) -> int:
        """Fine cells along an edge of a super-voxel."""
        return 1 if self.majorants is None else self.majorants.size

    @property
    def cells(self) -> tuple[int, ...]:
        """(3,) super-voxels."""
        return tuple(-(-n // self.size) for n in self.fine.shape)

    @property
    def polynomial(self) -> bool:
        """Whether the majorant is trilinear in a super-voxel, or in a fine cell to march."""
        if self.sampler == "ray_march":
            return self.linear
        return self.sampler == "supervoxel_linear"

    def fine_from_world(self, points: Floats | Vector) -> Floats:
        """Points (..., 3) in m -> coordinates in fine cells, float64."""
        medium = self.medium
        return (np.asarray(points, float) - medium.origin) / medium.voxel_size + self.fine.lower

    def per_depth(self, band: int) -> float:
        """Density times length in fine cells per unit optical depth; infinite in a vacuum."""
        scale = float(self.medium.sigma_t[band]) * self.medium.voxel_size
        return 1 / scale if scale > 1e-37 else np.inf


def enter(grid: PathGrid, origins: Floats, directions: Floats) -> tuple[Floats, Floats, Booleans]:
    """Where rays enter the domain: (start, points, hit).

    start   (n,) fine cells from the origin to the domain, 0 inside it
    points  (n, 3) where they enter, in fine cells, in the domain
    hit     (n,) whether they do
    Computed in float64, so that rays from far away lose no precision.
    """
    points = grid.fine_from_world(origins)
    upper = np.asarray(grid.fine.upper)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_lower = (grid.fine.lower - points) / directions
        to_upper = (upper - points) / directions
    # A ray parallel to a pair of faces is always between them, or never.
    parallel = directions == 0
    between = (points >= grid.fine.lower) & (points < upper)
    near = np.where(parallel, np.where(between, -np.inf, np.inf), np.minimum(to_lower, to_upper))
    far = np.where(parallel, np.inf, np.maximum(to_lower, to_upper))
    start = np.maximum(near.max(axis=1), 0)
    hit = start < far.min(axis=1)
    start = np.where(hit, start, 0)
    points = np.clip(points + start[:, None] * directions, grid.fine.lower, upper)
    return start, points, hit
