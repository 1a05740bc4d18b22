# SPDX-License-Identifier: GPL-3.0-or-later
"""Densities that node trees compute from a grid, checked against Cycles."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.materials import volume_optics
from lb_lighting.scene.nodes.arithmetic import Scaled
from lb_lighting.scene.nodes.shaders import Shader
from tests import scenery
from tests.scene.nodes.sockets import MATH, MIX, muted, number
from tests.scene.trees import add_node, attribute, computed, connect, make_material


class TestDensities:
    """Numbers times an attribute, written with different nodes."""

    def density(self, build):
        material = make_material("fog")
        tree = material.node_tree
        scatter = add_node(tree, "ShaderNodeVolumeScatter", Density=build(tree))
        shader = Shader(connect(material, scatter, "Volume"))
        (closure,) = shader.closures("Volume", {"VOLUME_SCATTER"})
        return shader.scaled_attribute(closure, "Density")

    @pytest.mark.parametrize(
        ("values", "settings", "expected"),
        [
            ((1.0, 2.0), {"operation": "ADD"}, "'Math'"),
            ((2.0, 0.0), {"operation": "POWER"}, "'Math'"),
            ((-1.0, 2.0), {"operation": "MAXIMUM"}, "'Math'"),
            ((0.0, 0.0), {"operation": "ADD"}, Scaled(1.0, "smoke")),
        ],
    )
    def test_of_sums_and_powers(self, values, settings, expected):
        def build(tree):
            return computed(tree, MATH, attribute(tree, "smoke"), values[0] or 0.0, **settings)

        if isinstance(expected, Scaled):
            assert self.density(build) == expected
        elif settings["operation"] == "MAXIMUM":
            assert self.density(build) == Scaled(1.0, "smoke")
        else:
            with pytest.raises(SceneError, match=f"its density with the node {expected}"):
                self.density(build)

    def test_two_grids_are_refused(self):
        def build(tree):
            factors = attribute(tree, "smoke"), attribute(tree, "heat")
            return computed(tree, MATH, *factors, operation="MULTIPLY")

        with pytest.raises(SceneError, match="'fog' computes its density with the node 'Math'"):
            self.density(build)

    def test_an_attribute_without_a_name_is_refused(self):
        with pytest.raises(SceneError, match="its density with the node 'Attribute'"):
            self.density(lambda tree: attribute(tree, ""))

    def test_alpha_and_the_color_of_volume_info_are_refused(self):
        with pytest.raises(SceneError, match="its density with the node 'Attribute'"):
            self.density(lambda tree: attribute(tree, "smoke", "Alpha"))
        with pytest.raises(SceneError, match="its density with the node 'Volume Info'"):
            self.density(lambda tree: tree.nodes.new("ShaderNodeVolumeInfo").outputs["Color"])


def times(tree, source, factor, **settings):
    return computed(tree, MATH, source, factor, operation="MULTIPLY", **settings)


def smoke(tree, output="Factor"):
    return attribute(tree, "density", output)


DENSITIES = {  # with a grid of density 0.5
    "a product, clamped": lambda tree: times(tree, smoke(tree), 6.0, use_clamp=True),
    "a product below the clamp": lambda tree: times(tree, smoke(tree), 1.5, use_clamp=True),
    "clamped, then scaled": lambda tree: times(
        tree, times(tree, smoke(tree), 6.0, use_clamp=True), 0.7
    ),
    "scaled on both sides": lambda tree: times(
        tree, times(tree, times(tree, smoke(tree), 3.0), 2.0), number(tree, 0.3)
    ),
    "clamped twice": lambda tree: times(
        tree, times(tree, smoke(tree), 6.0, use_clamp=True), 3.0, use_clamp=True
    ),
    "a negative number": lambda tree: times(tree, smoke(tree), -2.0),
    "a negative number twice": lambda tree: times(tree, times(tree, smoke(tree), -2.0), -1.5),
    "a negative number, clamped": lambda tree: times(
        tree, times(tree, smoke(tree), -2.0, use_clamp=True), -1.5
    ),
    "a quotient": lambda tree: computed(tree, MATH, smoke(tree), 0.4, operation="DIVIDE"),
    "the smaller": lambda tree: computed(tree, MATH, smoke(tree), 0.2, operation="MINIMUM"),
    "a clamp": lambda tree: computed(tree, "ShaderNodeClamp", smoke(tree), 0.0, 0.3),
    "a mix with a factor of 1": lambda tree: computed(tree, MIX, 1.0, 9.0, smoke(tree)),
    "a mix with zero": lambda tree: computed(tree, MIX, 0.25, smoke(tree), 0.0),
    "a color, scaled": lambda tree: computed(
        tree, "ShaderNodeVectorMath", smoke(tree, "Color"), 3.0, operation="SCALE"
    ),
    "a vector, times a grey": lambda tree: computed(
        tree, "ShaderNodeVectorMath", smoke(tree, "Vector"), (2, 2, 2), operation="MULTIPLY"
    ),
    "a muted product": lambda tree: muted(tree, MATH, smoke(tree), 6.0, operation="MULTIPLY"),
}


@pytest.mark.parametrize("build", DENSITIES.values(), ids=DENSITIES)
def test_densities_are_those_of_cycles(build, tmp_path, render):
    """Through a fog without light, the world has a brightness of e^-tau."""
    material = make_material()
    absorption = add_node(material.node_tree, "ShaderNodeVolumeAbsorption", Color=(0.8, 0.8, 0.8))
    socket = build(material.node_tree)
    material.node_tree.links.new(socket, absorption.inputs["Density"])
    ob = scenery.add_fog(tmp_path, np.full((40, 40, 40), 0.5), material=False)
    ob.data.materials.append(connect(material, absorption, "Volume"))
    scene = bpy.context.scene
    scene.camera.location = (4, 4, 20)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1
    scene.cycles.samples, scene.cycles.volume_biased = 1, True
    depth = -np.log(render()[0])
    fog = volume_optics(material)
    density = Scaled(1.0, fog.density_attribute, fog.limit).of({"density": 0.5})
    # The fog is 10 m deep, and its border is blurred by half a voxel.
    assert 10 * density * fog.optics.sigma_a == pytest.approx(depth, rel=0.03, abs=1e-3)
