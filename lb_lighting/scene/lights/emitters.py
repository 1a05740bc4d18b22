# SPDX-License-Identifier: GPL-3.0-or-later
"""The meshes of a scene whose surface shines, and that are not selected themselves."""

from collections import defaultdict

import bpy
import numpy as np

from ...ours import is_ours
from ..meshes import Faces
from ..read_meshes import read_mesh
from ..remarks import listed
from ..rendered import rendered_objects, world_matrix
from .light_nodes import LightShader, or_else
from .mesh_lights import Emitter, lamps_of

PATTERNS = "Counted as evenly bright, without the pattern that their nodes make: {}."
ROUGH = "Their shining surfaces count as a few lamps in their place: {}."
DROPPED = "Of what shines, the brightest count; the others, {:.0%} of that light, are left out: {}."
SELECTED = (
    "Their surfaces shine, which lights nothing while they are selected; bake without them for "
    "their light: {}."
)
_NOTED = 0.005  # share of the light that is left out, from which on it is told
_SHINING = {"EMISSION", "BSDF_PRINCIPLED"}


def shining_lamps(depsgraph, receivers, remarks, notes):
    """[light] that stand for the meshes which shine on the `Receivers`."""
    emitters = _emitters(depsgraph, receivers, remarks)
    shining = lamps_of(emitters, receivers.lower, receivers.upper)
    for name in shining.rough:
        remarks.add(ROUGH, name)
    if shining.share > _NOTED:
        notes.append(DROPPED.format(shining.share, listed(shining.dropped)))
    return shining.lights


def _emitters(depsgraph, receivers, remarks):
    glows = _Glows()
    if not any(map(glows.of, bpy.data.materials)):
        return []  # as in most scenes, however many objects they have
    rendered = rendered_objects(depsgraph.view_layer.layer_collection)
    meshes, placed = {}, defaultdict(list)
    for instance in depsgraph.object_instances:
        ob = instance.object
        owner = (instance.parent if instance.is_instance else ob).original
        if ob.type != "MESH" or not instance.show_self or ob.hide_render or owner not in rendered:
            continue
        key = owner, ob.data.as_pointer()
        if key not in meshes:
            meshes[key] = _read(ob, ob.data, owner, glows, receivers, remarks)
        if meshes[key]:
            placed[key].append([tuple(row) for row in instance.matrix_world])
    # These come last, because placing them may evaluate the scene anew.
    for ob in rendered:
        if ob.type != "MESH" or ob.evaluated_get(depsgraph).is_evaluated:
            continue
        mesh = _read(ob, ob.data, ob, glows, receivers, remarks)
        if mesh:
            key = ob, None
            meshes[key], placed[key] = mesh, [world_matrix(ob, depsgraph)]
    return [
        _emitter(mesh, slot, glow, np.array(placed[key], float), key[0].name)
        for key, found in meshes.items()
        if found
        for mesh, slots in [found]
        for slot, glow in slots.items()
    ]


def _read(ob, data, owner, glows, receivers, remarks):
    """(`Mesh`, {slot: (front, back)}) of a mesh that shines on the receivers, or None."""
    if is_ours(owner) or not data.polygons:
        return None
    materials = [slot.material for slot in ob.material_slots] or list(data.materials)
    slots = {n: glow for n, m in enumerate(materials) if m and (glow := glows.of(m.original))}
    if not slots:
        return None
    if owner in receivers.objects:
        remarks.add(SELECTED, owner.name)
        return None
    if not receivers.take_object(ob, remarks):
        return None
    for n in slots:
        for label in glows.patterns[materials[n].original]:
            remarks.add(PATTERNS, f"'{owner.name}' ({label})")
    mesh = read_mesh(data, len(materials))
    used = np.flatnonzero(np.bincount(mesh.slot, minlength=1))
    return mesh, {int(n): slots[n] for n in used if n in slots}


def _emitter(mesh, slot, glow, matrices, name):
    faces = Faces(mesh, slot, matrices, name)
    mirrored = np.linalg.det(matrices[:, :3, :3]) < 0
    triangles = faces.triangles
    each = len(triangles) // len(matrices)
    return Emitter(name, triangles, np.repeat(mirrored, each), faces.closed, *glow)


class _Glows:
    """What materials shine with, each read once.

    patterns  {material: [label of a node]} that was averaged, or not read
    """

    def __init__(self):
        self._known, self.patterns = {}, {}

    def of(self, material):
        """((3,), (3,)) W/(m^2 sr), the radiance of fronts and backs, or None for a dark one."""
        if material not in self._known:
            self._known[material] = or_else(None, self._read, material)
        return self._known[material]

    def _read(self, material):
        if material.node_tree is None:
            return None
        shaders = [LightShader(material, back=back, tolerant=True) for back in (0.0, 1.0)]
        sides = tuple(map(_radiance, shaders))
        self.patterns[material] = shaders[0].patterns | shaders[1].patterns
        return sides if np.any(sides) else None


def _radiance(shader):
    """(3,) W/(m^2 sr), not negative."""
    total = np.zeros(3)
    for closure in shader.shining("Surface", _SHINING):
        if closure.node.type == "EMISSION":
            total += closure.weight * _product(shader, closure, "Color", "Strength")
        elif np.any(glow := _product(shader, closure, "Emission Color", "Emission Strength")):
            total += closure.weight * shader.number(closure, "Alpha") * glow
    return np.maximum(total, 0)


def _product(shader, closure, color, strength):
    """(3,): a colour times a number, of which the colour is not read where the number is 0."""
    number = shader.number(closure, strength)
    return number * shader.color(closure, color) if number else np.zeros(3)
