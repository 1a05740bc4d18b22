# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse grids of OpenVDB: read block by block, and the places of their values.

Needs no Blender.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...arrays import Array, Booleans, Floats, Integers
from ...errors import SceneError
from ...transport.medium import Domain
from .resample import (
    BLOCK,
    Box,
    Readable,
    Voxel,
    block_sums,
    box_bounds,
    cubes,
    voxel_bounds,
)

NODE, ROOT = 128, 4096  # voxels along the edge of the nodes of OpenVDB's trees, above the leaves
MANY = 1 << 22  # root nodes up to which all are tried
BRICK = 8  # voxels along the edge of the blocks that `Matter` consists of
INVISIBLE = 1e-3  # optical depth, or share of the largest optical depth, too small to see


class SparseCells(Readable):
    """An openvdb grid in the world.

    A level set counts as the fog that OpenVDB makes of it: 1 inside, decreasing to 0 at the
    surface. In other grids, negative values and values that are not finite count as 0, as in
    Cycles, and so does the background value.
    """

    def __init__(self, vdb: Any, index_to_world: Floats, lower: Voxel, upper: Voxel) -> None:
        """lower, upper  (3,) int: the first active voxel, and the voxel after the last"""
        if not hasattr(vdb, "copyToArray"):  # openvdb has no class for grids of points
            raise SceneError(f"The grid '{vdb.name}' holds points, not values; choose another.")
        self.vdb, self.index_to_world = vdb, index_to_world
        self.lower, self.upper = np.asarray(lower), np.asarray(upper)
        self.channels = (3,) if isinstance(vdb.background, tuple) else ()
        self.background = np.array(vdb.background, np.float32)
        self.is_level_set = vdb.gridClass == "level set" and not self.channels

    @property
    def bounds(self) -> Box:
        """(lower, upper), each (3,) m: the box around the active voxels."""
        return voxel_bounds(self.lower, self.upper, self.index_to_world)

    def near(self, domain: Domain) -> tuple[Integers, Integers]:
        to_index = np.linalg.inv(self.index_to_world) @ domain.index_to_world
        lower, upper = box_bounds((-0.5,) * 3, np.subtract(domain.shape, 0.5), to_index)
        # Add a voxel, because values are interpolated up to the next voxel's centre.
        lower = np.maximum(self.lower, np.floor(lower) - 1).astype(int)
        return lower, np.minimum(self.upper, np.ceil(upper) + 2).astype(int)

    def blocks(self, lower: Voxel, upper: Voxel) -> Iterator[tuple[Integers, Array]]:
        for first, values in self.raw_blocks(lower, upper):
            values = self.counted(values)
            if values.any():
                yield first, values

    def read(self, lower: Voxel, upper: Voxel) -> Floats:
        result = np.zeros((*np.subtract(upper, lower), *self.channels), np.float32)
        first, end = np.maximum(lower, self.lower), np.minimum(upper, self.upper)
        if np.all(first < end):
            at = tuple(map(slice, first - lower, end - lower))
            result[at] = self.counted(self._raw(first, end))
        return result

    def raw_blocks(self, lower: Voxel, upper: Voxel) -> Iterator[tuple[Integers, Array]]:
        """Yields (first voxel, values in the file) of all blocks that may have values."""
        for node, node_end in self._nodes(lower, upper):
            for first, end in cubes(node, node_end, BLOCK):
                yield first, self._raw(first, end)

    def counted(self, values: Array) -> Array:
        """The values to light for `values` of the file, which this changes."""
        if self.is_level_set:
            values = values / -self.background if self.background > 0 else values < 0
            return np.clip(np.nan_to_num(values, nan=0, posinf=1, neginf=0), 0, 1)
        if self.background.any():
            is_empty = values == self.background
            values[is_empty.all(axis=-1) if self.channels else is_empty] = 0
        if not (values.min() >= 0 and values.max() < np.inf):
            values[~((values >= 0) & (values < np.inf))] = 0
        return values

    def _raw(self, first: Voxel, end: Voxel) -> Array:
        values = np.empty((*np.subtract(end, first), *self.channels), np.float32)
        self.vdb.copyToArray(values, tuple(map(int, first)))
        return values

    def _nodes(self, lower: Voxel, upper: Voxel) -> Iterator[tuple[Integers, Integers]]:
        """Yields (first, end) of the tree's nodes in the box that are not empty."""
        accessor = self.vdb.getConstAccessor()
        for root, root_end in self._roots(accessor, lower, upper):
            for node, node_end in cubes(root, root_end, NODE):
                if not self._is_empty(accessor, node, depth=2):
                    yield node, node_end

    def _roots(
        self, accessor: Any, lower: Voxel, upper: Voxel
    ) -> Iterator[tuple[Integers, Integers]]:
        """Yields (first, end) of the tree's largest nodes in the box that are not empty."""
        if np.prod((np.subtract(upper, lower) / ROOT + 1).astype(float)) < MANY:
            for root, end in cubes(lower, upper, ROOT):
                if not self._is_empty(accessor, root, depth=1):
                    yield root, end
            return
        # In a very large box, it is quicker to list the nodes of all values.
        corners = {tuple(c // ROOT for c in value.min) for value in self.vdb.citerOnValues()}
        for corner in sorted(corners):
            root = np.maximum(np.multiply(corner, ROOT), lower)
            end = np.minimum(np.add(corner, 1) * ROOT, upper)
            if np.all(root < end):
                yield root, end

    def _is_empty(self, accessor: Any, voxel: Voxel, depth: int) -> bool:
        """Whether the node that has the voxel, at this `depth`, is all 0 or background."""
        place = tuple(map(int, voxel))
        if accessor.getValueDepth(place) >= depth:
            return False
        value = np.array(accessor.getValue(place), np.float32)
        return bool(np.all(value == self.background) or not value.any())


@dataclass(frozen=True)
class Matter:
    """The distribution of a grid's values, in bricks of BRICK voxels along each edge.

    bricks    (n, 3) int, in BRICK voxels: the bricks that are not empty
    mean      (n,) float, the mean value of each
    negative  number of voxels that are negative
    infinite  number of voxels that are not finite
    """

    bricks: Integers
    mean: Floats
    negative: int
    infinite: int

    @classmethod
    def of(cls, cells: SparseCells, filled: bool = False) -> "Matter":
        """The matter of `cells`.

        filled  whether every voxel over 0 counts as 1
        """
        bricks, means, negative, infinite = [np.zeros((0, 3), int)], [np.zeros(0)], 0, 0
        for first, values in cells.raw_blocks(cells.lower, cells.upper):
            if not cells.is_level_set and not (values.min() >= 0 and values.max() < np.inf):
                is_negative = (values < 0) & (values != cells.background) & np.isfinite(values)
                negative += int(np.count_nonzero(is_negative))
                infinite += int(np.count_nonzero(~np.isfinite(values)))
            values = cells.counted(values)
            values = values.mean(axis=-1) if cells.channels else values
            start, sums = block_sums(values > 0 if filled else values, first, BRICK)
            filled_bricks = np.argwhere(sums)
            bricks.append(filled_bricks + start)
            means.append(sums[tuple(filled_bricks.T)] / BRICK**3)
        return cls(np.concatenate(bricks), np.concatenate(means), negative, infinite)

    @cached_property
    def layers(self) -> tuple[Integers, list[Floats], list[dict[int, Floats]]]:
        """(first brick (3,), [through], [across]): the matter in layers across each axis.

        through  (m,), the largest mean of each layer
        across   {other axis: (m,)}, the largest sum of means along that axis in each layer
        """
        lower = self.bricks.min(axis=0)
        size = self.bricks.max(axis=0) - lower + 1
        bricks = self.bricks - lower
        through = [_largest(bricks[:, axis], self.mean, size[axis]) for axis in range(3)]
        across: list[dict[int, Floats]] = [{} for _ in range(3)]
        for along in range(3):
            # Sum over lines along this axis, which have a place on the two others.
            one, two = (axis for axis in range(3) if axis != along)
            lines, number = np.unique(
                bricks[:, one].astype(np.int64) * size[two] + bricks[:, two], return_inverse=True
            )
            sums = np.bincount(number, self.mean)
            across[one][along] = _largest(lines // size[two], sums, size[one])
            across[two][along] = _largest(lines % size[two], sums, size[two])
        return lower, through, across

    def bounds(self, cells: SparseCells, sigma_t: float | None = None) -> Box:
        """(lower, upper), each (3,) m: the box of the visible part of `cells`.

        sigma_t  1/m for a value of 1, or None if only the relative values matter

        The part outside adds at most INVISIBLE to the optical depth along any line parallel to an
        axis; or at most this share of the largest optical depth, if that is less than 1.
        """
        # Find the optical depth that is too small to see.
        lengths = BRICK * np.linalg.norm(cells.index_to_world[:3, :3], axis=0)
        first, through, across = self.layers
        largest = max(lengths[a] * sums.max() for lines in across for a, sums in lines.items())
        allowed = INVISIBLE * (min(largest, 1 / sigma_t) if sigma_t else largest)
        # Drop the outer layers that stay below it.
        lower, upper = np.empty(3, int), np.empty(3, int)
        for axis, (largest_means, lines) in enumerate(zip(through, across, strict=True)):
            is_faint = np.all([lengths[a] * sums <= allowed for a, sums in lines.items()], axis=0)
            depth = lengths[axis] * largest_means
            lower[axis] = _leading(is_faint, depth, allowed)
            upper[axis] = len(depth) - _leading(is_faint[::-1], depth[::-1], allowed)
        lower = np.maximum((first + lower) * BRICK, cells.lower)
        upper = np.minimum((first + upper) * BRICK, cells.upper)
        return voxel_bounds(lower, upper, cells.index_to_world)

    def share_outside(self, cells: SparseCells, bounds: Box) -> float:
        """The share of the matter in `cells` that lies outside of `bounds`, (lower, upper) m."""
        centers = (self.bricks + 0.5) * BRICK - 0.5
        centers = centers @ cells.index_to_world[:3, :3].T + cells.index_to_world[:3, 3]
        inside = np.all((centers >= bounds[0]) & (centers <= bounds[1]), axis=1)
        return float(1 - self.mean[inside].sum() / self.mean.sum())

    def oddities(self, cells: SparseCells, name: str) -> list[str]:
        """[note] about the values of `cells` that are changed, for the object `name`."""
        grid = f"The grid '{cells.vdb.name}' of '{name}'"
        notes = []
        if cells.is_level_set:
            notes.append(f"{grid} is a level set; its inside is lit as fog of density 1.")
        elif cells.background.any():
            empty = ", ".join(f"{value:g}" for value in np.atleast_1d(cells.background))
            notes.append(f"{grid} has the value {empty} where it is empty; this counts as 0.")
        for count, what in ((self.negative, "negative"), (self.infinite, "not finite")):
            if count:
                voxels = "1 voxel that is" if count == 1 else f"{count} voxels that are"
                notes.append(f"{grid} has {voxels} {what}; this counts as 0.")
        return notes


def _leading(is_faint: Booleans, depth: Floats, allowed: float) -> int:
    """The number of first layers that are faint and together stay within the `allowed` depth."""
    return int(np.argmin(np.append(is_faint & (np.cumsum(depth) <= allowed), False)))


def _largest(places: Integers, values: Floats, size: int) -> Floats:
    """(size,): the largest of the `values` at each of the `places`, or 0."""
    result = np.zeros(size)
    np.maximum.at(result, places, values)
    return result
