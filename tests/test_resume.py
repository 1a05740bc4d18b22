# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames that are there already: kept where they are what the scene gives, and baked again else."""

import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import openvdb
import pytest

import lb_lighting
from lb_lighting import bake, worker
from lb_lighting.cache_key import cache_key
from lb_lighting.errors import EmptyError, SceneError
from lb_lighting.options import Options
from lb_lighting.output.modifier import has_modifier
from lb_lighting.output.vdb import DENSITY_GRID, LIGHT_GRID, read_metadata, read_whole, unfinished
from lb_lighting.output.volume import baked_path, baked_volumes
from lb_lighting.reading import read_scene
from lb_lighting.scene.volumes import Grid
from lb_lighting.sequence import REASONS, UNREADABLE, Sequence
from lb_lighting.transport import PointLight, Sky, Sun
from tests import scenery
from tests.scenery import read_grid


@pytest.fixture
def fog(scene, tmp_path):
    """A Volume object that stays the same in all frames."""
    scene.lb_lighting.resolution = 8
    return scenery.add_fog(tmp_path)


@pytest.fixture
def smoke(scene, tmp_path):
    """A function that makes a Volume object of a sequence with these values, None for no file."""

    def make(*frames):
        scene.lb_lighting.resolution = 8
        ob = scenery.add_fog(tmp_path)
        for number, values in enumerate(frames, 1):
            if values is not None:
                scenery.write_fog(tmp_path / f"smoke_{number:03}.vdb", values * scenery.ball())
        ob.data.filepath = str(tmp_path / "smoke_001.vdb")
        ob.data.is_sequence, ob.data.frame_duration = True, len(frames)
        return ob

    return make


def bake_frames(*objects, first=1, last=2, overwrite=False, **changes):
    options = Options.of(bpy.context.scene, **changes)
    work = Sequence(bpy.context, objects, options, first, last, overwrite)
    return bake.run(work, bpy.context)


def folder():
    (ob,) = baked_volumes(bpy.context.scene)
    return baked_path(ob).parent


def frames():
    """{frame: its file}."""
    return {int(path.stem[-4:]): path for path in sorted(folder().glob("frame_*.vdb"))}


def tokens():
    """{frame: the bake that wrote it}."""
    return {frame: read_metadata(path)["token"] for frame, path in frames().items()}


def colors():
    """{frame: (3,)}: the light of each, over that of red."""
    means = {n: read_grid(path)[0].mean(axis=(0, 1, 2)) for n, path in frames().items()}
    return {frame: mean / mean[0] for frame, mean in means.items()}


def test_only_frames_that_differ_are_baked_again(scene, fog):
    bake_frames(fog, last=4)
    old, before = folder(), tokens()
    data = bpy.data.objects["sun"].data
    for frame, color in ((2, (1, 1, 1)), (3, (1, 0.5, 0.25))):
        data.color = color
        data.keyframe_insert("color", frame=frame)
    for curve in data.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"
    notes = bake_frames(fog, last=4).notes
    assert "Kept, because nothing has changed: frames 1 to 2." in notes
    assert f"Baked again, because {REASONS['essence_lights']}: frames 3 to 4." in notes
    assert folder() != old
    assert len(list(old.glob("*.vdb"))) == 4  # undo shows them
    after = tokens()
    assert [after[frame] == before[frame] for frame in (1, 2, 3, 4)] == [True, True, False, False]
    for frame, color in colors().items():
        assert color == pytest.approx((1, 1, 1) if frame < 3 else (1, 0.5, 0.25), rel=0.02)
    with pytest.raises(SceneError, match="are all baked"):
        bake_frames(fog, last=4)


def moved(fog):
    fog.location.x = 1
    return "essence_sources"


def of_another_material(fog):
    nodes = fog.active_material.node_tree.nodes
    nodes["Principled Volume"].inputs["Density"].default_value = 1
    return "essence_sources"


def with_other_smoke(fog):
    scenery.write_fog(fog.data.filepath, scenery.ball() / 2)
    return "essence_sources"


