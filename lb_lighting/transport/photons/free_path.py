# SPDX-License-Identifier: GPL-3.0-or-later
"""Free path sampling: how far a photon flies until it collides (paper 2).

The distance s to the next collision has P(s > d) = exp(-optical depth of d). Four samplers draw
it, all without bias:

    ray_march            adds up the optical depth, fine cell by fine cell
    woodcock             fills the medium up to the largest density with virtual particles, which
                         change nothing, and takes a step at a time to the next particle
    supervoxel_constant  the same under an upper bound that is constant in a super-voxel
    supervoxel_linear    under one that is trilinear in a super-voxel

With one super-voxel the third is the second; with one a voxel, the first. `bounds.py` finds the
bounds. Ray marching is exact where the density is constant or linear in fine cells; in a
`PerlinMedium` it takes the density in the middle of each stretch of a cell, an error of second
order in the edge of the finest cell.
"""

import warnings
from dataclasses import dataclass
from math import prod

import numpy as np

from ...errors import (
    MediumError,
    SettingsError,
    SolverError,
    require_known,
    require_whole,
)
from .. import device as devices
from ..backend import backend_of
from ..memory import Footprint, require_memory
from . import majorants
from .perlin import PerlinMedium

SAMPLERS = ("ray_march", "woodcock", "supervoxel_constant", "supervoxel_linear")
_MOST_VALUES = 2**31 - 1  # that kernels can number
_MOST_CELLS = 128  # along an edge of noise: the bound of more would take longer than it saves
MOST_STEPS = 10**8  # of one path, before it is given up: a minute or so


