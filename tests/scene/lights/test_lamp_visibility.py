# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps light what: ray visibility, light linking, and what nodes make of a lamp."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import LightError
from lb_lighting.scene.lights.lamps import scene_lights
from lb_lighting.scene.lights.receivers import Receivers, members
from lb_lighting.transport.lights.distant import Sky, Sun
from lb_lighting.transport.lights.lamps import PointLight
from tests import scenery
from tests.scene.against import even_world, over_cycles


def receivers(surfaces=(), volumes=()):
    kinds = (False,) * len(surfaces) + (True,) * len(volumes)
    return Receivers((*surfaces, *volumes), kinds, np.full(3, -1.0), np.full(3, 1.0))


def read(lit, notes=None):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    notes = [] if notes is None else notes
    return scene_lights(bpy.context.scene, depsgraph, notes, False, lit)


def add_point(**settings):
    lamp = bpy.data.lights.new("lamp", "POINT")
    for name, value in settings.items():
        setattr(lamp, name, value)
    return scenery.link("lamp", lamp)


def add_box(name="box"):
    return scenery.link(name, bpy.data.meshes.new(name))


def keep_to(lamp, *objects):
    """Link the light of `lamp` to these objects alone."""
    collection = bpy.data.collections.new("receivers")
    for ob in objects:
        collection.objects.link(ob)
    lamp.light_linking.receiver_collection = collection
    return collection


@pytest.mark.usefixtures("quick_look")
class TestAgainstCycles:
    def test_a_lamp_that_volumes_do_not_see_leaves_them_dark(self, tmp_path):
        even_world(0.3)
        scenery.add_sun().visible_volume_scatter = False
        assert over_cycles(tmp_path, scenery.add_fog(tmp_path)) == pytest.approx(1, abs=0.1)

    def test_a_lamp_that_surfaces_do_not_see_leaves_them_dark(self, tmp_path):
        even_world(0.3)
        scenery.add_sun().visible_diffuse = False
        assert over_cycles(tmp_path, scenery.add_leaves()) == pytest.approx(1, abs=0.1)

    def test_a_lamp_that_is_linked_to_another_leaves_it_dark(self, tmp_path):
        even_world(0.3)
        keep_to(scenery.add_sun(), add_box("other"))
        assert over_cycles(tmp_path, scenery.add_fog(tmp_path)) == pytest.approx(1, abs=0.1)


class TestRayVisibility:
    @pytest.mark.parametrize(
        ("ray", "lit", "count"),
        [("visible_diffuse", "surfaces", 0), ("visible_diffuse", "volumes", 1),
         ("visible_volume_scatter", "surfaces", 1), ("visible_volume_scatter", "volumes", 0),
         ("visible_glossy", "surfaces", 1), ("visible_transmission", "volumes", 1),
         ("visible_camera", "volumes", 1)],
    )  # fmt: skip
    def test_a_lamp_lights_what_sees_it(self, ray, lit, count):
        notes, lamp = [], scenery.add_sun()
        setattr(lamp, ray, False)
        assert len(read(receivers(**{lit: [add_box()]}), notes)) == count
        assert len(notes) == 1 - count
        assert not notes or "Ray Visibility" in notes[0]

    def test_a_lamp_lights_all_of_a_mixed_bake_and_is_named(self):
        notes = []
        scenery.add_sun().visible_diffuse = False
        assert len(read(receivers([add_box()], [add_box("fog")]), notes)) == 1
        assert len(notes) == 1
        assert "Ray Visibility of 'sun', bake volumes and surfaces separately" in notes[0]

    @pytest.mark.parametrize(
        ("ray", "lit", "count"),
        [("diffuse", "surfaces", 0), ("diffuse", "volumes", 1), ("scatter", "volumes", 0),
         ("scatter", "surfaces", 1), ("camera", "surfaces", 1)],
    )  # fmt: skip
    def test_a_world_lights_what_sees_it(self, ray, lit, count):
        setattr(even_world(1.0).cycles_visibility, ray, False)
        assert len(read(receivers(**{lit: [add_box()]}))) == count

    def test_the_refusal_of_a_dark_scene_says_what_was_left_out(self):
        scenery.add_sun().visible_volume_scatter = False
        depsgraph = bpy.context.evaluated_depsgraph_get()
        with pytest.raises(LightError, match=r"no light.*Ray Visibility.*'sun'"):
            scene_lights(bpy.context.scene, depsgraph, [], True, receivers(volumes=[add_box()]))

    def test_of_a_solid_what_fills_it_counts(self, tmp_path):
        from lb_lighting.scene.opening import open_sources
        from lb_lighting.scene.reader import Reader

        ball = scenery.add_ball(material=scenery.volume_material(), role="SOLID")
        leaves, fog = scenery.add_leaves(), scenery.add_fog(tmp_path)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        objects = [ball, leaves, fog]
        sources = open_sources(objects, Reader(depsgraph, "MATERIAL", 0.0, ""))
        lit = Receivers.of(objects, sources, depsgraph)
        assert lit.volumes == (True, False, True)
        assert lit.lower == pytest.approx((-1,) * 3, abs=0.1)
        assert lit.upper == pytest.approx((1,) * 3, abs=0.1)