def under_a_red_sun(_fog):
    bpy.data.objects["sun"].data.color = (1, 0.5, 0.25)
    return "essence_lights"


def under_a_sky(_fog):
    bpy.context.scene.world = bpy.data.worlds.new("sky")
    return "essence_lights"


def in_smaller_voxels(_fog):
    bpy.context.scene.lb_lighting.resolution = 10
    return "essence"


def renamed_and_copied(fog):
    """Another file with the same grids."""
    fog.name = fog.data.name = "smoke"
    bpy.context.scene.lb_lighting.strength = 2
    fog.data.filepath = str(
        shutil.copy(fog.data.filepath, Path(fog.data.filepath).with_name("b.vdb"))
    )


@pytest.mark.parametrize(
    "change",
    [
        moved,
        of_another_material,
        with_other_smoke,
        under_a_red_sun,
        under_a_sky,
        in_smaller_voxels,
        renamed_and_copied,
    ],
    ids=lambda change: change.__name__,
)
def test_a_frame_tells_what_it_was_made_of(scene, fog, change):
    before = cache_keys(fog)
    assert cache_keys(fog) == before
    differs = change(fog)
    after = cache_keys(fog)
    assert [name for name in after if after[name] != before[name]] == [differs] * bool(differs)


def cache_keys(ob, **changes):
    options = Options.of(bpy.context.scene, **changes)
    return read_scene(bpy.context, [ob], options).cache_keys()


@pytest.mark.parametrize("how", ["ATTRIBUTE", "MODIFIER"])
@pytest.mark.parametrize("material", [True, False])
def test_showing_light_does_not_change_what_is_lit(scene, how, material):
    scene.lb_lighting.resolution = 8
    leaves = scenery.add_leaves(count=30, material=material)
    before = cache_keys(leaves, foliage=how)
    bake_frames(leaves, last=1, foliage=how)
    assert cache_keys(leaves, foliage=how) == before
    assert read_metadata(frames()[1]).items() >= before.items()


def test_a_mesh_that_keeps_the_light_of_the_last_frame_is_named(scene):
    scene.lb_lighting.resolution = 8
    notes = bake_frames(scenery.add_leaves(count=30)).notes
    assert any(note.startswith("'leaves' shows the light of the last frame") for note in notes)


def test_a_cache_key_tells_contents_apart_and_nothing_else():
    numbers = np.arange(6.0)
    alike = [numbers.copy(), {"b": 1, "a": (1.0, "x")}, None, len]
    assert cache_key(numbers, {"a": (1.0, "x"), "b": 1}, None, len) == cache_key(*alike)
    others = [
        cache_key(numbers.reshape(2, 3)),
        cache_key(numbers.astype("f4")),
        cache_key(numbers + 1e-12),
        cache_key([1, [2]], 3),
        cache_key([1, 2], [3]),
        cache_key("1"),
        cache_key(1),
        cache_key(True),
    ]
    assert len({cache_key(numbers), *others}) == len(others) + 1


def test_cache_keys_are_those_of_earlier_versions():
    """Or a sequence that an earlier version baked would be baked again as a whole."""
    lights = [Sun((0, 0.6, -0.8), (1, 2, 3)), Sky((1, 1, 1)), PointLight((0, 1, 2), 3.0)]
    assert cache_key(lights) == "c972eed024ba28ae0e8dfa01a2ccbeda"
    plain = {"a": {1, 2}, "b": (None, b"x", 1 + 2j, np.float32(0.1))}, np.arange(6.0), len
    assert cache_key(plain) == "dfa38b5a44a3f901f75fc8bef6ab435e"


