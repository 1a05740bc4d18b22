# SPDX-License-Identifier: GPL-3.0-or-later
"""Saved files are complete: the light of unsaved files comes along, full disks are reported."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import openvdb
import pytest
from bpy.app.handlers import persistent

from lb_lighting import blend_file, cli
from lb_lighting.errors import OutputError
from lb_lighting.output import saving, vdb
from lb_lighting.output.volume import baked_path, baked_volumes, default_folder, unsaved_folder
from lb_lighting.ui import running
from tests import scenery
from tests.keeping import light, write_light

ROOT = Path(__file__).parents[2]


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The folder for results of unsaved files."""
    monkeypatch.setenv("BLENDER_USER_DATAFILES", str(tmp_path / "datafiles"))
    assert not unsaved_folder().exists()
    assert default_folder() == unsaved_folder() == tmp_path / "datafiles" / "lb_lighting"
    return default_folder()


@pytest.fixture
def project(tmp_path):
    project = tmp_path / "project"
    project.mkdir()
    return project


def save(path, **options):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)


def shown():
    """(stored path, names of the grids that Blender reads from it) of the only baked volume."""
    (ob,) = baked_volumes(bpy.context.scene)
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert evaluated.grids.load()
    return ob.data.filepath, sorted(grid.name for grid in evaluated.grids)


@pytest.fixture(params=[None, (1, 2)], ids=["one", "sequence"])
def unsaved(request, scene, home, tmp_path):
    """The path of the light that was baked in an unsaved file."""
    return baked_path(light(scenery.add_fog(tmp_path), folder=home, frames=request.param))


class TestFirstSave:
    def test_the_light_comes_along(self, unsaved, home, project):
        before = shown()[1]
        save(project / "scene.blend")
        within = unsaved.relative_to(home)
        assert (project / within).exists()
        assert shown() == (f"//{within}", before)
        shutil.rmtree(home)
        moved = project.with_name("moved")
        project.rename(moved)
        bpy.ops.wm.open_mainfile(filepath=str(moved / "scene.blend"))
        assert shown() == (f"//{within}", before)

    def test_a_whole_sequence_comes_along(self, scene, home, project, tmp_path):
        frames = baked_path(light(scenery.add_fog(tmp_path), folder=home, frames=(1, 3))).parent
        save(project / "scene.blend")
        names = [path.name for path in sorted((project / frames.name).iterdir())]
        assert names == ["frame_0001.vdb", "frame_0002.vdb", "frame_0003.vdb"]

    def test_without_relative_paths_it_comes_along_too(self, unsaved, home, project):
        save(project / "scene.blend", relative_remap=False)
        bpy.ops.wm.open_mainfile(filepath=str(project / "scene.blend"))
        assert shown()[0] == f"//{unsaved.relative_to(home)}"

    def test_undo_finds_the_light_and_the_next_save_brings_it_along(self, scene, home, project):
        fog = scenery.add_fog(project)
        bpy.ops.ed.undo_push(message="start")
        path = baked_path(light(fog, folder=home))
        bpy.ops.ed.undo_push(message="bake")
        fog.location.x = 1
        bpy.ops.ed.undo_push(message="move")
        save(project / "scene.blend")
        bpy.ops.ed.undo()
        assert shown()[1]
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=str(project / "scene.blend"))
        assert shown()[0] == f"//{path.name}"

    def test_a_copy_has_the_light_and_the_unsaved_file_keeps_its_own(self, unsaved, home, project):
        save(project / "copy.blend", copy=True)
        assert Path(shown()[0]) == unsaved
        bpy.ops.wm.open_mainfile(filepath=str(project / "copy.blend"))
        assert shown()[0] == f"//{unsaved.relative_to(home)}"

    def test_a_save_that_fails_changes_nothing(self, unsaved, tmp_path, project):
        (project / "scene.blend").mkdir()
        with pytest.raises(RuntimeError):
            save(project / "scene.blend")
        assert Path(shown()[0]) == unsaved

    def test_another_disk_gets_a_copy(self, unsaved, home, project, monkeypatch):
        monkeypatch.setattr(os, "link", no_links)
        save(project / "scene.blend")
        assert (project / unsaved.relative_to(home)).read_bytes() == unsaved.read_bytes()
        assert not list(project.rglob("*.part"))

    def test_what_cannot_be_copied_stays_and_is_told(self, unsaved, project, monkeypatch, capsys):
        monkeypatch.setattr(os, "link", no_links)
        monkeypatch.setattr(shutil, "copy2", fill_up)
        monkeypatch.setattr(running, "last", ())
        save(project / "scene.blend")
        assert baked_path(*baked_volumes(bpy.context.scene)) == unsaved
        (note,) = running.last
        assert note.startswith(f"{unsaved} could not be copied beside the .blend and stays")
        assert note in capsys.readouterr().err
        assert not [path for path in project.rglob("*.vdb*") if path.is_file()]
        bpy.ops.wm.open_mainfile(filepath=str(project / "scene.blend"))
        assert baked_path(*baked_volumes(bpy.context.scene)) == unsaved
        monkeypatch.undo()

    def test_what_an_earlier_version_kept_in_its_own_folder_comes_along(
        self, scene, project, tmp_path, monkeypatch
    ):
        extension = tmp_path / "extension"
        (extension / "baked").mkdir(parents=True)
        monkeypatch.setattr(saving, "__package__", "bl_ext.user_default.lb_lighting.lb_lighting")
        monkeypatch.setattr(
            bpy.utils, "extension_path_user", lambda _name, path: str(extension / path)
        )
        path = baked_path(light(scenery.add_fog(tmp_path), folder=extension / "baked"))
        save(project / "scene.blend")
        assert shown()[0] == f"//{path.name}"
        assert (project / path.name).exists()

    def test_frames_that_are_not_finished_stay_where_they_are(self, scene, home, project, tmp_path):
        frames = baked_path(light(scenery.add_fog(tmp_path), folder=home, frames=(1, 2))).parent
        vdb.unfinished(frames / "frame_0003.vdb", "another").write_bytes(b"a part")
        save(project / "scene.blend")
        assert len(list((project / frames.name).iterdir())) == 2

    def test_the_startup_file_shows_light_where_it_is(self, unsaved, tmp_path, monkeypatch):
        (tmp_path / "config").mkdir()
        monkeypatch.setenv("BLENDER_USER_CONFIG", str(tmp_path / "config"))
        bpy.ops.wm.save_homefile()
        assert os.listdir(tmp_path / "config") == ["startup.blend"]
        assert Path(shown()[0]) == unsaved

    def test_what_lies_elsewhere_is_left_alone(self, scene, home, project, tmp_path):
        path = baked_path(light(scenery.add_fog(tmp_path), folder=tmp_path))
        save(project / "scene.blend")
        assert list(project.iterdir()) == [project / "scene.blend"]
        assert baked_path(*baked_volumes(scene)) == path


