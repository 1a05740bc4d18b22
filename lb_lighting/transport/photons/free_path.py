# SPDX-License-Identifier: GPL-3.0-or-later
"""Free path sampling: how far a photon travels before it collides (paper 2).

The distance s to the next collision has P(s > d) = exp(-optical depth of d). Four samplers draw
it without bias:

    ray_march            adds up the optical depth, fine cell by fine cell
    woodcock             adds virtual particles, which change nothing, until the density is the
                         largest one everywhere, and steps from particle to particle
    supervoxel_constant  the same, up to a majorant that is constant in each super-voxel
    supervoxel_linear    the same, up to a majorant that is trilinear in each super-voxel

With a single super-voxel, the third is the second; with one super-voxel per voxel, the first.
`majorants` computes the majorants. Ray marching is exact where the density is constant or linear in
fine cells. In a `PerlinMedium` it uses the density at the middle of the path through each cell; the
error is of second order in the edge of the finest cell.
"""

import warnings
from collections.abc import Callable, Sequence
from math import prod

import numpy as np

from ...arrays import Floats
from ...errors import (
    MediumError,
    SettingsError,
    SolverError,
    require_known,
    require_whole,
)
from .. import device as devices
from ..backend import backend_of
from ..device import Device
from ..medium import Medium
from ..memory import FLOAT, Footprint, require_memory
from .linear_majorants import linear_majorants
from .majorants import (
    FineGrid,
    Majorants,
    choose_size,
    constant_majorants,
    cost,
    fine_cells,
)
from .path_grid import PathGrid, enter
from .perlin import PerlinMedium

SAMPLERS = ("ray_march", "woodcock", "supervoxel_constant", "supervoxel_linear")
_MOST_VALUES = 2**31 - 1  # the most that kernels can index
_MOST_CELLS = 128  # super-voxels along an edge of noise: finer majorants cost more than they save
MOST_STEPS = 10**8  # after which a path is abandoned: about a minute


def path_grid(
    medium: Medium | PerlinMedium,
    sampler: str = "supervoxel_linear",
    interpolation: str = "constant",
    supervoxel: int | None = None,
    device: Device | str | None = None,
) -> PathGrid:
    """The `PathGrid` of a medium.

    interpolation  of a Medium's density: "constant" in voxels, or "linear" between their centres
    supervoxel     fine cells along the edge of a super-voxel; None for the cheapest size. In a
                   PerlinMedium it must be the edge of one of the noise's lattice cells
    device         as in `device.choose`; it makes the majorants
    """
    require_known(sampler, SAMPLERS, "sampler")
    if supervoxel is not None:
        require_whole(supervoxel, "super-voxel's edge in fine cells", 1, 2**31 - 1)
    if isinstance(medium, PerlinMedium):
        return _of_noise(medium, sampler, supervoxel)
    return _of_voxels(medium, sampler, interpolation, supervoxel, device)


def _of_voxels(
    medium: Medium,
    sampler: str,
    interpolation: str,
    supervoxel: int | None,
    device: Device | str | None,
) -> PathGrid:
    fine = fine_cells(medium.density, interpolation)
    if fine.values.size > _MOST_VALUES:
        raise MediumError(
            f"The samplers take {_MOST_VALUES} voxels at most, and the medium has "
            f"{medium.density.size}; lower its resolution."
        )
    majorants = None
    if sampler.startswith("supervoxel"):
        kind = sampler.removeprefix("supervoxel_")
        depth = float(medium.sigma_t.max()) * medium.voxel_size
        size = supervoxel or choose_size(medium.density, depth, kind, interpolation)
        size = min(size, max(fine.shape))
        if kind == "constant":
            majorants = constant_majorants(medium.density, size, interpolation)
        else:
            majorants = linear_majorants(medium.density, size, interpolation, device)
    largest = 0.0
    if sampler == "woodcock":
        whole = constant_majorants(medium.density, max(fine.shape), interpolation)
        largest = float(whole.values.max())
    return PathGrid(sampler, medium, interpolation == "linear", fine, majorants, largest)


