# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes onto the lattice: their surface area, and the space that they enclose."""

from collections import defaultdict
from dataclasses import dataclass

import bpy
import numpy as np
import openvdb

from ..errors import SceneError

BATCH = 1 << 18  # triangles or samples handled at once: enough for NumPy, little enough memory
LARGE = 8  # voxels: triangles with longer edges are halved first, to drop what lies outside
SAMPLES_PER_VOXEL = 3  # along an edge
# Level sets in lattices this many times finer than the domain. A hole is closed once a voxel is
# larger than it, so the coarse ones are for meshes that are not quite tight.
REFINEMENTS = (2, 1, 1 / 2, 1 / 4)
FLAT = 1e-6  # volume over extent cubed: what float32 makes of none
LEAKED = -1e-3  # voxels: a level set that leaks has no distance below zero but rounding


@dataclass(frozen=True)
class Part:
    """Triangles of one material that an object brings into the scene.

    triangles  (n, 3, 3) m, float64, world space: triangle, corner, coordinate
    material   bpy.types.Material or None
    object     the original object that they come from, or that instances them
    instanced  whether it instances them
    """

    triangles: np.ndarray
    material: bpy.types.Material | None
    object: bpy.types.Object
    instanced: bool


def world_parts(depsgraph, objects):
    """[Part]: all evaluated mesh surface that the original `objects` contribute to the scene.

    That is their own mesh (or that of a curve, text or metaball) with modifiers, and everything
    that they instance: geometry nodes, particles, collections, vertices and faces.
    Raises SceneError for vertices that are not finite.
    """
    chosen = set(objects)
    meshes = {}
    matrices = defaultdict(list)
    for instance in depsgraph.object_instances:
        source = (instance.parent if instance.is_instance else instance.object).original
        ob = instance.object
        if source not in chosen or not instance.show_self or ob.type != "MESH":
            continue
        materials = _materials(ob)
        key = source, ob.data.as_pointer(), materials, instance.is_instance
        if key not in meshes:
            meshes[key] = _triangles_by_slot(ob.data, len(materials))
        matrices[key].append([tuple(row) for row in instance.matrix_world])
    return [
        Part(
            _placed(triangles, np.array(matrices[key]), source), materials[slot], source, instanced
        )
        for key, slots in meshes.items()
        for source, _mesh, materials, instanced in [key]
        for slot, triangles in slots
    ]


def world_bounds(parts):
    """(lower, upper), each (3,) m, of all triangles; SceneError where there are none."""
    corners = [part.triangles.reshape(-1, 3) for part in parts]
    if not sum(map(len, corners)):
        raise SceneError("The selection has no faces; select a mesh that has some.")
    return (
        np.min([c.min(axis=0) for c in corners if len(c)], axis=0),
        np.max([c.max(axis=0) for c in corners if len(c)], axis=0),
    )


def surface_area(triangles, domain):
    """(nx, ny, nz) m^2, float64: the area of the surface (both sides counted once) in each voxel.

    triangles  (n, 3, 3) m, world space
    Each triangle is sampled at the centres of equal parts that are small beside a voxel. What lies
    outside of the domain is dropped.
    """
    corners = domain.to_index(triangles) + 0.5  # voxel (i, j, k) spans i..i+1
    area = np.zeros(np.prod(domain.shape))
    pending = _batches(corners, BATCH)
    while pending:
        batch = pending.pop()
        batch = batch[_touches(batch, domain.shape)]
        longest = np.linalg.norm(_edges(batch), axis=-1).max(axis=1, initial=0)
        large = longest > LARGE
        pending += _batches(_halves(batch[large]), BATCH)
        parts = np.ceil(longest * SAMPLES_PER_VOXEL).astype(int)
        for n in np.unique(parts[~large]):
            _add_area(area, batch[parts == n], max(1, n), domain.shape)
    return area.reshape(domain.shape) * domain.voxel_size**2


def foliage_density(triangles, domain):
    """(nx, ny, nz) 1/m: the extinction coefficient of opaque leaves turned every way.

    A leaf of area A shows A/2 on average over its orientations, so this is half the area per
    volume (Ross, The Radiation Regime and Architecture of Plant Stands, 1981).
    """
    return surface_area(triangles, domain) / (2 * domain.voxel_size**3)


def solid_fraction(triangles, domain):
    """(nx, ny, nz), 0 to 1: the share of each voxel that is inside the closed surface.

    triangles  (n, 3, 3) m, world space; the shells may overlap, and holes up to about four
               voxels are closed
    Raises SceneError where the surface encloses nothing.
    """
    if not np.any(_touches(domain.to_index(triangles) + 0.5, domain.shape)):
        return np.zeros(domain.shape, np.float32)
    inside_domain = np.all(triangles >= domain.origin) and np.all(triangles <= domain.upper)
    # Reaching only half of the volume that the faces claim means that a part has leaked.
    least = _enclosed_volume(triangles) / 2 if inside_domain else 0
    for refinement in REFINEMENTS:
        fraction, closed = _level_set_fraction(triangles, domain, refinement)
        if closed and fraction.sum() * domain.voxel_size**3 >= least:
            return fraction
    if _enclosed_volume(triangles) <= FLAT * np.ptp(triangles, axis=(0, 1)).max() ** 3:
        raise SceneError("The mesh is flat; give it a thickness, or light it as foliage instead.")
    raise SceneError(
        "The mesh is not closed, or it is thinner than a voxel; fill its holes, raise the "
        "resolution, or light it as foliage instead."
    )


