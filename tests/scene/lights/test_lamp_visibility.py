# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps light which objects (ray visibility, light linking), and the nodes of lamps."""

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
    """Link the light of `lamp` to these objects only."""
    collection = bpy.data.collections.new("receivers")
    for ob in objects:
        collection.objects.link(ob)
    lamp.light_linking.receiver_collection = collection
    return collection


@pytest.mark.usefixtures("quick_look")
class TestAgainstCycles:
    def test_a_lamp_hidden_from_volumes_does_not_light_them(self, tmp_path):
        even_world(0.3)
        scenery.add_sun().visible_volume_scatter = False
        assert over_cycles(tmp_path, scenery.add_fog(tmp_path)) == pytest.approx(1, abs=0.1)

    def test_a_lamp_hidden_from_surfaces_does_not_light_them(self, tmp_path):
        even_world(0.3)
        scenery.add_sun().visible_diffuse = False
        assert over_cycles(tmp_path, scenery.add_leaves()) == pytest.approx(1, abs=0.1)

    def test_a_lamp_linked_to_another_object_does_not_light_this_one(self, tmp_path):
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
    def test_a_lamp_lights_what_it_is_visible_to(self, ray, lit, count):
        notes, lamp = [], scenery.add_sun()
        setattr(lamp, ray, False)
        assert len(read(receivers(**{lit: [add_box()]}), notes)) == count
        assert len(notes) == 1 - count
        assert not notes or "Ray Visibility" in notes[0]

    def test_a_lamp_lights_all_of_a_mixed_bake_with_a_note(self):
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
    def test_a_world_lights_what_it_is_visible_to(self, ray, lit, count):
        setattr(even_world(1.0).cycles_visibility, ray, False)
        assert len(read(receivers(**{lit: [add_box()]}))) == count

    def test_the_error_of_a_dark_scene_names_what_was_left_out(self):
        scenery.add_sun().visible_volume_scatter = False
        depsgraph = bpy.context.evaluated_depsgraph_get()
        with pytest.raises(LightError, match=r"no light.*Ray Visibility.*'sun'"):
            scene_lights(bpy.context.scene, depsgraph, [], True, receivers(volumes=[add_box()]))

    def test_a_solid_with_a_volume_material_counts_as_a_volume(self, tmp_path):
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
    def test_the_state_of_a_child_collection_holds_for_all_its_objects(self, state, expected):
        collection, box = bpy.data.collections.new("set"), add_box()
        child, deep = bpy.data.collections.new("child"), bpy.data.collections.new("deep")
        collection.children.link(child)
        child.children.link(deep)
        deep.objects.link(box)
        deep.collection_objects[0].light_linking.link_state = "EXCLUDE"  # ignored
        collection.collection_children[0].light_linking.link_state = state
        assert members(collection, [box]) == [expected]

    def test_a_lamp_linked_to_one_object_lights_all_with_a_note(self):
        notes, box, other = [], add_box(), add_box("other")
        keep_to(scenery.add_sun(), box)
        assert len(read(receivers([box, other]), notes)) == 1
        assert len(notes) == 1
        assert "Light Linking of 'sun'" in notes[0]
        assert len(read(receivers([box]), notes)) == 1
        assert len(notes) == 1

    def test_shadow_linking_gives_a_note(self):
        notes, box, sun = [], add_box(), scenery.add_sun()
        sun.light_linking.blocker_collection = bpy.data.collections.new("blockers")
        assert len(read(receivers([box]), notes)) == 1
        assert notes == []
        sun.light_linking.blocker_collection.objects.link(add_box("other"))
        read(receivers([box]), notes)
        assert len(notes) == 1
        assert "cast shadows in the light of 'sun'" in notes[0]

    def test_missing_shadows_and_few_bounces_give_notes(self):
        notes, sun = [], scenery.add_sun()
        sun.data.use_shadow, sun.data.cycles.max_bounces = False, 2
        assert len(read(None, notes)) == 1
        assert len(notes) == 2

    def test_one_note_names_all_lamps_of_a_kind(self):
        notes = []
        for _ in range(7):
            scenery.add_sun().visible_diffuse = False
        read(receivers([add_box()]), notes)
        assert len(notes) == 1
        assert "'sun', 'sun.001', 'sun.002', 'sun.003', 'sun.004' and 2 more" in notes[0]


