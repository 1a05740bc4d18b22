# SPDX-License-Identifier: GPL-3.0-or-later
"""Majorants: upper bounds of a density in super-voxels, which the free path samplers step through.

Lengths are in fine cells, in each of which the density is a single polynomial: the voxels of a
density that is constant in them, or the boxes between voxel centres of one that is linear between
these. A super-voxel is a cube with edges of `size` fine cells; cell (i, j, k) begins at
(i, j, k) * size.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Floats, Integers
from ...errors import SettingsError, require_known

INTERPOLATIONS = ("constant", "linear")
KINDS = ("constant", "linear")

# Devices compute in float32, with a relative rounding error of up to _ROUNDING. Checking a majorant
# at the nodes, computing its coefficients, local coordinates and sum, and interpolating the density
# take fewer than 32 roundings, each relative to at most the sum of the coefficients' magnitudes.
_ROUNDING = 2.0**-24
MARGIN = 32 * _ROUNDING

_SCRATCH = 2**27  # bytes of node values that the kernel holds at a time

# The corners of a super-voxel, z fastest, and the powers of x, y, z in the terms of a majorant.
CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
TERMS = np.array(
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1)]
)

# The cost of crossing one super-voxel, in tentative collisions, by kind of majorant; and the linear
# majorant's excess over the density relative to that of the constant one: close to what
# tests/benchmarks/freepath.py measures for a head.
CELL_COST = {"constant": 0.65, "linear": 0.8}
LINEAR_EXCESS = 0.6


@dataclass(frozen=True)
class FineGrid:
    """A density as the samplers see it.

    values  float32, C order: voxels, or nodes, node i being at coordinate i; empty where the
            density is a function
    shape   (3,) fine cells
    lower   coordinate at which the domain begins, on each axis
    upper   (3,) coordinates at which it ends
    """

    values: Floats
    shape: tuple[int, ...]
    lower: float
    upper: tuple[float, ...]


@dataclass(frozen=True)
class Majorants:
    """Upper bounds of the density that hold in float32 arithmetic.

    size    fine cells along an edge of a super-voxel
    values  float32; (mx, my, mz), or (mx, my, mz, 8) coefficients of [1, x, y, z, xy, yz, zx, xyz]
            with x, y, z from 0 to 1 along the super-voxel. They need not hold beyond the fine
            grid, where the last super-voxels may stick out
    mean    of the majorant over the domain, in units of density
    """

    size: int
    values: Floats
    mean: float


def fine_cells(density: Floats, interpolation: str = "constant") -> FineGrid:
    """The `FineGrid` of a density (nx, ny, nz).

    "constant" is constant in each voxel. "linear" is trilinear between the voxels' centres and
    constant in the outer half voxels: the density is padded by its outermost values, and the domain
    begins at 0.5. SettingsError for another interpolation.
    """
    require_known(interpolation, INTERPOLATIONS, "interpolation")
    density = np.ascontiguousarray(density, np.float32)
    if interpolation == "constant":
        return FineGrid(density, density.shape, 0.0, tuple(map(float, density.shape)))
    nodes = np.pad(density, 1, mode="edge")
    upper = tuple(n + 0.5 for n in density.shape)
    return FineGrid(nodes, tuple(n + 1 for n in density.shape), 0.5, upper)


def constant_majorants(density: Floats, size: int, interpolation: str = "constant") -> Majorants:
    """The maximum density of each super-voxel. SettingsError for a size below 1."""
    grid = fine_cells(density, interpolation)
    require_size(size)
    values = block_maxima(grid.values, grid.shape, size)
    if interpolation == "linear":  # interpolation rounds; a voxel's own value is exact
        values = (values * (1 + MARGIN)).astype(np.float32)
    return Majorants(size, values, mean_of(values[..., None], TERMS[:1], grid, size))


def sizes(shape: Sequence[int]) -> list[int]:
    """The sizes to choose from, for `shape` fine cells: 1, 2, 4, ... up to the whole domain."""
    return [2**power for power in range((max(shape) - 1).bit_length() + 1)]


def choose_size(
    density: Floats, depth_per_density: float, kind: str, interpolation: str = "constant"
) -> int:
    """The size of super-voxels that makes tracing cheapest.

    depth_per_density  optical depth of one fine cell at density 1
    kind               "constant" or "linear", of the majorant
    Minimizes `cost`, for a uniform fluence. Starting a flight, in its first super-voxel, costs the
    same at every size.
    """
    require_known(kind, KINDS, "kind of majorant")
    grid = fine_cells(density, interpolation)
    mean = float(np.mean(density, dtype=float))
    maxima, costs = block_maxima(grid.values, grid.shape, 1), {}
    for size in sizes(grid.shape):
        if size > 1:
            maxima = block_maxima(maxima, maxima.shape, 2)
        bound = mean_of(maxima[..., None], TERMS[:1], grid, size)
        # The middle node of 2 x 2 x 2 voxels has their maximum, and so has any linear majorant.
        if kind == "linear" and (size > 2 or interpolation == "linear"):
            bound = mean + LINEAR_EXCESS * (bound - mean)
        costs[size] = cost(kind, size, depth_per_density * bound)
    return min(costs, key=lambda size: costs[size])


def cost(kind: str, size: int, depth: float) -> float:
    """The cost of tracing a path, per fine cell of its length, in tentative collisions.

    depth  optical depth of a fine cell at the mean majorant
    A ray crosses 3/2 / size super-voxels per fine cell: the mean chord 4V/S of a cube is 2/3 of its
    edge. The mean number of tentative collisions is the optical depth of the majorant.
    """
    return CELL_COST[kind] * 1.5 / size + depth


def require_size(size: int) -> None:
    if size < 1:
        raise SettingsError(f"A super-voxel must have 1 fine cell or more an edge, not {size}.")


def block_maxima(values: Floats, fine: Sequence[int], size: int) -> Floats:
    """(mx, my, mz): the largest of `values` in each cube of `size` of the `fine` cells (3,).

    `values` has one value per cell, or nodes, one more along each axis; cubes share the nodes on
    their faces.
    """
    for axis, cells in enumerate(fine):
        along = np.moveaxis(values, axis, 0)
        shared = len(along) - cells
        if size == 1 and not shared:
            continue
        maxima = along[:cells:size].copy("K")  # in the order of `values`
        # Slice by slice: NumPy's reduceat is forty times slower.
        for offset in range(1, min(size, cells) + shared):
            part = along[offset::size][: len(maxima)]
            np.maximum(maxima[: len(part)], part, out=maxima[: len(part)])
        values = np.moveaxis(maxima, 0, axis)
    return values


def mean_of(values: Floats, terms: Integers, grid: FineGrid, size: int) -> float:
    """The mean over the domain of polynomials (mx, my, mz, terms).

    The mean of a multilinear function over a box is its value at the centre.
    """
    lengths, centers = [], []
    for cells, upper in zip(values.shape, grid.upper, strict=False):
        edges = np.clip(np.arange(cells + 1) * float(size), grid.lower, upper)
        lengths.append(np.diff(edges))
        centers.append((edges[1:] + edges[:-1]) / 2 / size - np.arange(cells))
    total = 0.0
    for term, powers in enumerate(terms):
        x, y, z = (w * c**p for w, c, p in zip(lengths, centers, powers, strict=True))
        for layer, weight in zip(values[..., term], x, strict=True):
            total += weight * (y @ (layer @ z))
    return float(total / np.prod([w.sum() for w in lengths]))


@dataclass(frozen=True)
class Problem:
    """The linear programs of a grid of super-voxels.

    values   float32, voxels or nodes
    fine     (3,) fine cells
    size     fine cells along an edge of a super-voxel
    blocky   whether `values` are voxels: a node then has the largest value of the voxels around it
             that are in the super-voxel
    """

    values: Floats
    fine: tuple[int, ...]
    size: int
    blocky: bool

    @property
    def cells(self) -> tuple[int, ...]:
        return tuple(-(-n // self.size) for n in self.fine)

    @property
    def nodes(self) -> tuple[int, ...]:
        """(3,) the largest number of nodes of a super-voxel along each axis."""
        return tuple(min(self.size, n) + 1 for n in self.fine)

    def extents(self, axis: int) -> Integers:
        """(cells,) fine cells of each super-voxel along an axis; the last may have fewer."""
        return np.minimum(self.size, self.fine[axis] - np.arange(self.cells[axis]) * self.size)

    def slabs(self) -> Iterator[tuple[slice, "Problem"]]:
        """(slice of layers, `Problem`): as many layers along x as fit into the scratch."""
        layer = 4 * int(np.prod(self.nodes)) * self.cells[1] * self.cells[2]
        step = max(1, _SCRATCH // layer)
        for first in range(0, self.cells[0], step):
            last = min(first + step, self.cells[0])
            begin, end = first * self.size, min(last * self.size, self.fine[0])
            values = self.values[begin : end + (0 if self.blocky else 1)]
            slab = Problem(values, (end - begin, *self.fine[1:]), self.size, self.blocky)
            yield slice(first, last), slab
