# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of any kind onto the lattice, block by block.

What is sampled at last is as large as the lattice needs it, whatever the grid: a grid that is much
finer is averaged in blocks while it is read.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

SLAB = 1 << 17  # samples taken at once: few enough for the cache
BLOCK = 64  # voxels along the edge of what is read at once


class Readable:
    """A grid in the world that is read in parts; index_to_world as `Cells` have it.

    channels  () of a number in each voxel, (3,) of a vector: values have them last
    near(domain)          (lower, upper), (3,) int each: the voxels that `domain` needs, from lower
                          to before upper
    blocks(lower, upper)  yields (first voxel (3,), values) of all blocks that are not 0 there
    read(lower, upper)    the values there, 0 where the grid has none
    """

    channels = ()

    def on(self, domain):
        """(nx, ny, nz) float32, or (3, nx, ny, nz): averaged over the voxels of `domain`."""
        return averaged(self, domain)

    def at(self, index_to_world, first, shape):
        """The values at the voxel centres of a block of another grid.

        first, shape  (3,) of the block
        """
        to_own = np.linalg.inv(self.index_to_world) @ index_to_world @ translation(first)
        start = np.round(to_own[:3, 3]).astype(int)
        if np.allclose(to_own, translation(start), atol=1e-4):
            return self.read(start, start + shape)
        lower, upper = box_bounds((0, 0, 0), np.subtract(shape, 1), to_own)
        lower, upper = np.floor(lower).astype(int) - 1, np.ceil(upper).astype(int) + 2
        values = self.read(lower, upper)
        return _trilinear(values, _positions(to_own, (0, 0, 0), shape) - lower[:, None, None, None])


@dataclass(frozen=True)
class Cells(Readable):
    """A dense grid.

    values          (mx, my, mz), trilinear between voxel centres and 0 outside, as Cycles has it
    index_to_world  (4, 4): the centre of voxel (i, j, k) is at index_to_world @ (i, j, k, 1)
    """

    values: np.ndarray
    index_to_world: np.ndarray

    def near(self, _domain):
        return np.zeros(3, int), np.array(self.values.shape)

    def blocks(self, lower, upper):
        for first, end in cubes(lower, upper, BLOCK):
            yield first, self.values[tuple(map(slice, first, end))]

    def read(self, lower, upper):
        result = np.zeros(np.subtract(upper, lower), np.float32)
        inner = np.maximum(lower, 0), np.minimum(upper, self.values.shape)
        if np.all(inner[0] < inner[1]):
            to = tuple(map(slice, *np.subtract(inner, lower)))
            result[to] = self.values[tuple(map(slice, *inner))]
        return result


