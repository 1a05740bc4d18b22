# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's materials, rewired to show baked light on surfaces, and the way back.

A node group `LB Ambient` follows each closure that scatters diffusely, so that the user's own mixes
weigh its emission. Only rays that the eye sees directly find the emission. If it contains all
light, `LB Rest` before the closure takes its colour away.

Closures in a node group of the user are rewired in our copy of the group, which replaces it in lit
materials: the group itself may be linked, and other materials may use it too.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import bpy

from ..errors import OutputError
from ..ours import TAG, find_ours, give_back, is_ours, override
from ..scene.nodes.shaders import may_be_positive
from . import attribute, modifier
from .closures import (
    closure_links,
    group_sockets,
    is_principled,
    surface_closures,
    surface_sockets,
)
from .nodes import Node, Socket, new_material
from .surface_groups import AMBIENT_GROUP, REST_GROUP, ambient_group, rest_group

# The sockets of each diffuse closure that feed the inputs of `LB Ambient`.
AMBIENT_INPUTS = {
    "BSDF_PRINCIPLED": {"Color": "Base Color", "Alpha": "Alpha", "Metallic": "Metallic"},
    "BSDF_DIFFUSE": {"Color": "Color"},
    "BSDF_TRANSLUCENT": {"Color": "Color"},
    "SUBSURFACE_SCATTERING": {"Color": "Color"},
}

SLOT = "lb_lighting_slot"  # on a user's mesh: we added its material slot
# On a copy of a user's node group: that group, and the strength of the light in the copy.
ORIGINAL, STRENGTH = "lb_lighting_original", "lb_lighting_strength"


def wire_ambient(
    material: bpy.types.Material, strength: float = 1.0, all_light: bool = False
) -> None:
    """Add ambient light to what `material` shows; a second call updates it.

    strength   factor on the light, dimensionless
    all_light  whether any object with the material shows all light: then the eye finds no other
               diffuse light there

    Each diffuse closure emits its own colour, and its own alpha, times the light on the side that
    the eye sees, or on the other side if the closure is translucent. Other closures stay as they
    are. Raises OutputError for a material that cannot be edited.
    """
    _refuse_linked(material)
    tree = material.node_tree
    all_light = all_light or _still_needs_rest([tree])
    unwire_ambient(material)
    is_wired = _wire(tree, surface_sockets(tree), strength, all_light)
    if is_wired and hasattr(material, "cycles"):
        override(material, "cycles.emission_sampling", "NONE")


def unwire_ambient(material: bpy.types.Material) -> None:
    """Remove ambient light from `material`, and leave it as it was before `wire_ambient`."""
    _unwire(material.node_tree)
    give_back(material)


def refuse_unwritable(objects: Iterable[bpy.types.Object]) -> None:
    """Raise OutputError for the first object with a material that cannot be wired."""
    for ob in objects:
        for slot in ob.material_slots:
            if slot.material is not None:
                _refuse_linked(slot.material)


def hindrance(materials: Iterable[bpy.types.Material | None]) -> str | None:
    """Why `wire_ambient` cannot remove the diffuse light of the `materials` themselves, or None."""
    # What mirrors or transmits takes its colour from the same input.
    names = "Metallic", "Transmission Weight"
    closures = [c for material in materials for c in surface_closures(material)]
    if any(may_be_positive(c, name) for c in closures if is_principled(c) for name in names):
        return "a material is metal or glass"
    return None


def light_surface(ob: bpy.types.Object, strength: float = 1.0, all_light: bool = False) -> None:
    """Wire every material of `ob`, and one of ours where it has none; see `wire_ambient`."""
    if not ob.material_slots:
        mesh: Any = ob.data
        mesh.materials.append(None)
        mesh[SLOT] = True
    for slot in ob.material_slots:
        if slot.material is None:
            slot.material = _plain_material()
        wire_ambient(slot.material, strength, all_light)


def light_instances(
    ob: bpy.types.Object,
    materials: Sequence[bpy.types.Material | None],
    strength: float = 1.0,
    all_light: bool = False,
) -> list[str]:
    """Wire the `materials` of the instances that `ob` makes; notes on those that cannot be."""
    editable = {m for m in materials if m is not None and m.is_editable}
    for material in editable:
        wire_ambient(material, strength, all_light)
    if editable.issuperset(materials):
        return []
    return [f"Some instances of '{ob.name}' show no light; make their linked materials local."]