class TestLampNodes:
    def link(self, owner, kind, name="Strength"):
        """A new node of that kind, linked to the input `name` of the emission or background."""
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
    def test_an_unsupported_pattern_is_ignored_with_a_note(self, kind, name):
        notes, lamp = [], add_point(energy=10.0)
        node = self.link(lamp.data, kind, name)
        assert read(None, notes) == [PointLight((0, 0, 0), 10.0)]
        assert len(notes) == 1
        assert f"'lamp' ({node.bl_label})" in notes[0]

    def test_a_pattern_times_a_number_becomes_the_number(self):
        lamp = add_point(energy=10.0)
        node = self.link(lamp.data, "ShaderNodeMath")
        node.operation, node.inputs[1].default_value = "MULTIPLY", 5.0
        ies = lamp.data.node_tree.nodes.new("ShaderNodeTexIES")
        ies.inputs["Strength"].default_value = 2.0
        lamp.data.node_tree.links.new(ies.outputs[0], node.inputs[0])
        (point,) = read(None)
        assert point.power == pytest.approx(100)

    def test_an_image_becomes_its_mean_with_a_note(self):
        notes, lamp = [], add_point(energy=10.0)
        node = self.link(lamp.data, "ShaderNodeTexImage", "Color")
        node.image = bpy.data.images.new("gobo", 2, 1, float_buffer=True)
        node.image.pixels = [1, 1, 1, 1, 0, 0, 0, 1]
        (point,) = read(None, notes)
        assert point.power == pytest.approx(5)
        assert "'lamp' (Image Texture)" in notes[0]

    def test_nodes_with_a_constant_result_are_computed(self, render):
        """Compared with Cycles on white ground 3 m below the lamp."""
        from tests.scene.lights.scenes import add_white_ground

        add_white_ground()
        lamp = add_point(energy=100.0, shadow_soft_size=0.0)
        lamp.location = (0, 0, 3)
        self.link(lamp.data, "ShaderNodeBlackbody", "Color").inputs[0].default_value = 2500
        power = self.link(lamp.data, "ShaderNodeMath")
        power.operation = "POWER"
        power.inputs[0].default_value, power.inputs[1].default_value = 1.5, 3.0
        notes = []
        (point,) = read(None, notes)
        assert notes == []
        expected = np.array(point.power) / (4 * np.pi * 3**2)
        assert render() * np.pi == pytest.approx(expected, rel=1e-2)

    def test_a_quadratic_falloff_changes_nothing(self):
        notes, lamp = [], add_point(energy=10.0)
        self.link(lamp.data, "ShaderNodeLightFalloff").inputs[0].default_value = 3.0
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

    def test_shared_inputs_are_computed_once(self):
        """Forty sums of a value with itself have 2^40 paths."""
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
        (point,) = read(None, [])
        assert point.power == pytest.approx(10.0)

    def test_negative_lamps_are_left_out_with_a_note(self):
        notes = []
        add_point(energy=-5.0)
        add_point(energy=5.0)
        assert [lamp.power for lamp in read(None, notes)] == [5.0]
        assert len(notes) == 1
        assert "'lamp'" in notes[0]

    def test_a_lamp_with_unsupported_nodes_does_not_stop_others(self):
        scenery.add_sun()
        self.link(add_point(energy=10.0).data, "ShaderNodeTexNoise", "Color")
        assert {type(light) for light in read(None)} == {PointLight, Sun}


class TestWorldNodes:
    def mix(self, world, output, kind):
        """Mix the world, by an output of Light Path, with a background that it returns.

        kind  of the node that colours that background
        """
        tree = world.node_tree
        mix, path = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeLightPath")
        other = tree.nodes.new("ShaderNodeBackground")
        color = tree.nodes.new(kind)
        tree.links.new(color.outputs[0], other.inputs["Color"])
        tree.links.new(path.outputs[output], mix.inputs[0])
        tree.links.new(tree.nodes["Background"].outputs[0], mix.inputs[1])
        tree.links.new(other.outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
        return other

    def test_a_background_for_the_camera_only_lights_nothing(self):
        notes = []
        self.mix(even_world(0.5), "Is Camera Ray", "ShaderNodeTexSky")
        assert read(None, notes) == [Sky(0.5)]
        assert notes == []

    @pytest.mark.parametrize(
        ("output", "lit", "radiance"),
        [("Is Diffuse Ray", "surfaces", 2.0), ("Is Diffuse Ray", "volumes", 0.5),
         ("Is Volume Scatter Ray", "volumes", 2.0), ("Is Glossy Ray", "surfaces", 0.5)],
    )  # fmt: skip
    def test_light_path_selects_the_branch_of_each_receiver(self, output, lit, radiance):
        other = self.mix(even_world(0.5), output, "ShaderNodeRGB")
        color = other.inputs["Color"].links[0].from_socket
        color.default_value, other.inputs["Strength"].default_value = (1, 1, 1, 1), 2.0
        assert read(receivers(**{lit: [add_box()]})) == [Sky(radiance)]

    def test_the_volume_of_a_world_gives_a_note(self):
        notes, world = [], even_world(0.5)
        tree = world.node_tree
        fog = tree.nodes.new("ShaderNodeVolumeScatter")
        tree.links.new(fog.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
        assert read(None, notes) == [Sky(0.5)]
        assert len(notes) == 1
        assert "The volume of 'world' is left out" in notes[0]

    def test_the_world_of_the_view_layer_counts(self):
        even_world(0.5)
        override = even_world(2.0)
        bpy.context.scene.world = bpy.data.worlds["world"]
        bpy.context.view_layer.world_override = override
        assert read(None) == [Sky(2.0)]

    def test_a_negative_world_is_left_out_with_a_note(self):
        notes = []
        even_world(-1.0)
        assert read(None, notes) == []
        assert "negative light is not supported: 'world'" in notes[0]