def test_a_grid_of_nodes_is_keyed_by_its_values_without_its_empty_space():
    """Two voxels, 20000 voxels apart along each axis."""

    def key(value, far=20_000):
        grid = openvdb.FloatGrid()
        for place, number in ((0, 1.0), (far, value)):
            grid.getAccessor().setValueOn((place,) * 3, number)
        return cache_key(Grid("density", made=grid))

    assert key(0.5) == key(0.5)
    assert len({key(0.5), key(0.25), key(0.5, 19_999)}) == 3
    assert cache_key(Grid("density", made=openvdb.FloatGrid())) != key(0.5)


def test_frames_without_smoke_are_empty_and_the_others_go_on(scene, smoke):
    """The first has none yet, of the third the file is gone, the fifth is past the end."""
    ob = smoke(0, 1, None, 2)
    outcome = bake_frames(ob, last=5)
    (note,) = [note for note in outcome.notes if note.startswith("Empty")]
    assert note.startswith("Empty, so nothing is shown: frames 1, 3, 5.")
    grids = {}
    for frame, path in frames().items():
        density, light = (scenery.openvdb.read(str(path), n) for n in (DENSITY_GRID, LIGHT_GRID))
        grids[frame] = {g.name for g in scenery.openvdb.readAllGridMetadata(str(path))}
        for grid in (density, light):
            assert (grid.activeVoxelCount() == 0) == (frame in (1, 3, 5))
    assert all(names == grids[2] for names in grids.values())
    (shown,) = baked_volumes(scene)
    for frame in range(1, 6):
        scene.frame_set(frame)
        loaded = shown.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
        assert loaded.load()
        assert Path(loaded.frame_filepath) == frames()[frame]
    written = [path.stat().st_mtime_ns for path in frames().values()]
    with pytest.raises(SceneError, match="are all baked"):
        bake_frames(ob, last=5)
    assert [path.stat().st_mtime_ns for path in frames().values()] == written


def test_smoke_that_begins_at_last_takes_the_place_of_an_empty_frame(scene, smoke, tmp_path):
    ob = smoke(1, None)
    bake_frames(ob)
    scenery.write_fog(tmp_path / "smoke_002.vdb", scenery.ball())
    scene.frame_set(1)
    notes = bake_frames(ob).notes
    assert "Kept, because nothing has changed: frame 1." in notes
    assert not any(note.startswith("Empty") for note in notes)
    densities = [read_grid(path, DENSITY_GRID)[0] for path in frames().values()]
    np.testing.assert_array_equal(*densities)


def test_frames_that_are_all_empty_are_refused(scene, smoke, tmp_path):
    ob = smoke(0, None, 0)
    before, facts = set(tmp_path.iterdir()), scenery.snapshot()
    with pytest.raises(SceneError, match="nothing to light in frames 1 to 3"):
        bake_frames(ob, last=3)
    assert set(tmp_path.iterdir()) == before
    assert scenery.snapshot() == facts


def test_one_frame_by_itself_must_not_be_empty(scene, smoke):
    ob = smoke(0, 1)
    with pytest.raises(EmptyError, match="The grid 'density' is empty"):
        scenery.bake_light(ob)


def test_outside_of_the_frames_the_nearest_one_stays(scene, smoke):
    ob = smoke(1, 2, 3)
    bake_frames(ob, first=2, last=3)
    (shown,) = baked_volumes(scene)
    for frame, nearest in ((-5, 2), (1, 2), (4, 3), (99, 3)):
        scene.frame_set(frame)
        grids = shown.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
        assert grids.load()
        assert Path(grids.frame_filepath) == frames()[nearest]


def test_a_larger_range_shows_frames_that_are_there(scene, fog):
    bake_frames(fog, last=1)
    bake_frames(fog, first=2, last=2)
    outcome = bake_frames(fog)
    assert outcome.summary == "The frames 1 to 2 are all baked"
    assert "Kept, because nothing has changed: frames 1 to 2." in outcome.notes
    (shown,) = baked_volumes(scene)
    assert (shown.data.frame_start, shown.data.frame_duration) == (1, 2)


