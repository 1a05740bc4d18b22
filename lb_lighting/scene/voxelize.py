# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles onto the lattice: their surface area, and the space that they enclose."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import openvdb

from ..errors import SceneError

BATCH = 1 << 19  # triangles handled at once: many with the same number of samples, little memory
CACHED, SAMPLES = 1 << 13, 1 << 15  # triangles, and samples, that the processor's cache holds
LARGE = 8  # voxels: triangles with longer edges are halved first, to drop what lies outside
SAMPLES_PER_VOXEL = 4  # along a line
SAMPLES_OF_WALLS = 32  # so that no hole is taken for one
GOLDEN = (1 + 5**0.5) / 2
# Level sets in lattices this many times finer than the domain. A hole is closed once a voxel is
# larger than it, so the coarse ones are for meshes that are not quite tight.
REFINEMENTS = (2, 1, 1 / 2, 1 / 4)
FLAT = 1e-6  # volume over extent cubed: what float32 makes of none
LEAKED = -1e-3  # voxels: a level set that leaks has no distance below zero but rounding
# Area of a surface's holes over its own, up to which it is closed. A hole is a disc with the open
# edges around it: so a flat sheet has 1 or more, and a long pipe, which light crosses twice, less.
OPEN = 0.25
FARTHEST = 1e15  # m: what is farther away, or larger, is taken for infinite
BEHIND = 1e-4  # voxels: how far behind its front a sheet is put, where two voxels could have it


@dataclass(frozen=True)
class Faces:
    """The triangles of one slot of a mesh, where an object has them in the world.

    mesh      a `Mesh`, see meshes.py
    matrices  (k, 4, 4), the mesh's space to world space, for each time that it is there
    name      of the object
    """

    mesh: object
    slot: int
    matrices: np.ndarray
    name: str

    @cached_property
    def triangles(self):
        """(n, 3, 3) m, float64: triangle, corner, coordinate.

        Raises SceneError for vertices that are not finite.
        """
        own = self.mesh.points[self.mesh.corners[self._own]].astype(float)
        return _placed(own, self.matrices, self.name)

    @cached_property
    def closed(self):
        """(n,) bool, see `closed_triangles`."""
        return np.tile(self.mesh.closed[self._own], len(self.matrices))

    @property
    def area(self):
        """m^2, of one side."""
        return area_of(self.triangles)

    @property
    def dimensions(self):
        """How many dimensions are left of the mesh's space where it is scaled least to nothing."""
        axes = self.matrices[:, :3, :3]
        size = np.linalg.norm(axes, axis=(1, 2))
        if np.any(np.abs(np.linalg.det(axes)) > 1e-6 * size**3):  # quick, where there are many
            return 3
        return int(np.linalg.matrix_rank(axes.astype(np.float32)).max())

    def refuse_broken(self, dimensions=2):
        """SceneError for a mesh that has no place in the world, or fewer `dimensions` than that."""
        if self.mesh.fault:
            raise SceneError(f"'{self.name}' has {self.mesh.fault}.")
        if not is_finite(self.matrices):
            raise SceneError(
                f"'{self.name}' is placed by a transform that is not finite; clear its location, "
                "rotation and scale, and those of its instances."
            )
        if self.dimensions < dimensions:
            along = "" if dimensions == 2 else " along an axis"
            raise SceneError(f"'{self.name}' is scaled to nothing{along}; give it a size.")

    @property
    def _own(self):
        return self.mesh.slot == self.slot


def is_finite(values):
    """Whether all of the lengths `values`, m, are finite and in reach."""
    return bool(np.all(np.abs(values) < FARTHEST))  # NaN is not


def world_bounds(faces):
    """(lower, upper), each (3,) m, of all triangles; SceneError where there are none."""
    corners = [some.triangles.reshape(-1, 3) for some in faces]
    if not sum(map(len, corners)):
        raise SceneError("The selection has no faces; select a mesh that has some.")
    return (
        np.min([c.min(axis=0) for c in corners if len(c)], axis=0),
        np.max([c.max(axis=0) for c in corners if len(c)], axis=0),
    )


def area_of(triangles):
    """m^2, of one side of triangles (n, 3, 3)."""
    return _areas(triangles.T).sum()


def longest_edge(triangles):
    """m, of triangles (n, 3, 3)."""
    return _lengths(_edges(triangles.T)).max()