def is_lit(ob: bpy.types.Object) -> bool:
    """True for an object that shows our light on its surface."""
    return attribute.has_ambient(ob) or modifier.has_modifier(ob)


def unlight_surface(ob: bpy.types.Object) -> None:
    """Remove the material of ours, and its slot, that `light_surface` gave `ob`.

    The user's materials may light other objects too; `unwire_unused` handles them.
    """
    mesh: Any = ob.data
    for index, material in enumerate(mesh.materials):
        if material and is_ours(material):
            mesh.materials[index] = None
    for slot in ob.material_slots:  # the slots that are linked to the object
        if slot.material and is_ours(slot.material):
            slot.material = None
    if SLOT in mesh:
        del mesh[SLOT]
        if not any(slot.material for slot in ob.material_slots):
            mesh.materials.clear()


def unwire_unused() -> None:
    """Undo `light_surface` for all meshes and materials of the file that show no light.

    An object that is in no scene shows nothing.
    """
    lit = {ob for scene in bpy.data.scenes for ob in scene.objects if is_lit(ob)}
    # Meshes.
    meshes = {ob.data for ob in lit}
    for ob in bpy.data.objects:
        if not isinstance(ob.data, bpy.types.Mesh) or ob.data in meshes:
            continue
        if ob.is_editable and ob.data.is_editable:
            unlight_surface(ob)
    # Materials.
    needed = {slot.material for ob in lit for slot in ob.material_slots}
    # Any material may be one of an instance's, until no object has our modifier.
    may_be_instanced = any(modifier.has_modifier(ob) for ob in lit)
    for material in () if may_be_instanced else bpy.data.materials:
        if material not in needed and material.is_editable:
            unwire_ambient(material)


def _refuse_linked(material: bpy.types.Material) -> None:
    if not material.is_editable:
        raise OutputError(
            f"The material '{material.name}' is linked from another file; make it local."
        )


def _wire(tree: Any, sockets: Iterable[Socket], strength: float, all_light: bool) -> bool:
    """Add ambient light behind the diffuse closures that reach `sockets`; whether there were any.

    See `wire_ambient` for the other arguments.
    """
    # Find the outputs of closures and node groups, and the sockets that each feeds.
    fed: dict[Socket, list[Socket]] = {}
    for socket in sockets:
        for link in closure_links(socket):
            fed.setdefault(link.from_socket, []).append(link.to_socket)
    closures = {s: targets for s, targets in fed.items() if s.node.type in AMBIENT_INPUTS}
    groups = dict.fromkeys(s.node for s in fed if s.node.type == "GROUP")
    # Rewire the closures, and copies of the groups.
    for closure, targets in closures.items():
        _insert_ambient(tree, closure, targets, strength)
    if all_light:
        for node in dict.fromkeys(closure.node for closure in closures):
            _insert_rest(tree, node)
    copied = [node for node in groups if node.node_tree and _is_diffuse(node.node_tree)]
    for node in copied:
        node.node_tree = _lit_copy(node.node_tree, strength, all_light)
    return bool(closures or copied)


def _unwire(tree: Any) -> None:
    """Remove from `tree` what `_wire` added."""
    for node in _our_nodes(tree, AMBIENT_GROUP):
        closure = _source(node.inputs["Shader"])
        for target in [link.to_socket for link in node.outputs[0].links]:
            if closure:
                tree.links.new(closure, target)
        tree.nodes.remove(node)
    for node in _our_nodes(tree, REST_GROUP):
        for target in [link.to_socket for link in node.outputs[0].links]:
            _copy_input(tree, node.inputs["Color"], target)
        tree.nodes.remove(node)
    for node in _copied_groups(tree):
        _give_group_back(node)


def _is_diffuse(group: Any) -> bool:
    """Whether a user's node group, or one in it, outputs a diffuse closure."""
    nodes = [link.from_node for s in group_sockets(group) for link in closure_links(s)]
    return any(
        node.type in AMBIENT_INPUTS
        or (node.type == "GROUP" and node.node_tree and _is_diffuse(node.node_tree))
        for node in nodes
    )


