# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces out: light of the lattice as a colour attribute on the points of meshes."""

import itertools

import numpy as np

from ..errors import OutputError

AMBIENT_ATTRIBUTE = "lb_ambient"


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


def write_ambient(objects, depsgraph, domain, radiance):
    """Write the mean radiance at every vertex of the mesh `objects` as their `lb_ambient`.

    radiance  (1 or 3, nx, ny, nz) W/(m^2 sr), fluence / 4 pi

    The attribute (POINT, FLOAT_COLOR, alpha 1) is on the original meshes, which modifiers
    pass on. Objects that share a mesh get the mean of what each would have got.
    Raises OutputError for an object whose data cannot take an attribute; then nothing
    was written.
    """
    refuse_unwritable(objects)
    sharers = {}
    for ob in objects:
        sharers.setdefault(ob.data, []).append(ob)
    for mesh, users in sharers.items():
        light = [sample(domain, radiance, _vertices(ob, depsgraph)) for ob in users]
        _store(mesh, np.mean(light, axis=0))


def has_ambient(ob):
    """True for a mesh object with `lb_ambient` on it."""
    return ob.type == "MESH" and AMBIENT_ATTRIBUTE in ob.data.attributes


def remove_ambient(ob):
    """Take `lb_ambient` off the data of `ob`, if it is there."""
    if has_ambient(ob):
        ob.data.attributes.remove(ob.data.attributes[AMBIENT_ATTRIBUTE])


def refuse_unwritable(objects):
    """Raise OutputError for the first object whose data cannot take an attribute."""
    for ob in objects:
        if ob.type != "MESH":
            raise OutputError(f"{ob.name} is not a mesh; convert it to a mesh to light it.")
        if not ob.data.is_editable:
            raise OutputError(f"The mesh of {ob.name} is linked from another file; make it local.")
        if ob.data.is_editmode:
            raise OutputError(f"{ob.name} is in Edit Mode; leave it to light the mesh.")


def _vertices(ob, depsgraph):
    """(n, 3) m, world space: where the modifiers put the vertices of the mesh of `ob`.

    Modifiers that change the number of vertices leave no such place; then the vertices
    are taken where the original mesh has them.
    """
    evaluated = ob.evaluated_get(depsgraph)
    mesh = evaluated.data if len(evaluated.data.vertices) == len(ob.data.vertices) else ob.data
    local = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", local)
    to_world = np.array(evaluated.matrix_world)
    return local.reshape(-1, 3) @ to_world[:3, :3].T + to_world[:3, 3]


def _store(mesh, light):
    """light  (vertices, 1 or 3) W/(m^2 sr)."""
    colors = np.ones((len(mesh.vertices), 4), np.float32)
    colors[:, :3] = light
    _new_attribute(mesh).data.foreach_set("color", colors.ravel())
    mesh.update_tag()


def _new_attribute(mesh):
    if AMBIENT_ATTRIBUTE in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[AMBIENT_ATTRIBUTE])
    layers = mesh.color_attributes
    shown = layers.active_color_name, layers.default_color_name
    attribute = mesh.attributes.new(AMBIENT_ATTRIBUTE, "FLOAT_COLOR", "POINT")
    # The first colour of a mesh becomes its active one; it is not for painting or display.
    layers.active_color_name, layers.default_color_name = shown
    return attribute
