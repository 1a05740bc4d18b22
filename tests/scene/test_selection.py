# SPDX-License-Identifier: GPL-3.0-or-later
"""Selected objects that cannot be lit are skipped with a note; the others are baked."""

import bpy
import numpy as np
import pytest

from lb_lighting import bake, cli
from lb_lighting.errors import LightingError, SceneError
from lb_lighting.options import Options
from lb_lighting.output.attribute import AMBIENT_ATTRIBUTE
from lb_lighting.output.sources import RESULT
from lb_lighting.output.volume import baked_volumes
from lb_lighting.scene.medium_choice import FROM_MATERIAL
from lb_lighting.scene.opening import open_sources
from lb_lighting.scene.reader import Reader
from lb_lighting.sequence import Sequence
from tests import scenery
from tests.scenery import bake_light


@pytest.fixture
def scene(scene):
    """A scene with few voxels, because these tests do not check the light."""
    scene.lb_lighting.resolution = 8
    return scene


def read(*objects):
    """([name of each source], notes)."""
    reader = Reader(bpy.context.evaluated_depsgraph_get(), FROM_MATERIAL, 30.0, "")
    return [source.name for source in open_sources(objects, reader)], reader.notes


def is_lit(ob):
    return AMBIENT_ATTRIBUTE in ob.data.attributes


def add_everything_else():
    """Objects that have neither a volume nor faces."""
    data, bare = bpy.data, bpy.data.meshes.new("bare")
    bare.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    things = {
        "eye": data.cameras.new("eye"),
        "lamp": data.lights.new("lamp", "POINT"),
        "root": None,
        "rig": data.armatures.new("rig"),
        "cage": data.lattices.new("cage"),
        "path": data.curves.new("path", "CURVE"),
        "words": data.curves.new("words", "FONT"),
        "noise": data.speakers.new("noise"),
        "probe": data.lightprobes.new("probe", "SPHERE"),
        "sketch": data.grease_pencils.new("sketch"),
        "bare": bare,
    }
    things["words"].body = ""
    return [scenery.link(name, block) for name, block in things.items()]


def turn_by_nan(ob):
    ob.rotation_euler = (np.nan, 0, 0)


def scale_to_nothing(ob):
    ob.scale = (0, 0, 0)


def flatten_a_solid(ob):
    ob.scale, ob.lb_lighting.role = (1, 1, 0), "SOLID"


def move_a_vertex_to_nowhere(ob):
    ob.data.vertices[0].co = (np.nan, 0, 0)


def move_a_vertex_beyond_reach(ob):
    ob.data.vertices[0].co = (3e38, 0, 0)


def edit(ob):
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")


UNREADABLE = {
    turn_by_nan: "'ball' has a location, rotation or scale that is not a number; clear it.",
    scale_to_nothing: "'ball' is scaled to nothing; give it a size.",
    flatten_a_solid: "'ball' is scaled to nothing along an axis; give it a size.",
    move_a_vertex_to_nowhere: "'ball' has vertices whose position is not a number; repair "
    "or delete them.",
    move_a_vertex_beyond_reach: "'ball' has vertices whose position is not a number; repair "
    "or delete them.",
    edit: "'ball' is in Edit Mode; leave Edit Mode to light it.",
}


