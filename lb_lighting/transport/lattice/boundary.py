# SPDX-License-Identifier: GPL-3.0-or-later
"""Where light leaves a medium for good, and how much of it comes back (docs/theory/physics.md)."""

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

_EXTRAPOLATED = 2 / 3  # transport mean free paths outside where the fluence would be zero
_OUTWARD = float(WEIGHTS[MOVING[:, 0] > 0].sum())
_SLOPE = 6 * _EXTRAPOLATED * _OUTWARD / MEAN_LENGTH
REFLECTED = (_SLOPE - 1) / (_SLOPE + 1)
"""The share of light that leaves a scattering medium through an open face and comes back
(negative: more is let out), which sets how far outside the fluence extrapolates to zero."""


def returned(depth: Floats, albedo: float, g: float, edge: float | None = None) -> Floats:
    """(nx, ny, nz), the share of light leaving a voxel through an open face that comes back.

    `REFLECTED` where the domain would be thick if it were filled with what the voxel holds, and
    none where it is empty: what leaves there has scattered elsewhere. edge is that of
    `NumpyLattice`.
    """
    edge = edge or max(depth.shape)
    with np.errstate(divide="ignore", over="ignore"):
        return REFLECTED / (1 + 1 / (edge * depth * (1 - albedo * g)))


def boundary_reflection(
    depth: Floats,
    albedo: float,
    g: float,
    occlusion: Floats | None,
    cells: Cells,
    edge: float | None = None,
) -> tuple[Floats, dict[int, tuple[Integers, Floats]]]:
    """Where light that leaves is reflected: (outside, {face: (cells, shares)}).

    edge is that of `NumpyLattice`.

    outside  (count,), the share in each cell outside of the domain, the mean of those of the voxels
             whose light comes there; 0 inside
    face     0 to 5 for -x, +x, -y, +y, -z, +z: in these empty cells the share of what came through
             that face, an open one, goes back
    """
    share, inside = cells.flat(returned(depth, albedo, g, edge)), cells.is_inside()
    around = np.flatnonzero(~inside)
    arriving, sources = (
        sum(values.take(around - step, mode="wrap") for step in cells.steps)
        for values in (share, inside.astype(int))
    )
    outside = np.zeros(cells.count)
    outside[around] = arriving / np.maximum(sources, 1)
    faces = cells.flat(open_faces(depth, occlusion))
    within: dict[int, tuple[Integers, Floats]] = {}
    for face, directions in enumerate(THROUGH):
        ahead = cells.steps[directions[0]]  # the first of them is along the axis
        at = np.flatnonzero(np.roll(faces >> face & 1, ahead) * inside)
        within[face] = at, share[at - ahead]
    return outside, within


def open_faces(depth: Floats, occlusion: Floats | None = None) -> Integers:
    """(nx, ny, nz) uint8, the bits of the faces -x, +x, -y, +y, -z, +z of a voxel that are open.

    That is where the medium ends in a plane, as it does at the domain's faces: the nine voxels
    beyond are empty, and what leaves in any of the five directions through it meets nothing more.
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
    """(nx, ny, nz), whether what leaves each voxel along c meets nothing more.

    empty  whether voxels hold nothing
    clear  whether they hold nothing opaque, which is met beside the way, too
    """
    free, reach = _at(empty, c, True), 1
    for part in parts(c):
        free &= _at(clear, part, True)
    while reach < max(empty.shape):
        free &= _at(free, reach * c, True)
        reach *= 2
    return free


def _at(values: Array, step: Integers, outside: bool) -> Array:
    """(nx, ny, nz), the values of the voxels that lie a step from each."""
    shifted = np.full_like(values, outside)
    if np.all(np.abs(step) < values.shape):
        sizes = list(zip(step, values.shape, strict=True))
        here = tuple(slice(max(-d, 0), n - max(d, 0)) for d, n in sizes)
        source = tuple(slice(max(d, 0), n + min(d, 0)) for d, n in sizes)
        shifted[here] = values[source]
    return shifted
