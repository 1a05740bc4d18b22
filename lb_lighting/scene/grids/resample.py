# SPDX-License-Identifier: GPL-3.0-or-later
"""Resamples any grid to the lattice, block by block. Needs no Blender.

Memory depends on the lattice, not on the grid: a much finer grid is averaged in blocks while it is
read, and the blocks are sampled.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from ...arrays import Array, Floats, Integers
from ...transport.medium import Domain

type Box = tuple[Floats, Floats]  # lower and upper corner, each (3,) m
type Voxel = Sequence[int] | Integers  # (3,)
type Change = Callable[[Integers, Array], Array]

SLAB = 1 << 17  # samples at a time: few enough for the cache
BLOCK = 64  # voxels along the edge of a block that is read at once


class Readable(ABC):
    """A grid in the world that is read in blocks.

    index_to_world  (4, 4): the centre of voxel (i, j, k) is at index_to_world @ (i, j, k, 1)
    channels        () for numbers, (3,) for vectors, which are the last axis of values
    """

    index_to_world: Floats
    channels: tuple[int, ...] = ()

    @abstractmethod
    def near(self, domain: Domain) -> tuple[Integers, Integers]:
        """(lower, upper), (3,) int each: the voxels for `domain`, `upper` not included."""

    @abstractmethod
    def blocks(self, lower: Voxel, upper: Voxel) -> Iterator[tuple[Integers, Array]]:
        """Yields (first voxel (3,), values) of the blocks from `lower` to `upper`, except for 0."""

    @abstractmethod
    def read(self, lower: Voxel, upper: Voxel) -> Floats:
        """The values from `lower` to `upper`, 0 outside of the grid."""

    def on(self, domain: Domain) -> Floats:
        """(nx, ny, nz) float32, or (3, nx, ny, nz): averaged over the voxels of `domain`."""
        return averaged(self, domain)

    def at(self, index_to_world: Floats, first: Voxel, shape: Voxel) -> Floats:
        """The values at the voxel centres of a block of another grid.

        first, shape  (3,) of the block
        """
        to_index = np.linalg.inv(self.index_to_world) @ index_to_world @ translation(first)
        start = np.round(to_index[:3, 3]).astype(int)
        if np.allclose(to_index, translation(start), atol=1e-4):
            return self.read(start, np.add(start, shape))
        corner, opposite = box_bounds((0, 0, 0), np.subtract(shape, 1), to_index)
        lower, upper = np.floor(corner).astype(int) - 1, np.ceil(opposite).astype(int) + 2
        values = self.read(lower, upper)
        positions = _positions(to_index, (0, 0, 0), shape) - lower[:, None, None, None]
        return _trilinear(values, positions)


@dataclass(frozen=True)
class Cells(Readable):
    """A dense grid.

    values  (mx, my, mz), trilinear between voxel centres and 0 outside, as in Cycles
    """

    values: Floats
    index_to_world: Floats

    def near(self, _domain: Domain) -> tuple[Integers, Integers]:
        return np.zeros(3, int), np.array(self.values.shape)

    def blocks(self, lower: Voxel, upper: Voxel) -> Iterator[tuple[Integers, Array]]:
        for first, end in cubes(lower, upper, BLOCK):
            yield first, self.values[tuple(map(slice, first, end))]

    def read(self, lower: Voxel, upper: Voxel) -> Floats:
        result = np.zeros(np.subtract(upper, lower), np.float32)
        inner = np.maximum(lower, 0), np.minimum(upper, self.values.shape)
        if np.all(inner[0] < inner[1]):
            to = tuple(map(slice, *np.subtract(inner, lower)))
            result[to] = self.values[tuple(map(slice, *inner))]
        return result


def averaged(
    cells: Readable,
    domain: Domain,
    change: Change | None = None,
    channels: tuple[int, ...] | None = None,
) -> Floats:
    """(*channels, nx, ny, nz) float32: `cells` averaged over the voxels of `domain`, 0 outside.

    change    takes (first voxel, values) of a block, and returns the values (*channels, ...) to
              average instead; None for the values themselves
    channels  of the result of `change`

    The integral over space is kept: a fine grid is averaged in blocks of half a domain voxel or
    more, and the blocks are sampled about as densely as they lie.
    """
    channels = cells.channels if channels is None else channels
    result = np.zeros((*channels, *domain.shape), np.float32)
    lower, upper = cells.near(domain)
    if np.any(upper <= lower):
        return result
    from_lower = cells.index_to_world @ translation(lower)
    to_index = np.linalg.inv(from_lower) @ domain.index_to_world
    per_voxel = np.linalg.norm(to_index[:3, :3], axis=1)
    factors = np.maximum(1, np.round(per_voxel / 2)).astype(int)
    # Average the grid in blocks. Pages of the array that are never written take no memory.
    coarse = np.zeros((*channels, *(-(-(upper - lower) // factors) + 2)), np.float32)
    for first, values in cells.blocks(lower, upper):
        values = np.moveaxis(values, 3, 0) if values.ndim > 3 else values
        values = values if change is None else change(first, values)
        start, sums = block_sums(values, first - lower, factors)
        block: Any = tuple(map(slice, start + 1, start + 1 + sums.shape[-3:]))
        coarse[..., *block] += sums / factors.prod()
    # Sample the blocks.
    to_coarse = np.diag([*(1 / factors), 1.0]) @ translation((1 - factors) / 2) @ to_index
    for blocks, sampled in zip(
        coarse.reshape(-1, *coarse.shape[-3:]), result.reshape(-1, *domain.shape), strict=True
    ):
        _sample(blocks, to_coarse, sampled)
    return result


def block_sums(values: Array, first: Voxel, factors: int | Voxel) -> tuple[Integers, Floats]:
    """(first block (3,), sums (..., mx, my, mz)) of `values` in blocks of `factors` voxels.

    values  (..., nx, ny, nz), from voxel `first` on; block (0, 0, 0) begins at voxel (0, 0, 0)
    """
    factors = np.broadcast_to(factors, 3)
    start = np.asarray(first) // factors
    before = first - start * factors
    # Float32 is fast for the first axis, and precise enough for the few values of a block.
    for axis, kind in ((-3, np.float32), (-2, np.float64), (-1, np.float64)):
        values = _sums_along(values, axis, before[axis], factors[axis], kind)
    return start, values


def _sums_along(values: Array, axis: int, before: int, factor: int, kind: type) -> Floats:
    """Sums of each `factor` values along an axis; the first sum has `before` values fewer."""
    length = values.shape[axis]
    if factor > length:  # one block, or two
        edges = [0, factor - before] if before + length > factor else [0]
        sums: Floats = np.add.reduceat(values, edges, axis=axis, dtype=kind)
        return sums
    after = -(before + length) % factor
    if before or after:
        padding = [(0, 0)] * values.ndim
        padding[axis] = before, after
        values = np.pad(values, padding)
    shape = list(values.shape)
    shape[axis : axis + 1 or None] = [shape[axis] // factor, factor]
    sums = values.reshape(shape).sum(axis=axis, dtype=kind)
    return sums


def cubes(lower: Voxel, upper: Voxel, edge: int) -> Iterator[tuple[Integers, Integers]]:
    """Yields (first, end), (3,) int each: the box from `lower` to `upper`, cut into cubes along
    multiples of `edge`."""
    for corner in product(
        *(range(a - a % edge, b, edge) for a, b in zip(lower, upper, strict=True))
    ):
        yield np.maximum(corner, lower), np.minimum(np.add(corner, edge), upper)


def box_bounds(lower: Any, upper: Any, matrix: Array) -> Box:
    """(lower, upper), each (3,): the bounds of the box from `lower` to `upper` after `matrix`."""
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    return corners.min(axis=0), corners.max(axis=0)


def voxel_bounds(lower: Voxel, upper: Voxel, index_to_world: Floats) -> Box:
    """(lower, upper), each (3,) m: the bounds of the voxels from `lower`, without `upper`."""
    return box_bounds(np.subtract(lower, 0.5), np.subtract(upper, 0.5), index_to_world)


def translation(vector: Any) -> Floats:
    """(4, 4), the matrix that moves by `vector` (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = vector
    return matrix


def _sample(padded: Floats, to_index: Floats, result: Floats) -> None:
    """Fill `result` (nx, ny, nz) with the means of `padded`, which has a border of zeros.

    to_index  (4, 4), voxels of the result to voxels within the border
    """
    offsets = _sub_voxels(to_index)
    depth = max(1, SLAB // (result.shape[1] * result.shape[2]))
    for start in range(0, result.shape[0], depth):
        slab = result[start : start + depth]
        for offset in offsets:
            shift = np.add(offset, (start, 0, 0))
            slab += _trilinear(padded, _positions(to_index, shift, slab.shape) + 1)
        slab /= len(offsets)


def _sub_voxels(to_index: Floats) -> list[tuple[float, ...]]:
    """[(3,)] offsets, in domain voxels, of samples that are as close to each other as values."""
    steps = np.linalg.norm(to_index[:3, :3], axis=0)
    counts = np.maximum(1, np.ceil(steps - 0.1)).astype(int)  # one sample is enough up to 1.1
    return list(product(*((np.arange(n) + 0.5) / n - 0.5 for n in counts)))


def _positions(to_index: Floats, shift: Any, shape: Voxel) -> Floats:
    """(3, *shape): `to_index` of the lattice points of `shape`, moved by `shift`."""
    axes = np.ix_(*(np.arange(n) + s for n, s in zip(shape, shift, strict=True)))
    return np.stack(
        [sum(m * a for m, a in zip(row, axes, strict=False)) + row[3] for row in to_index[:3]]
    )


def _trilinear(padded: Floats, positions: Floats) -> Floats:
    """`padded` (with a border of zeros) at `positions` (3, ...), in its voxels; 0 outside."""
    last = np.array(padded.shape).reshape(3, *[1] * (positions.ndim - 1)) - 1
    inside = np.all((positions >= 0) & (positions < last), axis=0)
    positions = positions[:, inside]
    base = positions.astype(np.int64)
    high = (positions - base).astype(np.float32)
    sides = (1 - high, high)
    strides = padded.shape[1] * padded.shape[2], padded.shape[2], 1
    first = sum(stride * index for stride, index in zip(strides, base, strict=True))
    values = padded.ravel()
    interpolated = np.zeros(first.shape, np.float32)
    for i, j, k in product((0, 1), repeat=3):
        weight = sides[i][0] * sides[j][1] * sides[k][2]
        interpolated += weight * values[first + np.dot(strides, (i, j, k))]
    result = np.zeros(inside.shape, np.float32)
    result[inside] = interpolated
    return result
