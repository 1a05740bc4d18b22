# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: the same light as the operator, and one sentence where it fails."""

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from lb_lighting import cli, job
from lb_lighting.output.vdb import read_metadata
from lb_lighting.output.volume import baked_volumes
from tests import scenery
from tests.output.rendering import dark_scene, render
from tests.scenery import ambient, bake_light, read_grid, snapshot

ROOT = Path(__file__).parents[1]


@pytest.fixture
def blend(scene, tmp_path):
    """A saved scene with fog and leaves, both selected."""
    scenery.select(scenery.add_fog(tmp_path), scenery.add_leaves())
    scene.lb_lighting.folder = ""
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def run(*arguments, **options):
    """`python -m lb_lighting` in a process of its own."""
    command = [sys.executable, "-m", "lb_lighting", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, **options)


def light_of_scene():
    """The light of the baked volume and of the leaves."""
    (ob,) = baked_volumes(bpy.context.scene)
    light, first = read_grid(bpy.path.abspath(ob.data.filepath))
    return light, first, ambient(bpy.data.objects["leaves"])


def reopen(path):
    bpy.ops.wm.open_mainfile(filepath=str(path))


def test_every_way_to_bake_gives_the_same_light(blend, tmp_path):
    lit = tmp_path / "lit.blend"
    done = run("bake", blend, "--output", lit)
    assert done.returncode == 0
    assert "Lit 16 x 16 x 16 voxels" in done.stdout
    reopen(lit)
    found = [light_of_scene()]

    reopen(blend)
    assert cli.main(["bake", "--output", str(lit)], opens_file=False) == 0
    found.append(light_of_scene())

    reopen(blend)
    assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
    found.append(light_of_scene())

    reopen(blend)
    bake_light(bpy.data.objects["fog"], bpy.data.objects["leaves"])
    found.append(light_of_scene())

    for light, first, on_leaves in found[1:]:
        assert first == found[0][1]
        assert np.array_equal(light, found[0][0])
        assert np.array_equal(on_leaves, found[0][2])


def test_a_lit_file_renders(blend, tmp_path):
    assert run("bake", blend, "--objects", "fog").returncode == 0
    reopen(blend)
    bpy.data.objects["sun"].hide_render = True
    scene = dark_scene((0, -5, 0), (np.pi / 2, 0, 0), 2)
    assert render(scene, tmp_path / "lit.exr", 8, 2)[3:5, 3:5].min() > 0.01


def test_options_of_the_command_come_before_the_scenes(blend):
    arguments = ["bake", str(blend), "--objects", "fog", "--resolution", "12", "--mode", "ADD"]
    assert cli.main([*arguments, "--keep-absorbed"], opens_file=True) == 0
    reopen(blend)
    (ob,) = baked_volumes(bpy.context.scene)
    assert not bpy.data.objects["fog"].hide_render
    metadata = read_metadata(bpy.path.abspath(ob.data.filepath))
    assert (metadata["resolution"], metadata["mode"], metadata["keep_absorbed"]) == (
        12,
        "ADD",
        True,
    )
    assert bpy.context.scene.lb_lighting.resolution == 16


def test_frames(blend):
    arguments = ["bake", str(blend), "--objects", "fog", "--frames", "2-3"]
    assert cli.main(arguments, opens_file=True) == 0
    reopen(blend)
    (ob,) = baked_volumes(bpy.context.scene)
    assert (ob.data.is_sequence, ob.data.frame_start, ob.data.frame_duration) == (True, 2, 2)
    folder = Path(bpy.path.abspath(ob.data.filepath)).parent
    assert sorted(path.name for path in folder.iterdir()) == ["frame_0002.vdb", "frame_0003.vdb"]
    assert cli.main(arguments, opens_file=True) == 1
    assert cli.main([*arguments, "--overwrite"], opens_file=True) == 0


def test_frame(blend):
    ob = bpy.data.objects["fog"]
    for frame, x in ((1, 0), (11, 10)):
        ob.location.x = x
        ob.keyframe_insert("location", frame=frame)
    bpy.ops.wm.save_mainfile()
    arguments = ["bake", str(blend), "--objects", "fog", "--frame", "11"]
    assert cli.main(arguments, opens_file=True) == 0
    ob = bpy.data.objects["LB fog"]
    bpy.context.view_layer.update()
    corners = np.array(ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).bound_box)
    assert corners.mean(axis=0)[0] == pytest.approx(10, abs=0.3)


def test_a_relative_folder_is_that_of_the_shell(blend, tmp_path, monkeypatch):
    (tmp_path / "shell" / "out").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "shell")
    lit = tmp_path / "lit.blend"
    arguments = ["bake", str(blend), "--objects", "fog", "--folder", "out", "--output", str(lit)]
    assert cli.main(arguments, opens_file=True) == 0
    monkeypatch.chdir(tmp_path)
    reopen(lit)
    (ob,) = baked_volumes(bpy.context.scene)
    assert Path(bpy.path.abspath(ob.data.filepath)).parent.samefile(tmp_path / "shell" / "out")
    assert read_grid(bpy.path.abspath(ob.data.filepath))[0].any()


