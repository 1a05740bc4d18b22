# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that only emit, or only absorb, compared with Cycles."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from tests import scenery
from tests.output.rendering import dark_scene, render
from tests.scene.trees import add_node, attribute, computed, connect, make_material


def emission(tree, **how):
    strength = computed(
        tree, "ShaderNodeMath", attribute(tree, "density"), 3.0, operation="MULTIPLY", **how
    )
    return add_node(tree, "ShaderNodeEmission", Color=(1, 0.4, 0.1), Strength=strength)


def absorption(tree):
    density = computed(
        tree, "ShaderNodeMath", attribute(tree, "density"), 2.0, operation="MULTIPLY"
    )
    return add_node(tree, "ShaderNodeVolumeAbsorption", Color=(0.9, 0.5, 0.2), Density=density)


MATTER = {
    "it shines": lambda tree: emission(tree, use_clamp=True),
    "it absorbs": absorption,
    "black bodies": lambda tree: add_node(
        tree, "ShaderNodeVolumePrincipled", Density=0.0, Blackbody_Intensity=1.0,
        Temperature=1500.0, Temperature_Attribute="density", Density_Attribute="heat",
    ),
}  # fmt: skip


@pytest.mark.parametrize("build", MATTER.values(), ids=MATTER)
def test_the_picture_is_that_of_cycles(build, scene, tmp_path):
    dark_scene((0, -10, 0), (np.pi / 2, 0, 0), 3)
    background = scene.world.node_tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.2, 0.3, 0.4, 1)
    output = scene.world.node_tree.nodes.new("ShaderNodeOutputWorld")
    scene.world.node_tree.links.new(background.outputs[0], output.inputs[0])
    ob = scenery.add_fog(tmp_path, material=False)
    material = make_material()
    ob.data.materials.append(connect(material, build(material.node_tree), "Volume"))
    scene.cycles.volume_biased = True
    expected = render(scene, tmp_path / "cycles.exr", 16, 16)
    outcome = scenery.bake_light(ob, resolution=12)
    assert not any("no volume material" in note for note in outcome.notes)
    ours = render(scene, tmp_path / "ours.exr", 16, 16)
    assert ours.mean(axis=(0, 1)) == pytest.approx(expected.mean(axis=(0, 1)), rel=0.03)
    assert np.linalg.norm(ours - expected) / np.linalg.norm(expected) < 0.05


def test_a_volume_of_nothing_is_refused(scene, tmp_path):
    ob = scenery.add_fog(tmp_path, material=False)
    ob.data.materials.append(scenery.volume_material(density=0.0))
    with pytest.raises(SceneError, match="There is no density to light here"):
        scenery.bake_light(ob)


def test_leaves_are_lit_by_what_only_shines(scene, tmp_path):
    """There is no sun, and only the leaves scatter."""
    bpy.data.objects.remove(bpy.data.objects["sun"])
    leaves, glow = scenery.add_leaves(), scenery.add_fog(tmp_path, material=False)
    material = make_material()
    shader = emission(material.node_tree)
    glow.data.materials.append(connect(material, shader, "Volume"))
    scenery.bake_light(leaves, glow, resolution=12)
    assert scenery.ambient(leaves).mean(axis=0).min() > 0