def test_saved_elsewhere_the_light_is_found(scene, project, tmp_path):
    save(project / "scene.blend")
    path = baked_path(light(scenery.add_fog(project), folder=default_folder()))
    assert shown()[0] == f"//{path.name}"
    (tmp_path / "other").mkdir()
    save(tmp_path / "other" / "scene.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other" / "scene.blend"))
    assert baked_path(*baked_volumes(bpy.context.scene)) == path
    assert shown()[1]


def no_links(*_paths):
    raise OSError("no links here")


def fill_up(_old, new):
    Path(new).write_bytes(b"a part")
    raise OSError("No space left on device")


@pytest.fixture
def blend(scene, project):
    """A saved scene with a relative path and 1 MiB that cannot be compressed."""
    mesh = bpy.data.meshes.new("dust")
    mesh.from_pydata(np.random.default_rng(0).random((80_000, 3), np.float32), [], [])
    scenery.link("dust", mesh)
    path = project / "scene.blend"
    save(path)
    bpy.data.volumes.new("fog").filepath = "//fog.vdb"
    bpy.data.volumes["fog"].use_fake_user = True
    bpy.ops.wm.save_mainfile()
    (project / "scene.blend1").unlink()
    return path


class TestCommandLine:
    def clear(self, blend, *arguments):
        return cli.main(["clear", str(blend), *arguments], opens_file=True)

    def test_the_version_before_is_kept(self, blend):
        before = blend.read_bytes()
        assert self.clear(blend) == 0
        assert blend.with_name("scene.blend1").read_bytes() == before
        assert sorted(os.listdir(blend.parent)) == ["scene.blend", "scene.blend1"]

    @pytest.mark.parametrize("count", [0, 1, 2])
    def test_as_many_versions_are_kept_as_the_user_wants(self, project, count):
        blend, paths = project / "scene.blend", bpy.context.preferences.filepaths
        paths.save_version, usual = count, paths.save_version
        try:
            for text in ("first", "second", "third"):
                blend.write_text(text)
                blend_file.save(blend)
        finally:
            paths.save_version = usual
        kept = [blend.with_name(f"scene.blend{n}") for n in range(1, count + 1)]
        assert [path.read_text() for path in kept] == ["third", "second"][:count]
        assert len(os.listdir(project)) == 1 + count

    def test_paths_are_relative_to_where_it_is(self, blend, tmp_path):
        (tmp_path / "lit").mkdir()
        output = tmp_path / "lit" / "lit.blend"
        assert self.clear(blend, "--output", str(output)) == 0
        bpy.ops.wm.open_mainfile(filepath=str(output))
        assert bpy.data.volumes["fog"].filepath == "//../project/fog.vdb"
        assert self.clear(blend) == 0
        bpy.ops.wm.open_mainfile(filepath=str(blend))
        assert bpy.data.volumes["fog"].filepath == "//fog.vdb"

    @pytest.mark.parametrize("compress", [False, True])
    @pytest.mark.parametrize("left", [0.0, 0.5, 0.999])
    def test_a_part_of_a_file_replaces_nothing(self, blend, left, compress, monkeypatch, capfd):
        before = blend.read_bytes()
        bpy.context.preferences.filepaths.use_file_compression = compress

        @persistent
        def truncate(path, _none):
            os.truncate(path, int(left * os.path.getsize(path)))

        bpy.app.handlers.save_post.append(truncate)
        try:
            capfd.readouterr()
            assert self.clear(blend) == 1
        finally:
            bpy.app.handlers.save_post.remove(truncate)
            bpy.context.preferences.filepaths.use_file_compression = True
        (line,) = [x for x in capfd.readouterr().err.splitlines() if x.startswith("lb_lighting")]
        assert line == (
            f"lb_lighting: {blend} could not be written, and nothing was replaced; free space on "
            "its disk, or choose another --output."
        )
        assert blend.read_bytes() == before
        assert os.listdir(blend.parent) == ["scene.blend"]

    def test_light_that_no_file_shows_is_not_left_behind(self, scene, project, monkeypatch):
        scenery.select(scenery.add_fog(project))
        scene.lb_lighting.resolution, scene.lb_lighting.folder = 8, ""
        save(project / "scene.blend")

        def refuse(_path):
            raise OutputError("no space")

        monkeypatch.setattr(cli, "save", refuse)
        assert cli.main(["bake"], opens_file=False) == 1
        assert sorted(os.listdir(project)) == ["fog.vdb", "scene.blend"]

    def test_light_of_a_scene_without_a_file_goes_beside_the_output(
        self, scene, home, project, tmp_path
    ):
        path = baked_path(light(scenery.add_fog(tmp_path), folder=home))
        blend_file.save(project / "lit.blend")
        assert sorted(os.listdir(project)) == [path.name, "lit.blend"]
        bpy.ops.wm.open_mainfile(filepath=str(project / "lit.blend"))
        assert shown()[0] == f"//{path.name}"


