# SPDX-License-Identifier: GPL-3.0-or-later
"""The emissive meshes of a scene that are not selected themselves."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...arrays import Floats
from ...ours import is_ours
from ...transport.lights.lamps import AreaLight, PointLight
from ..meshes import Faces, Mesh
from ..nodes.shaders import Closure
from ..read_meshes import read_mesh
from ..remarks import Remarks, listed
from ..rendered import rendered_objects, world_matrix
from .light_nodes import LightShader, or_else
from .mesh_lights import Emitter, lamps_of
from .receivers import Receivers

PATTERNS = "Baked with even brightness, without the pattern from their nodes: {}."
ROUGH = "These emissive meshes are approximated by a few lamps: {}."
DROPPED = (
    "Only the brightest emissive meshes are baked; the others, with {:.0%} of their light, are "
    "left out: {}."
)
SELECTED = (
    "Emissive meshes light nothing while they are selected; deselect them to bake their light: {}."
)
_NOTED = 0.005  # share of the light that may be left out without a note
_EMISSIVE_NODES = {"EMISSION", "BSDF_PRINCIPLED"}

type Sides = tuple[Floats, Floats]  # W/(m^2 sr), (3,) each: the radiance of front and back


def mesh_lamps(
    depsgraph: bpy.types.Depsgraph, receivers: Receivers, remarks: Remarks, notes: list[str]
) -> list[AreaLight | PointLight]:
    """Lamps that stand for the emissive meshes that light the `receivers`."""
    emitters = _emitters(depsgraph, receivers, remarks)
    shining = lamps_of(emitters, receivers.lower, receivers.upper)
    for name in shining.rough:
        remarks.add(ROUGH, name)
    if shining.share > _NOTED:
        notes.append(DROPPED.format(shining.share, listed(shining.dropped)))
    return shining.lights


@dataclass
class _EmissiveMesh:
    """A mesh with materials that emit light.

    name      of its object
    slots     {material slot: radiance of its sides}
    matrices  [(4, 4)] from mesh space to world space, for each place of the mesh
    """

    name: str
    mesh: Mesh
    slots: dict[int, Sides]
    matrices: list[Any] = field(default_factory=list)

    def emitters(self) -> list[Emitter]:
        """[Emitter], one for each slot."""
        matrices = np.array(self.matrices, float)
        mirrored = np.linalg.det(matrices[:, :3, :3]) < 0
        emitters = []
        for slot, sides in self.slots.items():
            faces = Faces(self.mesh, slot, matrices, self.name)
            triangles = faces.triangles
            repeats = len(triangles) // len(matrices)
            mirrored_triangles = np.repeat(mirrored, repeats)
            emitters.append(Emitter(self.name, triangles, mirrored_triangles, faces.closed, *sides))
        return emitters


def _emitters(
    depsgraph: bpy.types.Depsgraph, receivers: Receivers, remarks: Remarks
) -> list[Emitter]:
    glows = _Glows()
    if not any(map(glows.of, bpy.data.materials)):
        return []  # as in most scenes, so do not go through their objects
    assert depsgraph.view_layer
    rendered = rendered_objects(depsgraph.view_layer.layer_collection)
    meshes: dict[tuple[Any, int | None], _EmissiveMesh | None] = {}
    # Read each mesh that viewports show once, and collect its places.
    instances: Iterable[Any] = depsgraph.object_instances
    for instance in instances:
        ob = instance.object
        owner = (instance.parent if instance.is_instance else ob).original
        if ob.type != "MESH" or not instance.show_self or ob.hide_render or owner not in rendered:
            continue
        key = owner, ob.data.as_pointer()
        if key not in meshes:
            meshes[key] = _read(ob, owner, glows, receivers, remarks)
        if mesh := meshes[key]:
            mesh.matrices.append([tuple(row) for row in instance.matrix_world])
    # Add objects that are hidden in viewports. They come last: to place them may evaluate the scene
    # again.
    for ob in rendered:
        if ob.type != "MESH" or ob.evaluated_get(depsgraph).is_evaluated:
            continue
        if mesh := _read(ob, ob, glows, receivers, remarks):
            mesh.matrices.append(world_matrix(ob, depsgraph))
            meshes[ob, None] = mesh
    return [emitter for mesh in meshes.values() if mesh for emitter in mesh.emitters()]


def _read(
    ob: Any,
    owner: bpy.types.Object,
    glows: "_Glows",
    receivers: Receivers,
    remarks: Remarks,
) -> _EmissiveMesh | None:
    """The mesh of `ob`, still without a place, or None if it does not light the receivers.

    owner  the original object: `ob` itself, or the one that instances it
    """
    if is_ours(owner) or not ob.data.polygons:
        return None
    materials = [slot.material for slot in ob.material_slots] or list(ob.data.materials)
    slots = {n: sides for n, m in enumerate(materials) if m and (sides := glows.of(m.original))}
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
    mesh = read_mesh(ob.data, len(materials))
    used = np.flatnonzero(np.bincount(mesh.slot, minlength=1))
    return _EmissiveMesh(owner.name, mesh, {int(n): slots[int(n)] for n in used if n in slots})


class _Glows:
    """The emission of materials, read once each.

    patterns  {material: {label of a node: None}} for the nodes whose pattern was averaged or
              ignored
    """

    def __init__(self) -> None:
        self._sides: dict[bpy.types.Material, Sides | None] = {}
        self.patterns: dict[bpy.types.Material, dict[str, None]] = {}

    def of(self, material: bpy.types.Material) -> Sides | None:
        """The radiance of the front and back of faces, or None if the material is dark."""
        if material not in self._sides:
            self._sides[material] = or_else(None, self._read, material)
        return self._sides[material]

    def _read(self, material: bpy.types.Material) -> Sides | None:
        if material.node_tree is None:
            return None
        shaders = [LightShader(material, back=back, tolerant=True) for back in (0.0, 1.0)]
        sides = _radiance(shaders[0]), _radiance(shaders[1])
        self.patterns[material] = shaders[0].patterns | shaders[1].patterns
        return sides if np.any(sides) else None


def _radiance(shader: LightShader) -> Floats:
    """(3,) W/(m^2 sr), not negative."""
    total = np.zeros(3)
    for closure in shader.contributing("Surface", _EMISSIVE_NODES):
        if closure.node.type == "EMISSION":
            total += closure.weight * _product(shader, closure, "Color", "Strength")
        elif np.any(glow := _product(shader, closure, "Emission Color", "Emission Strength")):
            total += closure.weight * shader.number(closure, "Alpha") * glow
    return np.maximum(total, 0)


def _product(shader: LightShader, closure: Closure, color: str, strength: str) -> Floats:
    """(3,): a colour times a strength. At a strength of 0, the colour is not read."""
    number = shader.number(closure, strength)
    return number * shader.color(closure, color) if number else np.zeros(3)