class TestLightLinking:
    @pytest.mark.parametrize(
        ("states", "expected"),
        [({}, True), ({"box": "INCLUDE"}, True), ({"box": "EXCLUDE"}, False),
         ({"other": "INCLUDE"}, False), ({"other": "EXCLUDE"}, True),
         ({"other": "INCLUDE", "box": "EXCLUDE"}, False)],
    )  # fmt: skip
    def test_membership_is_that_of_blender(self, states, expected):
        collection, box = bpy.data.collections.new("set"), add_box()
        for name, state in states.items():
            collection.objects.link(box if name == "box" else add_box(name))
            collection.collection_objects[-1].light_linking.link_state = state
        assert members(collection, [box]) == [expected]

    @pytest.mark.parametrize(("state", "expected"), [("INCLUDE", True), ("EXCLUDE", False)])
    def test_a_child_collection_has_one_state_for_all_in_it(self, state, expected):
        collection, box = bpy.data.collections.new("set"), add_box()
        child, deep = bpy.data.collections.new("child"), bpy.data.collections.new("deep")
        collection.children.link(child)
        child.children.link(deep)
        deep.objects.link(box)
        deep.collection_objects[0].light_linking.link_state = "EXCLUDE"  # of no matter
        collection.collection_children[0].light_linking.link_state = state
        assert members(collection, [box]) == [expected]

    def test_one_that_lights_some_lights_all_and_is_named(self):
        notes, box, other = [], add_box(), add_box("other")
        keep_to(scenery.add_sun(), box)
        assert len(read(receivers([box, other]), notes)) == 1
        assert len(notes) == 1
        assert "Light Linking of 'sun'" in notes[0]
        assert len(read(receivers([box]), notes)) == 1
        assert len(notes) == 1

    def test_shadow_linking_is_told(self):
        notes, box, sun = [], add_box(), scenery.add_sun()
        sun.light_linking.blocker_collection = bpy.data.collections.new("blockers")
        assert len(read(receivers([box]), notes)) == 1
        assert notes == []
        sun.light_linking.blocker_collection.objects.link(add_box("other"))
        read(receivers([box]), notes)
        assert len(notes) == 1
        assert "cast shadows in the light of 'sun'" in notes[0]

    def test_a_lamp_without_shadows_or_with_few_bounces_is_told(self):
        notes, sun = [], scenery.add_sun()
        sun.data.use_shadow, sun.data.cycles.max_bounces = False, 2
        assert len(read(None, notes)) == 1
        assert len(notes) == 2

    def test_each_kind_is_one_sentence_that_names_all(self):
        notes = []
        for _ in range(7):
            scenery.add_sun().visible_diffuse = False
        read(receivers([add_box()]), notes)
        assert len(notes) == 1
        assert "'sun', 'sun.001', 'sun.002', 'sun.003', 'sun.004' and 2 more" in notes[0]


