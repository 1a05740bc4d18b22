# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes of lights: they have the values that the same nodes have in materials."""

import pytest

from lb_lighting.scene.lights.light_nodes import LightShader
from lb_lighting.scene.nodes.shaders import Shader
from tests.scene.nodes.sockets import COLORS, STRENGTHS
from tests.scene.trees import add_node, connect, make_material


@pytest.mark.parametrize("build", STRENGTHS.values(), ids=STRENGTHS)
def test_numbers_are_those_of_materials(build):
    material = make_material()
    tree = material.node_tree
    shader = add_node(tree, "ShaderNodeEmission", Strength=3.0)
    tree.links.new(build(tree), shader.inputs["Strength"])
    connect(material, shader, "Surface")
    numbers = []
    for reader in (Shader(material), LightShader(material)):
        (closure,) = reader.closures("Surface", {"EMISSION"})
        numbers.append(reader.number(closure, "Strength"))
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-12)


@pytest.mark.parametrize("build", COLORS.values(), ids=COLORS)
def test_colors_are_those_of_materials(build):
    material = make_material()
    tree = material.node_tree
    shader = add_node(tree, "ShaderNodeEmission", Color=(1, 0, 0))
    tree.links.new(build(tree), shader.inputs["Color"])
    connect(material, shader, "Surface")
    colors = []
    for reader in (Shader(material), LightShader(material)):
        (closure,) = reader.closures("Surface", {"EMISSION"})
        colors.append(reader.color(closure, "Color"))
    assert colors[0] == pytest.approx(colors[1], rel=1e-12)
