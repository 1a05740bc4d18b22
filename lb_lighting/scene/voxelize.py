# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces on the lattice: their area in each voxel, as foliage and as occluders."""

from itertools import pairwise
from typing import Any

import numpy as np

from ..arrays import Array, Booleans, Floats, Integers
from ..transport.medium import Domain
from .enclosure import enclosed_points, lies_in
from .meshes import Faces
from .triangles import (
    area_of,
    areas,
    edges,
    enclosed_volume,
    halves,
    in_voxels,
    lengths,
    normals,
    touches,
)

BATCH = 1 << 19  # triangles at a time: many have the same number of samples, and memory stays low
CACHED, SAMPLES = 1 << 13, 1 << 15  # triangles, and samples, that fit into the processor's cache
LARGE = 8  # voxels: triangles with longer edges are halved first, to drop the parts outside
SAMPLES_PER_VOXEL = 4  # along a line
SAMPLES_OF_WALLS = 32  # enough to leave no holes in a wall
GOLDEN = (1 + 5**0.5) / 2
BEHIND = 1e-4  # voxels: the distance that a sheet is moved back, for sheets between two voxels


def surface_area(
    triangles: Floats,
    domain: Domain,
    weight: Floats | None = None,
    samples: int = SAMPLES_PER_VOXEL,
) -> Floats:
    """(nx, ny, nz) m^2, float64: the area of one side of the surface in each voxel.

    triangles  (n, 3, 3) m, world space
    weight     (n,), factor on the area of each triangle, or None for 1
    samples    along a line as long as a voxel
    Evenly distributed points, much closer than voxels, share the area of their triangle. The area
    outside of the domain is dropped.
    """
    weight = np.ones(len(triangles)) if weight is None else weight
    area = np.zeros(np.add(domain.shape, 2))  # a layer around the lattice takes the area outside
    pending = _batches(BATCH, triangles, weight)
    while pending:
        batch, factor = pending.pop()
        near, edge, size = _measured(batch, domain)
        large, small = near & (edge > LARGE), near & (edge <= LARGE)
        pending += _batches(BATCH, halves(batch[large]), np.tile(factor[large], 2))
        count = _sample_counts(edge[small], size[small], samples)
        _add_areas(area, batch[small], (size * factor)[small], count, domain)
    return area[1:-1, 1:-1, 1:-1] * domain.voxel_size**2


def foliage_density(faces: Faces, domain: Domain, direction: Floats | None = None) -> Floats:
    """(nx, ny, nz) 1/m: the extinction coefficient of opaque leaves.

    direction  (3,), unit vector along which the light travels, or None for the mean over all

    A leaf of area A and normal n has a projected area of A |n . direction|, on average A/2 (Ross,
    The Radiation Regime and Architecture of Plant Stands, 1981). A closed body, such as wood,
    counts half as much, because light crosses two of its faces where it would cross one leaf.
    """
    projected = 0.5 if direction is None else np.abs(normals(faces.triangles) @ direction)
    weight = projected * np.where(faces.closed, 0.5, 1.0)
    return surface_area(faces.triangles, domain, weight) / domain.voxel_size**3


def opaque_share(triangles: Floats, closed: Booleans, domain: Domain) -> Floats:
    """(nx, ny, nz), 0 to 1: the share of the light entering a voxel that the surface stops.

    triangles  (n, 3, 3) m, world space
    closed     (n,) bool, see `closed_triangles`

    It is at least the share of the voxel inside closed bodies. A body much thinner than a voxel,
    with a surface S, has a mean projected area of S/4; the voxel's is 6 h^2/4. An open sheet
    counts with its whole area, for light that faces it. So a wall across a voxel stops all light,
    and a wall between two voxels lies in the one behind its front.
    """
    # Fill closed bodies.
    body = triangles[closed]
    solid: Floats | float = enclosed_points(body, domain)
    claimed = enclosed_volume(body) if lies_in(body, domain) else 0.0
    # Treat them as surfaces if they are thinner than a voxel, or leak through holes.
    if np.sum(solid) * domain.voxel_size**3 < claimed / 2:
        is_thin = 4 * claimed / area_of(body) < domain.voxel_size  # the diameter of a rod
        closed = closed & is_thin
        solid = 0.0
    # Add the projected areas of the surfaces.
    behind = triangles - BEHIND * domain.voxel_size * normals(triangles)[:, None]
    area = surface_area(behind, domain, np.where(closed, 1 / 6, 1.0), SAMPLES_OF_WALLS)
    share: Floats = np.maximum(solid, np.minimum(area / domain.voxel_size**2, 1))
    return share.astype(np.float32)