class TestLampNodes:
    def feed(self, owner, kind, name="Strength"):
        """A new node of that kind, which feeds the input `name` of what shines."""
        nodes = owner.node_tree.nodes
        node = nodes.new(kind)
        shader = next(n for n in nodes if n.type in {"EMISSION", "BACKGROUND"})
        owner.node_tree.links.new(node.outputs[0], shader.inputs[name])
        return node

    @pytest.mark.parametrize(
        ("kind", "name"),
        [("ShaderNodeTexIES", "Strength"), ("ShaderNodeTexNoise", "Color"),
         ("ShaderNodeAttribute", "Color")],
    )  # fmt: skip
    def test_what_cannot_be_read_counts_without_its_pattern_and_is_named(self, kind, name):
        notes, lamp = [], add_point(energy=10.0)
        node = self.feed(lamp.data, kind, name)
        assert read(None, notes) == [PointLight((0, 0, 0), 10.0)]
        assert len(notes) == 1
        assert f"'lamp' ({node.bl_label})" in notes[0]

    def test_a_pattern_times_a_number_counts_as_the_number(self):
        lamp = add_point(energy=10.0)
        node = self.feed(lamp.data, "ShaderNodeMath")
        node.operation, node.inputs[1].default_value = "MULTIPLY", 5.0
        ies = lamp.data.node_tree.nodes.new("ShaderNodeTexIES")
        ies.inputs["Strength"].default_value = 2.0
        lamp.data.node_tree.links.new(ies.outputs[0], node.inputs[0])
        (point,) = read(None)
        assert point.power == pytest.approx(100)

    def test_an_image_counts_as_its_mean_and_is_named(self):
        notes, lamp = [], add_point(energy=10.0)
        node = self.feed(lamp.data, "ShaderNodeTexImage", "Color")
        node.image = bpy.data.images.new("gobo", 2, 1, float_buffer=True)
        node.image.pixels = [1, 1, 1, 1, 0, 0, 0, 1]
        (point,) = read(None, notes)
        assert point.power == pytest.approx(5)
        assert "'lamp' (Image Texture)" in notes[0]

    def test_nodes_that_compute_a_constant_are_read(self, render):
        """Against Cycles, on white ground 3 m under it."""
        from tests.scene.lights.test_lamps import add_white_ground

        add_white_ground()
        lamp = add_point(energy=100.0, shadow_soft_size=0.0)
        lamp.location = (0, 0, 3)
        self.feed(lamp.data, "ShaderNodeBlackbody", "Color").inputs[0].default_value = 2500
        power = self.feed(lamp.data, "ShaderNodeMath")
        power.operation = "POWER"
        power.inputs[0].default_value, power.inputs[1].default_value = 1.5, 3.0
        notes = []
        (point,) = read(None, notes)
        assert notes == []
        expected = np.array(point.power) / (4 * np.pi * 3**2)
        assert render() * np.pi == pytest.approx(expected, rel=1e-2)

    def test_a_falloff_that_is_quadratic_changes_nothing(self):
        notes, lamp = [], add_point(energy=10.0)
        self.feed(lamp.data, "ShaderNodeLightFalloff").inputs[0].default_value = 3.0
        assert read(None, notes) == [PointLight((0, 0, 0), 30.0)]
        assert notes == []

    def test_a_group_without_an_output_is_dark_as_in_cycles(self):
        notes, lamp = [], add_point(energy=10.0)
        tree = bpy.data.node_groups.new("empty", "ShaderNodeTree")
        tree.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
        nodes = lamp.data.node_tree.nodes
        group = nodes.new("ShaderNodeGroup")
        group.node_tree = tree
        emission = next(n for n in nodes if n.type == "EMISSION")
        lamp.data.node_tree.links.new(group.outputs[0], emission.inputs["Strength"])
        assert read(None, notes) == []

    def test_nodes_that_share_inputs_are_read_once_each(self):
        """Forty sums of a value with itself: read by their paths, they are 2^40."""
        lamp = add_point(energy=10.0)
        nodes, links = lamp.data.node_tree.nodes, lamp.data.node_tree.links
        value = nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = 0.5**40
        socket = value.outputs[0]
        for _ in range(40):
            total = nodes.new("ShaderNodeMath")
            links.new(socket, total.inputs[0])
            links.new(socket, total.inputs[1])
            socket = total.outputs[0]
        emission = next(n for n in nodes if n.type == "EMISSION")
        links.new(socket, emission.inputs["Strength"])
        [found] = read(None, [])
        assert found.power == pytest.approx(10.0)

    def test_negative_lamps_are_left_out_and_named(self):
        notes = []
        add_point(energy=-5.0)
        add_point(energy=5.0)
        assert [lamp.power for lamp in read(None, notes)] == [5.0]
        assert len(notes) == 1
        assert "'lamp'" in notes[0]

    def test_a_lamp_is_not_lost_for_another_that_cannot_be_read(self):
        scenery.add_sun()
        self.feed(add_point(energy=10.0).data, "ShaderNodeTexNoise", "Color")
        assert {type(light) for light in read(None)} == {PointLight, Sun}