class TestReading:
    def test_objects_that_are_no_source_share_a_note(self):
        scenery.add_leaves()
        others = add_everything_else()
        names, (note,) = read(*others[:5], bpy.data.objects["leaves"])
        assert names == ["leaves"]
        assert note == (
            "Skipped, as they have neither a volume nor faces: "
            "'eye', 'lamp', 'root', 'rig', 'cage'."
        )

    def test_one_is_skipped(self):
        leaves, eye = scenery.add_leaves(), scenery.link("eye", bpy.data.cameras.new("eye"))
        names, notes = read(eye, leaves)
        assert names == ["leaves"]
        assert notes == ["Skipped, as it has neither a volume nor faces: 'eye'."]

    def test_a_long_list_is_shortened(self):
        others = add_everything_else()
        _found, (note,) = read(*others, scenery.add_leaves())
        names = "'eye', 'lamp', 'root', 'rig', 'cage', 'path', 'words', 'noise'"
        assert note.endswith(f": {names} and 3 more.")

    def test_a_selection_without_a_source_is_refused(self):
        with pytest.raises(SceneError, match=r"^'eye' has neither a volume nor faces; select"):
            read(*add_everything_else())

    def test_hidden_objects_are_skipped(self):
        leaves, away = scenery.add_leaves(), scenery.add_ball("away")
        away.hide_set(True)
        assert read(leaves, away) == (["leaves"], ["Skipped, as it is hidden: 'away'."])

    @pytest.mark.parametrize("spoil", UNREADABLE, ids=lambda spoil: spoil.__name__)
    def test_a_source_that_cannot_be_read_is_left_out_and_named(self, spoil):
        leaves, ball = scenery.add_leaves(), scenery.add_ball()
        spoil(ball)
        bpy.context.view_layer.update()
        names, notes = read(ball, leaves)
        assert names == ["leaves"]
        assert notes == [f"'ball' is left out. {UNREADABLE[spoil]}"]

    @pytest.mark.parametrize("spoil", UNREADABLE, ids=lambda spoil: spoil.__name__)
    def test_a_single_source_that_cannot_be_read_is_refused(self, spoil):
        ball = scenery.add_ball()
        spoil(ball)
        bpy.context.view_layer.update()
        with pytest.raises(SceneError) as caught:
            read(ball)
        assert str(caught.value) == UNREADABLE[spoil]

    def test_a_missing_file_is_left_out(self):
        gone = bpy.data.volumes.new("gone")
        gone.filepath = "//gone.vdb"
        gone = scenery.link("gone", gone)
        names, notes = read(gone, scenery.add_leaves())
        assert names == ["leaves"]
        assert notes[0].startswith("'gone' is left out. The volume file '//gone.vdb' of 'gone'")

    @pytest.mark.parametrize("number", [-5, 7])
    def test_a_missing_slot_counts_as_the_nearest(self, number):
        ball = scenery.add_ball(material=scenery.leaf_material())
        ball.data.materials.append(scenery.leaf_material((0.9, 0.1, 0.1)))
        slots = ball.data.attributes.new("material_index", "INT", "FACE")
        slots.data.foreach_set("value", np.full(len(ball.data.polygons), number, np.int32))
        reader = Reader(bpy.context.evaluated_depsgraph_get(), FROM_MATERIAL, 30.0, "")
        (source,) = open_sources([ball], reader)
        (leaf,) = source.leaves
        assert leaf[1].sigma_s == pytest.approx((0.1, 0.5, 0.1) if number < 0 else (0.9, 0.1, 0.1))