def _lit_copy(group: Any, strength: float, all_light: bool) -> Any:
    """Our copy of the user's node group `group`, with ambient light in it.

    All materials share the newest copy, which has the present contents of the group.
    """
    old = [
        copy
        for copy in bpy.data.node_groups
        if copy.get(ORIGINAL) == group and copy[STRENGTH] == strength and not copy.library
    ]
    copy = group.copy()
    copy[TAG], copy[ORIGINAL], copy[STRENGTH] = AMBIENT_GROUP + " copy", group, strength
    copy.description = f"Made by a bake from {group.name}: edit that group and bake again"
    _wire(copy, group_sockets(copy), strength, all_light or _still_needs_rest(old))
    for other in old:
        other.user_remap(copy)
        _remove_copy(other)
    copy.name = f"{group.name} (LB)"
    return copy


def _copied_groups(tree: Any) -> list[Node]:
    """The group nodes of `tree` that show a copy of ours."""
    return [n for n in tree.nodes if n.type == "GROUP" and n.node_tree and ORIGINAL in n.node_tree]


def _give_group_back(node: Node) -> None:
    """Make a group node show the user's group again; if that is gone, our copy becomes it."""
    copy = node.node_tree
    group = copy.get(ORIGINAL)
    if group is not None:
        node.node_tree = group
        if not copy.users:
            _remove_copy(copy)
    elif not copy.library:
        _unwire(copy)
        for key in (TAG, ORIGINAL, STRENGTH):
            del copy[key]


def _remove_copy(copy: Any) -> None:
    """Remove a copy of ours, and the copies in it that nothing else uses."""
    for node in _copied_groups(copy):
        _give_group_back(node)
    bpy.data.node_groups.remove(copy)


def _still_needs_rest(trees: Iterable[Any]) -> bool:
    """Whether other objects need the `LB Rest` of `trees`. It does not harm objects that do not."""
    return any(map(_has_rest, trees)) and any(map(_shows_all_light, bpy.data.objects))


def _has_rest(tree: Any) -> bool:
    if _our_nodes(tree, REST_GROUP):
        return True
    return any(_has_rest(node.node_tree) for node in _copied_groups(tree))


def _shows_all_light(ob: bpy.types.Object) -> bool:
    return attribute.shows_all_light(ob) or modifier.shows_all_light(ob)


def _our_nodes(tree: Any, tag: str) -> list[Node]:
    """Our nodes of a tree that have a tag."""
    return [node for node in tree.nodes if node.get(TAG) == tag]


def _source(socket: Socket) -> Socket | None:
    """The output socket that feeds `socket`, or None."""
    return next((link.from_socket for link in socket.links if not link.is_muted), None)


def _insert_ambient(tree: Any, closure: Socket, targets: Iterable[Socket], strength: float) -> None:
    """Insert `LB Ambient` between the socket `closure` and the sockets `targets` that it feeds."""
    shader = closure.node
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = ambient_group()
    node.name = node.label = AMBIENT_GROUP
    node[TAG] = AMBIENT_GROUP
    node.parent = shader.parent
    node.location = shader.location.x + shader.width + 20, shader.location.y
    node.inputs["Strength"].default_value = strength
    for name, source in AMBIENT_INPUTS[shader.type].items():
        _copy_input(tree, shader.inputs[source], node.inputs[name])
    node.inputs["Through"].default_value = shader.type == "BSDF_TRANSLUCENT"
    tree.links.new(closure, node.inputs["Shader"])
    for target in targets:
        tree.links.new(node.outputs["Shader"], target)


def _insert_rest(tree: Any, shader: Node) -> None:
    """Insert `LB Rest` before the colour of a node's diffuse closure."""
    socket = shader.inputs[AMBIENT_INPUTS[shader.type]["Color"]]
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = rest_group()
    node.name = node.label = node[TAG] = REST_GROUP
    node.parent = shader.parent
    node.location = shader.location.x - node.width - 20, shader.location.y
    _copy_input(tree, socket, node.inputs["Color"])
    tree.links.new(node.outputs["Color"], socket)


def _copy_input(tree: Any, socket: Socket, target: Socket) -> None:
    """Give the input `target` the value of the input `socket`, and its link, muted or not."""
    target.default_value = socket.default_value
    for link in socket.links:
        tree.links.new(link.from_socket, target).is_muted = link.is_muted


def _plain_material() -> bpy.types.Material:
    """Our material that looks like a mesh without a material in Cycles."""
    material = find_ours(bpy.data.materials, AMBIENT_GROUP)
    if material:
        return material
    material = new_material(AMBIENT_GROUP, AMBIENT_GROUP)
    tree: Any = material.node_tree
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material
