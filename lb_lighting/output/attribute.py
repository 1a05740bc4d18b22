# SPDX-License-Identifier: GPL-3.0-or-later
"""Light on surfaces, as colour attributes on the points of meshes."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import bpy
import numpy as np

from ..arrays import Floats
from ..errors import OutputError
from ..scene.read_meshes import vertices
from .ambient import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    WHOLE_ATTRIBUTE,
    Vertices,
)


def read_vertices(
    ob: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    is_body: bool = False,
    is_wall: bool = False,
) -> Vertices:
    """The `Vertices` of the mesh object `ob`, at the current frame."""
    mesh, to_world = vertices(ob, depsgraph)
    return Vertices(mesh, to_world, is_body, is_wall)


def sharers() -> Counter[Any]:
    """{mesh: number of rendered objects that use it}, for meshes that several objects share."""
    return Counter(ob.data for ob in bpy.data.objects if _is_sharer(ob))


def _is_sharer(ob: bpy.types.Object) -> bool:
    is_shared = ob.type == "MESH" and _mesh(ob).users > 1
    return is_shared and not ob.hide_render and bool(ob.users_scene)


def misplaced(
    ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, sharers: Counter[Any]
) -> str | None:
    """Why light on the vertices of the mesh object `ob` would belong to other places, or None.

    sharers  as `sharers` returns them
    """
    if sharers[ob.data] > _is_sharer(ob):
        return "the mesh is shared with other objects"
    evaluated: Any = ob.evaluated_get(depsgraph).data
    if len(evaluated.vertices) != len(_mesh(ob).vertices):
        return "modifiers add or remove vertices"
    return None


def instancers(
    objects: Iterable[bpy.types.Object], depsgraph: Any
) -> dict[bpy.types.Object, bpy.types.Object]:
    """{one of `objects`: another object that instances it}."""
    objects = set(objects)
    parents = {}
    for instance in depsgraph.object_instances:
        if not instance.is_instance:
            continue
        ob, parent = instance.object.original, instance.parent.original
        if ob in objects and parent not in objects:
            parents[ob] = parent
    return parents


def write_ambient(
    objects: Sequence[bpy.types.Object], sides: Iterable[Floats], all_light: bool = False
) -> None:
    """Write the light that falls on every vertex of the mesh `objects`.

    sides      for each object, as `Vertices.light` returns it
    all_light  whether it is all light, not scattered light alone: then `lb_whole` (POINT, FLOAT)
               is 1

    `lb_ambient` is the irradiance on the side that the normal points to, and `lb_ambient_back`
    that on the other, both divided by pi, in W/(m^2 sr): the radiance of a white surface. The
    attributes (POINT, FLOAT_COLOR, alpha 1) are on the original meshes; modifiers pass them on.
    Objects that share a mesh get the mean of their light.
    Raises OutputError for an object whose data cannot take an attribute, or whose number of
    vertices has changed; then nothing was written.
    """
    refuse_unwritable(objects)
    by_mesh: dict[bpy.types.Mesh, list[Floats]] = {}
    for ob, light in zip(objects, sides, strict=True):
        mesh = _mesh(ob)
        if len(mesh.vertices) != light.shape[1]:
            raise OutputError(f"The mesh of '{ob.name}' changed during the bake; bake it again.")
        by_mesh.setdefault(mesh, []).append(light)
    for mesh, lights in by_mesh.items():
        both = lights[0] if len(lights) == 1 else np.mean(lights, axis=0)
        for name, light in zip((AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE), both, strict=True):
            _store(mesh, name, light)
        _remove(mesh, WHOLE_ATTRIBUTE)
        if all_light:
            mark: Any = mesh.attributes.new(WHOLE_ATTRIBUTE, "FLOAT", "POINT")
            mark.data.foreach_set("value", np.ones(len(mesh.vertices), np.float32))


def shows_all_light(ob: bpy.types.Object) -> bool:
    """True for a mesh object whose `lb_ambient` is all light."""
    return has_ambient(ob) and WHOLE_ATTRIBUTE in _mesh(ob).attributes


def has_ambient(ob: bpy.types.Object) -> bool:
    """True for a mesh object that has `lb_ambient`."""
    return ob.type == "MESH" and AMBIENT_ATTRIBUTE in _mesh(ob).attributes


def remove_ambient(ob: bpy.types.Object) -> None:
    """Remove our attributes from the data of `ob`, if it has any."""
    if has_ambient(ob):
        for name in (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE, WHOLE_ATTRIBUTE):
            _remove(_mesh(ob), name)


def refuse_unwritable(objects: Iterable[bpy.types.Object]) -> None:
    """Raise OutputError for the first object whose data cannot take an attribute."""
    for ob in objects:
        if ob.type != "MESH":
            raise OutputError(f"'{ob.name}' is not a mesh; convert it to a mesh to light it.")
        if not _mesh(ob).is_editable:
            raise OutputError(
                f"The mesh of '{ob.name}' is linked from another file; make it local."
            )
        if _mesh(ob).is_editmode:
            raise OutputError(f"'{ob.name}' is in Edit Mode; leave Edit Mode to light it.")


def _mesh(ob: bpy.types.Object) -> bpy.types.Mesh:
    assert isinstance(ob.data, bpy.types.Mesh)
    return ob.data


def _store(mesh: bpy.types.Mesh, name: str, light: Floats) -> None:
    """Write the attribute `name`; light is (vertices, 4) float32, W/(m^2 sr)."""
    _new_attribute(mesh, name).data.foreach_set("color", light.ravel())
    mesh.update_tag()


def _new_attribute(mesh: bpy.types.Mesh, name: str) -> Any:
    _remove(mesh, name)
    colors: Any = mesh.color_attributes
    shown = colors.active_color_name, colors.default_color_name
    attribute = mesh.attributes.new(name, "FLOAT_COLOR", "POINT")
    # Blender activates the first colour attribute of a mesh; ours is not for painting or display.
    colors.active_color_name, colors.default_color_name = shown
    return attribute


def _remove(mesh: bpy.types.Mesh, name: str) -> None:
    if name in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[name])
