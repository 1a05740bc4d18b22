# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's materials, wired so that surfaces show light of the lattice, and the way back.

The node group `LB Ambient` is put right behind each closure that scatters diffusely, so that the
user's own mixes weigh its emission, for the rays that the eye sees by alone. Where that is all the
light there is, `LB Rest` takes the closure's colour away before it.

Closures in a node group of the user are wired in a copy of ours, which takes its place in the lit
materials: the group itself may be linked, and other materials may use it, too.
"""

import bpy

from ..errors import OutputError
from ..ours import (
    TAG,
    find_ours,
    give_back,
    is_ours,
    override,
)
from . import attribute, modifier
from .closures import (
    closure_links,
    group_sockets,
    is_principled,
    may_be_positive,
    surface_closures,
    surface_sockets,
)
from .groups import (
    AMBIENT_GROUP,
    REST_GROUP,
    ambient_group,
    rest_group,
)
from .nodes import new_material

# What each diffuse closure gives to the inputs of `LB Ambient`.
AMBIENT_INPUTS = {
    "BSDF_PRINCIPLED": {"Color": "Base Color", "Alpha": "Alpha", "Metallic": "Metallic"},
    "BSDF_DIFFUSE": {"Color": "Color"},
    "BSDF_TRANSLUCENT": {"Color": "Color"},
    "SUBSURFACE_SCATTERING": {"Color": "Color"},
}

SLOT = "lb_lighting_slot"  # on a user's mesh: its material slot is from us
# On a copy of a node group of the user: that group, and the strength of the light in the copy.
ORIGINAL, STRENGTH = "lb_lighting_original", "lb_lighting_strength"


def wire_ambient(material, strength=1.0, whole=False):
    """Add ambient light to what `material` shows; a second call updates it.

    strength  factor on the light, dimensionless
    whole     whether some of what it is on shows all light: then the eye finds there no other
              that is scattered diffusely

    Each diffuse closure emits its own colour, and its own alpha, times the light of the side that
    is seen, or of the other where it is translucent; others stay as they are. Raises OutputError
    for a material that cannot be edited.
    """
    _refuse_linked(material)
    tree = material.node_tree
    whole = whole or _is_still_whole([tree])
    unwire_ambient(material)
    if _wire(tree, surface_sockets(tree), strength, whole) and hasattr(material, "cycles"):
        override(material, "cycles.emission_sampling", "NONE")


def unwire_ambient(material):
    """Take ambient light out of `material` and leave it as it was before `wire_ambient`."""
    _unwire(material.node_tree)
    give_back(material)


def refuse_unwritable(objects):
    """Raise OutputError for the first object with a material that cannot be wired."""
    for ob in objects:
        for slot in ob.material_slots:
            if slot.material is not None:
                _refuse_linked(slot.material)


def hindrance(materials):
    """Why `wire_ambient` cannot take away what the `materials` scatter diffusely themselves, or
    None."""
    # What mirrors, or lets through, takes its colour from the same input.
    names = "Metallic", "Transmission Weight"
    closures = [c for material in materials for c in surface_closures(material)]
    if any(may_be_positive(c, name) for c in closures if is_principled(c) for name in names):
        return "a material is of metal or glass"
    return None


def light_surface(ob, strength=1.0, whole=False):
    """Wire every material of `ob`, and one of ours where it has none; see `wire_ambient`."""
    if not ob.material_slots:
        ob.data.materials.append(None)
        ob.data[SLOT] = True
    for slot in ob.material_slots:
        if slot.material is None:
            slot.material = _plain_material()
        wire_ambient(slot.material, strength, whole)


def light_instances(ob, materials, strength=1.0, whole=False):
    """Wire the `materials` of what the modifiers of `ob` instance; notes on what cannot be."""
    editable = {m for m in materials if m is not None and m.is_editable}
    for material in editable:
        wire_ambient(material, strength, whole)
    if editable.issuperset(materials):
        return []
    return [
        f"Some instances of '{ob.name}' show no light; give them materials that are not linked."
    ]


def _is_whole(ob):
    return attribute.shows_all_light(ob) or modifier.is_whole(ob)


def is_lit(ob):
    """True for an object that shows light of ours on its surface."""
    return attribute.has_ambient(ob) or modifier.has_modifier(ob)


def unlight_surface(ob):
    """Take away the material of ours, and the slot for it, that `light_surface` gave `ob`.

    The user's materials may light other objects too; `unwire_unused` sees to them.
    """
    for index, material in enumerate(ob.data.materials):
        if material and is_ours(material):
            ob.data.materials[index] = None
    for slot in ob.material_slots:  # those that are linked to the object
        if slot.material and is_ours(slot.material):
            slot.material = None
    if SLOT in ob.data:
        del ob.data[SLOT]
        if not any(slot.material for slot in ob.material_slots):
            ob.data.materials.clear()


def unwire_unused():
    """Undo `light_surface` for all meshes and materials of the file that show no light.

    What is in no scene any more shows nothing.
    """
    lit = {ob for scene in bpy.data.scenes for ob in scene.objects if is_lit(ob)}
    meshes = {ob.data for ob in lit}
    for ob in bpy.data.objects:
        editable = ob.type == "MESH" and ob.is_editable and ob.data.is_editable
        if editable and ob.data not in meshes:
            unlight_surface(ob)
    needed = {slot.material for ob in lit for slot in ob.material_slots}
    # Those of instances may be anyone's; they wait until no plant is left that has some.
    shared = any(modifier.has_modifier(ob) for ob in lit)
    for material in () if shared else bpy.data.materials:
        if material not in needed and material.is_editable:
            unwire_ambient(material)


def _refuse_linked(material):
    if not material.is_editable:
        raise OutputError(
            f"The material {material.name} is linked from another file; make it local."
        )


def _wire(tree, sockets, strength, whole):
    """Put ambient light behind the diffuse closures that come to `sockets`; whether there were any.

    The arguments are as those of `wire_ambient`.
    """
    found = {}
    for socket in sockets:
        for link in closure_links(socket):
            found.setdefault(link.from_socket, []).append(link.to_socket)
    closures = {s: targets for s, targets in found.items() if s.node.type in AMBIENT_INPUTS}
    groups = dict.fromkeys(s.node for s in found if s.node.type == "GROUP")
    for closure, targets in closures.items():
        _insert_ambient(tree, closure, targets, strength)
    if whole:
        for node in dict.fromkeys(closure.node for closure in closures):
            _insert_rest(tree, node)
    copied = [node for node in groups if node.node_tree and _is_diffuse(node.node_tree)]
    for node in copied:
        node.node_tree = _lit_copy(node.node_tree, strength, whole)
    return bool(closures or copied)


def _unwire(tree):
    """Take out of `tree` what `_wire` put there."""
    for node in _ours(tree, AMBIENT_GROUP):
        closure = _source(node.inputs["Shader"])
        for target in [link.to_socket for link in node.outputs[0].links]:
            if closure:
                tree.links.new(closure, target)
        tree.nodes.remove(node)
    for node in _ours(tree, REST_GROUP):
        for target in [link.to_socket for link in node.outputs[0].links]:
            _hand_on(tree, node.inputs["Color"], target)
        tree.nodes.remove(node)
    for node in _copied(tree):
        _give_group_back(node)


def _is_diffuse(group):
    """Whether a node group of the user, or one in it, has a diffuse closure to hand on."""
    nodes = [link.from_node for s in group_sockets(group) for link in closure_links(s)]
    return any(
        node.type in AMBIENT_INPUTS
        or (node.type == "GROUP" and node.node_tree and _is_diffuse(node.node_tree))
        for node in nodes
    )


def _lit_copy(group, strength, whole):
    """Our copy of the node group `group` of the user, with ambient light in it.

    All materials share the newest, which holds what the group holds now.
    """
    old = [
        copy
        for copy in bpy.data.node_groups
        if copy.get(ORIGINAL) == group and copy[STRENGTH] == strength and not copy.library
    ]
    copy = group.copy()
    copy[TAG], copy[ORIGINAL], copy[STRENGTH] = AMBIENT_GROUP + " copy", group, strength
    copy.description = f"Made by a bake from {group.name}: change that one, and bake again"
    _wire(copy, group_sockets(copy), strength, whole or _is_still_whole(old))
    for other in old:
        other.user_remap(copy)
        _remove_copy(other)
    copy.name = f"{group.name} (LB)"
    return copy


def _copied(tree):
    """The group nodes of `tree` that show a copy of ours."""
    return [n for n in tree.nodes if n.type == "GROUP" and n.node_tree and ORIGINAL in n.node_tree]


def _give_group_back(node):
    """Let a group node show the user's group again; where that is gone, our copy becomes it."""
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


