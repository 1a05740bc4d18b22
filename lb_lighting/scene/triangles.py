# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry of many triangles at once: edges, areas, normals, closed surfaces.

Corners are arrays (3, 3, n): coordinate, corner, triangle. NumPy then runs along the triangles.
"""

import numpy as np

from ..arrays import Booleans, Floats, Integers
from ..transport.medium import Domain

# Area of the holes of a surface over its own area, up to which the surface counts as closed. A hole
# is a disc whose rim is as long as the open edges. So a flat sheet has 1 or more, and a long pipe,
# which light crosses twice, has less.
OPEN = 0.25
FARTHEST = 1e15  # m: greater distances and sizes count as infinite


def is_finite(values: Floats) -> bool:
    """Whether all the lengths `values`, m, are finite and less than FARTHEST."""
    return bool(np.all(np.abs(values) < FARTHEST))  # false for NaN


def area_of(triangles: Floats) -> float:
    """m^2, the total area of one side of the triangles (n, 3, 3)."""
    return float(areas(triangles.T).sum())


def longest_edge(triangles: Floats) -> float:
    """m, of the triangles (n, 3, 3)."""
    return float(lengths(edges(triangles.T)).max())


def edges(corners: Floats) -> Floats:
    """(3, 3, n): edge k runs from corner k to the next."""
    return np.roll(corners, -1, axis=1) - corners


def lengths(vectors: Floats) -> Floats:
    """(...): the lengths of the vectors (3, ...)."""
    x, y, z = vectors
    length: Floats = np.sqrt(x * x + y * y + z * z)
    return length


def areas(corners: Floats) -> Floats:
    """(n,): the areas of the triangles with these corners."""
    return lengths(_area_vectors(corners)) / 2


def normals(triangles: Floats) -> Floats:
    """(n, 3): the unit normals of the triangles (n, 3, 3); 0 for those without area."""
    across = _area_vectors(triangles.T)
    length = lengths(across)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0).T


def _area_vectors(corners: Floats) -> Floats:
    """(3, n): normal vectors whose length is twice the area of the triangle."""
    sides = edges(corners)
    return np.cross(sides[:, 0], sides[:, 1], axis=0)


def in_voxels(triangles: Floats, domain: Domain) -> Floats:
    """(3, 3, n) voxels: the corners of the triangles (n, 3, 3) m; voxel i spans from i to i + 1."""
    corners = np.ascontiguousarray(triangles.T) - np.reshape(domain.origin, (3, 1, 1))
    corners /= domain.voxel_size
    return corners


def touches(corners: Floats, shape: tuple[int, ...]) -> Booleans:
    """(n,) bool: whether the bounding box of each triangle meets the lattice of this `shape`.

    corners  see `in_voxels`
    """
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    meets: Booleans = np.all((upper >= 0) & (lower <= np.reshape(shape, (3, 1))), axis=0)
    return meets


def halves(triangles: Floats) -> Floats:
    """(2 n, 3, 3): the triangles, cut from the middle of their longest edge to the other corner."""
    longest = lengths(edges(triangles.T)).argmax(axis=0)
    corner = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, corner[..., None], axis=1), 1, 0)
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def enclosed_volume(triangles: Floats) -> float:
    """m^3, by the divergence theorem about the mean of the corners, where small holes matter least.

    triangles  (n, 3, 3) m
    """
    if not len(triangles):
        return 0.0
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    return float(abs(np.einsum("ni,ni->", a, np.cross(b, c))) / 6)


def closed_triangles(points: Floats, corners: Integers) -> Booleans:
    """(n,) bool: whether each triangle belongs to a surface with at most small holes.

    points   (vertices, 3) m
    corners  (n, 3), the vertices of each triangle
    """
    # Find the open edges: those that only one triangle uses.
    low, high = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).T
    edge, uses = np.unique(low.astype(np.int64) * len(points) + high, return_counts=True)
    rims = np.stack(np.divmod(edge[uses == 1], len(points)), axis=1)
    # Group the triangles into surfaces, and the open edges into rims of holes.
    surface, rim = _connected(corners, len(points)), _connected(rims, len(points))
    # Compare the area of the holes with that of the surface.
    length = np.linalg.norm(points[rims[:, 0]] - points[rims[:, 1]], axis=1)
    perimeter = np.bincount(rim[rims[:, 0]], length, len(points))
    holes = np.bincount(surface, perimeter**2 / (4 * np.pi), len(points))
    area = np.bincount(surface[corners[:, 0]], areas(points[corners].T), len(points))
    is_closed: Booleans = holes < OPEN * area
    return is_closed[surface[corners[:, 0]]]


def _connected(corners: Integers, count: int) -> Integers:
    """(count,): for each vertex, the lowest vertex that it is connected to.

    corners  (n, 2 or 3), groups of connected vertices
    """
    lowest = np.arange(count)
    while True:
        of_group = lowest[corners].min(axis=1, keepdims=True)
        joined = lowest.copy()
        np.minimum.at(joined, lowest[corners], of_group)
        joined = joined[joined]
        if np.array_equal(joined, lowest):
            return lowest
        lowest = joined