def _materials(ob):
    """The original materials of an evaluated object by slot; a bare mesh has one empty slot."""
    # Curves, texts and metaballs turn up as temporary mesh objects that have no slots.
    slots = [slot.material for slot in ob.material_slots] or ob.data.materials
    return tuple(m and m.original for m in slots) or (None,)


def _triangles_by_slot(mesh, slots):
    """[(slot, (n, 3, 3) m in object space)] for every material slot that has faces."""
    mesh.calc_loop_triangles()
    points = _read(mesh.vertices, "co", np.float32, 3)
    corners = _read(mesh.loop_triangles, "vertices", np.int32, 3)
    # Faces that name a slot which is not there are drawn with the last one.
    slot = np.minimum(_read(mesh.loop_triangles, "material_index", np.int32, 1)[:, 0], slots - 1)
    return [(int(i), points[corners[slot == i]].astype(float)) for i in np.unique(slot)]


def _read(collection, attribute, dtype, width):
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(attribute, values)
    return values.reshape(-1, width)


def _placed(triangles, matrices, ob):
    """`triangles` (n, 3, 3) of `ob` once for each of the `matrices` (k, 4, 4): (k n, 3, 3)."""
    rotated = np.einsum("kij,nj->kni", matrices[:, :3, :3], triangles.reshape(-1, 3))
    placed = (rotated + matrices[:, None, :3, 3]).reshape(-1, 3, 3)
    if not np.all(np.isfinite(placed)):
        raise SceneError(f"'{ob.name}' has vertices that are not finite; repair or delete them.")
    return placed


def _batches(triangles, size):
    return [triangles[i : i + size] for i in range(0, len(triangles), size)]


def _touches(triangles, shape):
    """(n,) bool: does the bounding box meet the lattice?"""
    lower, upper = triangles.min(axis=1), triangles.max(axis=1)
    return np.all((upper >= 0) & (lower <= shape), axis=-1)


def _edges(triangles):
    """(n, 3, 3): edge k runs from corner k to the next."""
    return np.roll(triangles, -1, axis=1) - triangles


def _halves(triangles):
    """(2 n, 3, 3): each triangle cut from the middle of its longest edge to the corner opposite."""
    longest = np.linalg.norm(_edges(triangles), axis=-1).argmax(axis=1)
    corner = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, corner[..., None], axis=1), 1, 0)
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _add_area(area, triangles, n, shape):
    """Add the area of triangles, in squared voxels, to the flat lattice `area`.

    n  parts that each edge is divided in; a sample stands for 1/n^2 of the triangle
    """
    edges = _edges(triangles)
    share = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1) / (2 * n**2)
    weights = _part_centers(n)
    size = max(1, BATCH // len(weights))
    for some, value in zip(_batches(triangles, size), _batches(share, size), strict=True):
        voxel = np.floor(weights @ some).astype(np.int32).reshape(-1, 3)
        value = value.repeat(len(weights))
        inside = np.all((voxel >= 0) & (voxel < shape), axis=-1)
        flat = np.ravel_multi_index(tuple(voxel[inside].T), shape)
        np.add.at(area, flat, value[inside])


def _part_centers(n):
    """(n^2, 3): barycentric centres of the equal triangles that a triangle is divided in."""
    i, j = np.divmod(np.arange(n * n), n)
    upright = i + j < n
    # The parts that stand on their head fill the other half of the square, mirrored.
    u = np.where(upright, i + 1 / 3, n - i - 1 / 3)
    v = np.where(upright, j + 1 / 3, n - j - 1 / 3)
    return np.stack([u, v, n - u - v], axis=-1) / n


def _enclosed_volume(triangles):
    """m^3, by the divergence theorem about the mesh's middle, where small holes matter least."""
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    return abs(np.einsum("ni,ni->", a, np.cross(b, c))) / 6


def _level_set_fraction(triangles, domain, refinement):
    """(fraction by voxel of `domain`, was an inside found) from a level set of another fineness."""
    points = (domain.to_index(triangles) + 0.5) * refinement - 0.5
    distance = openvdb.FloatGrid.createLevelSetFromPolygons(
        points.reshape(-1, 3).astype(np.float32),
        triangles=np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3),
        transform=openvdb.createLinearTransform(1.0),
        halfWidth=2.0,
    )
    cells = np.empty(np.ceil(np.multiply(domain.shape, refinement)).astype(int), np.float32)
    distance.copyToArray(cells)
    closed = bool(cells.min() < LEAKED)
    # The share of a cell beyond a plane at this distance: exact for planes along the lattice.
    inside = np.clip(0.5 - cells, 0, 1)
    return _refitted(inside, refinement, domain.shape), closed


def _refitted(cells, refinement, shape):
    """`cells` averaged or repeated onto `shape`, which is `refinement` times coarser."""
    if refinement >= 1:
        n = int(refinement)
        return cells.reshape(shape[0], n, shape[1], n, shape[2], n).mean(axis=(1, 3, 5))
    for axis in range(3):
        cells = cells.repeat(round(1 / refinement), axis=axis)
    return cells[tuple(map(slice, shape))]
