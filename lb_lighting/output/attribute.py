# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces out: light of the lattice as colour attributes on the points of meshes."""

import itertools

import numpy as np

from ..errors import OutputError

AMBIENT_ATTRIBUTE = "lb_ambient"
BACK_ATTRIBUTE = "lb_ambient_back"
STAND_OFF = 0.75  # voxels in front of a wall: where its light is taken, not from its other side
LEAST_OPEN = 1e-3  # share of the voxels around a point, below which it is dark


def sample(domain, values, points):
    """Trilinear samples of a voxel field; outside of the domain, the value at its border.

    values  (bands, nx, ny, nz), at the voxel centres of `domain`
    points  (n, 3) m, world space
    Returns (n, bands).
    """
    last = np.subtract(domain.shape, 1)
    position = np.clip(domain.to_index(points), 0, last)
    low = np.floor(position).astype(int)
    fraction = position - low
    result = np.zeros((len(position), len(values)))
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.where(corner, fraction, 1 - fraction).prod(axis=1)
        x, y, z = np.minimum(low + corner, last).T
        result += weight[:, None] * values[:, x, y, z].T
    return result


def write_ambient(objects, depsgraph, field, bodies=(), walls=(), occlusion=None):
    """Write the scattered light that falls on the mesh `objects`, at every vertex.

    field      a `Field`: its fluence and flux are what shows; unscattered light is Cycles' own
    bodies     those of `objects` that are filled with light: both sides show what comes out of them
    walls      those that stop all light, whose two sides are lit apart from each other
    occlusion  (nx, ny, nz) of the medium, whose opaque voxels are dark, or None

    `lb_ambient` has the irradiance of the side that the normal points to, and `lb_ambient_back`
    that of the other, both divided by pi, in W/(m^2 sr): what a white surface sends out. The
    attributes (POINT, FLOAT_COLOR, alpha 1) are on the original meshes, which modifiers pass on.
    Objects that share a mesh get the mean of what each would have got.
    Raises OutputError for an object whose data cannot take an attribute; then nothing
    was written.
    """
    refuse_unwritable(objects)
    sharers = {}
    for ob in objects:
        sharers.setdefault(ob.data, []).append(ob)
    for mesh, users in sharers.items():
        sides = [_sides(ob, depsgraph, field, ob in bodies, ob in walls, occlusion) for ob in users]
        for name, light in zip(
            (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE), np.mean(sides, axis=0), strict=True
        ):
            _store(mesh, name, light)


def has_ambient(ob):
    """True for a mesh object with `lb_ambient` on it."""
    return ob.type == "MESH" and AMBIENT_ATTRIBUTE in ob.data.attributes


def remove_ambient(ob):
    """Take our attributes off the data of `ob`, if they are there."""
    if has_ambient(ob):
        for name in (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE):
            _remove(ob.data, name)


def refuse_unwritable(objects):
    """Raise OutputError for the first object whose data cannot take an attribute."""
    for ob in objects:
        if ob.type != "MESH":
            raise OutputError(f"{ob.name} is not a mesh; convert it to a mesh to light it.")
        if not ob.data.is_editable:
            raise OutputError(f"The mesh of {ob.name} is linked from another file; make it local.")
        if ob.data.is_editmode:
            raise OutputError(f"{ob.name} is in Edit Mode; leave it to light the mesh.")


def _sides(ob, depsgraph, field, is_body, is_wall, occlusion):
    """((vertices, bands), the same): irradiance / pi of the front and of the back."""
    points, normals = _vertices(ob, depsgraph)
    off = STAND_OFF * field.domain.voxel_size * normals if is_wall else 0
    front, _ = irradiance(field, points + off, normals, occlusion)
    _, back = irradiance(field, points - off, normals, occlusion)
    return np.array((back, back) if is_body else (front, back)) / np.pi


def irradiance(field, points, normals, occlusion=None):
    """(front, back), each (n, bands) W/m^2: what falls on surfaces from the scattered light.

    points, normals  (n, 3) m and unit vectors, world space
    occlusion        (nx, ny, nz) or None: what of each voxel holds no light

    Radiance is taken to be linear in direction, with the moments phi (fluence) and J (flux): then
    what arrives at the side of the normal n is phi/4 - J.n/2, which cannot be negative.
    """
    bands = len(field.fluence)
    moments = np.concatenate([field.fluence, field.flux.reshape(3 * bands, *field.domain.shape)])
    moments = sample(field.domain, moments, points)
    if occlusion is not None:  # voxels count by what of them is open
        moments /= np.maximum(sample(field.domain, 1 - occlusion[None], points), LEAST_OPEN)
    fluence, flux = moments[:, :bands], moments[:, bands:].reshape(-1, bands, 3)
    along = np.einsum("nba,na->nb", flux, normals)
    return np.maximum(0, fluence / 4 - along / 2), np.maximum(0, fluence / 4 + along / 2)


def _vertices(ob, depsgraph):
    """Points (n, 3) m and unit normals (n, 3), world space, of the mesh of `ob` after modifiers.

    Modifiers that change the number of vertices leave no such place; then the vertices
    are taken where the original mesh has them.
    """
    evaluated = ob.evaluated_get(depsgraph)
    mesh = evaluated.data if len(evaluated.data.vertices) == len(ob.data.vertices) else ob.data
    points, normals = np.empty((2, 3 * len(mesh.vertices)), np.float32)
    mesh.vertices.foreach_get("co", points)
    mesh.vertex_normals.foreach_get("vector", normals)
    to_world = np.array(evaluated.matrix_world)
    turn = to_world[:3, :3]
    # Normals turn with the cofactors, which exist for what is scaled flat, too.
    cofactors = np.cross(np.roll(turn, -1, axis=0), np.roll(turn, -2, axis=0))
    cofactors *= np.copysign(1, np.linalg.det(turn))  # Cycles keeps the front of what is mirrored
    normals = normals.reshape(-1, 3) @ cofactors.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    return points.reshape(-1, 3) @ turn.T + to_world[:3, 3], normals


def _store(mesh, name, light):
    """light  (vertices, 1 or 3) W/(m^2 sr)."""
    colors = np.ones((len(mesh.vertices), 4), np.float32)
    colors[:, :3] = light
    _new_attribute(mesh, name).data.foreach_set("color", colors.ravel())
    mesh.update_tag()


def _new_attribute(mesh, name):
    _remove(mesh, name)
    layers = mesh.color_attributes
    shown = layers.active_color_name, layers.default_color_name
    attribute = mesh.attributes.new(name, "FLOAT_COLOR", "POINT")
    # The first colour of a mesh becomes its active one; it is not for painting or display.
    layers.active_color_name, layers.default_color_name = shown
    return attribute


def _remove(mesh, name):
    if name in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[name])
