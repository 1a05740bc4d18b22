# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes from end to end: every kind of source, baked, baked again, and removed."""

import os
import tempfile
from pathlib import Path

import bpy
import numpy as np
import openvdb
import pytest

from lb_lighting import bake
from lb_lighting.clearing import clear
from lb_lighting.errors import (
    DeviceError,
    LightError,
    MediumError,
    OutputError,
    SceneError,
    SettingsError,
    SolverError,
)
from lb_lighting.options import Options
from lb_lighting.output.vdb import DENSITY_GRID, read_metadata
from lb_lighting.output.volume import baked_volumes
from lb_lighting.reading import read_scene, sources_of
from tests import scenery
from tests.output import rendering
from tests.scenery import ambient, bake_light, read_grid, snapshot

TOP, BOTTOM = np.s_[..., -1], np.s_[..., 0]


def baked():
    """The one baked Volume object of the scene."""
    (ob,) = baked_volumes(bpy.context.scene)
    return ob


def shader(ob):
    """The inputs of the node group that shows a baked volume."""
    nodes = ob.active_material.node_tree.nodes
    return next(node for node in nodes if node.type == "GROUP").inputs


def light_by_height(outcome):
    """(nz - 2 padding,): the mean fluence of the layers of the domain, from below."""
    return outcome.field.fluence[0].mean(axis=(0, 1))[2:-2]


# The grids of two beams, where the medium scatters forwards.
BEAMS = {"lb_direct_1", "lb_direct_2", "lb_forward_1", "lb_forward_2"}


