# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes of meshes, and of the sky that they show."""

import bpy
import numpy as np
import pytest

from lb_lighting.options import Options
from lb_lighting.output.vdb import DENSITY_GRID
from lb_lighting.reading import read_scene
from tests import scenery
from tests.baking import baked
from tests.scenery import ambient, bake_light, read_grid


class TestMeshes:
    def test_leaves_get_their_light_and_show_it(self, scene, tmp_path):
        ob = scenery.add_leaves()
        bake_light(ob)
        light = ambient(ob)
        z = np.array([vertex.co.z for vertex in ob.data.vertices])
        assert light.min() >= 0
        assert light[z > 0.5].mean() > light[z < -0.5].mean()
        assert light[:, 1].mean() > light[:, 0].mean()  # leaves are green
        assert any(node.type == "GROUP" for node in ob.active_material.node_tree.nodes)
        assert baked().hide_render

    def test_plant_preset(self, scene):
        ob = scenery.add_leaves()
        bake_light(ob, medium="plant")
        assert ambient(ob)[:, 1].mean() > ambient(ob)[:, 0].mean()

    def test_solid_gets_its_light(self, scene):
        ob = scenery.add_ball(role="SOLID", material=scenery.leaf_material())
        outcome = bake_light(ob, medium="pmma")
        mass = read_grid(outcome.path, DENSITY_GRID)[0].sum() * outcome.field.domain.voxel_size**3
        assert mass == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.05)
        light = ambient(ob)
        z = np.array([vertex.co.z for vertex in ob.data.vertices])
        assert light[z > 0.6].mean() > light[z < -0.6].mean()

    def test_occluder_shades_what_is_below(self, scene, tmp_path):
        fog = scenery.add_fog(tmp_path)
        lid = scenery.add_ball(role="OCCLUDER", radius=1)
        lid.location, lid.scale = (0, 0, 0.7), (1, 1, 0.2)
        free = bake_light(fog, domain="fog").field.fluence[0]
        shaded = bake_light(fog, lid, domain="fog").field.fluence[0]
        middle = np.s_[7:9, 7:9, 9]
        assert shaded[middle].mean() < 0.5 * free[middle].mean()

    def test_collection_instance(self, scene):
        leaves = scenery.add_leaves()
        collection = bpy.data.collections.new("tree")
        scene.collection.objects.unlink(leaves)
        collection.objects.link(leaves)
        instance = scenery.link("instance", None)
        instance.instance_type, instance.instance_collection = "COLLECTION", collection
        instance.location = (5, 0, 0)
        outcome = bake_light(instance)
        domain = outcome.field.domain
        assert np.add(domain.origin, domain.upper) / 2 == pytest.approx((5, 0, 0), abs=0.1)
        assert any("'instance'" in note for note in outcome.notes)

    def test_a_mesh_without_a_surface_is_replaced_as_a_volume_is(self, scene):
        ob = scenery.add_ball(material=scenery.volume_material())
        bake_light(ob)
        assert ob.hide_render
        assert not baked().hide_render


class TestSky:
    """A sky's own light in what surfaces show."""

    RADIANCE = (0.25, 0.5, 1.0)

    @pytest.fixture
    def leaves(self, scene):
        """So few that hardly any sky is hidden, under a sky alone."""
        bpy.data.objects.remove(bpy.data.objects["sun"])
        scene.world = bpy.data.worlds.new("sky")
        background = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
        background.inputs["Color"].default_value = (*self.RADIANCE, 1)
        background.inputs["Strength"].default_value = 2
        scene.lb_lighting.resolution = 10  # a sky takes NumPy long
        return scenery.add_leaves(count=3)

    def test_a_lone_leaf_gets_all_of_it(self, leaves):
        scattered = bake_light(leaves).field
        assert ambient(leaves).max() < 0.05
        outcome = bake_light(leaves, sky=True)
        assert ambient(leaves) == pytest.approx(
            np.tile(2 * np.array(self.RADIANCE), (9, 1)), rel=0.05
        )
        assert not any("sky" in note for note in outcome.notes)
        assert any("sky" in fact for fact in outcome.report_lines)
        assert np.array_equal(outcome.field.fluence, scattered.fluence)

    def test_both_ways_of_foliage_get_the_same(self, leaves, tmp_path):
        read = bake_light(leaves, sky=True, foliage="MODIFIER").path
        found = read_grid(read, "lb_ambient")[0]
        assert found.max() == pytest.approx(2 * max(self.RADIANCE), rel=0.05)

    def test_under_a_dense_crown_there_is_less(self, leaves):
        bpy.data.objects.remove(leaves)
        crown = scenery.add_leaves(count=2000)
        bake_light(crown, sky=True)
        light = ambient(crown)[:, 2] / (2 * self.RADIANCE[2])
        place = np.array([vertex.co for vertex in crown.data.vertices])
        inner = np.abs(place).max(axis=1) < 0.3
        assert light.max() < 1.05
        assert light[inner].mean() < 0.75 * light[~inner].mean()

    def test_the_papers_light_is_all_there_is(self, leaves):
        bake_light(leaves, model="paper")
        light = ambient(leaves)
        bake_light(leaves, model="paper", sky=True)
        assert np.array_equal(ambient(leaves), light)
        assert "lb_whole" in leaves.data.attributes

    @pytest.mark.parametrize("hinders", ["sun", "solid", "metal", "metal in a group"])
    def test_where_it_cannot_be_cycles_keeps_it_and_the_user_is_told(self, leaves, hinders):
        objects = [leaves]
        if hinders == "sun":
            scenery.add_sun()
        elif hinders == "metal":
            shader = leaves.active_material.node_tree.nodes["Principled BSDF"]
            shader.inputs["Metallic"].default_value = 1
        elif hinders == "solid":
            material = scenery.leaf_material()
            objects.append(scenery.add_ball(role="SOLID", material=material))
        else:
            tree = bpy.data.node_groups.new("user", "ShaderNodeTree")
            tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
            closure, output = (
                tree.nodes.new(k) for k in ("ShaderNodeBsdfPrincipled", "NodeGroupOutput")
            )
            closure.inputs["Metallic"].default_value = 1
            tree.links.new(closure.outputs[0], output.inputs[0])
            nodes, links = (
                leaves.active_material.node_tree.nodes,
                leaves.active_material.node_tree.links,
            )
            group = nodes.new("ShaderNodeGroup")
            group.node_tree = tree
            links.new(group.outputs[0], nodes["Material Output"].inputs["Surface"])
        task = read_scene(bpy.context, objects, Options.of(bpy.context.scene, sky=True))
        assert not task.all_light
        assert sum("sky" in note for note in task.medium_choice.notes) == 1
