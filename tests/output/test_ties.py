# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever users do to a source or its light, their objects stay, and none stays hidden."""

import bpy
import numpy as np
import pytest

from lb_lighting.clearing import clear
from lb_lighting.output import ties
from lb_lighting.output.sources import RESULT, is_lost, scene_objects
from lb_lighting.output.volume import APPENDED, baked_path, baked_volumes, is_foreign
from lb_lighting.reading import sources_of
from tests import scenery
from tests.keeping import hidden, light
from tests.scenery import bake_light, snapshot


@pytest.fixture
def fog(scene, tmp_path):
    return scenery.add_fog(tmp_path)


@pytest.fixture
def baked(fog, tmp_path):
    """The light of the fog, in its own collection and in an undo step."""
    ob = light(fog, folder=tmp_path)
    collection = bpy.data.collections.new("light")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(ob)
    bpy.context.scene.collection.objects.unlink(ob)
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="bake")
    return ob


def delete(ob):
    scenery.select(ob)
    bpy.ops.object.delete("EXEC_DEFAULT", True)


def remove(ob):
    bpy.data.objects.remove(ob)


def unlink(ob):
    bpy.data.collections["light"].objects.unlink(ob)


def remove_collection(_ob):
    bpy.data.collections.remove(bpy.data.collections["light"])


def move_to_another_scene(ob):
    bpy.data.scenes.new("other").collection.objects.link(ob)
    unlink(ob)


def duplicate(*objects):
    """Copies that the user made, in the order of their names."""
    scenery.select(*objects)
    bpy.ops.object.duplicate()
    bpy.context.view_layer.update()
    return sorted(bpy.context.selected_objects, key=lambda ob: ob.name)


def volumes():
    return {ob.name for ob in bpy.data.objects if ob.type == "VOLUME"}


WAYS = [delete, remove, unlink, remove_collection, move_to_another_scene]


class TestDeletedLight:
    @pytest.mark.parametrize("lose", WAYS)
    def test_the_source_comes_back_by_itself(self, fog, baked, lose):
        assert hidden(fog) == [True]
        lose(baked)
        bpy.context.view_layer.update()
        assert hidden(fog) == [False]
        fog.select_set(True)
        assert bpy.ops.lb_lighting.bake.poll()

    @pytest.mark.parametrize("lose", WAYS[:-1])
    def test_clear_takes_out_all_that_is_left(self, scene, tmp_path, lose):
        fog = scenery.add_fog(tmp_path)
        before = snapshot()
        collection = bpy.data.collections.new("light")
        scene.collection.children.link(collection)
        ob = light(fog, folder=tmp_path)
        collection.objects.link(ob)
        scene.collection.objects.unlink(ob)
        lose(ob)
        cleared = clear(bpy.context)
        assert cleared.count == 1
        for collection in list(bpy.data.collections):
            bpy.data.collections.remove(collection)
        bpy.data.orphans_purge()
        after = snapshot()
        assert {name: after.get(name) for name in before} == before
        assert not [ob for ob in bpy.data.objects if ob.name.startswith("LB")]

    def test_clear_leaves_light_in_another_scene(self, fog, baked):
        move_to_another_scene(baked)
        assert clear(bpy.context).count == 1
        assert hidden(fog) == [False]
        assert baked_volumes(bpy.data.scenes["other"]) == [baked]

    def test_undo_brings_the_light_back_and_hides_the_source(self, baked):
        delete(baked)
        states = []
        for step in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.undo):
            step()
            fog = bpy.data.objects["fog"]
            states.append((len(baked_volumes(bpy.context.scene)), *hidden(fog)))
        assert states == [(1, True), (0, False), (1, True)]

    def test_light_that_is_linked_again_hides_the_source(self, fog, baked):
        unlink(baked)
        bpy.context.view_layer.update()
        bpy.context.scene.collection.objects.link(baked)
        bpy.context.view_layer.update()
        assert hidden(fog) == [True]
        clear(bpy.context)
        assert hidden(fog) == [False]

    def test_what_the_user_hid_before_stays_hidden(self, scene, tmp_path):
        fog = scenery.add_fog(tmp_path)
        fog.hide_viewport = fog.hide_render = True
        remove(light(fog, folder=tmp_path))
        bpy.context.view_layer.update()
        assert hidden(fog) == [True]

    def test_all_sources_of_one_light_come_back(self, scene, tmp_path):
        fogs = [scenery.add_fog(tmp_path, name=name) for name in ("a", "b")]
        delete(light(*fogs, folder=tmp_path))
        bpy.context.view_layer.update()
        assert hidden(*fogs) == [False, False]
        assert clear(bpy.context).count == 2

    def test_light_in_one_of_two_scenes_stands_for_the_source(self, fog, baked):
        bpy.data.scenes.new("other").collection.objects.link(fog)
        bpy.context.view_layer.update()
        assert hidden(fog) == [True]

    def test_a_script_may_save_at_once(self, baked, tmp_path):
        remove(baked)
        path = str(tmp_path / "scene.blend")
        bpy.ops.wm.save_as_mainfile(filepath=path)
        bpy.ops.wm.open_mainfile(filepath=path)
        assert hidden(bpy.data.objects["fog"]) == [False]

    def test_files_that_were_saved_without_a_source_in_sight_are_mended(
        self, baked, tmp_path, monkeypatch
    ):
        path = str(tmp_path / "scene.blend")
        with monkeypatch.context() as patch:
            patch.setattr(ties, "mend", lambda: None)
            delete(baked)
            bpy.ops.wm.save_as_mainfile(filepath=path)
            bpy.ops.wm.open_mainfile(filepath=path)
            assert hidden(bpy.data.objects["fog"]) == [True]
        bpy.ops.wm.open_mainfile(filepath=path)
        assert hidden(bpy.data.objects["fog"]) == [False]
        assert clear(bpy.context).count == 1
        assert bpy.data.objects.keys() == ["fog", "sun"]

    def test_a_new_bake_takes_the_place_of_the_light(self, scene, fog, baked):
        scene.lb_lighting.resolution = 8
        delete(baked)
        bake_light(bpy.data.objects["fog"], mode="ADD")
        assert volumes() == {"LB fog", "fog"}
        bpy.context.view_layer.update()
        assert hidden(bpy.data.objects["fog"]) == [False]

    def test_light_whose_source_was_deleted_goes_with_clear(self, fog, baked):
        remove(fog)
        bpy.context.view_layer.update()
        assert baked_volumes(bpy.context.scene) == [baked]
        assert clear(bpy.context).count == 1
        assert "LB fog" not in bpy.data.objects

    def test_where_nothing_is_wrong_nothing_is_changed(self, fog, baked):
        before = snapshot()
        changed = []
        bpy.app.handlers.depsgraph_update_post.append(lambda *_: changed.append(1))
        try:
            ties.mend()
            bpy.context.view_layer.update()
        finally:
            bpy.app.handlers.depsgraph_update_post.pop()
        assert (snapshot(), changed) == (before, [])