def surface_area(triangles, domain, weight=None, samples=SAMPLES_PER_VOXEL):
    """(nx, ny, nz) m^2, float64: the area of the surface (both sides counted once) in each voxel.

    triangles  (n, 3, 3) m, world space
    weight     (n,), factor on the area of each triangle, or None for 1
    samples    along a line as long as a voxel
    Each triangle is sampled at points that fill it evenly, close beside a voxel, and that share
    its area. What lies outside of the domain is dropped.
    """
    weight = np.ones(len(triangles)) if weight is None else weight
    area = np.zeros(np.add(domain.shape, 2))  # a layer around the lattice takes what lies outside
    pending = _batches(BATCH, triangles, weight)
    while pending:
        batch, factor = pending.pop()
        near, edge, size = _measured(batch, domain)
        large, small = near & (edge > LARGE), near & (edge <= LARGE)
        pending += _batches(BATCH, _halves(batch[large]), np.tile(factor[large], 2))
        count = _sample_counts(edge[small], size[small], samples)
        _add_areas(area, batch[small], (size * factor)[small], count, domain)
    return area[1:-1, 1:-1, 1:-1] * domain.voxel_size**2


def foliage_density(faces, domain, direction=None):
    """(nx, ny, nz) 1/m: the extinction coefficient of opaque leaves.

    faces      `Faces`
    direction  (3,), unit vector along which the light travels, or None for the mean over all

    A leaf of area A and normal n shows A |n . direction|, which is A/2 on average over its
    orientations (Ross, The Radiation Regime and Architecture of Plant Stands, 1981). A closed body,
    such as wood, shows half of that, because light meets two of its faces where it could meet one.
    """
    shown = 0.5 if direction is None else np.abs(_normals(faces.triangles) @ direction)
    weight = shown * np.where(faces.closed, 0.5, 1.0)
    return surface_area(faces.triangles, domain, weight) / domain.voxel_size**3


def opaque_share(triangles, closed, domain):
    """(nx, ny, nz), 0 to 1: the share of the light that comes to a voxel which the surface stops.

    triangles  (n, 3, 3) m, world space
    closed     (n,) bool, see `closed_triangles`

    It is at least the share of the voxel inside of closed bodies. Where one is much thinner than a
    voxel, a surface S shows S/4 on average of the 6 h^2/4 that the voxel shows. An open sheet
    shows its whole area to light that faces it; so a wall across a voxel stops all, and the voxel
    is that behind the wall's front where it lies between two.
    """
    body = triangles[closed]
    solid = _inside(body, domain)
    claimed = _enclosed_volume(body) if _lies_in(body, domain) else 0.0
    if solid.sum() * domain.voxel_size**3 < claimed / 2:
        # Either it is thinner than a voxel, or its holes let the inside out: then it is walls.
        closed = closed & (4 * claimed / area_of(body) < domain.voxel_size)  # the width of a rod
        solid = 0.0
    behind = triangles - BEHIND * domain.voxel_size * _normals(triangles)[:, None]
    shown = surface_area(behind, domain, np.where(closed, 1 / 6, 1.0), SAMPLES_OF_WALLS)
    return np.maximum(solid, np.minimum(shown / domain.voxel_size**2, 1)).astype(np.float32)


def solid_fraction(triangles, domain):
    """(nx, ny, nz), 0 to 1: the share of each voxel that is inside the closed surface.

    triangles  (n, 3, 3) m, world space; the shells may overlap, and holes up to about four
               voxels are closed
    Raises SceneError where the surface encloses nothing.
    """
    fraction = _enclosed_fraction(triangles, domain)
    if fraction is not None:
        return fraction
    if _enclosed_volume(triangles) <= FLAT * np.ptp(triangles, axis=(0, 1)).max() ** 3:
        raise SceneError("The mesh is flat; give it a thickness, or light it as foliage instead.")
    raise SceneError(
        "The mesh is not closed, or it is thinner than a voxel; fill its holes, raise the "
        "resolution, or light it as foliage instead."
    )


def _enclosed_fraction(triangles, domain):
    """What `solid_fraction` returns, or None where the surface encloses nothing."""
    if not np.any(_touches(_corners(triangles, domain), domain.shape)):
        return np.zeros(domain.shape, np.float32)
    # Reaching only half of the volume that the faces claim means that a part has leaked.
    least = _enclosed_volume(triangles) / 2 if _lies_in(triangles, domain) else 0
    for refinement in REFINEMENTS:
        fraction, closed = _level_set_fraction(triangles, domain, refinement)
        if closed and fraction.sum() * domain.voxel_size**3 >= least:
            return fraction
    return None