class TestVolume:
    def test_material_is_read_and_light_falls_off_away_from_the_sun(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        outcome = bake_light(ob)
        assert outcome.path.parent == tmp_path
        light = light_by_height(outcome)
        assert light[-1] > 1.2 * light[0]
        assert shader(baked())["Sigma S"].default_value[:] == pytest.approx((3.6,) * 3)
        assert shader(baked())["Sigma A"].default_value[0] == pytest.approx(0.4)

    def test_preset_has_the_optical_depth_asked_for(self, scene, tmp_path):
        bake_light(scenery.add_fog(tmp_path), medium="cloud", optical_depth=10, padding=1)
        sigma = [shader(baked())[name].default_value[0] for name in ("Sigma S", "Sigma A")]
        longest = 2 * 16 / 14  # m, of the domain
        assert sum(sigma) * longest == pytest.approx(10)
        assert sigma[0] / sum(sigma) == pytest.approx(0.99)

    def test_a_missing_material_is_told(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path, material=False))
        assert "'fog' has no volume material; the preset 'cloud' was used." in outcome.notes

    def test_grey_is_one_band(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path))
        assert outcome.field.fluence.shape == (1, 16, 16, 16)
        light, _first = read_grid(outcome.path)
        assert np.array_equal(light[..., 0], light[..., 1])
        assert np.array_equal(light[..., 0], light[..., 2])

    def test_a_coloured_sun_colours_grey_fog_and_is_solved_once(self, scene, tmp_path):
        bpy.data.lights["sun"].color = (1, 0.5, 0)
        field = bake_light(scenery.add_fog(tmp_path)).field
        assert field.report.runs == 1
        assert field.fluence[1] == pytest.approx(field.fluence[0] / 2, rel=1e-6)
        assert not field.fluence[2].any()

    def test_coloured_fog_colours_white_light(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.data.materials[0] = scenery.volume_material(color=(0.9, 0.5, 0.1))
        means = bake_light(ob).field.fluence.mean(axis=(1, 2, 3))
        assert means[0] > means[1] > means[2]

    def test_file_is_aligned_with_its_source(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.location, ob.rotation_euler, ob.scale = (3, -2, 1), (0.3, 0.2, 0.5), (1, 0.5, 0.7)
        outcome = bake_light(ob)
        density, first = read_grid(outcome.path, DENSITY_GRID)
        domain = outcome.field.domain
        weights = density / density.sum()
        indices = np.stack(np.indices(density.shape), axis=-1) + first
        center = domain.origin + (np.einsum("xyz,xyzi->i", weights, indices) + 0.5) * (
            domain.voxel_size
        )
        assert np.abs(center - ob.location).max() < 0.1 * domain.voxel_size
        assert baked().matrix_world.translation[:] == (0, 0, 0)

    def test_the_residual_is_told_while_it_is_solved(self, scene, tmp_path):
        ob, told = scenery.add_fog(tmp_path), []
        ob.data.materials[0] = scenery.volume_material(60.0, (0.99, 0.99, 0.99))
        task = read_scene(bpy.context, [ob], Options.of(scene))
        lit = task.run(lambda **said: told.append(said["stage"]), tmp_path)
        assert told[:2] == ["Filling voxels", "Solving"]
        residuals = [stage[len("Solving (residual ") : -2] for stage in told if "residual" in stage]
        assert np.all(np.diff(np.array(residuals, float)) <= 0)
        assert 100 * lit.report.residual < float(residuals[-1]) < 100

    def test_a_quality_is_planned_for(self, scene, tmp_path):
        fog = scenery.add_fog(tmp_path, 0.003 * scenery.ball())
        outcome = bake_light(fog, quality="final")
        assert outcome.plan.settings.scattering == "single"
        assert not outcome.field.fluence.any()
        assert read_metadata(outcome.path)["expected_error"] == pytest.approx(outcome.plan.error)
        assert any("No lattice" in line for line in outcome.report_lines)

    def test_what_a_quality_plans_is_left_alone_by_hand(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path), scattering="single")
        assert outcome.plan is None
        assert outcome.field.report.steps == 0

    def test_metadata_tells_the_settings(self, scene, tmp_path):
        told = read_metadata(bake_light(scenery.add_fog(tmp_path), strength=0.5).path)
        assert told["resolution"] == 16
        assert told["strength"] == 0.5
        assert told["model"] == "physical"
        assert told["device"] == "NumPy (no OpenCL)"

    def test_each_lamp_has_its_own_unscattered_light(self, scene, tmp_path):
        lamp = scenery.link("point", bpy.data.lights.new("point", "POINT"))
        lamp.location = (0, 0, 5)
        bpy.data.lights["point"].energy = 40 * np.pi * 25  # 10 W/m^2 in the middle of a void
        path = bake_light(scenery.add_fog(tmp_path)).path
        sun, point = (read_grid(path, f"lb_direct_{n}")[0][..., 0] * 4 * np.pi for n in (1, 2))
        assert sun.max() == pytest.approx(3, rel=1e-3)
        assert point.max() == pytest.approx(10 * 5**2, rel=0.02)  # W/sr times 4 pi: none is lost
        nodes = baked().active_material.node_tree.nodes
        assert {node.label for node in nodes if node.label} == BEAMS

    def test_directional_scattering_of_what_scatters_forwards(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Anisotropy"].default_value = 0.85
        outcome, stages = bake_light(ob), []
        assert any("Directional scattering took" in line for line in outcome.report_lines)
        moments = {f"lb_moment_{n}" for n in range(1, 9)}
        names = {grid.name for grid in openvdb.readAllGridMetadata(str(outcome.path))}
        assert names == {"density", "lb_light", "lb_direct_1", "lb_forward_1", *moments}
        nodes = baked().active_material.node_tree.nodes
        labels = {node.label for node in nodes if node.label}
        assert labels == {"LB Moments", "lb_direct_1", "lb_forward_1"}

        def progress(stage, fraction):
            stages.append((fraction, stage))

        left = bake_light(ob, gather=False)
        names = {grid.name for grid in openvdb.readAllGridMetadata(str(left.path))}
        assert not names & moments
        assert not any("Directional scattering took" in line for line in left.report_lines)
        bake_light(ob, quality="preview", progress=progress)
        assert stages == sorted(stages, key=lambda told: told[0])
        assert "Directional scattering" in {stage for _, stage in stages}

    @pytest.mark.parametrize(
        "changes",
        [{"anisotropy": 0.5}, {"scattering": "single"}, {"mode": "ADD", "model": "paper"}],
    )
    def test_no_directional_scattering_where_it_changes_little(self, scene, tmp_path, changes):
        ob, changes = scenery.add_fog(tmp_path), dict(changes)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Anisotropy"].default_value = changes.pop("anisotropy", 0.85)
        assert "gather" not in bake_light(ob, **changes).field.report.seconds

    def test_of_the_paper_all_light_is_one(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path), model="paper")
        assert outcome.field.report.model == "paper"
        light, _first = read_grid(outcome.path)
        assert light.max() == pytest.approx(outcome.field.fluence.max() / (4 * np.pi), rel=0.2)
        assert len(baked().active_material.node_tree.nodes) == 2

    def test_spots_are_beams_and_areas_are_not(self, scene, tmp_path):
        for kind in ("SPOT", "AREA"):
            lamp = scenery.link(kind, bpy.data.lights.new(kind, kind))
            lamp.location = (0, 0, 5)
        outcome = bake_light(scenery.add_fog(tmp_path))
        spot, area = outcome.field.by_light[1:, 0]
        assert spot.any()
        assert area.any()
        nodes = baked().active_material.node_tree.nodes
        assert {node.label for node in nodes if node.label} == BEAMS
        assert not outcome.notes or "not read" not in " ".join(outcome.notes)

    def test_own_light_needs_no_lamp(self, scene, tmp_path):
        bpy.data.objects.remove(bpy.data.objects["sun"])
        ob = scenery.add_fog(tmp_path)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Emission Strength"].default_value = 3
        inputs["Emission Color"].default_value = (1, 0.5, 0, 1)
        outcome = bake_light(ob)
        shone, _first = read_grid(outcome.path, "lb_emission")
        assert shone.max(axis=(0, 1, 2)) == pytest.approx((3, 1.5, 0), rel=1e-5)
        entered = outcome.field.report.energy["entered"]
        radiated = 4 * np.pi * shone.sum(axis=(0, 1, 2)) * outcome.field.domain.voxel_size**3
        assert entered == pytest.approx(radiated, rel=1e-4)
        with pytest.raises(KeyError, match="lb_emission"):  # there Cycles shows it
            read_grid(bake_light(ob, mode="ADD").path, "lb_emission")

    def test_the_papers_model_has_no_fire(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Emission Strength"].default_value = 3
        note = "The paper model leaves out the light of fire; choose Physical to bake it."
        assert note in bake_light(ob, model="paper").notes

    def test_coefficients_per_unit_of_object_space(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        world = bake_light(ob).field
        ob.scale = (2, 2, 2)
        ob.data.render.space = "OBJECT"
        # Twice as large and half as dense: the same light.
        assert bake_light(ob).field.fluence == pytest.approx(world.fluence, rel=1e-5)
        ob.data.render.space = "WORLD"
        assert bake_light(ob).field.fluence[0][:, :, 2].mean() < world.fluence[0][:, :, 2].mean()

    def test_domain_object_gives_the_bounds(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        box = scenery.add_ball("box", radius=1)
        box.scale, box.location = (2, 2, 2), (1, 0, 0)
        scene.lb_lighting.domain = box
        domain = bake_light(ob).field.domain
        assert np.add(domain.origin, domain.upper) / 2 == pytest.approx((1, 0, 0), abs=1e-5)
        assert domain.voxel_size == pytest.approx(4 / 12)


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


class TestSeveral:
    def test_each_is_lit_and_the_render_shows_volumes_only_as_volume(self, scene, tmp_path):
        fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
        fog.location = (3, 0, 0)
        outcome = bake_light(fog, leaves)
        assert ambient(leaves).mean() > 0
        _density, first = read_grid(outcome.path, DENSITY_GRID)
        domain = outcome.field.domain
        left = domain.origin[0] + (first[0] - 0.5) * domain.voxel_size
        assert left > 1.5  # no fog where the leaves are
        assert shader(baked())["Sigma S"].default_value[:] == pytest.approx((3.6,) * 3)

    def test_two_volumes_are_replaced_by_one(self, scene, tmp_path):
        fogs = [scenery.add_fog(tmp_path, name=name) for name in ("a", "b")]
        fogs[1].location = (3, 0, 0)
        bake_light(*fogs)
        assert [fog.hide_render for fog in fogs] == [True, True]
        assert not baked().hide_render


class TestAgain:
    def test_the_same_light_from_the_hidden_source_and_from_the_baked_volume(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        first = bake_light(ob)
        assert ob.hide_viewport
        second = bake_light(ob)
        third = bake_light(baked())
        assert second.path != first.path
        for again in (second, third):
            assert np.array_equal(again.field.fluence, first.field.fluence)
        assert Path(bpy.path.abspath(baked().data.filepath)) == third.path

    def test_lit_materials_do_not_light_themselves(self, scene):
        ob = scenery.add_leaves()
        bake_light(ob)
        light = ambient(ob)
        bake_light(ob)
        assert np.array_equal(ambient(ob), light)
        assert sum(node.type == "GROUP" for node in ob.active_material.node_tree.nodes) == 1

    def test_a_filled_mesh_keeps_its_medium(self, scene):
        ob = scenery.add_ball(material=scenery.volume_material())
        first = bake_light(ob)
        assert np.array_equal(bake_light(ob).field.fluence, first.field.fluence)

    def test_from_replace_to_add_and_back(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        for mode, hidden in (("REPLACE", True), ("ADD", False), ("REPLACE", True)):
            bake_light(ob, mode=mode)
            assert (ob.hide_render, ob.hide_viewport) == (hidden, hidden)
            assert shader(baked())["Replace"].default_value == hidden

    def test_the_baked_volume_is_selected_in_place_of_its_source(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        scenery.select(ob)
        bake_light(*bpy.context.selected_objects)
        assert bpy.context.selected_objects == [baked()]


class TestFollows:
    def test_the_light_goes_where_its_source_goes(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.location, ob.rotation_euler, ob.scale = (1, 2, 3), (0.3, 0.2, 0.1), (1, 2, 1)
        bpy.context.view_layer.update()
        before = ob.matrix_world.copy()
        bake_light(ob)
        assert np.array(baked().matrix_world) == pytest.approx(np.eye(4), abs=1e-5)
        ob.location, ob.rotation_euler = (0, 0, 1), (0, 0, 1)
        bpy.context.view_layer.update()
        moved = baked().evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
        expected = ob.matrix_basis @ before.inverted()
        assert np.array(moved) == pytest.approx(np.array(expected), abs=1e-5)

    def test_a_second_bake_begins_where_the_source_is(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        bake_light(ob)
        ob.location = (0, 0, 1)
        bpy.context.view_layer.update()
        bake_light(ob)
        bpy.context.view_layer.update()
        assert np.array(baked().matrix_world) == pytest.approx(np.eye(4), abs=1e-5)


class TestMeanwhile:
    """What may happen to a scene while it is lit."""

    def finish(self, baking):
        while not baking.update(wait=0.5):
            pass
        return baking.apply(bpy.context)

    def test_renamed_and_moved(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        baking = bake.Baking(bpy.context, [ob], Options.of(scene))
        ob.name, ob.location = "other", (5, 0, 0)
        outcome = self.finish(baking)
        assert ob.hide_render
        assert np.mean([outcome.result.domain.origin, outcome.result.domain.upper]) < 1
        bpy.context.view_layer.update()
        assert baked().matrix_world.translation[:] == pytest.approx((5, 0, 0), abs=1e-5)

    @pytest.mark.parametrize("how", ["object", "from the scene", "scene"])
    def test_deleted(self, scene, tmp_path, how):
        ob = scenery.add_fog(tmp_path)
        baking = bake.Baking(bpy.context, [ob], Options.of(scene))
        if how == "object":
            bpy.data.objects.remove(ob)
        elif how == "from the scene":
            scene.collection.objects.unlink(ob)
        else:
            bpy.data.scenes.new("other")
            bpy.data.scenes.remove(scene)
        with pytest.raises(SceneError, match="was deleted during the bake; nothing was changed"):
            self.finish(baking)
        assert [path.name for path in tmp_path.iterdir()] == ["fog.vdb"]

    def test_a_mesh_that_gets_other_vertices(self, scene, tmp_path):
        ob = scenery.add_leaves()
        baking = bake.Baking(bpy.context, [ob], Options.of(scene))
        ob.data.vertices.add(1)
        before = snapshot()
        with pytest.raises(OutputError, match="mesh of 'leaves' changed during the bake"):
            self.finish(baking)
        assert snapshot() == before
        assert list(tmp_path.iterdir()) == []

    def test_another_scene_in_view(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        baking = bake.Baking(bpy.context, [ob], Options.of(scene))
        other = bpy.data.scenes.new("other")
        while not baking.update(wait=0.5):
            pass
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            baking.apply(bpy.context)
        assert [ob.name for ob in baked_volumes(scene)] == ["LB fog"]
        assert baked_volumes(other) == []

    def test_cancelled(self, scene, tmp_path, processes):
        ob = scenery.add_fog(tmp_path)
        before = snapshot()
        baking = bake.Baking(bpy.context, [ob], Options.of(scene))
        baking.cancel()
        assert processes[-1].poll() is not None
        assert snapshot() == before
        assert [path.name for path in tmp_path.iterdir()] == ["fog.vdb"]


class TestTogether:
    """Sources that were baked in one go stay tied to their light."""

    @pytest.fixture
    def pair(self, scene, tmp_path):
        first, second = (scenery.add_fog(tmp_path, name=name) for name in ("first", "second"))
        second.location.x = 3
        bpy.context.view_layer.update()
        bake_light(first, second)
        return first, second

    def test_their_light_stands_for_both(self, pair):
        path = Path(baked().data.filepath)
        bake_light(baked())
        assert {ob.hide_render for ob in pair} == {True}
        light, again = read_grid(path), read_grid(baked().data.filepath)
        assert again[1] == light[1]
        np.testing.assert_array_equal(again[0], light[0])

    def test_one_baked_alone_leaves_the_other_as_it_was(self, pair):
        first, second = pair
        bake_light(second)
        assert baked().name in bpy.context.scene.objects
        assert (first.hide_render, second.hide_render) == (False, True)
        assert sources_of(bpy.context.scene, [baked()]) == [second]

    def test_a_new_name_does_not_break_the_tie(self, pair):
        first, second = pair
        first.name = "renamed"
        assert sources_of(bpy.context.scene, [baked()]) == [first, second]
        bake_light(baked())
        assert baked()

    def test_light_removed_by_hand_gives_the_sources_back(self, pair):
        bpy.data.objects.remove(baked())
        assert clear(bpy.context).count == 2
        assert {ob.hide_render for ob in pair} == {False}

    def test_light_whose_sources_are_gone(self, pair):
        for ob in pair:
            bpy.data.objects.remove(ob)
        with pytest.raises(SceneError, match="was baked from were deleted"):
            bake_light(baked())
        assert clear(bpy.context).count == 1

    def test_another_scene_keeps_its_light(self, pair):
        other = bpy.data.scenes.new("other")
        other.collection.objects.link(pair[0])
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            assert clear(bpy.context).count == 0
        assert pair[0].hide_render


class TestClear:
    @pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
    @pytest.mark.parametrize("bakes", [1, 2])
    def test_the_file_is_as_it_was(self, scene, tmp_path, mode, bakes):
        sources = [
            scenery.add_fog(tmp_path),
            scenery.add_leaves(),
            scenery.add_leaves("bare", material=False),
            scenery.add_ball(role="SOLID", material=scenery.leaf_material()),
            scenery.add_ball("filled", material=scenery.volume_material()),
        ]
        scenery.select(*sources)
        before = snapshot()
        for _ in range(bakes):
            bake_light(*sources, mode=mode)
        assert snapshot() != before
        assert clear(bpy.context).count > 0
        assert snapshot() == before

    def test_nothing_of_the_users_own_is_taken(self, scene, tmp_path):
        fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
        fog.hide_render = True
        scene.cycles.volume_biased = True
        leaves.data.color_attributes.new("painted", "BYTE_COLOR", "CORNER")
        before = snapshot()
        bake_light(fog, leaves)
        clear(bpy.context)
        assert snapshot() == before

    @pytest.mark.parametrize("delete", [True, False])
    def test_files_are_deleted_only_when_asked(self, scene, tmp_path, delete):
        fog = scenery.add_fog(tmp_path)
        path = bake_light(fog).path
        cleared = clear(bpy.context)
        if delete:
            cleared.delete_files()
        assert path.exists() != delete
        assert Path(fog.data.filepath).exists()

    def test_nothing_to_clear(self, scene):
        before = snapshot()
        assert clear(bpy.context).count == 0
        assert snapshot() == before


class TestRendered:
    @pytest.fixture
    def picture(self, tmp_path):
        """A function that renders the scene from the side: (16, 16) linear radiance."""
        rendering.dark_scene((0, -5, 0), (np.pi / 2, 0, 0), 2.4)

        def render():
            path = tmp_path / "picture.exr"
            return rendering.render(bpy.context.scene, path, 16, 4).mean(axis=2)

        return render

    @pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
    def test_a_cloud_is_brighter_on_the_side_of_the_sun(self, scene, tmp_path, picture, mode):
        bake_light(scenery.add_fog(tmp_path), mode=mode)
        bpy.data.objects["sun"].hide_render = True  # what is left is the baked light
        light = picture()
        below, above = light[3:8, 4:12].mean(), light[8:13, 4:12].mean()
        assert below > 0.01
        assert above > 1.1 * below

    def test_leaves_glow_in_baked_light_alone(self, scene, picture):
        ob = scenery.add_leaves()
        bake_light(ob)
        bpy.data.objects["sun"].hide_render = True
        glow = picture().mean()
        clear(bpy.context)
        assert glow > 1e-4
        assert not picture().any()

    def test_a_filled_mesh_is_seen(self, scene, picture):
        bake_light(scenery.add_ball(material=scenery.volume_material()))
        bpy.data.objects["sun"].hide_render = True
        assert picture()[6:10, 6:10].min() > 0.01


def missing_file(folder):
    ob = scenery.add_fog(folder)
    ob.data.filepath = str(folder / "nowhere.vdb")
    return [ob]


def mesh_without_faces(_folder):
    return [scenery.link("points", bpy.data.meshes.new("points"))]


def linked(folder):
    """Leaves whose mesh and material are another file's."""
    path = str(folder / "library.blend")
    mesh = bpy.data.meshes.new("twig")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 1)], [], [(0, 1, 2)])
    mesh.materials.append(scenery.leaf_material())
    bpy.data.libraries.write(path, {mesh})
    bpy.data.batch_remove([mesh, mesh.materials[0]])
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.meshes = there.meshes
    return [scenery.link("twig", here.meshes[0])]


def linked_material(folder):
    ob = linked(folder)[0]
    ob.data = ob.data.copy()
    return [ob]


def linked_object(folder):
    path = str(folder / "library.blend")
    bpy.data.libraries.write(path, {scenery.add_fog(folder, name="haze")})
    bpy.data.objects.remove(bpy.data.objects["haze"])
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["haze"]
    bpy.context.scene.collection.objects.link(here.objects[0])
    return here.objects


def fog(folder):
    return [scenery.add_fog(folder)]


BAD_SOURCES = {
    "nothing": (lambda folder: [], {}, SceneError, "Nothing is selected; "),
    "empty": (
        lambda folder: [scenery.link("none", None)],
        {},
        SceneError,
        "'none' has neither a volume nor faces; ",
    ),
    "camera": (
        lambda folder: [scenery.link("eye", bpy.data.cameras.new("eye"))],
        {},
        SceneError,
        "'eye' has neither a volume nor faces; ",
    ),
    "no faces": (mesh_without_faces, {}, SceneError, "'points' has neither a volume nor faces; "),
    "missing file": (missing_file, {}, SceneError, "nowhere.vdb' of 'fog' cannot be read"),
    "no such grid": (
        fog,
        {"grid": "smoke"},
        SceneError,
        "'fog' has no grid 'smoke'; choose one of: density",
    ),
    "no density": (
        lambda folder: [scenery.add_ball(role="OCCLUDER")],
        {},
        SceneError,
        "There is no density to light here; ",
    ),
    "linked object": (
        linked_object,
        {},
        OutputError,
        "'haze' is linked from another file; make it local.",
    ),
    "linked mesh": (linked, {}, OutputError, "The mesh of 'twig' is linked from another file; "),
    "linked material": (
        linked_material,
        {},
        OutputError,
        "The material 'leaf' is linked from another file; ",
    ),
    "missing folder": (
        fog,
        {"folder": "nowhere"},
        OutputError,
        "nowhere does not exist; choose another or create it.",
    ),
    "unknown medium": (fog, {"medium": "milk"}, SettingsError, "There is no medium called 'milk'"),
    "unknown mode": (fog, {"mode": "MULTIPLY"}, SettingsError, "There is no mode called"),
    "unknown domain": (fog, {"domain": "box"}, SettingsError, "There is no object 'box' to use"),
    "no padding": (fog, {"padding": 0}, SettingsError, "The padding must be 1 voxel or more"),
    "no depth": (fog, {"optical_depth": 0}, SettingsError, "The optical depth must be positive"),
}


class TestBadInput:
    """One sentence, the scene as it was, and no file."""

    def refused(self, objects, error, sentence, **changes):
        before = snapshot()
        files = set(Path(bpy.context.scene.lb_lighting.folder).iterdir())
        stages = []
        with pytest.raises(error) as caught:
            bake_light(*objects, progress=lambda *told: stages.append(told[0]), **changes)
        assert not any(stage.startswith("Solving") for stage in stages)
        assert sentence in str(caught.value)
        assert "\n" not in str(caught.value)
        assert snapshot() == before
        assert set(Path(bpy.context.scene.lb_lighting.folder).iterdir()) == files

    @pytest.mark.parametrize("name", BAD_SOURCES)
    def test_is_refused_before_the_solve(self, scene, tmp_path, name):
        make, changes, error, sentence = BAD_SOURCES[name]
        self.refused(make(tmp_path), error, sentence, **changes)

    def test_no_light(self, scene, tmp_path):
        bpy.data.lights["sun"].energy = 0
        self.refused(fog(tmp_path), LightError, "The scene has no light; add a lamp")

    def test_resolution_of_nothing(self, scene, tmp_path):
        sentence = "A resolution of 0 voxels is too low; use 7 or more."
        self.refused(fog(tmp_path), MediumError, sentence, resolution=0)

    def test_too_fine_for_the_memory(self, scene, tmp_path):
        sentence = "the largest resolution that fits is "
        self.refused(fog(tmp_path), DeviceError, sentence, resolution=20_000)

    @pytest.mark.parametrize("strength", [-1.0, float("nan")])
    def test_strength_below_nothing(self, scene, tmp_path, strength):
        with pytest.raises(SettingsError, match="strength must not be negative"):
            bake_light(scenery.add_fog(tmp_path), strength=strength)

    def test_too_small_to_write(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.scale = (1e-5, 1e-5, 1e-5)
        bpy.context.view_layer.update()
        with pytest.raises(SceneError, match="scale the scene up"):
            bake_light(ob)

    def test_domain_without_a_size(self, scene, tmp_path):
        scenery.link("empty", None)
        with pytest.raises(SettingsError, match="has no size; choose a mesh"):
            bake_light(scenery.add_fog(tmp_path), domain="empty")

    def test_unknown_device(self, scene, tmp_path):
        sentence = "There is no device called 'abacus'; choose one of: "
        self.refused(fog(tmp_path), DeviceError, sentence, device="abacus")

    def test_a_solver_that_is_killed(self, scene, tmp_path, processes):
        objects, before = fog(tmp_path), snapshot()
        options = Options.of(scene, resolution=40)
        with pytest.raises(SolverError, match="ended by signal 9; nothing was changed"):
            bake.bake(bpy.context, objects, options, lambda *_progress: processes[-1].kill())
        assert snapshot() == before
        assert [path.name for path in tmp_path.iterdir()] == ["fog.vdb"]

    def test_edit_mode(self, scene):
        ob = scenery.add_leaves()
        bpy.context.view_layer.objects.active = ob
        bpy.ops.object.mode_set(mode="EDIT")
        with pytest.raises(OutputError, match="'leaves' is in Edit Mode; leave Edit Mode"):
            bake_light(ob)

    @pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs POSIX users")
    def test_read_only_folder(self, scene):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            objects = fog(folder)
            scene.lb_lighting.folder = str(folder)
            with scenery.read_only(folder):
                self.refused(objects, OutputError, " is not writable; choose another")
