# SPDX-License-Identifier: GPL-3.0-or-later
"""Use LB Light keeps the transmission bounces that glass and water need, and no others."""

import bpy
import pytest

from lb_lighting.output.render_settings import leave_light, use_light
from tests import scenery
from tests.output.graphs import user_group
from tests.output.rendering import surface
from tests.output.test_lit_objects import lit_object


def water(weight=1.0):
    material = bpy.data.materials.new("water")
    material.node_tree.nodes["Principled BSDF"].inputs["Transmission Weight"].default_value = weight
    return material


def textured_water():
    material = water(0.0)
    tree = material.node_tree
    weight = tree.nodes["Principled BSDF"].inputs["Transmission Weight"]
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs["Factor"], weight)
    return material


def in_a_group(kind):
    material = surface("ShaderNodeBsdfDiffuse")
    tree = material.node_tree
    group = user_group(material, kind)
    tree.links.new(group.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return material


def grouped_water():
    """The group's own input makes it clear."""
    material = in_a_group("ShaderNodeBsdfPrincipled")
    node = next(n for n in material.node_tree.nodes if n.type == "GROUP")
    group = node.node_tree
    group.interface.new_socket("Clear", in_out="INPUT", socket_type="NodeSocketFloat")
    inside = group.nodes.new("NodeGroupInput")
    weight = group.nodes["Principled BSDF"].inputs["Transmission Weight"]
    group.links.new(inside.outputs[0], weight)
    node.inputs["Clear"].default_value = 0.5
    return material


def muted_glass():
    material = surface("ShaderNodeBsdfGlass")
    material.node_tree.nodes["Glass BSDF"].mute = True
    return material


CLEAR = {
    "glass": lambda: surface("ShaderNodeBsdfGlass"),
    "refraction": lambda: surface("ShaderNodeBsdfRefraction"),
    "water": water,
    "textured water": textured_water,
    "glass in a group": lambda: in_a_group("ShaderNodeBsdfGlass"),
    "water in a group": grouped_water,
}
OTHERS = {
    "dry": lambda: water(0.0),
    "a diffuse group": lambda: in_a_group("ShaderNodeBsdfDiffuse"),
    "muted glass": muted_glass,
    "a hole": lambda: surface("ShaderNodeBsdfTransparent"),
}


@pytest.mark.parametrize("name", [*CLEAR, *OTHERS])
def test_transmission_stays_where_a_material_is_clear(name):
    scene = bpy.context.scene
    lit_object(scene, scenery.leaf_material())
    (CLEAR | OTHERS)[name]()
    before = scene.cycles.transmission_bounces
    use_light(scene)
    assert scene.cycles.diffuse_bounces == 0
    assert scene.cycles.transmission_bounces == (before if name in CLEAR else 0)
    leave_light(scene)
    assert scene.cycles.transmission_bounces == before
