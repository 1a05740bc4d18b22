# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflection where light leaves a medium and cannot return (docs/theory/physics.md)."""

from typing import Any

import numpy as np

from ...arrays import Array, Booleans, Floats, Integers
from .layout import (
    MEAN_LENGTH,
    MOVING,
    THROUGH,
    WEIGHTS,
    Cells,
    parts,
)

_EXTRAPOLATED = 2 / 3  # extrapolation length, in transport mean free paths
_OUTWARD = float(WEIGHTS[MOVING[:, 0] > 0].sum())
_SLOPE = 6 * _EXTRAPOLATED * _OUTWARD / MEAN_LENGTH
REFLECTED = (_SLOPE - 1) / (_SLOPE + 1)
"""The share of light that an open face of a scattering medium reflects (negative: more leaves).
It sets the distance at which the fluence extrapolates to zero."""


def returned(depth: Floats, albedo: float, g: float, edge: float | None = None) -> Floats:
    """(nx, ny, nz): the share of light that an open face of each voxel reflects.

    It is `REFLECTED` where a domain filled with the voxel's matter would be thick, and 0 in empty
    voxels: light that leaves there has scattered elsewhere. edge is that of `NumpyLattice`.
    """
    edge = edge or max(depth.shape)
    with np.errstate(divide="ignore", over="ignore"):
        return REFLECTED / (1 + 1 / (edge * depth * (1 - albedo * g)))


def reflection(
    depth: Floats,
    albedo: float,
    g: float,
    occlusion: Floats | None,
    cells: Cells,
    edge: float | None = None,
) -> tuple[Floats, dict[int, tuple[Integers, Floats]]]:
    """(outside, {face: (cells, shares)}): the places where leaving light is reflected.

    edge     that of `NumpyLattice`
    outside  (count,): the share reflected by each cell outside of the domain, the mean over the
             voxels whose light arrives there; 0 inside
    face     0 to 5 for -x, +x, -y, +y, -z, +z: empty cells behind an open face, and the share of
             the light through that face that they reflect
    """
    share, inside = cells.flat(returned(depth, albedo, g, edge)), cells.is_inside()
    # Cells outside of the domain take the mean of the voxels that send light there.
    around = np.flatnonzero(~inside)
    arriving, sources = (
        sum(values.take(around - step, mode="wrap") for step in cells.steps)
        for values in (share, inside.astype(int))
    )
    outside = np.zeros(cells.count)
    outside[around] = arriving / np.maximum(sources, 1)
    # Cells in the domain, behind faces at which the medium ends in a plane.
    faces = cells.flat(open_faces(depth, occlusion))
    within: dict[int, tuple[Integers, Floats]] = {}
    for face, directions in enumerate(THROUGH):
        ahead = cells.steps[directions[0]]  # the first of them is along the axis
        at = np.flatnonzero(np.roll(faces >> face & 1, ahead) * inside)
        within[face] = at, share[at - ahead]
    return outside, within


def open_faces(depth: Floats, occlusion: Floats | None = None) -> Integers:
    """(nx, ny, nz) uint8: a bit for each open face -x, +x, -y, +y, -z, +z of a voxel.

    The medium ends at an open face in a plane, as at the domain's faces: the nine voxels beyond are
    empty, and light that leaves in any of the five directions through the face meets nothing more.
    """
    clear = np.zeros(depth.shape) == (0 if occlusion is None else occlusion)
    empty = clear & (depth == 0)
    free = np.array([_is_free(empty, clear, c) for c in MOVING])
    faces = np.zeros(depth.shape, np.uint8)
    for face, directions in enumerate(THROUGH):
        outward = MOVING[directions[0]]
        nine = empty
        for across in np.eye(3, dtype=int)[outward == 0]:
            nine = nine & _at(nine, across, True) & _at(nine, -across, True)
        ends = _at(nine, outward, True) & free[directions].all(axis=0) & ~empty
        faces |= ends.astype(np.uint8) << face
    return faces


def _is_free(empty: Booleans, clear: Booleans, c: Integers) -> Booleans:
    """(nx, ny, nz): whether light that leaves each voxel along c meets nothing more.

    empty  whether voxels are empty
    clear  whether they hold nothing opaque, which also blocks light beside its way
    """
    free, reach = _at(empty, c, True), 1
    for part in parts(c):
        free &= _at(clear, part, True)
    while reach < max(empty.shape):
        free &= _at(free, reach * c, True)
        reach *= 2
    return free


def _at(values: Array, step: Integers, outside: Any) -> Array:
    """(nx, ny, nz): the value of the voxel that lies a step from each."""
    neighbours = np.full_like(values, outside)
    if np.all(np.abs(step) < values.shape):
        sizes = list(zip(step, values.shape, strict=True))
        here = tuple(slice(max(-d, 0), n - max(d, 0)) for d, n in sizes)
        there = tuple(slice(max(d, 0), n + min(d, 0)) for d, n in sizes)
        neighbours[here] = values[there]
    return neighbours
