# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames baked one after the other: their files, what is kept, and what is begun anew."""

from pathlib import Path

import bpy
import numpy as np
import pytest

from lb_lighting import bake, job
from lb_lighting.errors import OutputError, SceneError, SolverError
from lb_lighting.options import Options
from lb_lighting.output.vdb import DENSITY_GRID, read_metadata
from lb_lighting.output.volume import baked_path, baked_volumes
from lb_lighting.sequence import Sequence
from lb_lighting.ui import running
from tests import scenery
from tests.scenery import read_grid

FRAMES = (1, 2, 3)


@pytest.fixture
def fog(scene, tmp_path):
    """A Volume object that shows another file at each frame, denser by the frame."""
    folder = tmp_path / "smoke"
    folder.mkdir()
    for frame in FRAMES:
        scenery.write_fog(folder / f"fog_{frame:03}.vdb", frame * scenery.ball())
    ob = scenery.add_fog(tmp_path)
    ob.data.filepath = str(folder / "fog_001.vdb")
    ob.data.is_sequence, ob.data.frame_duration = True, len(FRAMES)
    (tmp_path / "fog.vdb").unlink()
    scene.frame_set(2)
    return ob


def bake_frames(ob, first=1, last=3, overwrite=False, progress=None, **changes):
    options = Options.of(bpy.context.scene, **changes)
    work = Sequence(bpy.context, [ob], options, first, last, overwrite)
    return bake.run(work, bpy.context, progress)


def baked():
    (ob,) = baked_volumes(bpy.context.scene)
    return ob


def frames():
    """{name: time of its last change} of the frames that are shown."""
    folder = baked_path(baked()).parent
    return {path.name: path.stat().st_mtime_ns for path in sorted(folder.iterdir())}


def test_a_missing_folder_is_reported_as_for_a_single_bake(scene, fog, tmp_path):
    nowhere = tmp_path / "nowhere"
    with pytest.raises(OutputError, match="nowhere does not exist; choose another or create it"):
        bake_frames(fog, folder=str(nowhere))
    assert not nowhere.exists()
    assert not fog.hide_render


def test_frames_are_planned_once(scene, fog):
    stages = []
    outcome = bake_frames(fog, progress=lambda *now: stages.append(now[0]), quality="preview")
    assert {stage for stage in stages if "Planning" in stage} == {"Frame 1: Planning"}
    assert outcome.plan is None
    stamps = [read_metadata(outcome.path.with_name(name)) for name in frames()]
    assert {stamp["quality"] for stamp in stamps} == {"preview"}
    stages.clear()
    fog.data.sequence_mode = "EXTEND"
    bake_frames(fog, last=4, progress=lambda *now: stages.append(now[0]), quality="preview")
    assert stages
    assert not any("Planning" in stage for stage in stages)  # of the frame that was added, either


def test_each_frame_has_its_own_light(scene, fog):
    reports = []
    outcome = bake_frames(fog, progress=lambda *status: reports.append(status))
    assert list(frames()) == ["frame_0001.vdb", "frame_0002.vdb", "frame_0003.vdb"]
    densities = [
        read_grid(outcome.path.with_name(name), DENSITY_GRID)[0].max() for name in frames()
    ]
    assert np.divide(densities, densities[0]) == pytest.approx(FRAMES, rel=1e-5)
    assert scene.frame_current == 2
    assert next(stage.split(":")[0] for stage, _fraction in reports) == "Frame 1"
    fractions = [fraction for _stage, fraction in reports]
    assert fractions == sorted(fractions)


def test_blender_shows_the_file_of_its_frame(scene, fog):
    bake_frames(fog)
    for frame in FRAMES:
        scene.frame_set(frame)
        shown = baked().evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
        assert shown.load()
        assert Path(shown.frame_filepath).name == f"frame_{frame:04}.vdb"


def test_cancelled_it_tells_what_is_kept(scene, fog):
    work = Sequence(bpy.context, [fog], Options.of(scene), 1, 3)
    assert work.kept == "nothing was changed"
    job.wait(work)
    assert work.apply(bpy.context) is None
    running.start(work)
    assert bpy.ops.lb_lighting.cancel() == {"FINISHED"}
    assert running.last == ("The bake was cancelled; 1 of 3 frames are baked and kept",)
    assert list(frames()) == ["frame_0001.vdb"]


