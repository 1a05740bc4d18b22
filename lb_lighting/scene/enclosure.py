# SPDX-License-Identifier: GPL-3.0-or-later
"""The share of each voxel inside a closed surface, from level sets of OpenVDB."""

import numpy as np
import openvdb

from ..arrays import Array, Floats
from ..errors import SceneError
from ..transport.medium import Domain
from .triangles import enclosed_volume, in_voxels, touches

# Level sets in lattices this many times finer than the domain. A level set closes holes that are
# smaller than its voxels, so the coarse ones are for meshes that are not quite closed.
REFINEMENTS = (2, 1, 1 / 2, 1 / 4)
FLAT = 1e-6  # volume over extent cubed: the rounding error of float32 for a flat mesh
LEAKED = -1e-3  # voxels: a level set that leaks has negative distances only by rounding


def solid_fraction(triangles: Floats, domain: Domain) -> Floats:
    """(nx, ny, nz), 0 to 1: the share of each voxel inside the closed surface.

    triangles  (n, 3, 3) m, world space; the shells may overlap, and holes up to about four
               voxels are closed
    Raises SceneError if the surface encloses nothing.
    """
    fraction = _enclosed_fraction(triangles, domain)
    if fraction is not None:
        return fraction
    if enclosed_volume(triangles) <= FLAT * np.ptp(triangles, axis=(0, 1)).max() ** 3:
        raise SceneError("The mesh is flat; give it a thickness, or light it as foliage instead.")
    raise SceneError(
        "The mesh is not closed, or it is thinner than a voxel; fill its holes, raise the "
        "resolution, or light it as foliage instead."
    )


def enclosed_points(triangles: Floats, domain: Domain) -> Floats:
    """(nx, ny, nz), 0 to 1: the share of eight points in each voxel that the surface encloses.

    It is right on average even for twigs, which `solid_fraction` thickens to branches.
    """
    if not len(triangles) or not np.any(touches(in_voxels(triangles, domain), domain.shape)):
        return np.zeros(domain.shape)
    return _resampled(_distances(triangles, domain, 2) < LEAKED, 2, domain.shape)


def lies_in(triangles: Floats, domain: Domain) -> bool:
    """Whether all the triangles (n, 3, 3) m lie in the domain."""
    return bool(np.all(triangles >= domain.origin) and np.all(triangles <= domain.upper))


def _enclosed_fraction(triangles: Floats, domain: Domain) -> Floats | None:
    """The result of `solid_fraction`, or None if the surface encloses nothing."""
    if not np.any(touches(in_voxels(triangles, domain), domain.shape)):
        return np.zeros(domain.shape, np.float32)
    # Less than half of the volume that the faces enclose means that a part has leaked.
    least = enclosed_volume(triangles) / 2 if lies_in(triangles, domain) else 0
    for refinement in REFINEMENTS:
        fraction, is_closed = _level_set_fraction(triangles, domain, refinement)
        if is_closed and fraction.sum() * domain.voxel_size**3 >= least:
            return fraction
    return None


def _level_set_fraction(
    triangles: Floats, domain: Domain, refinement: float
) -> tuple[Floats, bool]:
    """(share of each voxel of `domain`, whether there is an inside), at a refinement."""
    distances = _distances(triangles, domain, refinement)
    is_closed = bool(distances.min() < LEAKED)
    # The share of a cell beyond a plane at this distance: exact for planes along the lattice.
    inside = np.clip(0.5 - distances, 0, 1)
    return _resampled(inside, refinement, domain.shape), is_closed


def _distances(triangles: Floats, domain: Domain, refinement: float) -> Floats:
    """Signed distances to the surface, in cells of a lattice that is finer by `refinement`."""
    points = (domain.to_index(triangles) + 0.5) * refinement - 0.5
    level_set = openvdb.FloatGrid.createLevelSetFromPolygons(
        points.reshape(-1, 3).astype(np.float32),
        triangles=np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3),
        transform=openvdb.createLinearTransform(1.0),
        halfWidth=2.0,
    )
    shape = np.ceil(np.multiply(domain.shape, refinement)).astype(int)
    distances = np.empty(tuple(shape), np.float32)
    level_set.copyToArray(distances)
    return distances


def _resampled(cells: Array, refinement: float, shape: tuple[int, ...]) -> Floats:
    """`cells` averaged or repeated onto `shape`; they are finer by `refinement`."""
    if refinement >= 1:
        n = int(refinement)
        return cells.reshape(shape[0], n, shape[1], n, shape[2], n).mean(axis=(1, 3, 5))
    for axis in range(3):
        cells = cells.repeat(round(1 / refinement), axis=axis)
    return cells[tuple(map(slice, shape))]
