# SPDX-License-Identifier: GPL-3.0-or-later
"""The least linear majorants in NumPy float64: the twin of kernels/photons/majorants.cl."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from ...arrays import Floats, Integers
from .majorants import Problem

# The linear program stops this close to its optimum, relative to the majorant's mean, or after
# this many exchanges; a head volume takes 12 on average and 50 at most.
TOLERANCE = 1e-3
EXCHANGES = 64
SMALLEST_PIVOT = 1e-4  # of an exchange; float32 turns smaller ones into noise

_BATCH = 2**20  # node values at a time


def least_corners(problem: Problem) -> Floats:
    """Corner values (mx, my, mz, 8) of the least majorants of a `majorants.Problem`."""
    corners = np.empty((*problem.cells, 8))
    for alike in product(*(_alike(problem, axis) for axis in range(3))):
        cells, extents = zip(*alike, strict=True)
        nodes = _node_values(problem, cells, extents)
        weights = _corner_weights(extents)
        least = np.empty((len(nodes), 8))
        step = max(1, _BATCH // nodes.shape[1])
        for first in range(0, len(nodes), step):
            batch = slice(first, first + step)
            least[batch] = _least_corners(nodes[batch].astype(float), weights)
        corners[np.ix_(*cells)] = least.reshape(*map(len, cells), 8)
    return corners


def _alike(problem: Problem, axis: int) -> list[tuple[Integers, int]]:
    """[(super-voxels, their fine cells)] along an axis: the whole ones, then the cut one."""
    whole, rest = divmod(problem.fine[axis], problem.size)
    alike = [(np.arange(whole), problem.size), (np.array([whole]), rest)]
    return [(cells, extent) for cells, extent in alike if len(cells) and extent]


def _node_values(problem: Problem, cells: Sequence[Integers], extents: Sequence[int]) -> Floats:
    """(cells, nodes) of the super-voxels at `cells`, a triple of indices; z fastest in both."""
    values = problem.values
    for axis, (index, extent) in enumerate(zip(cells, extents, strict=True)):
        begin = index[:, None] * problem.size
        node = np.arange(extent + 1)
        if problem.blocky:
            below, above = np.maximum(node - 1, 0), np.minimum(node, extent - 1)
            values = np.maximum(
                values.take((begin + below).ravel(), axis),
                values.take((begin + above).ravel(), axis),
            )
        else:
            values = values.take((begin + node).ravel(), axis)
    split = [n for i, e in zip(cells, extents, strict=True) for n in (len(i), e + 1)]
    values = values.reshape(split).transpose(0, 2, 4, 1, 3, 5)
    return values.reshape(int(np.prod(split[::2])), -1)


def _corner_weights(extents: Sequence[int]) -> Floats:
    """(nodes, 8): the weight of each corner in a trilinear function at each node."""
    x, y, z = (np.stack([1 - t, t]) for t in (np.arange(e + 1) / e for e in extents))
    return np.einsum("ai,bj,ck->ijkabc", x, y, z).reshape(-1, 8)


def _least_corners(nodes: Floats, weights: Floats) -> Floats:
    """(cells, 8): corner values of the least trilinear functions above `nodes` (cells, nodes).

    This is the dual simplex method. The basis of each cell is 8 nodes at which its function equals
    their values, at first the corners. The node farthest above the function enters the basis, and
    the one whose share in the dual objective would turn negative first leaves it. The mean of the
    function never decreases and never exceeds the optimum. Raised by its largest violation, the
    function is a majorant.
    """
    best = np.empty((len(nodes), 8))
    least = np.full(len(nodes), np.inf)
    at_corner = np.argmax(weights, axis=0)
    going = np.arange(len(nodes))
    corners = nodes[:, at_corner]
    inverse = np.tile(np.eye(8), (len(nodes), 1, 1))  # from values at the 8 nodes to corner values
    share = np.ones((len(nodes), 8))
    for _ in range(EXCHANGES + 1):
        missing = nodes - corners @ weights.T
        worst = missing.argmax(axis=1)
        excess = np.maximum(missing[np.arange(len(nodes)), worst], 0)
        mean = corners.mean(axis=1)
        better = mean + excess < least[going]
        least[going[better]] = (mean + excess)[better]
        best[going[better]] = (corners + excess[:, None])[better]

        on = excess > TOLERANCE * mean
        if not on.any():
            break
        state: list[Any] = [going, nodes, corners, inverse, share, excess, worst]
        going, nodes, corners, inverse, share, excess, worst = (values[on] for values in state)
        entering = np.einsum("ci,cik->ck", weights[worst], inverse)
        usable = entering > SMALLEST_PIVOT  # at least one is: they sum to 1
        ratio = np.where(usable, share / np.where(usable, entering, 1), np.inf)
        leaving, step = ratio.argmin(axis=1), ratio.min(axis=1)
        row = np.arange(len(nodes))
        column = inverse[row, :, leaving] / entering[row, leaving, None]
        corners = corners + column * excess[:, None]
        inverse -= column[:, :, None] * entering[:, None, :]
        inverse[row, :, leaving] = column
        share = np.maximum(share - step[:, None] * entering, 0)
        share[row, leaving] = step
    return best