class TestBakes:
    def test_everything_is_selected(self, scene, tmp_path):
        leaves, _others = scenery.add_leaves(), add_everything_else()
        scenery.select(*scene.objects)
        assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
        assert is_lit(leaves)
        assert [ob.name for ob in scene.objects if RESULT in ob] == ["leaves"]
        scenery.select(*(ob for ob in scene.objects if not ob.hide_viewport))
        assert bpy.ops.lb_lighting.bake() == {"FINISHED"}  # with the baked volume
        assert len(baked_volumes(scene)) == 1

    def test_a_baked_volume_whose_source_is_gone_is_left_out(self, scene, tmp_path):
        fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
        bake_light(fog)
        (lost,) = baked_volumes(scene)
        bpy.data.objects.remove(fog)
        outcome = bake_light(lost, leaves)
        beginning = f"'{lost.name}' is left out. The objects that '{lost.name}' was baked from"
        assert any(note.startswith(beginning) for note in outcome.notes)
        assert is_lit(leaves)

    def test_linked_objects_are_left_out(self, scene, tmp_path):
        scenery.add_ball("far")
        path = str(tmp_path / "library.blend")
        bpy.data.libraries.write(path, {bpy.data.objects["far"]})
        bpy.data.objects.remove(bpy.data.objects["far"])
        with bpy.data.libraries.load(path, link=True) as (_there, here):
            here.objects = ["far"]
        scene.collection.objects.link(here.objects[0])
        leaves = scenery.add_leaves()
        outcome = bake_light(here.objects[0], leaves)
        assert is_lit(leaves)
        note = "'far' is left out. 'far' is linked from another file; make it local."
        assert note in outcome.notes

    def test_an_open_solid_is_left_out_and_unchanged(self, scene):
        """It is names only when the voxels are filled."""
        leaves, mesh = scenery.add_leaves(), bpy.data.meshes.new("sheet")
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
        mesh.materials.append(scenery.volume_material())
        sheet = scenery.link("sheet", mesh)
        outcome = bake_light(sheet, leaves)
        assert any(n.startswith("'sheet' is left out. The mesh is flat") for n in outcome.notes)
        assert is_lit(leaves)
        assert not sheet.hide_viewport
        assert not sheet.hide_render
        with pytest.raises(SceneError, match="The mesh is flat"):
            bake_light(sheet)

    def test_a_loose_vertex_at_infinity_does_not_matter(self, scene):
        leaves = scenery.add_leaves()
        leaves.data.vertices.add(2)
        leaves.data.vertices[-2].co, leaves.data.vertices[-1].co = (np.nan, 0, 0), (3e38, 0, 0)
        bake_light(leaves)
        assert np.isfinite(scenery.ambient(leaves)).all()

    def test_a_domain_at_infinity_is_named(self, scene):
        leaves, box = scenery.add_leaves(), scenery.add_ball("box")
        box.location.x = np.nan
        bpy.context.view_layer.update()
        with pytest.raises(LightingError, match=r"^The domain 'box' has a location, rotation or"):
            bake_light(leaves, domain="box")

    def test_a_sequence_goes_on_though_a_camera_is_selected(self, scene, tmp_path):
        fog, eye = scenery.add_fog(tmp_path), scenery.link("eye", bpy.data.cameras.new("eye"))
        options = Options.of(scene)
        paths = set()
        for last in (1, 2):
            sequence = Sequence(bpy.context, [eye, fog], options, 1, last)
            paths.add(bake.run(sequence, bpy.context).path.parent)
        assert len(paths) == 1

    def test_an_occluder_without_an_area_stops_nothing(self, scene):
        leaves, wall = scenery.add_leaves(), scenery.add_ball("wall", radius=0, role="OCCLUDER")
        bake_light(leaves, wall)
        assert is_lit(leaves)

    def test_an_object_much_smaller_than_the_others_is_noted(self, scene):
        leaves, speck = scenery.add_leaves(), scenery.add_ball("speck", radius=0.01)
        outcome = bake_light(leaves, speck)
        (note,) = [note for note in outcome.notes if "voxels wide beside the other objects" in note]
        assert note.startswith("'speck' is only 0.04 voxels")

    def test_long_names(self, scene):
        leaves = scenery.add_leaves(name="y" * 300)
        assert bake_light(leaves).path.is_file()

    @pytest.mark.parametrize("length", [300, 4000])
    def test_a_folder_that_is_too_long_is_refused(self, scene, length):
        with pytest.raises(LightingError, match=r"does not exist; choose|too long a path"):
            bake_light(scenery.add_leaves(), folder="/tmp/" + "y" * length)


class TestCommandLine:
    def bake(self, path, *arguments):
        return cli.main(["bake", str(path), *arguments], opens_file=True)

    def save(self, folder):
        path = folder / "scene.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        return path

    def test_a_camera_among_the_objects_is_skipped(self, scene, tmp_path, capsys):
        scenery.add_leaves()
        scenery.link("eye", bpy.data.cameras.new("eye"))
        path = self.save(tmp_path)
        assert self.bake(path, "--objects", "eye", "leaves") == 0
        assert "Skipped, as it has neither a volume nor faces: 'eye'." in capsys.readouterr().out
        assert is_lit(bpy.data.objects["leaves"])
        assert self.bake(path, "--objects", "eye") == 1
        assert "'eye' has neither a volume nor faces; select" in capsys.readouterr().err

    def test_a_file_that_was_saved_in_edit_mode(self, scene, tmp_path):
        leaves = scenery.add_leaves()
        scenery.select(leaves)
        edit(leaves)
        assert self.bake(self.save(tmp_path)) == 0
        assert is_lit(bpy.data.objects["leaves"])
