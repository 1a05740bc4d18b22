# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders that make light of the lattice visible in volumes, and the settings they need.

Volumes: the node group `LB Volume Light` on the baked Volume object. "REPLACE" stands in
for the source object: it absorbs, and emits all light scattered towards the eye; nothing
in it scatters, so Cycles has nothing left to sample. The light of each lamp that has not
scattered yet comes from one direction, and a node `LB Beam` finds how much of it goes to the
eye. "ADD" lies over the source and only emits, for the rays that the eye sees by alone, because
Cycles would scatter the emission once more and count it twice.

Surfaces are the affair of `shading_surfaces`.
"""

import bpy

from ..ours import (
    TAG,
    give_back,
    is_ours,
    is_overridden,
    override,
)
from .closures import is_clear
from .groups import (
    BEAM_GROUP,
    MOMENTS_GROUP,
    VOLUME_GROUP,
    beam_group,
    lamp_group,
    moments_group,
    volume_group,
)
from .keys import remove_keys, set_values
from .look import Look
from .nodes import new_material
from .shading_surfaces import is_lit
from .vdb import AXES, direct_grid, forward_grid
from .volume import baked_volumes

VOLUME_BOUNCES = "cycles.volume_bounces"


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
    if lit and not any(map(is_clear, bpy.data.materials)):
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


def remove_unused():
    """Remove our materials, node groups and actions that nothing uses."""
    for blocks in (bpy.data.materials, bpy.data.node_groups, bpy.data.actions):
        while unused := [block for block in blocks if is_ours(block) and not block.users]:
            bpy.data.batch_remove(unused)  # which may have been all that used another


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


def _volume_material(volume):
    """The material of the Volume datablock `volume`, made if it has none of ours."""
    found = next((m for m in volume.materials if m and is_ours(m)), None)
    if found:
        return found
    material = new_material(volume.name, VOLUME_GROUP)
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
