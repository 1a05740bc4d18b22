# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, checked against Cycles."""

from math import pi, radians

import bpy
import numpy as np
import pytest
from mathutils import Euler

from lb_lighting.errors import LightError
from lb_lighting.scene.lights.lamps import scene_lights
from lb_lighting.transport import Medium
from lb_lighting.transport.lights.distant import Sun
from lb_lighting.transport.lights.lamps import AreaLight, PointLight, SpotLight
from tests.scene.lights.scenes import add_lamp, add_sun, add_white_ground, lights


class TestSuns:
    @pytest.mark.parametrize(
        "settings",
        [
            {"energy": 2.0, "color": (1, 0.5, 0.25)},
            {"energy": 1.5, "exposure": 1.0, "use_temperature": True, "temperature": 3000},
            {"energy": 4.0, "normalize": False, "angle": radians(30)},
            {"energy": 4.0, "normalize": False, "angle": 0.0},
        ],
    )
    def test_irradiance_is_that_of_cycles(self, settings, render):
        """A white diffuse ground reflects irradiance over pi."""
        add_white_ground()
        add_sun(**settings)
        (sun,) = lights()
        assert render() * pi == pytest.approx(np.broadcast_to(sun.irradiance, 3), rel=1e-2)

    def test_strength_and_color_of_its_nodes(self, render):
        add_white_ground()
        lamp = add_sun(energy=2.0).data
        emission = lamp.node_tree.nodes["Emission"]
        emission.inputs["Color"].default_value = (1, 0.5, 0, 1)
        emission.inputs["Strength"].default_value = 3
        (sun,) = lights()
        assert sun.irradiance == pytest.approx((6, 3, 0))
        assert render() * pi == pytest.approx(sun.irradiance, rel=1e-2)

    def test_grey_is_a_scalar(self):
        add_sun(energy=2.0)
        assert lights() == [Sun((0, 0, -1), 2.0)]

    def test_direction_is_that_of_its_light(self):
        rotation = Euler((0.5, -0.3, 1.2))
        add_sun(rotation=rotation)
        (sun,) = lights()
        assert sun.direction == pytest.approx(-rotation.to_matrix().col[2])

    def test_instances(self):
        collection = bpy.data.collections.new("lamps")
        add_sun(collection)
        empty = bpy.data.objects.new("empty", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.rotation_euler = (pi / 2, 0, 0)
        bpy.context.collection.objects.link(empty)
        (sun,) = lights()
        assert sun.direction == pytest.approx((0, 1, 0), abs=1e-6)

    def test_hidden_lamps_are_left_out(self):
        add_sun(energy=1.0)
        add_sun(energy=2.0).hide_render = True
        collection = bpy.data.collections.new("off")
        bpy.context.scene.collection.children.link(collection)
        add_sun(collection, energy=3.0)
        collection.hide_render = True
        add_sun(energy=0.0)
        assert [sun.irradiance for sun in lights()] == [1.0]

    def test_lamps_hidden_in_viewports_only_are_included(self):
        """Hidden by the object, its collection or the eye icon; placed as at the current frame."""
        scene, parent = bpy.context.scene, bpy.data.objects.new("parent", None)
        scene.collection.objects.link(parent)
        parent.rotation_euler = (pi / 2, 0, 0)
        add_sun(energy=1.0).hide_viewport = True
        collection = bpy.data.collections.new("off")
        scene.collection.children.link(collection)
        add_sun(collection, energy=2.0).parent = parent
        collection.hide_viewport = True
        moving = add_sun(energy=3.0)
        moving.keyframe_insert("rotation_euler", frame=1)
        moving.rotation_euler = (0, pi / 2, 0)
        moving.keyframe_insert("rotation_euler", frame=2)
        moving.hide_viewport = True
        eye = add_sun(energy=4.0, rotation=(pi, 0, 0))
        eye.hide_set(True)
        scene.frame_set(2)
        names = set(bpy.data.objects.keys())
        directions = {sun.irradiance: sun.direction for sun in lights()}
        assert directions == {
            1.0: pytest.approx((0, 0, -1)),
            2.0: pytest.approx((0, 1, 0), abs=1e-6),
            3.0: pytest.approx((-1, 0, 0), abs=1e-6),
            4.0: pytest.approx((0, 0, 1), abs=1e-6),
        }
        assert set(bpy.data.objects.keys()) == names
        assert moving.hide_viewport
        assert collection.hide_viewport

    def test_a_lamp_in_two_collections_counts_once(self):
        collection = bpy.data.collections.new("too")
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(add_sun())
        assert len(lights()) == 1

    def test_a_lamp_in_an_excluded_collection_is_left_out(self):
        collection = bpy.data.collections.new("out")
        bpy.context.scene.collection.children.link(collection)
        add_sun(collection, energy=2.0)
        bpy.context.view_layer.layer_collection.children["out"].exclude = True
        add_sun(energy=1.0)
        assert [sun.irradiance for sun in lights()] == [1.0]


class TestPoints:
    HEIGHT = 3.0  # m above the ground; the picture shows 0.25 m around the point below

    @pytest.mark.parametrize(
        "settings",
        [
            {"energy": 200.0, "color": (1, 0.5, 0.25)},
            {"energy": 100.0, "exposure": 1.0, "use_temperature": True, "temperature": 3000},
            {"energy": 200.0, "shadow_soft_size": 0.2, "use_soft_falloff": False},
            {"energy": 200.0, "normalize": False, "shadow_soft_size": 0.1},
            {"energy": 200.0, "normalize": False, "shadow_soft_size": 0.0},
        ],
    )
    def test_power_is_that_of_cycles(self, settings, render):
        """A white diffuse ground reflects power / (4 pi distance^2) over pi.

        The mean over the picture is 0.25 % less than the value right below the lamp.
        """
        add_white_ground()
        add_lamp("POINT", (0, 0, self.HEIGHT), **settings)
        (point,) = lights()
        irradiance = np.broadcast_to(point.power, 3) / (4 * pi * self.HEIGHT**2)
        assert render() * pi == pytest.approx(irradiance, rel=1e-2)

    def test_position(self):
        parent = bpy.data.objects.new("parent", None)
        bpy.context.collection.objects.link(parent)
        parent.location = (1, 2, 3)
        add_lamp("POINT", (0.5, 0, 0), energy=10.0).parent = parent
        assert lights() == [PointLight((1.5, 2, 3), 10.0)]

    def test_the_radius_counts_with_soft_falloff(self):
        for kind in ("POINT", "SPOT"):
            add_lamp(kind, (0, 0, 0), energy=10.0, shadow_soft_size=0.25)
            add_lamp(kind, (0, 0, 0), energy=10.0, shadow_soft_size=0.25, use_soft_falloff=False)
        assert [lamp.radius for lamp in lights()] == [0.25, 0.0] * 2


def falloff(cosine, angle, blend):
    """(n,): a spot's smoothstep from the edge of its cone to the end of its soft border."""
    edge = np.cos(angle / 2)
    share = np.clip((cosine - edge) / max(blend * (1 - edge), 1e-9), 0, 1)
    return 3 * share**2 - 2 * share**3


class TestSpots:
    HEIGHT = 3.0  # m above the ground

    @pytest.mark.parametrize(
        ("tilt", "settings", "scale"),
        [
            (0.0, {"color": (1, 0.5, 0.25), "spot_blend": 1.0}, 1),
            (0.2, {"use_temperature": True, "temperature": 3000, "spot_blend": 0.6}, 2),
            (0.24, {"shadow_soft_size": 0.0, "spot_blend": 1.0}, 1),
            (0.2, {"normalize": False, "shadow_soft_size": 0.02, "spot_blend": 0.15}, 1),
            (0.0, {"normalize": False, "shadow_soft_size": 0.0}, 1),
        ],
    )
    def test_light_is_that_of_cycles(self, tilt, settings, scale, render):
        """On a white diffuse ground; the picture shows 0.25 m around the point below the lamp."""
        add_white_ground()
        settings = {"shadow_soft_size": 0.0, "energy": 300.0, "spot_size": 0.6} | settings
        ob = add_lamp("SPOT", (0, 0, self.HEIGHT), **settings)
        ob.rotation_euler, ob.scale = (tilt, 0, 0), (scale,) * 3
        (spot,) = lights()
        x, y = (np.indices((64, 64)) + 0.5).reshape(2, -1) / 64 * 0.5 - 0.25
        ray = np.stack((x, y, np.full(x.size, -self.HEIGHT)), axis=1)
        length = np.linalg.norm(ray, axis=1)
        cosine = ray @ spot.direction / length / np.linalg.norm(spot.direction)
        share = falloff(cosine, spot.angle, spot.blend) * self.HEIGHT / length**3
        irradiance = np.broadcast_to(spot.power, 3) / (4 * pi) * share.mean()
        assert render() * pi == pytest.approx(irradiance, rel=1e-2)

    def test_position_and_direction(self):
        ob = add_lamp("SPOT", (1, 2, 3), energy=10.0, spot_size=1.0, spot_blend=0.25)
        ob.rotation_euler = rotation = Euler((0.5, -0.3, 1.2))
        (spot,) = lights()
        assert isinstance(spot, SpotLight)
        assert spot.position == (1, 2, 3)
        assert spot.direction == pytest.approx(-rotation.to_matrix().col[2])
        assert (spot.angle, spot.power, spot.blend) == pytest.approx((1.0, 10.0, 0.25))

    def test_stretching_widens_the_cone(self):
        add_lamp("SPOT", spot_size=1.0).scale = (2, 2, 1)
        (spot,) = lights()
        assert np.tan(spot.angle / 2) == pytest.approx(2 * np.tan(0.5))

    def test_a_note_names_spots_with_uneven_cones(self):
        add_lamp("SPOT").scale = (2, 2, 1)
        add_lamp("SPOT").scale = (2, 1, 1)
        skewed = add_lamp("SPOT")
        skewed.rotation_euler = (0.5, 0, 0)
        skewed.parent = add_lamp("POINT")
        skewed.parent.scale = (1, 2, 1)
        notes = []
        bpy.context.view_layer.update()
        scene_lights(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), notes)
        (note,) = [note for note in notes if "round cone" in note]
        assert "'spot.001', 'spot.002'" in note