class TestCopies:
    def test_a_copy_of_the_light_is_the_users(self, fog, baked, tmp_path):
        (copy,) = duplicate(baked)
        path, shown = baked_path(copy), copy.active_material
        assert light(fog, folder=tmp_path) == baked  # another bake
        assert baked_path(baked) != path == baked_path(copy)
        assert copy.active_material == shown != baked.active_material
        assert clear(bpy.context).count == 1
        assert copy.name in bpy.context.scene.objects
        assert baked_path(copy) == path
        assert hidden(fog, copy) == [False, False]

    def test_of_a_light_without_a_source_the_copy_stays(self, fog, baked):
        remove(fog)
        (copy,) = duplicate(baked)
        clear(bpy.context)
        assert volumes() == {copy.name}

    def test_a_copy_of_the_light_can_be_baked(self, scene, fog, baked):
        scene.lb_lighting.resolution = 8
        (copy,) = duplicate(baked)
        outcome = bake_light(copy)
        assert outcome.result.optics.sigma_s == pytest.approx(3.6)
        assert outcome.result.optics.sigma_a == pytest.approx(0.4)
        assert hidden(fog, baked, copy) == [True, False, True]
        assert copy[RESULT] not in (None, baked)

    def test_a_copy_of_the_source_is_as_before_the_bake(self, fog, baked):
        copy = fog.copy()
        bpy.context.scene.collection.objects.link(copy)
        bpy.context.view_layer.update()
        assert hidden(fog, copy) == [True, False]
        assert sources_of(bpy.context.scene, [baked]) == [fog]

    def test_a_bake_of_the_copy_leaves_the_light_of_the_first(self, scene, fog, baked):
        scene.lb_lighting.resolution = 8
        copy, path = fog.copy(), baked_path(baked)
        scene.collection.objects.link(copy)
        copy.location.x = 5
        bake_light(copy)
        assert hidden(fog, copy) == [True, True]
        assert baked_path(baked) == path
        assert fog[RESULT] == baked != copy[RESULT]
        assert clear(bpy.context).count == 2
        assert hidden(fog, copy) == [False, False]

    def test_source_and_light_copied_together_are_a_pair(self, fog, baked):
        fog.hide_viewport = False  # as in the outliner, which also copies hidden objects
        bpy.context.view_layer.update()
        copied_light, copy = duplicate(fog, baked)
        copy.hide_viewport = fog.hide_viewport = True
        assert sources_of(bpy.context.scene, [copied_light]) == [copy]
        assert sources_of(bpy.context.scene, [baked]) == [fog]
        delete(copied_light)
        bpy.context.view_layer.update()
        assert hidden(fog, copy) == [True, False]

    def test_a_full_copy_of_the_scene_is_cleared_alone(self, fog, baked, tmp_path):
        path = baked_path(baked)
        bpy.ops.scene.new(type="FULL_COPY")
        other = bpy.context.scene
        assert len(baked_volumes(other)) == 1
        cleared = clear(bpy.context)
        assert cleared.count == 1
        (note,) = cleared.delete_files()
        assert note == f"{path} was kept, because 'LB fog' still shows it."
        assert path.exists()
        assert hidden(fog) == [True]

    def test_light_of_a_file_that_is_older_than_the_marking_of_copies(self, fog, baked):
        for ob in (fog, baked):
            del ob["lb_lighting_identity"]
        ties.mend()
        (copy,) = duplicate(baked)
        clear(bpy.context)
        assert volumes() == {copy.name, "fog"}