def test_damaged_frames_are_baked_again(scene, fog):
    bake_frames(fog, last=3)
    old, before = frames(), tokens()
    for frame, left in ((2, 1), (3, 1000)):
        old[frame].write_bytes(old[frame].read_bytes()[:left])
        assert read_whole(old[frame]) == {}
    notes = bake_frames(fog, last=3).notes
    assert f"Baked again, because {UNREADABLE}: frames 2 to 3." in notes
    assert frames()[2] != old[2]  # Blender may have read what it was
    assert tokens()[1] == before[1]
    assert all(read_whole(path) for path in frames().values())


def test_a_file_without_its_end_is_not_whole(scene, fog):
    path = scenery.bake_light(fog).path
    assert read_whole(path) == read_metadata(path)
    path.write_bytes(path.read_bytes()[:-1])
    assert read_whole(path) == {}


def test_scraps_of_one_bake_are_not_those_of_another(scene, fog):
    bake_frames(fog, last=1)
    path = frames()[1]
    task = read_scene(bpy.context, [fog], Options.of(scene), path, frame=1)
    other = unfinished(path, "another")
    for name in (other, unfinished(path, task.token)):
        name.write_bytes(b"begun")
    worker.remove_scraps(task)
    assert path.exists()
    assert other.exists()
    assert not unfinished(path, task.token).exists()
    task.token = read_metadata(path)["token"]
    worker.remove_scraps(task)
    assert not path.exists()


def test_two_processes_bake_the_same_frames(scene, fog, tmp_path):
    scenery.select(fog)
    blend = str(tmp_path / "shared.blend")
    bake_frames(fog, last=1)
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    command = [sys.executable, "-m", "lb_lighting", "bake", blend, "--frames", "1-4"]
    home = Path(lb_lighting.__file__).parent.parent
    both = [
        subprocess.Popen(
            [*command, "--output", str(tmp_path / f"{n}.blend")],
            cwd=home,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for n in range(2)
    ]
    outputs = [process.communicate()[0] for process in both]
    assert [process.returncode for process in both] == [0, 0], outputs
    assert list(frames()) == [1, 2, 3, 4]
    assert all(read_whole(path) for path in frames().values())
    densities = {read_grid(path, DENSITY_GRID)[0].sum() for path in frames().values()}
    assert len(densities) == 1
    assert not list(folder().glob(".*"))


def test_a_cloud_that_begins_later_leaves_the_plant_beside_it_as_it_is(scene, smoke):
    """In the first frame there is nothing of it, and it is no fog of leaves either."""
    ob, leaves = smoke(0, 1), scenery.add_leaves(count=20)
    notes = bake_frames(ob, leaves, foliage="MODIFIER").notes
    assert any(note.startswith(f"'{ob.name}' is left out.") for note in notes)
    grids = [scenery.openvdb.read(str(path), DENSITY_GRID) for path in frames().values()]
    assert [grid.activeVoxelCount() > 0 for grid in grids] == [False, True]
    (shown,) = baked_volumes(scene)
    assert not shown.hide_render
    assert ob.hide_render
    assert has_modifier(leaves)
    assert not has_modifier(ob)


def test_a_cloud_that_ends_beside_a_plant_stays_hidden(scene, smoke):
    ob, leaves = smoke(1, 0), scenery.add_leaves(count=20)
    bake_frames(ob, leaves)
    (shown,) = baked_volumes(scene)
    assert not shown.hide_render
    assert ob.hide_render


def test_what_cannot_be_lit_beside_it_changes_no_frame(scene, fog, tmp_path):
    """It is left out of bakes, and so of what frames are compared with."""
    path = str(tmp_path / "library.blend")
    leaves = scenery.add_leaves(count=20)
    bpy.data.libraries.write(path, {leaves})
    bpy.data.objects.remove(leaves)
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["leaves"]
    scene.collection.objects.link(here.objects[0])
    notes = bake_frames(fog, here.objects[0]).notes
    assert any(note.startswith("'leaves' is left out.") for note in notes)
    with pytest.raises(SceneError, match="are all baked"):
        bake_frames(fog, here.objects[0])
