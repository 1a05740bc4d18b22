# SPDX-License-Identifier: GPL-3.0-or-later
"""Emission of volumes; output/test_light_levels.py compares it with Cycles."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.emission import BlackBody, Glow, black_body_color, shining, volume_glows
from lb_lighting.scene.grids.resample import Cells
from lb_lighting.scene.nodes.arithmetic import Scaled
from lb_lighting.transport.medium import Domain
from tests import scenery

LUMINANCE = np.array((0.2126, 0.7152, 0.0722))
DOMAIN = Domain((0, 0, 0), 0.5, (6, 6, 6))
RNG = np.random.default_rng(1)


def principled(**inputs):
    """A Principled Volume; a text for a number links the attribute of that name to it."""
    material = scenery.volume_material()
    tree = material.node_tree
    sockets = tree.nodes["Principled Volume"].inputs
    for name, value in inputs.items():
        socket = sockets[name.replace("_", " ")]
        if isinstance(value, str) and socket.type != "STRING":
            attribute = tree.nodes.new("ShaderNodeAttribute")
            attribute.attribute_name = value
            tree.links.new(attribute.outputs["Factor"], socket)
        else:
            socket.default_value = value
    return material


def cells(values):
    """A grid with voxels of 1 m; three along each edge fill the domain."""
    to_world = np.eye(4)
    to_world[:3, 3] = 0.5
    return Cells(np.asarray(values, np.float32), to_world)


def black(**inputs):
    (glow,) = volume_glows(principled(Blackbody_Intensity=1.0, **inputs))
    return glow


def test_none():
    assert volume_glows(None) == []
    assert volume_glows(principled()) == []
    assert volume_glows(principled(Emission_Strength=1.0, Emission_Color=(0, 0, 0, 1))) == []


def test_strength_times_color():
    (glow,) = volume_glows(principled(Emission_Strength=2.0, Emission_Color=(1, 0.5, 0.25, 1)))
    assert glow.color == pytest.approx((2, 1, 0.5))
    assert glow.grids == []


def test_attribute():
    (glow,) = volume_glows(principled(Emission_Strength="flame", Emission_Color=(1, 0.5, 0, 1)))
    assert glow == Glow((1, 0.5, 0), "flame")


@pytest.mark.parametrize("name", ["Emission Coefficients", "Emission"])
def test_other_nodes(name):
    material = scenery.volume_material()
    nodes = material.node_tree.nodes
    nodes.remove(nodes["Principled Volume"])
    if name == "Emission":
        node = nodes.new("ShaderNodeEmission")
        node.inputs["Color"].default_value = (0.5, 1, 0, 1)
        node.inputs["Strength"].default_value = 4
    else:
        node = nodes.new("ShaderNodeVolumeCoefficients")
        node.inputs[name].default_value = (2, 4, 0)
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    material.node_tree.links.new(node.outputs[0], output.inputs["Volume"])
    assert volume_glows(material) == [Glow((2, 4, 0))]


@pytest.mark.parametrize("kelvin", [1200, 2000, 6500])
def test_black_bodies_follow_the_stefan_boltzmann_law(kelvin):
    """In Cycles, a metre emits a millionth of the radiance of that law."""
    radiance = black().radiance({"temperature": np.array(kelvin / 1000)})
    assert LUMINANCE @ radiance == pytest.approx(5.670373e-14 / np.pi * kelvin**4, rel=1e-2)
    assert np.all(np.diff(radiance) < 0) == (kelvin < 6500)


def test_colors_of_black_bodies_are_those_of_blender():
    """They are those of lamps by temperature; outside Blender's range, those at its ends."""
    lamp = bpy.data.lights.new("lamp", "POINT")
    lamp.use_temperature = True
    temperatures, expected = np.geomspace(800, 12000, 300), []
    for lamp.temperature in temperatures:
        expected.append(tuple(lamp.temperature_color))
    assert black_body_color(temperatures) == pytest.approx(np.array(expected), abs=2e-3)
    for kelvin, end in ((0.0, expected[0]), (20000.0, expected[-1])):
        assert black_body_color(kelvin) == pytest.approx(end, abs=2e-3)


def test_settings_of_black_bodies():
    assert black(Temperature=2000.0).temperature == Scaled(2000.0, "temperature")
    assert black(Temperature_Attribute="heat").grids == ["heat"]
    (glow,) = volume_glows(principled(Blackbody_Intensity="flame"))
    assert isinstance(glow, BlackBody)
    assert set(glow.grids) == {"flame", "temperature"}
    full, none = (glow.radiance({"flame": np.array(f), "temperature": 2.0}) for f in (1.0, 0.0))
    assert full.max() > 0
    assert not none.any()
    with pytest.raises(SceneError, match="multiplies the temperature attributes"):
        volume_glows(principled(Blackbody_Intensity=1.0, Temperature="heat"))


def test_reading_changes_nothing():
    """A change would end a preview."""
    material = principled(Blackbody_Intensity=1.0)
    bpy.context.evaluated_depsgraph_get().update()
    updates = []

    def collect(_scene, depsgraph):
        updates.extend(depsgraph.updates)

    bpy.app.handlers.depsgraph_update_post.append(collect)
    try:
        assert volume_glows(material)
        bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(collect)
    assert updates == []
    assert not bpy.data.lights


def test_the_lattice_keeps_the_power():
    """It averages the emission of voxels, not their temperature."""
    heat = cells(RNG.random((3, 3, 3)) * [[[0]], [[1]], [[0]]] * 3)
    domain = Domain((-1, -1, -1), 0.5, (10, 10, 10))
    emission = shining([black()], {"temperature": heat}, heat, domain)
    expected = black().radiance({"temperature": heat.values}).sum(axis=(0, 1, 2))
    assert emission.sum(axis=(1, 2, 3)) * 0.5**3 == pytest.approx(expected, rel=1e-5)


def test_grids_of_different_sizes():
    flame = cells(np.ones((3, 3, 3)))
    heat = Cells(np.full((6, 6, 6), 1.5, np.float32), DOMAIN.index_to_world)
    (glow,) = volume_glows(principled(Blackbody_Intensity="flame"))
    both = shining([glow], {"flame": flame, "temperature": heat}, flame, DOMAIN)
    expected = glow.radiance({"flame": np.ones(()), "temperature": 1.5})
    assert both[:, 2, 3, 2] == pytest.approx(expected, rel=1e-5)


def test_missing_grids():
    """A missing flame is 0, and a missing temperature is the one of the node."""
    inside = cells(np.ones((3, 3, 3)))
    assert not shining([Glow((1, 1, 1), "flame")], {}, inside, DOMAIN).any()
    emission = shining([black(Temperature=1500.0)], {}, inside, DOMAIN)
    assert LUMINANCE @ emission[:, 2, 2, 2] == pytest.approx(
        5.670373e-14 / np.pi * 1500**4, rel=1e-2
    )