class TestWorldNodes:
    def mix(self, world, output, seen_by_camera):
        """The world as it is, or else a node of the kind `seen_by_camera`, by a Light Path."""
        tree = world.node_tree
        mix, path = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeLightPath")
        seen = tree.nodes.new("ShaderNodeBackground")
        color = tree.nodes.new(seen_by_camera)
        tree.links.new(color.outputs[0], seen.inputs["Color"])
        tree.links.new(path.outputs[output], mix.inputs[0])
        tree.links.new(tree.nodes["Background"].outputs[0], mix.inputs[1])
        tree.links.new(seen.outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
        return seen

    def test_what_the_camera_alone_sees_does_not_light(self):
        notes = []
        self.mix(even_world(0.5), "Is Camera Ray", "ShaderNodeTexSky")
        assert read(None, notes) == [Sky(0.5)]
        assert notes == []

    @pytest.mark.parametrize(
        ("output", "lit", "radiance"),
        [("Is Diffuse Ray", "surfaces", 2.0), ("Is Diffuse Ray", "volumes", 0.5),
         ("Is Volume Scatter Ray", "volumes", 2.0), ("Is Glossy Ray", "surfaces", 0.5)],
    )  # fmt: skip
    def test_each_kind_of_ray_sees_its_branch(self, output, lit, radiance):
        seen = self.mix(even_world(0.5), output, "ShaderNodeRGB")
        color = seen.inputs["Color"].links[0].from_socket
        color.default_value, seen.inputs["Strength"].default_value = (1, 1, 1, 1), 2.0
        assert read(receivers(**{lit: [add_box()]})) == [Sky(radiance)]

    def test_a_volume_is_told(self):
        notes, world = [], even_world(0.5)
        tree = world.node_tree
        fog = tree.nodes.new("ShaderNodeVolumeScatter")
        tree.links.new(fog.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
        assert read(None, notes) == [Sky(0.5)]
        assert len(notes) == 1
        assert "The volume of 'world' is left out" in notes[0]

    def test_a_view_layers_own_world_counts(self):
        even_world(0.5)
        own = even_world(2.0)
        bpy.context.scene.world = bpy.data.worlds["world"]
        bpy.context.view_layer.world_override = own
        assert read(None) == [Sky(2.0)]

    def test_a_negative_one_is_left_out(self):
        notes = []
        even_world(-1.0)
        assert read(None, notes) == []
        assert "negative light is not supported: 'world'" in notes[0]
