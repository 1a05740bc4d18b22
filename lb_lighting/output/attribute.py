# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces out: light of the lattice as colour attributes on the points of meshes."""

from collections import Counter

import bpy
import numpy as np

from ..errors import OutputError
from ..scene.read_meshes import vertices
from .ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    WHOLE_ATTRIBUTE,
    Vertices,
)


def read_vertices(ob, depsgraph, is_body=False, is_wall=False):
    """The `Vertices` of the mesh object `ob`, at the current frame."""
    return Vertices(*vertices(ob, depsgraph), is_body, is_wall)


def sharers():
    """Counter {mesh: how many objects renders show it by}, of meshes that several objects have."""
    return Counter(ob.data for ob in bpy.data.objects if _is_sharer(ob))


def _is_sharer(ob):
    return ob.type == "MESH" and ob.data.users > 1 and not ob.hide_render and bool(ob.users_scene)


def misplaced(ob, depsgraph, sharers):
    """Why light on the vertices of the mesh object `ob` would be that of other places, or None."""
    if sharers[ob.data] > _is_sharer(ob):
        return "the mesh is shared with other objects"
    if len(ob.evaluated_get(depsgraph).data.vertices) != len(ob.data.vertices):
        return "modifiers add or remove vertices"
    return None


def instancers(objects, depsgraph):
    """{one of `objects`: an object that instances it and is none of them}."""
    objects, found = set(objects), {}
    for instance in depsgraph.object_instances:
        if not instance.is_instance:
            continue
        ob, parent = instance.object.original, instance.parent.original
        if ob in objects and parent not in objects:
            found[ob] = parent
    return found


def write_ambient(objects, sides, whole=False):
    """Write the light that falls on the mesh `objects`, at every vertex.

    sides  for each of them what `Vertices.light` returns
    whole  whether that is all light: then `lb_whole` (POINT, FLOAT) says so

    `lb_ambient` has the irradiance of the side that the normal points to, and `lb_ambient_back`
    that of the other, both divided by pi, in W/(m^2 sr): what a white surface sends out. The
    attributes (POINT, FLOAT_COLOR, alpha 1) are on the original meshes, which modifiers pass on.
    Objects that share a mesh get the mean of what each would have got.
    Raises OutputError for an object whose data cannot take an attribute, or has another number of
    vertices by now; then nothing was written.
    """
    refuse_unwritable(objects)
    sharers = {}
    for ob, light in zip(objects, sides, strict=True):
        if len(ob.data.vertices) != light.shape[1]:
            raise OutputError(f"The mesh of {ob.name} was changed while it was lit; bake it again.")
        sharers.setdefault(ob.data, []).append(light)
    for mesh, lights in sharers.items():
        both = lights[0] if len(lights) == 1 else np.mean(lights, axis=0)
        for name, light in zip((AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE), both, strict=True):
            _store(mesh, name, light)
        _remove(mesh, WHOLE_ATTRIBUTE)
        if whole:
            mark = mesh.attributes.new(WHOLE_ATTRIBUTE, "FLOAT", "POINT")
            mark.data.foreach_set("value", np.ones(len(mesh.vertices), np.float32))


def is_whole(ob):
    """True for a mesh object whose `lb_ambient` is all light."""
    return has_ambient(ob) and WHOLE_ATTRIBUTE in ob.data.attributes


def has_ambient(ob):
    """True for a mesh object with `lb_ambient` on it."""
    return ob.type == "MESH" and AMBIENT_ATTRIBUTE in ob.data.attributes


def remove_ambient(ob):
    """Take our attributes off the data of `ob`, if they are there."""
    if has_ambient(ob):
        for name in (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE, WHOLE_ATTRIBUTE):
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


def _store(mesh, name, light):
    """light  (vertices, 4) float32, W/(m^2 sr)."""
    _new_attribute(mesh, name).data.foreach_set("color", light.ravel())
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
