# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that Clear deletes on request: all of ours, except those that are still shown."""

import os
import tempfile
from pathlib import Path

import bpy
import pytest

from lb_lighting import cli
from lb_lighting.clearing import clear
from lb_lighting.errors import OutputError
from lb_lighting.output.volume import baked_path
from tests import scenery
from tests.keeping import light, write_light


@pytest.fixture
def fog(scene, tmp_path):
    return scenery.add_fog(tmp_path)


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.*"))


def test_all_frames_of_a_sequence_and_their_folder_go(fog, tmp_path):
    frames = baked_path(light(fog, folder=tmp_path, frames=(1, 3))).parent
    assert len(files(frames)) == 3
    assert bpy.ops.lb_lighting.clear(delete_files=True) == {"FINISHED"}
    assert not frames.exists()
    assert files(tmp_path) == ["fog.vdb"]


def test_files_of_others_stay_in_the_folder_of_a_sequence(fog, tmp_path):
    frames = baked_path(light(fog, folder=tmp_path, frames=(1, 3))).parent
    scenery.write_fog(frames / "frame_0007.vdb", scenery.ball())
    (frames / "notes.txt").write_text("mine")
    write_light(frames / "cloud.vdb")  # ours, but not of this sequence
    clear(bpy.context).delete_files()
    assert files(frames) == ["cloud.vdb", "frame_0007.vdb", "notes.txt"]


@pytest.mark.parametrize("frames", [None, (1, 3)])
def test_a_file_that_a_copy_shows_is_kept_and_the_user_is_told(fog, tmp_path, frames, capfd):
    baked = light(fog, folder=tmp_path, frames=frames)
    path, before = baked_path(baked), files(tmp_path)
    scenery.select(baked)
    bpy.ops.object.duplicate()
    assert bpy.ops.lb_lighting.clear(delete_files=True) == {"FINISHED"}
    kept = path.parent if frames else path
    note = f"Warning: {kept} was kept, because 'LB fog.001' still shows it."
    assert note in capfd.readouterr().out
    assert files(tmp_path) == before


def test_a_file_that_only_a_volume_without_an_object_shows_is_kept(fog, tmp_path):
    path = baked_path(light(fog, folder=tmp_path))
    other = bpy.data.volumes.new("mine")
    other.filepath, other.use_fake_user = str(path), True
    (note,) = clear(bpy.context).delete_files()
    assert "'mine' still shows it" in note
    assert path.exists()


def test_light_that_was_deleted_leaves_no_file(fog, tmp_path):
    bpy.ops.object.select_all(action="DESELECT")
    baked = light(fog, folder=tmp_path)
    scenery.select(baked)
    bpy.ops.object.delete()
    clear(bpy.context).delete_files()
    assert files(tmp_path) == ["fog.vdb"]


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs POSIX users")
def test_a_file_that_cannot_be_deleted_does_not_save_the_others(scene, tmp_path):
    with tempfile.TemporaryDirectory() as closed, tempfile.TemporaryDirectory() as other:
        closed, other = Path(closed), Path(other)
        other.chmod(0o777)
        first, second = (scenery.add_fog(tmp_path, name=name) for name in ("a", "b"))
        kept = baked_path(light(first, folder=closed))
        gone = baked_path(light(second, folder=other))
        cleared = clear(bpy.context)
        expected = pytest.raises(OutputError, match=f"{kept.name} could not be deleted")
        with scenery.read_only(closed), expected:
            cleared.delete_files()
        assert kept.exists()
        assert not gone.exists()


def test_files_go_only_when_the_scene_without_them_is_saved(fog, tmp_path, monkeypatch, capsys):
    path = baked_path(light(fog, folder=tmp_path))
    blend = tmp_path / "lit.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    arguments = ["clear", str(blend), "--delete-files"]

    def refuse(_path):
        raise OutputError("no space")

    with monkeypatch.context() as patch:
        patch.setattr(cli, "save", refuse)
        assert cli.main(arguments, opens_file=True) == 1
    assert path.exists()
    assert cli.main(arguments, opens_file=True) == 0
    assert not path.exists()
    assert "LB light removed from 1 object\n" in capsys.readouterr().out