def _of_noise(medium: PerlinMedium, sampler: str, supervoxel: int | None) -> PathGrid:
    """The grid of noise; its cells are those of the finest lattice."""
    n = medium.resolution
    fine = FineGrid(np.empty((0, 0, 0), np.float32), (n, n, n), 0.0, (float(n),) * 3)
    majorants = None
    if supervoxel is not None and n % supervoxel:
        raise SettingsError(
            f"Super-voxels of {supervoxel} cells do not fill {n} of them; use a power of two."
        )
    if sampler.startswith("supervoxel"):
        kind = sampler.removeprefix("supervoxel_")
        make = medium.linear_majorants if kind == "linear" else medium.constant_majorants
        majorants = make(n // supervoxel) if supervoxel else _cheapest_majorants(medium, kind, make)
    largest = float(medium.constant_majorants(1).values.max()) if sampler == "woodcock" else 0.0
    return PathGrid(sampler, medium, False, fine, majorants, largest)


def _cheapest_majorants(
    medium: PerlinMedium, kind: str, make: Callable[[int], Majorants]
) -> Majorants:
    """The majorants with which a PerlinMedium is sampled fastest; make(cells) makes some."""
    depth = float(medium.sigma_t.max()) * medium.voxel_size
    made, cells = [], medium.coarsest
    while cells <= min(_MOST_CELLS, medium.resolution):
        made.append(make(cells))
        cells *= 2
    return min(made, key=lambda candidate: cost(kind, candidate.size, depth * candidate.mean))


class FreePathSampler:
    """Draws free paths in one medium; its preparation serves any number of rays.

    The arguments are those of `sample_free_paths`.
    """

    def __init__(
        self,
        medium: Medium | PerlinMedium,
        sampler: str = "supervoxel_linear",
        device: Device | str | None = None,
        *,
        band: int = 0,
        interpolation: str = "constant",
        supervoxel: int | None = None,
        most_steps: int = MOST_STEPS,
    ) -> None:
        if not 0 <= band < medium.bands:
            raise SettingsError(f"The medium has no band {band}; it has {medium.bands}.")
        self.device = devices.choose(device)
        require_whole(most_steps, "number of steps", 1, 2**31 - 1)
        require_memory(self.device, medium.shape, lambda shape: _footprint(shape, medium))
        self.grid = path_grid(medium, sampler, interpolation, supervoxel, self.device)
        self.paths = backend_of(self.device).paths(self.grid)
        self.band, self.most_steps = band, most_steps

    def sample(self, origins: Floats, directions: Floats, seed: int = 0) -> Floats:
        """(n,) m: distances, as `sample_free_paths` returns them."""
        return self.count(origins, directions, seed)[0]

    def count(self, origins: Floats, directions: Floats, seed: int = 0) -> tuple[Floats, int]:
        """(distances as of `sample`, number of real and virtual particles that the rays met)."""
        require_whole(seed, "seed", 0, 2**32 - 1)
        origins, directions = check_rays(origins, directions)
        start, inside, hit = enter(self.grid, origins, directions)
        distances = np.full(len(origins), np.inf)
        rays = np.concatenate([inside[hit], directions[hit]], axis=1).T
        lengths, particles, violations = self.paths.free_paths(
            np.ascontiguousarray(rays, np.float32),
            np.flatnonzero(hit),
            self.grid.per_depth(self.band),
            seed,
            self.most_steps,
        )
        refuse_violations(violations)
        lost = np.count_nonzero(np.isnan(lengths))
        if lost:
            warnings.warn(
                f"{lost} of {len(origins)} rays took over {self.most_steps} steps and were given "
                "up; their distance is NaN. Use smaller super-voxels, or ray marching.",
                RuntimeWarning,
                stacklevel=3,
            )
        distances[hit] = (start[hit] + lengths) * self.grid.medium.voxel_size
        return distances, particles


def _footprint(shape: Sequence[int], medium: Medium | PerlinMedium) -> Footprint:
    """The least memory: that of a density of `shape` voxels."""
    return Footprint({"density": 0 if isinstance(medium, PerlinMedium) else FLOAT * prod(shape)})


def sample_free_paths(
    medium: Medium | PerlinMedium,
    origins: Floats,
    directions: Floats,
    sampler: str = "supervoxel_linear",
    seed: int = 0,
    device: Device | str | None = None,
    *,
    band: int = 0,
    interpolation: str = "constant",
    supervoxel: int | None = None,
) -> Floats:
    """How far photons travel before they collide.

    medium         `Medium` or `PerlinMedium`, surrounded by vacuum
    origins        (n, 3) m, inside or outside the medium
    directions     (n, 3), of any length but 0
    sampler        one of SAMPLERS
    seed           0 to 2^32 - 1; ray i of a seed draws the same numbers in any set of rays
    device         None for the best, or part of the label of one of `device.devices()`
    band           of the sigma_t to use
    interpolation  of a Medium's density: "constant" in voxels, or "linear" between their centres
    supervoxel     voxels along the edge of a super-voxel; None for the cheapest size
    Returns (n,) float64 m, infinite where a ray leaves the medium or misses it, and NaN, with a
    RuntimeWarning, where it takes over MOST_STEPS steps.
    Raises SettingsError for invalid rays and for arguments outside these ranges.
    Source: paper 2.
    """
    prepared = FreePathSampler(
        medium, sampler, device, band=band, interpolation=interpolation, supervoxel=supervoxel
    )
    return prepared.sample(origins, directions, seed)


def check_rays(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Both as (n, 3) float64, the directions of length 1, or SettingsError."""
    origins, directions = np.asarray(origins, float), np.asarray(directions, float)
    if origins.ndim != 2 or origins.shape[1] != 3 or origins.shape != directions.shape:
        raise SettingsError(
            "Rays need origins and directions of one shape (n, 3); "
            f"they have {origins.shape} and {directions.shape}."
        )
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    bad = ~(np.isfinite(origins).all(axis=1) & np.isfinite(lengths[:, 0]) & (lengths[:, 0] > 0))
    if bad.any():
        raise SettingsError(
            f"{np.count_nonzero(bad)} of {len(bad)} rays have an origin that is not finite or a "
            f"direction of no length; the first is ray {np.argmax(bad)}."
        )
    return origins, directions / lengths


def refuse_violations(violations: int) -> None:
    if violations:
        raise SolverError(
            f"In {violations} paths the density was above its majorant, so they are biased; "
            "this is an error of LB Lighting, please report it with the scene."
        )