def test_an_ended_bake_goes_on_where_it_was(scene, fog, processes):
    """The second solver is killed; what it left is not taken for a frame."""
    killing = lambda *_status: len(processes) == 2 and processes[1].kill()  # noqa: E731
    with pytest.raises(SolverError):
        bake_frames(fog, progress=killing)
    before = frames()
    assert list(before) == ["frame_0001.vdb"]
    assert scene.frame_current == 2
    bake_frames(fog)
    after = frames()
    assert len(after) == 3
    assert after["frame_0001.vdb"] == before["frame_0001.vdb"]


def test_what_is_baked_is_kept_unless_asked(scene, fog):
    bake_frames(fog)
    before, folder = frames(), baked_path(baked()).parent
    with pytest.raises(SceneError, match="1 to 3 are all baked; choose Overwrite Frames to bake"):
        bake_frames(fog)
    assert frames() == before
    bake_frames(fog, overwrite=True)
    assert baked_path(baked()).parent != folder
    assert len(frames()) == 3
    assert len(list(folder.iterdir())) == 3  # undo shows them again


def test_other_options_make_other_frames(scene, fog):
    bake_frames(fog)
    folder = baked_path(baked()).parent
    bake_frames(fog, strength=0.5, resolution=12)
    assert baked_path(baked()).parent != folder


def test_a_range_that_ends_before_it_begins_is_refused(scene, fog, tmp_path):
    before = set(tmp_path.iterdir())
    with pytest.raises(SceneError, match="The last frame comes before the first; correct"):
        bake_frames(fog, 3, 1)
    assert set(tmp_path.iterdir()) == before


def test_a_frame_that_cannot_be_read_leaves_nothing(scene, fog, tmp_path):
    fog.data.filepath = str(tmp_path / "nowhere_001.vdb")
    before = set(tmp_path.iterdir())
    with pytest.raises(SceneError, match="cannot be read"):
        bake_frames(fog)
    assert set(tmp_path.iterdir()) == before
    assert scene.frame_current == 2


def test_one_frame_again_is_no_sequence(scene, fog):
    bake_frames(fog)
    scenery.bake_light(fog)
    assert not baked().data.is_sequence


def test_frames_of_one_material_are_gathered_alike(scene, fog):
    """Also those whose voxels would be too thick for it alone, and those that are baked later."""
    inputs = fog.active_material.node_tree.nodes["Principled Volume"].inputs
    for name, value in {"Anisotropy": 0.85, "Density": 40.0, "Color": (1, 1, 1, 1)}.items():
        inputs[name].default_value = value

    def iterations(**changes):
        bake_frames(fog, quality="preview", **changes)
        folder = baked_path(baked()).parent
        return {name: read_metadata(folder / name)["gathered"] for name in frames()}

    first, last = (f"frame_{n:04}.vdb" for n in (1, 3))
    assert iterations(first=3, last=3) == {last: 0}
    assert iterations(first=1, last=1, overwrite=True) == {first: 1}
    assert iterations(first=3, last=3) == {first: 1, last: 1}
    assert set(iterations(overwrite=True).values()) == {1}


def test_frames_show_all_light_alike(scene, fog):
    """Also those in which a lamp shines, too, and those that are baked later."""
    sun = bpy.data.objects["sun"].data
    for frame, energy in ((1, 0.0), (2, 3.0)):
        sun.energy = energy
        sun.keyframe_insert("energy", frame=frame)
    scene.world = bpy.data.worlds.new("sky")
    scene.lb_lighting.resolution = 8
    leaves = scenery.add_leaves(count=20)

    def whole(first, last):
        bake_frames(leaves, first, last, sky=True, foliage="MODIFIER")
        folder = baked_path(baked()).parent
        return [read_metadata(folder / name)["whole"] for name in frames()]

    assert whole(1, 1) == [True]
    assert whole(1, 2) == [True, True]