class TestAreas:
    HEIGHT = 2.0  # m above the ground; the picture shows 0.25 m around the point below

    @pytest.mark.parametrize(
        "settings",
        [
            {"shape": "SQUARE", "size": 0.5, "color": (1, 0.5, 0.25)},
            {"shape": "RECTANGLE", "size": 1.0, "size_y": 0.3, "exposure": 1.0},
            {"shape": "DISK", "size": 1.2},
            {"shape": "ELLIPSE", "size": 0.4, "size_y": 1.0, "normalize": False},
            {"shape": "RECTANGLE", "size": 1.0, "size_y": 0.3, "normalize": False},
            {"shape": "DISK", "size": 0.5, "spread": radians(80)},
        ],
    )
    @pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 2, 3)])
    def test_light_is_that_of_cycles(self, settings, scale, render):
        """On a white diffuse ground, compared with our photons that hit the visible part."""
        add_white_ground()
        ob = add_lamp("AREA", (0, 0, self.HEIGHT), energy=100.0, **settings)
        ob.scale, ob.rotation_euler = scale, (0, 0, 0.7)
        (area,) = lights()
        medium = Medium(np.zeros((4, 4, 4)), 0.125, (1, 1, 1), 0, origin=(-0.25, -0.25, 0))
        irradiance = [self.power_on_ground(area, medium, band) / 0.25 for band in range(3)]
        assert render() * pi == pytest.approx(irradiance, rel=1e-2)

    def power_on_ground(self, area, medium, band):
        origins, toward, power = area.emit(2**18, medium, np.random.default_rng(1), band)
        toward[:, 2] = np.minimum(toward[:, 2], -1e-9)
        ends = origins - origins[:, 2:] / toward[:, 2:] * toward
        return power[np.all(abs(ends[:, :2]) < 0.25, axis=1)].sum()

    def test_position_and_direction(self):
        ob = add_lamp("AREA", (1, 2, 3), energy=10.0, shape="RECTANGLE", size=2.0, size_y=0.5)
        ob.rotation_euler = rotation = Euler((0.5, -0.3, 1.2))
        (area,) = lights()
        assert isinstance(area, AreaLight)
        assert area.center == (1, 2, 3)
        assert np.cross(area.u, area.v) == pytest.approx(-rotation.to_matrix().col[2])
        assert area.u == pytest.approx(0.5 * rotation.to_matrix().col[1])
        assert (area.power, area.ellipse, area.spread) == (10.0, False, pytest.approx(pi))

    @pytest.mark.parametrize(
        "scale", [(-1, 1, 1), (1, 1, -1), (-1, -1, -1), (-1, -1, 1), (1, 1, 0)]
    )
    def test_mirrored_lamps_emit_to_the_side_of_cycles(self, scale):
        add_lamp("AREA", size=1.0).scale = scale
        (area,) = lights()
        assert np.cross(area.u, area.v) == pytest.approx((0, 0, -1 if scale[2] >= 0 else 1))

    @pytest.mark.parametrize("kind", ["SUN", "SPOT", "AREA"])
    def test_a_lamp_scaled_to_zero_is_left_out(self, kind):
        add_lamp(kind).scale = (0, 0, 0)
        add_sun(energy=2.0)
        notes = []
        (sun,) = lights(notes)
        assert sun.irradiance == pytest.approx(2.0)
        assert notes == [f"Left out, because they are scaled to zero: '{kind.lower()}'."]

    def test_portals_are_left_out(self):
        add_lamp("AREA").data.cycles.is_portal = True
        with pytest.raises(LightError, match="no light"):
            lights()