@dataclass(frozen=True)
class PathGrid:
    """What paths step through; lengths are in fine cells, see `bounds.py`.

    sampler   one of SAMPLERS
    medium    the `Medium` or `PerlinMedium`
    linear    whether the density is linear between voxel centres, not constant in voxels
    fine      majorants.FineGrid; its values are None where the density is a function
    bound     majorants.Bound in super-voxels; None for the samplers that have none
    majorant  an upper bound of the density everywhere, for Woodcock's sampler; else 0
    """

    sampler: str
    medium: object
    linear: bool
    fine: majorants.FineGrid
    bound: majorants.Bound | None
    majorant: float

    @property
    def procedural(self):
        return isinstance(self.medium, PerlinMedium)

    @property
    def size(self):
        """Fine cells along an edge of a super-voxel."""
        return 1 if self.bound is None else self.bound.size

    @property
    def cells(self):
        """(3,) super-voxels."""
        return tuple(-(-n // self.size) for n in self.fine.shape)

    @property
    def polynomial(self):
        """Whether the bound is trilinear in a super-voxel; that of a linear fine cell is."""
        if self.sampler == "ray_march":
            return self.linear
        return self.sampler == "supervoxel_linear"

    def fine_from_world(self, points):
        """Points (..., 3) in m -> coordinates in fine cells, float64."""
        medium = self.medium
        return (np.asarray(points, float) - medium.origin) / medium.voxel_size + self.fine.lower

    def per_depth(self, band):
        """Density times fine cells in an optical depth of 1; infinite in a vacuum."""
        scale = float(self.medium.sigma_t[band]) * self.medium.voxel_size
        return 1 / scale if scale > 1e-37 else np.inf


def path_grid(
    medium, sampler="supervoxel_linear", interpolation="constant", supervoxel=None, device=None
):
    """The `PathGrid` of a medium.

    interpolation  of a Medium's density: "constant" in voxels, or "linear" between their centres
    supervoxel     fine cells along the edge of a super-voxel; None for the size that is cheapest.
                   In a PerlinMedium it must be the edge of one of the noise's lattice cells
    device         as in `device.choose`, where the bound is made
    """
    require_known(sampler, SAMPLERS, "sampler")
    if supervoxel is not None:
        require_whole(supervoxel, "super-voxel's edge in fine cells", 1, 2**31 - 1)
    make = _of_noise if isinstance(medium, PerlinMedium) else _of_voxels
    return make(medium, sampler, interpolation, supervoxel, device)


def _of_voxels(medium, sampler, interpolation, supervoxel, device):
    fine = majorants.fine_cells(medium.density, interpolation)
    if fine.values.size > _MOST_VALUES:
        raise MediumError(
            f"The samplers take {_MOST_VALUES} voxels at most, and the medium has "
            f"{medium.density.size}; lower its resolution."
        )
    bound = None
    if sampler.startswith("supervoxel"):
        kind = sampler.removeprefix("supervoxel_")
        depth = float(medium.sigma_t.max()) * medium.voxel_size
        size = supervoxel or majorants.choose_size(medium.density, depth, kind, interpolation)
        size = min(size, max(fine.shape))
        if kind == "constant":
            bound = majorants.constant_bound(medium.density, size, interpolation)
        else:
            bound = majorants.linear_bound(medium.density, size, interpolation, device)
    majorant = 0.0
    if sampler == "woodcock":
        whole = majorants.constant_bound(medium.density, max(fine.shape), interpolation)
        majorant = float(whole.values.max())
    return PathGrid(sampler, medium, interpolation == "linear", fine, bound, majorant)


def _of_noise(medium, sampler, interpolation, supervoxel, device):
    """Noise is linear in its finest cells, whatever `interpolation`; its bounds take no device."""
    n = medium.resolution
    fine = majorants.FineGrid(None, (n, n, n), 0.0, (float(n),) * 3)
    bound = None
    if supervoxel is not None and n % supervoxel:
        raise SettingsError(
            f"Super-voxels of {supervoxel} cells do not fill {n} of them; use a power of two."
        )
    if sampler.startswith("supervoxel"):
        kind = sampler.removeprefix("supervoxel_")
        make = medium.linear_bound if kind == "linear" else medium.constant_bound
        bound = make(n // supervoxel) if supervoxel else _cheapest_bound(medium, kind, make)
    majorant = float(medium.constant_bound(1).values.max()) if sampler == "woodcock" else 0.0
    return PathGrid(sampler, medium, False, fine, bound, majorant)


def _cheapest_bound(medium, kind, make):
    """The bound of a PerlinMedium under which the sampler is fastest; make(cells) makes one."""
    depth = float(medium.sigma_t.max()) * medium.voxel_size
    made, cells = [], medium.coarsest
    while cells <= min(_MOST_CELLS, medium.resolution):
        made.append(make(cells))
        cells *= 2
    return min(made, key=lambda bound: majorants.cost(kind, bound.size, depth * bound.mean))


class FreePathSampler:
    """Draws free paths in one medium: what it prepares serves any number of rays.

    The arguments are those of `sample_free_paths`.
    """

    def __init__(
        self,
        medium,
        sampler="supervoxel_linear",
        device=None,
        *,
        band=0,
        interpolation="constant",
        supervoxel=None,
        most_steps=MOST_STEPS,
    ):
        if not 0 <= band < medium.bands:
            raise SettingsError(f"The medium has no band {band}; it has {medium.bands}.")
        self.device = devices.choose(device)
        require_whole(most_steps, "number of steps", 1, 2**31 - 1)
        require_memory(self.device, medium.shape, lambda shape: _plan(shape, medium))
        self.grid = path_grid(medium, sampler, interpolation, supervoxel, self.device)
        self.paths = backend_of(self.device).paths(self.grid)
        self.band, self.most_steps = band, most_steps

    def sample(self, origins, directions, seed=0):
        """(n,) m: distances, as `sample_free_paths` returns them."""
        return self.count(origins, directions, seed)[0]

    def count(self, origins, directions, seed=0):
        """(what `sample` returns, how many particles, real and virtual, these rays met)."""
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


def _plan(shape, medium):
    """The `Footprint`: at least the density must fit."""
    return Footprint({"density": 0 if isinstance(medium, PerlinMedium) else 4 * prod(shape)})


def sample_free_paths(
    medium,
    origins,
    directions,
    sampler="supervoxel_linear",
    seed=0,
    device=None,
    *,
    band=0,
    interpolation="constant",
    supervoxel=None,
):
    """How far photons fly until they collide.

    medium         `Medium` or `PerlinMedium`; outside is vacuum
    origins        (n, 3) m, in the medium or outside
    directions     (n, 3), of any length but 0
    sampler        one of SAMPLERS
    seed           0 to 2^32 - 1; ray i of a seed draws the same numbers whatever the others are
    device         None for the best, or part of the label of one of `device.devices()`
    band           whose sigma_t counts
    interpolation  of a Medium's density: "constant" in voxels, or "linear" between their centres
    supervoxel     voxels along the edge of a super-voxel; None for the size that is cheapest
    Returns (n,) float64 m, infinite where a ray leaves the medium or misses it, and NaN, with a
    RuntimeWarning, where it takes over MOST_STEPS steps.
    Raises SettingsError for rays that are not, and for what is not on the lists above.
    Source: paper 2.
    """
    prepared = FreePathSampler(
        medium, sampler, device, band=band, interpolation=interpolation, supervoxel=supervoxel
    )
    return prepared.sample(origins, directions, seed)


def check_rays(origins, directions):
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


def enter(grid, origins, directions):
    """Where rays enter the domain: (start, points, hit).

    start   (n,) fine cells from the origin to the domain, 0 inside it
    points  (n, 3) where they enter, in fine cells, in the domain
    hit     (n,) whether they do
    In float64, so that rays from far away lose nothing.
    """
    points = grid.fine_from_world(origins)
    upper = np.asarray(grid.fine.upper)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_lower = (grid.fine.lower - points) / directions
        to_upper = (upper - points) / directions
    # Parallel to a pair of faces: always between them, or never.
    parallel = directions == 0
    between = (points >= grid.fine.lower) & (points < upper)
    near = np.where(parallel, np.where(between, -np.inf, np.inf), np.minimum(to_lower, to_upper))
    far = np.where(parallel, np.inf, np.maximum(to_lower, to_upper))
    start = np.maximum(near.max(axis=1), 0)
    hit = start < far.min(axis=1)
    start = np.where(hit, start, 0)
    points = np.clip(points + start[:, None] * directions, grid.fine.lower, upper)
    return start, points, hit


def refuse_violations(violations):
    if violations:
        raise SolverError(
            f"In {violations} paths the density was over its upper bound, so they are biased; "
            "this is an error of LB Lighting, please report it with the scene."
        )