def closed_triangles(points, corners):
    """(n,) bool: is each of a surface with small holes at most?

    points   (vertices, 3) m
    corners  (n, 3), the vertices of each triangle
    """
    low, high = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).T
    edges, uses = np.unique(low.astype(np.int64) * len(points) + high, return_counts=True)
    # An edge between two triangles is used twice.
    rims = np.stack(np.divmod(edges[uses == 1], len(points)), axis=1)
    piece, rim = _pieces(corners, len(points)), _pieces(rims, len(points))
    length = np.linalg.norm(points[rims[:, 0]] - points[rims[:, 1]], axis=1)
    around = np.bincount(rim[rims[:, 0]], length, len(points))
    holes = np.bincount(piece, around**2 / (4 * np.pi), len(points))
    area = np.bincount(piece[corners[:, 0]], _areas(points[corners].T), len(points))
    return (holes < OPEN * area)[piece[corners[:, 0]]]


def _pieces(corners, count):
    """(count,): for each vertex the least one that `corners` (n, 2 or 3) connect it to."""
    piece = np.arange(count)
    while True:
        least = piece[corners].min(axis=1, keepdims=True)
        joined = piece.copy()
        np.minimum.at(joined, piece[corners], least)
        joined = joined[joined]
        if np.array_equal(joined, piece):
            return piece
        piece = joined


def _placed(triangles, matrices, name):
    """`triangles` (n, 3, 3) once for each of the `matrices` (k, 4, 4): (k n, 3, 3)."""
    rotated = triangles.reshape(-1, 3) @ matrices[:, :3, :3].swapaxes(1, 2)
    placed = (rotated + matrices[:, None, :3, 3]).reshape(-1, 3, 3)
    if not np.all(np.isfinite(placed)):
        raise SceneError(f"'{name}' has vertices that are not finite; repair or delete them.")
    return placed


def _batches(size, *arrays):
    """[(some of each of the `arrays`)]: as many rows as `size` at once."""
    return [tuple(a[i : i + size] for a in arrays) for i in range(0, len(arrays[0]), size)]


def _corners(triangles, domain):
    """Triangles (n, 3, 3) m in voxels, as (3, 3, n): coordinate, corner, triangle.

    So NumPy runs along triangles. Voxel (i, j, k) spans i to i + 1.
    """
    corners = np.ascontiguousarray(triangles.T) - np.reshape(domain.origin, (3, 1, 1))
    corners /= domain.voxel_size
    return corners


def _touches(corners, shape):
    """(n,) bool: does the bounding box of `_corners` meet the lattice?"""
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    return np.all((upper >= 0) & (lower <= np.reshape(shape, (3, 1))), axis=0)


def _edges(corners):
    """(3, 3, n): edge k of `_corners` runs from corner k to the next."""
    return np.roll(corners, -1, axis=1) - corners


def _lengths(vectors):
    """(...), of vectors (3, ...), in their unit."""
    x, y, z = vectors
    return np.sqrt(x * x + y * y + z * z)


def _across(corners):
    """(3, n): the vectors across `_corners`, twice as long as the triangles have area."""
    edges = _edges(corners)
    return np.cross(edges[:, 0], edges[:, 1], axis=0)


def _areas(corners):
    """(n,), in the square of their unit."""
    return _lengths(_across(corners)) / 2


def _normals(triangles):
    """(n, 3) unit vectors across the triangles (n, 3, 3); 0 for those without area."""
    across = _across(triangles.T)
    length = _lengths(across)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0).T


def _measured(triangles, domain):
    """(near, edge, size), each (n,), of triangles (n, 3, 3) m.

    near  bool, whether it may meet the lattice
    edge  voxels, the longest
    size  squared voxels, the area
    """
    near, edge, size = np.empty(len(triangles), bool), *np.empty((2, len(triangles)))
    for some, own_near, own_edge, own_size in _batches(CACHED, triangles, near, edge, size):
        corners = _corners(some, domain)
        own_near[:] = _touches(corners, domain.shape)
        own_edge[:] = _lengths(_edges(corners)).max(axis=0)
        own_size[:] = _areas(corners)
    return near, edge, size


def _halves(triangles):
    """(2 n, 3, 3): each triangle cut from the middle of its longest edge to the corner opposite."""
    longest = _lengths(_edges(triangles.T)).argmax(axis=0)
    corner = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, corner[..., None], axis=1), 1, 0)
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _sample_counts(edge, size, samples):
    """(n,), of triangles with these longest edges, voxels, and areas, squared voxels.

    That is about how many squares they touch of which `samples` fit along a voxel.
    """
    # Rounded up to five binary digits, so that many triangles have the same.
    touched = np.ceil(samples**2 * size + samples * edge)
    fraction, exponent = np.frexp(np.maximum(1, touched))
    return np.ldexp(np.ceil(32 * fraction), exponent - 5).astype(np.int64)


