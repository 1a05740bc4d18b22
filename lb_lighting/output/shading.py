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

import math

import bpy

from ..ours import TAG, give_back, is_ours, is_overridden, override
from ..transport.lights import Sun
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

    mode              "REPLACE" or "ADD"
    sigma_s, sigma_a  scattering and absorption coefficient at density 1, 1/m, scalar or (3,)
    g                 mean cosine of the scattering angle, scalar or (3,)
    beams             the `Sun`, `PointLight` or `SpotLight` of each grid `direct_grid(1)` ...
                      and `forward_grid(1)` ...
    core              m, that of the falloff of points and spots: an edge of a voxel
    strength          factor on the light, dimensionless
    lobes             mean cosine, scalar or (3,), of what `forward_grid`s are scattered to, where
                      that was gathered and the file has each `moment_grid`
    """
    volume_group()  # one that an older file has is brought up to date
    material = _volume_material(ob.data)
    nodes = material.node_tree.nodes
    for node in [node for node in nodes if is_ours(node)]:
        nodes.remove(node)
    inputs = next(node for node in nodes if node.type == "GROUP").inputs
    inputs["Strength"].default_value = strength
    inputs["Sigma S"].default_value = _triple(sigma_s)
    inputs["Sigma A"].default_value = _triple(sigma_a)
    inputs["G"].default_value = _triple(g)
    inputs["Replace"].default_value = mode == "REPLACE"
    target = inputs["Direct"]
    once = _triple(g)
    # Light that has scattered before goes about the way of the beam, its mean cosine to that is g.
    twice = tuple(v * v for v in once) if lobes is None else _triple(lobes)
    if lobes is not None:
        target = _insert_moments(material.node_tree, target)
    kinds = [(direct_grid, once), *([(forward_grid, twice)] if max(once) > 0 else [])]
    grids = [(grid(n), beam, own) for n, beam in enumerate(beams, 1) for grid, own in kinds]
    for number, (grid, beam, own) in enumerate(grids, 1):
        target = _insert_beam(material.node_tree, target, number, grid, beam, core, own)


def remove_unused():
    """Remove our materials and node groups that nothing uses."""
    for blocks in (bpy.data.materials, bpy.data.node_groups):
        while unused := [block for block in blocks if is_ours(block) and not block.users]:
            bpy.data.batch_remove(unused)  # which may have been all that used another


def _triple(value):
    """A spectral value as three bands."""
    value = list(value) if hasattr(value, "__len__") else [value]
    return value * 3 if len(value) == 1 else value


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


def _insert_beam(tree, target, number, name, beam, core, g):
    """Add a beam's grid, the `number`-th, from 1, to the socket `target`; the socket for the next
    one."""
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
    node.inputs["G"].default_value = g
    grid = new("ShaderNodeAttribute", 0)
    grid.attribute_name = name
    light = grid.outputs["Vector"]
    if isinstance(beam, Sun):
        length = math.hypot(*beam.direction)
        for axis, component in zip(AXES, beam.direction, strict=True):
            node.inputs[axis].default_value = (component / length,) * 3
    else:
        lamp = new("ShaderNodeGroup", 200)
        lamp.node_tree = lamp_group()
        lamp.inputs["Position"].default_value = beam.position
        lamp.inputs["Radius"].default_value = beam.radius
        lamp.inputs["Core"].default_value = core
        lamp.inputs["Peak"].default_value = beam.peak(core)
        tree.links.new(light, lamp.inputs["Intensity"])
        light = lamp.outputs["Light"]
        for axis in AXES:
            tree.links.new(lamp.outputs[axis], node.inputs[axis])
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