def test_clear(blend, tmp_path):
    before = snapshot()
    lit, cleared = str(tmp_path / "lit.blend"), str(tmp_path / "cleared.blend")
    assert cli.main(["bake", str(blend), "--output", lit], opens_file=True) == 0
    assert len(list(tmp_path.glob("fog_lb_*.vdb"))) == 1
    arguments = ["clear", lit, "--delete-files", "--output", cleared]
    assert cli.main(arguments, opens_file=True) == 0
    assert not list(tmp_path.glob("fog_lb_*.vdb"))
    reopen(cleared)
    after = snapshot()
    # The path of the fog is relative in one file and not in the other.
    assert {name for name in before if before[name] != after.get(name)} <= {("volumes", "fog")}
    assert list(after) == list(before)


def test_devices(capsys):
    assert cli.main(["devices"], opens_file=False) == 0
    listed = capsys.readouterr().out.splitlines()
    names = [line.rsplit(",", 1)[0] for line in listed]  # what memory is free changes
    assert names == [line.rsplit(",", 1)[0] for line in job.device_lines()]


def test_without_opencl_a_note_says_how_to_get_faster(blend, monkeypatch, capsys):
    monkeypatch.setenv("OCL_ICD_VENDORS", "/nowhere")
    bpy.context.scene.lb_lighting.device = ""
    assert cli.main(["bake", "--objects", "fog"], opens_file=False) == 0
    printed = capsys.readouterr().out
    assert "Solved with NumPy; an OpenCL driver for your processor or graphics card" in printed


def break_nothing(_blend):
    pass


def select_nothing(_blend):
    scenery.select()


def remove_the_fog(blend):
    (blend.parent / "fog.vdb").unlink()


def switch_off_the_sun(_blend):
    bpy.data.lights["sun"].energy = 0


BAD = {
    "nothing selected": (select_nothing, [], "Nothing is selected; "),
    "no such object": (break_nothing, ["--objects", "cat"], "The scene has no object 'cat'; "),
    "no volume or faces": (break_nothing, ["--objects", "sun"], "'sun' has neither a volume nor"),
    "missing file": (remove_the_fog, ["--objects", "fog"], "fog.vdb' of 'fog' cannot be read"),
    "no such grid": (
        break_nothing,
        ["--objects", "fog", "--grid", "smoke"],
        "'fog' has no grid 'smoke'; choose",
    ),
    "zero resolution": (break_nothing, ["--resolution", "0"], "A resolution of 0 voxels is too"),
    "too fine": (break_nothing, ["--resolution", "50000"], "the largest resolution that fits is"),
    "no light": (switch_off_the_sun, [], "The scene has no light; "),
    "no such folder": (break_nothing, ["--folder", "nowhere"], "does not exist; choose another"),
    "no such device": (break_nothing, ["--device", "abacus"], "There is no device called 'abacus'"),
    "no such medium": (break_nothing, ["--medium", "milk"], "There is no medium called 'milk'; "),
    "no such place": (
        break_nothing,
        ["--output", "/nowhere/a.blend"],
        "The folder /nowhere does not",
    ),
}


class TestBadInput:
    """One sentence on stderr, exit code 1, and the file as it was."""

    @pytest.mark.parametrize("name", BAD)
    def test_is_refused(self, blend, capfd, name):
        spoil, arguments, sentence = BAD[name]
        spoil(blend)
        bpy.ops.wm.save_mainfile()
        before = blend.read_bytes()
        files = set(blend.parent.glob("*.vdb"))
        capfd.readouterr()
        assert cli.main(["bake", str(blend), *arguments], opens_file=True) == 1
        (line,) = capfd.readouterr().err.splitlines()
        assert line.startswith("lb_lighting: ")
        assert sentence in line
        assert blend.read_bytes() == before
        assert set(blend.parent.glob("*.vdb")) == files

    def test_exit_code_and_stderr_of_the_module(self, blend):
        done = run("bake", blend, "--objects", "cat")
        assert done.returncode == 1
        assert done.stderr == "lb_lighting: The scene has no object 'cat'; check the name.\n"

    def test_no_such_blend(self, tmp_path, capfd):
        assert cli.main(["bake", str(tmp_path / "a.blend")], opens_file=True) == 1
        assert "a.blend cannot be opened; check the path." in capfd.readouterr().err

    def test_a_scene_without_a_file_needs_an_output(self, scene, tmp_path, capsys):
        scenery.add_fog(tmp_path)
        assert cli.main(["bake", "--objects", "fog"], opens_file=False) == 1
        assert "choose one with --output." in capsys.readouterr().err
        assert not list(tmp_path.glob("fog_lb_*.vdb"))

    def test_unknown_arguments(self, capsys):
        with pytest.raises(SystemExit) as caught:
            cli.main(["bake", "--colour", "red"], opens_file=False)
        assert caught.value.code == 2
        assert "--colour" in capsys.readouterr().err