class TestAppended:
    @pytest.fixture
    def library(self, baked, tmp_path):
        path = tmp_path / "library.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        bpy.ops.wm.read_factory_settings(use_empty=True)
        return path

    def append(self, library, *names):
        with bpy.data.libraries.load(str(library)) as (_there, here):
            here.objects = list(names)
        for ob in here.objects:
            bpy.context.scene.collection.objects.link(ob)
        return here.objects

    def test_light_alone_is_the_users(self, library):
        (ob,) = self.append(library, "LB fog")
        assert baked_volumes(bpy.context.scene) == []
        assert clear(bpy.context).count == 0
        assert ob.name in bpy.data.objects

    def test_with_its_source_it_is_cleared_but_its_file_is_kept(self, library):
        fog, ob = self.append(library, "fog", "LB fog")
        path = baked_path(ob)
        assert ob[APPENDED]
        cleared = clear(bpy.context)
        assert hidden(fog) == [False]
        (note,) = cleared.delete_files()
        assert note == f"{path} was kept, because it belongs to another .blend file."
        assert path.exists()

    def test_what_is_linked_is_left_to_its_file(self, library):
        with bpy.data.libraries.load(str(library), link=True) as (_there, here):
            here.objects = ["fog", "LB fog"]
        for ob in here.objects:
            bpy.context.scene.collection.objects.link(ob)
        bpy.context.view_layer.update()
        assert clear(bpy.context).count == 0
        assert hidden(bpy.data.objects["fog"]) == [True]
        assert baked_volumes(bpy.context.scene)

    def test_an_override_has_its_light_in_its_own_file_once_it_is_baked(self, library, tmp_path):
        with bpy.data.libraries.load(str(library), link=True) as (_there, here):
            here.objects = ["fog", "LB fog"]
        linked = baked_path(here.objects[1])
        overrides = [ob.override_create(remap_local_usages=True) for ob in here.objects]
        for ob in overrides:
            bpy.context.scene.collection.objects.link(ob)
        fog, ob = overrides
        fog[RESULT] = ob
        bpy.context.view_layer.update()
        assert is_foreign(ob)
        assert light(fog, folder=tmp_path) == ob
        assert baked_path(bpy.data.objects["LB fog", str(library)]) == linked
        assert not is_foreign(ob)

    def test_what_was_baked_here_since_is_of_this_file(self, library, tmp_path):
        fog, ob = self.append(library, "fog", "LB fog")
        assert light(fog, folder=tmp_path) == ob
        path = baked_path(ob)
        assert clear(bpy.context).delete_files() == []
        assert not path.exists()


def test_many_objects_take_no_time_that_is_felt(scene, tmp_path):
    """The number of lookups grows with the objects, not with objects times sources."""
    sources = [scenery.source(f"leaf {n}") for n in range(30)]
    light(*sources, folder=tmp_path)
    looked = np.zeros(2, int)

    class Counted(set):
        def __contains__(self, item):
            looked[0] += 1
            return super().__contains__(item)

    scenes = [Counted(objects) for objects in scene_objects()]
    assert not any(is_lost(source, scenes) for source in sources)
    assert looked[0] == 2 * len(sources)