def _add_areas(area, triangles, value, count, domain):
    """Add `value` (n,), squared voxels, of triangles (n, 3, 3) m to `area` at `count` (n,) points.

    area  (nx + 2, ny + 2, nz + 2), the lattice with a layer around it
    """
    # Those with as many points together, and along x, so that the cache holds their voxels.
    x = (triangles[:, 0, 0] - domain.origin[0]) / domain.voxel_size
    order = np.argsort(count * area.shape[0] + x.clip(0, domain.shape[0]).astype(np.int64))
    triangles, share, count = triangles.take(order, axis=0), (value / count)[order], count[order]
    starts = np.flatnonzero(np.diff(count, prepend=0))
    for start, stop in pairwise([*starts, len(count)]):
        points = _points_within(count[start])
        size = max(1, SAMPLES // count[start])
        for some, each in _batches(size, triangles[start:stop], share[start:stop]):
            _add_samples(area, _corners(some, domain), points, each)


def _points_within(count):
    """(3, count): barycentric coordinates of points that fill a triangle evenly.

    A Fibonacci lattice stays even however a triangle stretches it (H. Niederreiter, Random Number
    Generation and Quasi-Monte Carlo Methods, 1992, on Kronecker sequences). Its rows have equal
    areas, and become longer away from the first corner; its mean is the triangle's centre.
    """
    edges = np.arange(count + 1) / count
    length = 2 / 3 * count * np.diff(edges**1.5)  # of a row at its centre of mass
    along = (0.5 + np.arange(count) / GOLDEN) % 1
    along = np.clip(along + 0.5 - length @ along / length.sum(), 0, 1)
    return np.stack([1 - length, length * (1 - along), length * along])


def _add_samples(area, corners, points, share):
    """Add the `share` (n,) of each of the `points` (3, k) within triangles to `area`.

    area     (nx + 2, ny + 2, nz + 2), the lattice with a layer around it
    corners  (3, 3, n), see `_corners`
    """
    # From the first corner on, so that a face along the lattice stays on its side of the voxels.
    edges = corners[:, 1:] - corners[:, :1]
    voxel = np.floor(edges.swapaxes(1, 2) @ points[1:] + corners[:, 0, :, None])  # (3, n, k)
    inner = np.reshape(area.shape, (3, 1, 1)) - 2
    if corners.min() < 0 or np.any(corners >= inner):
        voxel = voxel.clip(-1, inner)
    strides = np.divide(area.strides, area.itemsize)
    flat = (strides @ voxel.reshape(3, -1) + strides.sum()).astype(np.intp)
    np.add.at(area.reshape(-1), flat, share.repeat(points.shape[1]))


def _enclosed_volume(triangles):
    """m^3, by the divergence theorem about the mesh's middle, where small holes matter least."""
    if not len(triangles):
        return 0.0
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    return abs(np.einsum("ni,ni->", a, np.cross(b, c))) / 6


def _level_set_fraction(triangles, domain, refinement):
    """(fraction by voxel of `domain`, was an inside found) from a level set of another fineness."""
    cells = _distances(triangles, domain, refinement)
    closed = bool(cells.min() < LEAKED)
    # The share of a cell beyond a plane at this distance: exact for planes along the lattice.
    inside = np.clip(0.5 - cells, 0, 1)
    return _refitted(inside, refinement, domain.shape), closed


def _inside(triangles, domain):
    """(nx, ny, nz), 0 to 1: of eight points in each voxel, how many the surface encloses.

    It is right on average even for twigs, of which `_level_set_fraction` makes branches.
    """
    if not len(triangles) or not np.any(_touches(_corners(triangles, domain), domain.shape)):
        return np.zeros(domain.shape)
    return _refitted(_distances(triangles, domain, 2) < LEAKED, 2, domain.shape)


def _distances(triangles, domain, refinement):
    """Signed distances to the surface, in cells, of a lattice so many times finer than `domain`."""
    points = (domain.to_index(triangles) + 0.5) * refinement - 0.5
    distance = openvdb.FloatGrid.createLevelSetFromPolygons(
        points.reshape(-1, 3).astype(np.float32),
        triangles=np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3),
        transform=openvdb.createLinearTransform(1.0),
        halfWidth=2.0,
    )
    cells = np.empty(np.ceil(np.multiply(domain.shape, refinement)).astype(int), np.float32)
    distance.copyToArray(cells)
    return cells


def _lies_in(triangles, domain):
    return np.all(triangles >= domain.origin) and np.all(triangles <= domain.upper)


def _refitted(cells, refinement, shape):
    """`cells` averaged or repeated onto `shape`, which is `refinement` times coarser."""
    if refinement >= 1:
        n = int(refinement)
        return cells.reshape(shape[0], n, shape[1], n, shape[2], n).mean(axis=(1, 3, 5))
    for axis in range(3):
        cells = cells.repeat(round(1 / refinement), axis=axis)
    return cells[tuple(map(slice, shape))]