def _remove_copy(copy):
    """Remove a copy of ours, and those in it that nothing else uses."""
    for node in _copied(copy):
        _give_group_back(node)
    bpy.data.node_groups.remove(copy)


def _is_still_whole(trees):
    """Whether other objects need what `trees` have of `LB Rest`; it does no harm to the rest."""
    return any(map(_has_rest, trees)) and any(map(_is_whole, bpy.data.objects))


def _has_rest(tree):
    return bool(_ours(tree, REST_GROUP)) or any(_has_rest(n.node_tree) for n in _copied(tree))


def _ours(tree, tag):
    """Our nodes of a tree that have a tag."""
    return [node for node in tree.nodes if node.get(TAG) == tag]


def _source(socket):
    """The output socket that feeds `socket`, or None."""
    return next((link.from_socket for link in socket.links if not link.is_muted), None)


def _insert_ambient(tree, closure, targets, strength):
    """Put `LB Ambient` between the socket `closure` and the sockets `targets` that it feeds."""
    shader = closure.node
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = ambient_group()
    node.name = node.label = AMBIENT_GROUP
    node[TAG] = AMBIENT_GROUP
    node.parent = shader.parent
    node.location = shader.location.x + shader.width + 20, shader.location.y
    node.inputs["Strength"].default_value = strength
    for name, source in AMBIENT_INPUTS[shader.type].items():
        _hand_on(tree, shader.inputs[source], node.inputs[name])
    node.inputs["Through"].default_value = shader.type == "BSDF_TRANSLUCENT"
    tree.links.new(closure, node.inputs["Shader"])
    for target in targets:
        tree.links.new(node.outputs["Shader"], target)


def _insert_rest(tree, shader):
    """Put `LB Rest` before the colour of the diffuse closure of a node."""
    socket = shader.inputs[AMBIENT_INPUTS[shader.type]["Color"]]
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = rest_group()
    node.name = node.label = node[TAG] = REST_GROUP
    node.parent = shader.parent
    node.location = shader.location.x - node.width - 20, shader.location.y
    _hand_on(tree, socket, node.inputs["Color"])
    tree.links.new(node.outputs["Color"], socket)


def _hand_on(tree, socket, target):
    """Give the input `target` the value of the input `socket`, and its link, muted or not."""
    target.default_value = socket.default_value
    for link in socket.links:
        tree.links.new(link.from_socket, target).is_muted = link.is_muted


def _plain_material():
    """Our material that looks as Cycles shows a mesh without one."""
    found = find_ours(bpy.data.materials, AMBIENT_GROUP)
    if found:
        return found
    material = new_material(AMBIENT_GROUP, AMBIENT_GROUP)
    nodes = material.node_tree.nodes
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material