SMALL = "mount -t tmpfs -o size={} none {} && "


def on_small_disk(folder, size, script):
    """The finished shell `script`, to which `folder` is a disk of `size`."""
    may = subprocess.run(["unshare", "-m", "sh", "-c", SMALL.format(size, folder) + "true"])
    if may.returncode:
        pytest.skip("disks cannot be mounted here")
    command = ["unshare", "-m", "sh", "-c", SMALL.format(size, folder) + script]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)


@pytest.mark.skipif(not shutil.which("unshare"), reason="needs namespaces of Linux")
class TestFullDisk:
    """On a real disk, with the command in a separate process."""

    def test_the_blend_stays(self, blend, tmp_path):
        disk = tmp_path / "disk"
        disk.mkdir()
        size = f"{int(1.5 * blend.stat().st_size / 1024)}k"
        copy = disk / "scene.blend"
        done = on_small_disk(
            disk,
            size,
            f"cp {blend} {copy}; {sys.executable} -m lb_lighting clear {copy}; code=$?; "
            f"ls -A {disk}; cmp {blend} {copy} && exit $code",
        )
        assert done.returncode == 1
        assert done.stdout.splitlines()[-1] == "scene.blend"
        assert (
            "scene.blend could not be written, and nothing was replaced; free space" in done.stderr
        )

    def test_no_part_of_a_result_stays(self, scene, project, tmp_path):
        scenery.select(scenery.add_fog(project))
        scene.lb_lighting.resolution = 8
        blend, disk = project / "scene.blend", tmp_path / "disk"
        save(blend)
        disk.mkdir()
        before = blend.read_bytes()
        done = on_small_disk(
            disk,
            "16k",
            f"{sys.executable} -m lb_lighting bake {blend} --folder {disk}; code=$?; "
            f"ls -A {disk}; exit $code",
        )
        assert done.returncode == 1
        (line,) = [x for x in done.stderr.splitlines() if x.startswith("lb_lighting")]
        assert "could not be written; choose a folder that is writable and has free space" in line
        assert not [line for line in done.stdout.splitlines() if "vdb" in line]
        assert blend.read_bytes() == before


@pytest.mark.parametrize("missing", [40, 0.5])
def test_a_part_of_a_vdb_replaces_nothing(tmp_path, monkeypatch, missing):
    """Even if the disk has free space again when it is checked."""
    path = write_light(tmp_path / "a.vdb")
    before, write = path.read_bytes(), openvdb.write

    def truncate(path, *arguments):
        write(path, *arguments)
        size = os.path.getsize(path)
        os.truncate(path, size - (missing if missing > 1 else int(missing * size)))

    monkeypatch.setattr(vdb.openvdb, "write", truncate)
    with pytest.raises(OutputError, match="could not be written; choose a folder"):
        write_light(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.vdb"]
