# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders that make light of the lattice visible, and the settings they need.

Volumes: the node group `LB Volume Light` on the baked Volume object. "REPLACE" stands in
for the source object: it absorbs, and emits all light scattered towards the eye; nothing
in it scatters, so Cycles has nothing left to sample. The light of each lamp that has not
scattered yet comes from one direction, and a node `LB Beam` finds how much of it goes to the
eye. "ADD" lies over the source and only emits, for camera rays alone, because Cycles would
scatter the emission once more and count it twice.

Surfaces: the node group `LB Ambient`, put right behind each closure that scatters
diffusely, so that the user's own mixes weigh its emission; again for camera rays alone. Where that
is all the light there is, `LB Rest` takes the closure's colour away before it.
"""

import bpy

from ..errors import OutputError
from ..ours import TAG, find_ours, give_back, is_ours, is_overridden, override
from . import attribute, modifier
from .groups import (
    AMBIENT_GROUP,
    BEAM_GROUP,
    MOMENTS_GROUP,
    REST_GROUP,
    VOLUME_GROUP,
    ambient_group,
    beam_group,
    lamp_group,
    moments_group,
    rest_group,
    volume_group,
)
from .keys import remove_keys, set_values
from .look import Look
from .vdb import AXES, direct_grid, forward_grid
from .volume import baked_volumes

# Nodes that hand on the closures of others.
PASSING_NODES = {"MIX_SHADER", "ADD_SHADER", "REROUTE"}

# What each diffuse closure gives to the inputs of `LB Ambient`; a user's group gives nothing,
# since what it holds is its own affair.
AMBIENT_INPUTS = {
    "BSDF_PRINCIPLED": {"Color": "Base Color", "Alpha": "Alpha"},
    "BSDF_DIFFUSE": {"Color": "Color"},
    "BSDF_TRANSLUCENT": {"Color": "Color"},
    "SUBSURFACE_SCATTERING": {"Color": "Color"},
    "GROUP": {},
}

VOLUME_BOUNCES = "cycles.volume_bounces"
CLEAR = {"BSDF_GLASS", "BSDF_REFRACTION"}

SLOT = "lb_lighting_slot"  # on a user's mesh: its material slot is from us


def prepare_scene(scene):
    """Make Cycles march through volumes, which renders "REPLACE" fast and without noise."""
    if hasattr(scene, "cycles"):  # Cycles is an add-on, which may be off
        override(scene, "cycles.volume_biased", True)


def restore_scene(scene):
    """Give back what `prepare_scene` and `use_light` changed."""
    give_back(scene)


def use_light(scene):
    """Set what a render with the light of the lattice wants, for which it stands.

    Volumes are marched through, and scatter once (in "ADD"; in "REPLACE" not at all). Where
    surfaces show ambient light, diffuse bounces are in it, and so are those through translucent
    ones; what is seen through glass needs its bounces, so they stay where a material is clear.
    """
    prepare_scene(scene)
    override(scene, VOLUME_BOUNCES, 0)
    lit = [ob for ob in scene.objects if is_lit(ob)]
    if lit:
        override(scene, "cycles.diffuse_bounces", 0)
    if lit and not any(map(_is_clear, bpy.data.materials)):
        override(scene, "cycles.transmission_bounces", 0)


def uses_light(scene):
    """True after `use_light`, until the scene was given back."""
    return is_overridden(scene, VOLUME_BOUNCES)


def leave_light(scene):
    """Give back what `use_light` changed; what the bake needs stays."""
    restore_scene(scene)
    if any(not ob.hide_render for ob in baked_volumes(scene)):
        prepare_scene(scene)


def hide_source(ob):
    """Hide the object that a baked volume replaces, from viewport and render."""
    override(ob, "hide_viewport", True)
    override(ob, "hide_render", True)


def show_source(ob):
    """Give the object the visibility it had before `hide_source`."""
    give_back(ob)


def shade_volume(ob, mode, sigma_s, sigma_a, g=0.0, beams=(), core=0.0, strength=1.0, lobes=None):
    """Give the baked Volume object `ob` the material that shows its light.

    mode      "REPLACE" or "ADD"
    strength  factor on the light, dimensionless

    For the others see `Look.of`.
    """
    look = Look.of(sigma_s, sigma_a, g, beams, core, lobes)
    shade_frames(ob, mode, {0: look}, strength)


def shade_frames(ob, mode, looks, strength=1.0):
    """As `shade_volume`, where every frame of a sequence has its own `Look`: {frame: Look}.

    What differs between them has a key in each of these frames, and stays until the next.
    """
    volume_group()  # one that an older file has is brought up to date
    material = _volume_material(ob.data)
    tree = material.node_tree
    remove_keys(tree)
    for node in [node for node in tree.nodes if is_ours(node)]:
        tree.nodes.remove(node)
    inputs = next(node for node in tree.nodes if node.type == "GROUP").inputs
    inputs["Strength"].default_value = strength
    inputs["Replace"].default_value = mode == "REPLACE"
    once = {frame: look.g for frame, look in looks.items()}
    set_values(tree, inputs["Sigma S"], {frame: look.sigma_s for frame, look in looks.items()})
    set_values(tree, inputs["Sigma A"], {frame: look.sigma_a for frame, look in looks.items()})
    set_values(tree, inputs["G"], once)
    target = inputs["Direct"]
    if any(look.lobes for look in looks.values()):
        target = _insert_moments(tree, target)
    # Light that has scattered before goes about the way of the beam, its mean cosine to that is g.
    twice = {n: look.lobes or tuple(g * g for g in look.g) for n, look in looks.items()}
    is_forward = max(map(max, once.values())) > 0
    kinds = [(direct_grid, once), *([(forward_grid, twice)] if is_forward else [])]
    count = 0
    for number, beams in enumerate(_by_number(looks), 1):
        for grid, own in kinds:
            for beams_of_kind in _by_kind(beams):
                count += 1
                target = _insert_beam(tree, target, count, grid(number), beams_of_kind, own)


def wire_ambient(material, strength=1.0, whole=False):
    """Add ambient light to what `material` shows; a second call updates it.

    strength  factor on the light, dimensionless
    whole     whether some of what it is on shows all light: then camera rays find there no other
              that is scattered diffusely

    Each diffuse closure emits its own colour, and its own alpha, times the light of the side that
    is seen, or of the other where it is translucent; others stay as they are. Raises OutputError
    for a material that cannot be edited.
    """
    _refuse_linked(material)
    tree = material.node_tree
    # Others that it is on may still need it, and it does no harm to the rest.
    whole = whole or (bool(_ours(tree, REST_GROUP)) and any(map(_is_whole, bpy.data.objects)))
    unwire_ambient(material)
    for closure, targets in _diffuse_closures(tree).items():
        _insert_ambient(tree, closure, targets, strength)
        if whole and "Color" in AMBIENT_INPUTS[closure.node.type]:
            _insert_rest(tree, closure.node)
    if _ours(tree, AMBIENT_GROUP) and hasattr(material, "cycles"):
        override(material, "cycles.emission_sampling", "NONE")


def unwire_ambient(material):
    """Take ambient light out of `material` and leave it as it was before `wire_ambient`."""
    tree = material.node_tree
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
    trees = [material.node_tree for material in materials if material and material.node_tree]
    shaders = {closure.node for tree in trees for closure in _diffuse_closures(tree)}
    shaders |= {
        link.from_node
        for shader in shaders
        if is_ours(shader)
        for link in _closure_links(shader.inputs["Shader"])
    }
    shaders = [shader for shader in shaders if not is_ours(shader)]
    if any(shader.type == "GROUP" for shader in shaders):
        return "a material has its shaders in a node group"
    # What mirrors, or lets through, takes its colour from the same input.
    own = [shader for shader in shaders if shader.type == "BSDF_PRINCIPLED"]
    weights = [s.inputs[name] for s in own for name in ("Metallic", "Transmission Weight")]
    if any(weight.is_linked or weight.default_value > 0 for weight in weights):
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
    return attribute.is_whole(ob) or modifier.is_whole(ob)


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


def remove_unused():
    """Remove our materials, node groups and actions that nothing uses."""
    groups = bpy.data.node_groups
    # Groups twice, for one holds another.
    for blocks in (bpy.data.materials, groups, groups, bpy.data.actions):
        bpy.data.batch_remove([block for block in blocks if is_ours(block) and not block.users])


def _is_clear(material):
    """Whether one sees through the material, but for holes."""
    nodes = material.node_tree.nodes if material.node_tree else ()
    weights = [n.inputs["Transmission Weight"] for n in nodes if n.type == "BSDF_PRINCIPLED"]
    return any(n.type in CLEAR for n in nodes) or any(
        weight.is_linked or weight.default_value > 0 for weight in weights
    )


def _refuse_linked(material):
    if not material.is_editable:
        raise OutputError(
            f"The material {material.name} is linked from another file; make it local."
        )


def _by_number(looks):
    """[{frame: beam}] of each number, of the frames that have one; see `Look.beams`."""
    most = max(len(look.beams) for look in looks.values())
    return [
        {frame: look.beams[n] for frame, look in looks.items() if n < len(look.beams)}
        for n in range(most)
    ]


def _by_kind(beams):
    """[{frame: beam or None}], suns and lamps apart; None where a frame has the other kind."""
    kinds = dict.fromkeys("Position" in beam for beam in beams.values())
    return [
        {frame: beam if ("Position" in beam) == kind else None for frame, beam in beams.items()}
        for kind in kinds
    ]


def _active_outputs(tree):
    """The output nodes that render engines use: one, or one for each engine."""
    outputs = dict.fromkeys(tree.get_output_node(engine) for engine in ("CYCLES", "EEVEE"))
    return [output for output in outputs if output]


def _ours(tree, tag):
    """Our nodes of a tree that have a tag."""
    return [node for node in tree.nodes if node.get(TAG) == tag]


def _source(socket):
    """The output socket that feeds `socket`, or None."""
    return next((link.from_socket for link in socket.links if not link.is_muted), None)


def _diffuse_closures(tree):
    """{output socket of a diffuse closure: [input sockets that it reaches the surface by]}."""
    found = {}
    for output in _active_outputs(tree):
        for link in _closure_links(output.inputs["Surface"]):
            if link.from_node.type in AMBIENT_INPUTS:
                found.setdefault(link.from_socket, []).append(link.to_socket)
    return found


def _closure_links(socket):
    """The links that bring closures to `socket`, from behind mixes, sums and reroutes."""
    for link in socket.links:
        node = link.from_node
        # An invalid link closes a circle.
        if link.is_muted or not link.is_valid or link.from_socket.type != "SHADER":
            continue
        if node.type in PASSING_NODES:
            for below in node.inputs:
                yield from _closure_links(below)
        elif not node.mute:
            yield link


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
    material = _new_material(AMBIENT_GROUP, AMBIENT_GROUP)
    nodes = material.node_tree.nodes
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material


def _volume_material(volume):
    """The material of the Volume datablock `volume`, made if it has none of ours."""
    found = next((m for m in volume.materials if m and is_ours(m)), None)
    if found:
        return found
    material = _new_material(volume.name, VOLUME_GROUP)
    nodes = material.node_tree.nodes
    light = nodes.new("ShaderNodeGroup")
    light.node_tree = volume_group()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(light.outputs["Volume"], output.inputs["Volume"])
    volume.materials.append(material)
    return material


def _insert_beam(tree, target, number, name, beams, g):
    """Add a beam's grid, the `number`-th, from 1, to the socket `target`; the socket for the next
    one.

    beams  {frame: beam or None}, all of one kind; None where the grid holds another kind's light
    g      {frame: mean cosine of the scattering angle, (3,)}
    """
    x, y = -250 * number, -300

    def new(kind, down):
        node = tree.nodes.new(kind)
        node.location = x - 250, y - down
        node[TAG] = BEAM_GROUP
        return node

    node = new("ShaderNodeGroup", 0)
    node.location.x = x
    node.node_tree = beam_group()
    node.label = name
    set_values(tree, node.inputs["G"], g)
    grid = new("ShaderNodeAttribute", 0)
    grid.attribute_name = name
    light = grid.outputs["Vector"]
    known = {frame: beam for frame, beam in beams.items() if beam is not None}
    if len(known) < len(beams):
        share = new("ShaderNodeVectorMath", 400)
        share.operation = "SCALE"
        shown = {frame: float(beam is not None) for frame, beam in beams.items()}
        set_values(tree, share.inputs["Scale"], shown)
        tree.links.new(light, share.inputs[0])
        light = share.outputs["Vector"]
    values = {
        name: {n: beam[name] for n, beam in known.items()} for name in next(iter(known.values()))
    }
    told = node
    if "Position" in values:
        told = new("ShaderNodeGroup", 200)
        told.node_tree = lamp_group()
        tree.links.new(light, told.inputs["Intensity"])
        light = told.outputs["Light"]
        for axis in AXES:
            tree.links.new(told.outputs[axis], node.inputs[axis])
    for name, by_frame in values.items():
        set_values(tree, told.inputs[name], by_frame)
    tree.links.new(light, node.inputs["Light"])
    tree.links.new(node.outputs["Radiance"], target)
    return node.inputs["Others"]


def _insert_moments(tree, target):
    """Add what was gathered to the socket `target`; the socket for beams."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.location = 0, 250
    node.node_tree = moments_group()
    node[TAG] = node.label = MOMENTS_GROUP
    tree.links.new(node.outputs["Radiance"], target)
    return node.inputs["Others"]


def _new_material(name, tag):
    material = bpy.data.materials.new(name)
    material[TAG] = tag
    material.node_tree.nodes.clear()
    return material