def averaged(cells, domain, change=None, channels=None):
    """`cells`, a `Readable`, averaged over the voxels of `domain`.

    change    takes (first voxel, values) of a block, and returns the values (*channels, ...) to be
              averaged in their place; None for the values themselves
    channels  of what `change` returns

    Returns (*channels, nx, ny, nz) float32, 0 outside of the grid. The integral over space is kept:
    a fine grid is averaged in blocks of about half a domain voxel or more, and the blocks are
    sampled about as densely as they lie.
    """
    channels = cells.channels if channels is None else channels
    result = np.zeros((*channels, *domain.shape), np.float32)
    lower, upper = cells.near(domain)
    if np.any(upper <= lower):
        return result
    from_own = cells.index_to_world @ translation(lower)
    to_index = np.linalg.inv(from_own) @ domain.index_to_world
    per_voxel = np.linalg.norm(to_index[:3, :3], axis=1)
    factors = np.maximum(1, np.round(per_voxel / 2)).astype(int)
    # With a border of zeros; memory is taken only where something is written.
    coarse = np.zeros((*channels, *(-(-(upper - lower) // factors) + 2)), np.float32)
    for first, values in cells.blocks(lower, upper):
        values = np.moveaxis(values, 3, 0) if values.ndim > 3 else values
        values = values if change is None else change(first, values)
        start, sums = block_sums(values, first - lower, factors)
        at = tuple(map(slice, start + 1, start + 1 + sums.shape[-3:]))
        coarse[..., *at] += sums / factors.prod()
    to_coarse = np.diag([*(1 / factors), 1.0]) @ translation((1 - factors) / 2) @ to_index
    for own, sampled in zip(
        coarse.reshape(-1, *coarse.shape[-3:]), result.reshape(-1, *domain.shape), strict=True
    ):
        _sample(own, to_coarse, sampled)
    return result


def block_sums(values, first, factors):
    """(first block (3,), sums (..., mx, my, mz)) of `values` in blocks of `factors` voxels.

    values  (..., nx, ny, nz), which begin at voxel `first`; block (0, 0, 0) at voxel (0, 0, 0)
    """
    factors = np.broadcast_to(factors, 3)
    start = np.asarray(first) // factors
    before = first - start * factors
    # The first axis in float32: quick, and no more are added than make up a block.
    for axis, kind in ((-3, np.float32), (-2, np.float64), (-1, np.float64)):
        values = _sums_along(values, axis, before[axis], factors[axis], kind)
    return start, values


def _sums_along(values, axis, before, factor, kind):
    """Sums of `factor` values along an axis, of the first `before` fewer."""
    length = values.shape[axis]
    if factor > length:  # all in one block, or in two
        edges = [0, factor - before] if before + length > factor else [0]
        return np.add.reduceat(values, edges, axis=axis, dtype=kind)
    after = -(before + length) % factor
    if before or after:
        beside = [(0, 0)] * values.ndim
        beside[axis] = before, after
        values = np.pad(values, beside)
    shape = list(values.shape)
    shape[axis : axis + 1 or None] = [shape[axis] // factor, factor]
    return values.reshape(shape).sum(axis=axis, dtype=kind)


def cubes(lower, upper, edge):
    """Yields (first, end), (3,) int each, of the box from `lower` to `upper` in cubes that are
    aligned with multiples of `edge`."""
    for corner in product(
        *(range(a - a % edge, b, edge) for a, b in zip(lower, upper, strict=True))
    ):
        yield np.maximum(corner, lower), np.minimum(np.add(corner, edge), upper)


def box_bounds(lower, upper, matrix):
    """(lower, upper), each (3,): the box around the box from `lower` to `upper` under `matrix`."""
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    return corners.min(axis=0), corners.max(axis=0)


def voxel_bounds(lower, upper, index_to_world):
    """(lower, upper), each (3,) m: the box around the voxels from `lower` to before `upper`."""
    return box_bounds(np.subtract(lower, 0.5), np.subtract(upper, 0.5), index_to_world)


def translation(vector):
    """(4, 4)"""
    matrix = np.eye(4)
    matrix[:3, 3] = vector
    return matrix


def _sample(padded, to_index, result):
    """Fill `result` (nx, ny, nz) with the means of `padded`, which has a border of zeros.

    to_index  (4, 4), from voxels of the result to those within the border
    """
    offsets = _sub_voxels(to_index)
    depth = max(1, SLAB // (result.shape[1] * result.shape[2]))
    for start in range(0, result.shape[0], depth):
        slab = result[start : start + depth]
        for offset in offsets:
            shift = np.add(offset, (start, 0, 0))
            slab += _trilinear(padded, _positions(to_index, shift, slab.shape) + 1)
        slab /= len(offsets)


def _sub_voxels(to_index):
    """[(3,)] offsets, in domain voxels, of samples that lie no wider apart than the values."""
    steps = np.linalg.norm(to_index[:3, :3], axis=0)
    counts = np.maximum(1, np.ceil(steps - 0.1)).astype(int)  # little is lost at 1.1
    return list(product(*((np.arange(n) + 0.5) / n - 0.5 for n in counts)))


def _positions(to_index, shift, shape):
    """(3, *shape): `to_index` of the lattice points of `shape`, moved by `shift`."""
    axes = np.ix_(*(np.arange(n) + s for n, s in zip(shape, shift, strict=True)))
    return np.stack(
        [sum(m * a for m, a in zip(row, axes, strict=False)) + row[3] for row in to_index[:3]]
    )


def _trilinear(padded, positions):
    """`padded` (with a border of zeros) at `positions` (3, ...), in its voxels; 0 beyond."""
    last = np.array(padded.shape).reshape(3, *[1] * (positions.ndim - 1)) - 1
    inside = np.all((positions >= 0) & (positions < last), axis=0)
    positions = positions[:, inside]
    base = positions.astype(np.int64)
    high = (positions - base).astype(np.float32)
    sides = (1 - high, high)
    strides = padded.shape[1] * padded.shape[2], padded.shape[2], 1
    first = sum(stride * index for stride, index in zip(strides, base, strict=True))
    values = padded.ravel()
    found = np.zeros(first.shape, np.float32)
    for i, j, k in product((0, 1), repeat=3):
        weight = sides[i][0] * sides[j][1] * sides[k][2]
        found += weight * values[first + np.dot(strides, (i, j, k))]
    result = np.zeros(inside.shape, np.float32)
    result[inside] = found
    return result
