# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes of several sources, baked again, moved, changed meanwhile, and removed."""

from pathlib import Path

import bpy
import numpy as np
import pytest

from lb_lighting import bake
from lb_lighting.clearing import clear
from lb_lighting.errors import (
    OutputError,
    SceneError,
)
from lb_lighting.options import Options
from lb_lighting.output.vdb import DENSITY_GRID
from lb_lighting.output.volume import baked_volumes
from lb_lighting.reading import sources_of
from tests import scenery
from tests.baking import baked, shader
from tests.scenery import ambient, bake_light, read_grid, snapshot


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