def _batches(size: int, *arrays: Array) -> list[tuple[Any, ...]]:
    """The `arrays` in batches of up to `size` rows: one part of each array in each batch."""
    return [tuple(a[i : i + size] for a in arrays) for i in range(0, len(arrays[0]), size)]


def _measured(triangles: Floats, domain: Domain) -> tuple[Booleans, Floats, Floats]:
    """(near, edge, size), each (n,), of triangles (n, 3, 3) m.

    near  bool, whether the triangle may meet the lattice
    edge  voxels, the longest edge
    size  squared voxels, the area
    """
    near, edge, size = np.empty(len(triangles), bool), *np.empty((2, len(triangles)))
    for batch, batch_near, batch_edge, batch_size in _batches(CACHED, triangles, near, edge, size):
        corners = in_voxels(batch, domain)
        batch_near[:] = touches(corners, domain.shape)
        batch_edge[:] = lengths(edges(corners)).max(axis=0)
        batch_size[:] = areas(corners)
    return near, edge, size


def _sample_counts(edge: Floats, size: Floats, samples: int) -> Integers:
    """(n,): about how many squares each triangle touches, of which `samples` fit along a voxel.

    edge, size  (n,), see `_measured`
    """
    # Rounded up to five binary digits, so that many triangles have the same count.
    touched = np.ceil(samples**2 * size + samples * edge)
    fraction, exponent = np.frexp(np.maximum(1, touched))
    counts: Integers = np.ldexp(np.ceil(32 * fraction), exponent - 5).astype(np.int64)
    return counts


def _add_areas(
    area: Floats, triangles: Floats, value: Floats, count: Integers, domain: Domain
) -> None:
    """Add `value` (n,), squared voxels, of triangles (n, 3, 3) m to `area` at `count` (n,) points.

    area  (nx + 2, ny + 2, nz + 2), the lattice with a layer around it
    """
    # Sort by the number of points, then along x, so that the voxels stay in the cache.
    x = (triangles[:, 0, 0] - domain.origin[0]) / domain.voxel_size
    order = np.argsort(count * area.shape[0] + x.clip(0, domain.shape[0]).astype(np.int64))
    triangles, share, count = triangles.take(order, axis=0), (value / count)[order], count[order]
    starts = np.flatnonzero(np.diff(count, prepend=0))
    # Add the triangles that have the same number of points.
    for start, stop in pairwise([*starts, len(count)]):
        points = _points_within(count[start])
        size = max(1, SAMPLES // count[start])
        for batch, shares in _batches(size, triangles[start:stop], share[start:stop]):
            _add_samples(area, in_voxels(batch, domain), points, shares)


def _points_within(count: int) -> Floats:
    """(3, count): barycentric coordinates of points that fill a triangle evenly.

    A Fibonacci lattice stays even under any affine map (H. Niederreiter, Random Number Generation
    and Quasi-Monte Carlo Methods, 1992, on Kronecker sequences). Its rows have equal areas, and
    lengthen away from the first corner; its mean is the centre of the triangle.
    """
    steps = np.arange(count + 1) / count
    length = 2 / 3 * count * np.diff(steps**1.5)  # of a row, at its centre of mass
    along = (0.5 + np.arange(count) / GOLDEN) % 1
    along = np.clip(along + 0.5 - length @ along / length.sum(), 0, 1)
    return np.stack([1 - length, length * (1 - along), length * along])


def _add_samples(area: Floats, corners: Floats, points: Floats, share: Floats) -> None:
    """Add the `share` (n,) of each point within the triangles to `area`.

    area     (nx + 2, ny + 2, nz + 2), the lattice with a layer around it
    corners  (3, 3, n), see `in_voxels`
    points   (3, k), see `_points_within`
    """
    # Start from the first corner, so that a face along the lattice stays on its side of the voxels.
    sides = corners[:, 1:] - corners[:, :1]
    voxel = np.floor(sides.swapaxes(1, 2) @ points[1:] + corners[:, 0, :, None])  # (3, n, k)
    inner = np.reshape(area.shape, (3, 1, 1)) - 2
    if corners.min() < 0 or np.any(corners >= inner):
        voxel = voxel.clip(-1, inner)
    strides = np.divide(area.strides, area.itemsize)
    flat = (strides @ voxel.reshape(3, -1) + strides.sum()).astype(np.intp)
    np.add.at(area.reshape(-1), flat, share.repeat(points.shape[1]))
