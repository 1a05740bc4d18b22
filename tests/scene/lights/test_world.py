# SPDX-License-Identifier: GPL-3.0-or-later
"""The world as a light, checked against Cycles."""

from math import pi

import bpy
import numpy as np
import pytest
from mathutils import Euler

from lb_lighting.errors import LightError
from lb_lighting.transport.lights.base import bands_of
from lb_lighting.transport.lights.distant import Sky, Sun
from tests.scene.lights.scenes import (
    add_environment,
    add_mapping,
    add_sun,
    add_white_ground,
    add_world,
    irradiance,
    lights,
)


class TestWorld:
    def test_color_times_strength(self):
        add_world((0.5, 0.25, 1), 2.0)
        (sky,) = lights()
        assert isinstance(sky, Sky)
        assert sky.radiance == pytest.approx((1, 0.5, 2))

    def test_grey_is_a_scalar(self):
        add_world(strength=0.5)
        assert lights() == [Sky(0.5)]

    def test_beside_a_sun(self):
        add_world(strength=0.5)
        add_sun(energy=2.0)
        assert [type(light) for light in lights()] == [Sun, Sky]
        assert [light.spectrum for light in lights()] == [2, 0.5]

    def test_an_environment_becomes_a_sky(self):
        """Radiance 1 above 45 degrees of latitude."""
        pixels = np.zeros((64, 8, 4))
        pixels[48:] = 1
        add_environment(add_world(), pixels)
        (sky,) = lights()
        assert sky.towards((0, 0, 1)) == pytest.approx(1, rel=1e-2)
        assert sky.towards((0.8, 0, 0.6)) == 0
        assert irradiance([sky], (0, 0, 1)) == pytest.approx((pi / 2,) * 3, rel=5e-3)

    @pytest.mark.parametrize(
        ("kind", "rotation"),
        [(None, None), ("POINT", (0, 0, 0.8)), ("POINT", (0.5, -0.9, 2.1)),
         ("TEXTURE", (0.5, -0.9, 2.1)), ("VECTOR", (0, 0, -2.5))],
    )  # fmt: skip
    def test_an_environment_lights_as_in_cycles(self, kind, rotation, render):
        """A tilted ground under a coloured sky with a small sun in it, for several rotations."""
        add_white_ground()
        bpy.context.object.rotation_euler = Euler((0.6, -0.5, 0))
        normal = np.array(bpy.context.object.rotation_euler.to_matrix().col[2])
        row, column = np.indices((64, 128))
        pixels = np.ones((64, 128, 4))
        pixels[..., :3] = np.stack((row / 64, column / 128, np.ones_like(row)), axis=-1)
        pixels[40:42, 30:32, :3] = (2000, 1000, 500)
        render()  # makes the camera, and a world that the next line replaces
        world = add_world(strength=0.5)
        environment = add_environment(world, pixels)
        if kind:
            add_mapping(environment, kind, rotation)
        sky_lights = lights()
        assert {type(light) for light in sky_lights} == {Sun, Sky}
        bpy.context.scene.cycles.samples = 1024
        assert render() * pi == pytest.approx(irradiance(sky_lights, normal), rel=2e-2)

    def test_a_grey_environment_is_one_band(self):
        pixels = np.ones((8, 16, 4)) * np.linspace(0, 1, 16)[:, None]
        add_environment(add_world(strength=2.0), pixels)
        (sky,) = lights()
        assert bands_of(sky) == 1
        add_environment(add_world((1, 1, 1)), pixels * (1, 0.5, 1, 1))
        assert bands_of(lights()[0]) == 3

    def test_an_environment_with_another_mapping_becomes_its_mean_color(self):
        pixels = np.zeros((64, 8, 4))
        pixels[48:] = 1
        environment, notes = add_environment(add_world(), pixels), []
        mapping = add_mapping(environment, "POINT", (0, 0, 1))
        mapping.inputs["Scale"].default_value = (1, 1, 2)
        (sky,) = lights(notes)
        assert sky.radiance == pytest.approx((1 - np.sqrt(0.5)) / 2, rel=1e-3)
        assert len(notes) == 1
        assert "'world' is baked as its mean colour" in notes[0]

    def test_missing_image_is_refused(self):
        world = add_world()
        add_environment(world, np.ones((2, 2, 4))).image = None
        with pytest.raises(LightError, match=r"'world'.*not loaded"):
            lights()

    def test_sky_texture_is_refused(self):
        world = add_world()
        tree = world.node_tree
        sky = tree.nodes.new("ShaderNodeTexSky")
        tree.links.new(sky.outputs[0], tree.nodes["Background"].inputs["Color"])
        with pytest.raises(
            LightError, match=r"'Sky Texture'.*; use a constant value or an image\.$"
        ):
            lights()

    def test_other_shaders_than_background_are_refused(self):
        tree = add_world().node_tree
        shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
        output = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
        tree.links.new(shader.outputs[0], output.inputs["Surface"])
        with pytest.raises(LightError, match=r"'Diffuse BSDF'.*; replace it\.$"):
            lights()

    def test_no_light_at_all(self):
        with pytest.raises(LightError, match="no light"):
            lights()
        add_world((0, 0, 0))
        with pytest.raises(LightError, match="no light"):
            lights()
