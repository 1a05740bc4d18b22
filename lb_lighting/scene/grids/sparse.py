# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse grids, read block by block as their values count, and where they have how much."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...errors import SceneError
from .resample import (
    BLOCK,
    Readable,
    block_sums,
    box_bounds,
    cubes,
    voxel_bounds,
)

NODE, ROOT = 128, 4096  # voxels along the edge of the nodes of OpenVDB's trees, above the leaves
MANY = 1 << 22  # root nodes that are looked at one by one
BRICK = 8  # voxels along the edge of the pieces that matter is counted in
INVISIBLE = 1e-3  # optical depth, or share of the largest that there is, which nobody sees


class SparseCells(Readable):
    """An openvdb grid in the world.

    Level sets count as the fog that OpenVDB makes of them: 1 inside, fading to 0 at the surface.
    Of others, what is negative or not finite counts as 0, as in Cycles, and so does the value that
    the grid has where it is empty.
    """

    def __init__(self, vdb, index_to_world, lower, upper):
        """lower, upper  (3,) int: of its active voxels, the first and the one behind the last"""
        if not hasattr(vdb, "copyToArray"):
            raise SceneError(f"The grid '{vdb.name}' holds points, not values; choose another.")
        self.vdb, self.index_to_world = vdb, index_to_world
        self.lower, self.upper = np.asarray(lower), np.asarray(upper)
        self.channels = (3,) if isinstance(vdb.background, tuple) else ()
        self.background = np.array(vdb.background, np.float32)
        self.is_level_set = vdb.gridClass == "level set" and not self.channels

    @property
    def bounds(self):
        """(lower, upper), each (3,) m: the box around its active voxels."""
        return voxel_bounds(self.lower, self.upper, self.index_to_world)

    def near(self, domain):
        to_own = np.linalg.inv(self.index_to_world) @ domain.index_to_world
        lower, upper = box_bounds((-0.5,) * 3, np.subtract(domain.shape, 0.5), to_own)
        # One voxel more, because a value reaches as far as the next voxel's centre.
        lower = np.maximum(self.lower, np.floor(lower) - 1).astype(int)
        return lower, np.minimum(self.upper, np.ceil(upper) + 2).astype(int)

    def blocks(self, lower, upper):
        for first, values in self.raw_blocks(lower, upper):
            values = self.counted(values)
            if values.any():
                yield first, values

    def read(self, lower, upper):
        result = np.zeros((*np.subtract(upper, lower), *self.channels), np.float32)
        first, end = np.maximum(lower, self.lower), np.minimum(upper, self.upper)
        if np.all(first < end):
            at = tuple(map(slice, first - lower, end - lower))
            result[at] = self.counted(self._raw(first, end))
        return result

    def raw_blocks(self, lower, upper):
        """Yields (first voxel, values as they are) of all blocks that can have any."""
        for node, node_end in self._nodes(lower, upper):
            for first, end in cubes(node, node_end, BLOCK):
                yield first, self._raw(first, end)

    def counted(self, values):
        """`values`, which are changed, as they count."""
        if self.is_level_set:
            values = values / -self.background if self.background > 0 else values < 0
            return np.clip(np.nan_to_num(values, nan=0, posinf=1, neginf=0), 0, 1)
        if self.background.any():
            empty = values == self.background
            values[empty.all(axis=-1) if self.channels else empty] = 0
        if not (values.min() >= 0 and values.max() < np.inf):
            values[~((values >= 0) & (values < np.inf))] = 0
        return values

    def _raw(self, first, end):
        values = np.empty((*np.subtract(end, first), *self.channels), np.float32)
        self.vdb.copyToArray(values, tuple(map(int, first)))
        return values

    def _nodes(self, lower, upper):
        """Yields (first, end) of the parts of the box whose node in the tree is not empty."""
        accessor = self.vdb.getConstAccessor()
        for root, root_end in self._roots(accessor, lower, upper):
            for node, node_end in cubes(root, root_end, NODE):
                if not self._is_empty(accessor, node, depth=2):
                    yield node, node_end

    def _roots(self, accessor, lower, upper):
        if np.prod((np.subtract(upper, lower) / ROOT + 1).astype(float)) < MANY:
            for root, end in cubes(lower, upper, ROOT):
                if not self._is_empty(accessor, root, depth=1):
                    yield root, end
            return
        # So large a box, that it is quicker to go from voxel to voxel.
        there = {tuple(c // ROOT for c in value.min) for value in self.vdb.citerOnValues()}
        for corner in sorted(there):
            root = np.maximum(np.multiply(corner, ROOT), lower)
            end = np.minimum(np.add(corner, 1) * ROOT, upper)
            if np.all(root < end):
                yield root, end

    def _is_empty(self, accessor, voxel, depth):
        """Whether all of the node of a `depth` with that voxel is one value that counts as none."""
        voxel = tuple(map(int, voxel))
        if accessor.getValueDepth(voxel) >= depth:
            return False
        value = np.array(accessor.getValue(voxel), np.float32)
        return bool(np.all(value == self.background) or not value.any())


@dataclass(frozen=True)
class Matter:
    """Where a grid has how much of what counts.

    bricks    (n, 3) int, in BRICK voxels: those that have any
    mean      (n,) float, of the values in each
    negative, infinite  how many voxels are negative, and not finite
    """

    bricks: np.ndarray
    mean: np.ndarray
    negative: int
    infinite: int

    @classmethod
    def of(cls, cells, filled=False):
        """Of `SparseCells`.

        filled  every voxel over 0 counts as 1
        """
        bricks, means, negative, infinite = [np.zeros((0, 3), int)], [np.zeros(0)], 0, 0
        for first, values in cells.raw_blocks(cells.lower, cells.upper):
            if not cells.is_level_set and not (values.min() >= 0 and values.max() < np.inf):
                bad = (values < 0) & (values != cells.background) & np.isfinite(values)
                negative += np.count_nonzero(bad)
                infinite += np.count_nonzero(~np.isfinite(values))
            values = cells.counted(values)
            values = values.mean(axis=-1) if cells.channels else values
            start, sums = block_sums(values > 0 if filled else values, first, BRICK)
            there = np.argwhere(sums)
            bricks.append(there + start)
            means.append(sums[tuple(there.T)] / BRICK**3)
        return cls(np.concatenate(bricks), np.concatenate(means), negative, infinite)

    @cached_property
    def layers(self):
        """(first brick (3,), [through], [across]): what light meets in layers across each axis.

        through  (m,), the largest mean of each layer
        across   {other axis: (m,)}, the largest sum of means along that axis in each layer
        """
        lower = self.bricks.min(axis=0)
        size = self.bricks.max(axis=0) - lower + 1
        bricks = self.bricks - lower
        through = [_largest(bricks[:, axis], self.mean, size[axis]) for axis in range(3)]
        across = [{} for _ in range(3)]
        for along in range(3):
            # Lines along this axis, by the other two.
            one, two = (axis for axis in range(3) if axis != along)
            lines, number = np.unique(
                bricks[:, one].astype(np.int64) * size[two] + bricks[:, two], return_inverse=True
            )
            sums = np.bincount(number, self.mean)
            across[one][along] = _largest(lines // size[two], sums, size[one])
            across[two][along] = _largest(lines % size[two], sums, size[two])
        return lower, through, across

    def bounds(self, cells, sigma_t=None):
        """(lower, upper), each (3,) m: the box of all of the `cells` that can be seen.

        sigma_t  1/m where a value is 1, or None where nothing but the shares of values counts

        What lies outside adds no more than INVISIBLE to the optical depth along any line that is
        parallel to an axis, or than that share of the largest, if that is less than 1.
        """
        lengths = BRICK * np.linalg.norm(cells.index_to_world[:3, :3], axis=0)
        first, through, across = self.layers
        largest = max(lengths[a] * sums.max() for lines in across for a, sums in lines.items())
        allowed = INVISIBLE * (min(largest, 1 / sigma_t) if sigma_t else largest)
        lower, upper = np.empty(3, int), np.empty(3, int)
        for axis, (own, lines) in enumerate(zip(through, across, strict=True)):
            faint = np.all([lengths[a] * sums <= allowed for a, sums in lines.items()], axis=0)
            depth = lengths[axis] * own
            lower[axis] = _leading(faint, depth, allowed)
            upper[axis] = len(own) - _leading(faint[::-1], depth[::-1], allowed)
        lower = np.maximum((first + lower) * BRICK, cells.lower)
        upper = np.minimum((first + upper) * BRICK, cells.upper)
        return voxel_bounds(lower, upper, cells.index_to_world)

    def share_outside(self, cells, bounds):
        """Of all matter in `cells`, what lies outside of the box of `bounds`, (lower, upper) m."""
        centers = (self.bricks + 0.5) * BRICK - 0.5
        centers = centers @ cells.index_to_world[:3, :3].T + cells.index_to_world[:3, 3]
        inside = np.all((centers >= bounds[0]) & (centers <= bounds[1]), axis=1)
        return 1 - self.mean[inside].sum() / self.mean.sum()

    def oddities(self, cells, name):
        """[note] of what counts for something else than it is, in `cells` of the object `name`."""
        grid = f"The grid '{cells.vdb.name}' of '{name}'"
        notes = []
        if cells.is_level_set:
            notes.append(f"{grid} is a level set; what it encloses is lit as fog of density 1.")
        elif cells.background.any():
            empty = ", ".join(f"{value:g}" for value in np.atleast_1d(cells.background))
            notes.append(f"{grid} has the value {empty} where it is empty; that counts as 0.")
        for count, what in ((self.negative, "negative"), (self.infinite, "not finite")):
            if count:
                voxels = "1 voxel that is" if count == 1 else f"{count} voxels that are"
                notes.append(f"{grid} has {voxels} {what}; that counts as 0.")
        return notes


def _leading(faint, depth, allowed):
    """How many of the first layers can be left out."""
    return int(np.argmin(np.append(faint & (np.cumsum(depth) <= allowed), False)))


def _largest(places, values, size):
    """(size,): the largest of `values` at each of the `places`, or 0."""
    result = np.zeros(size)
    np.maximum.at(result, places, values)
    return result
