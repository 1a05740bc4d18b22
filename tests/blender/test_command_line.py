# SPDX-License-Identifier: GPL-3.0-or-later
"""`blender --background X.blend --command lb_lighting ...`, as processes of their own."""

import subprocess
from pathlib import Path

import bpy
import pytest
from scenes import baked, sun, volume_material, volume_object, write_ball


@pytest.fixture
def blend(tmp_path):
    """The path of a saved scene with a cloud and a sun."""
    write_ball(tmp_path / "ball.vdb", center=(0, 0, 0))
    volume_object(tmp_path / "ball.vdb", volume_material(density=5.0))
    sun((0, 0, -1))
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return str(path)


def run(*arguments, blend=()):
    """The finished process: its returncode, stdout and stderr."""
    command = [bpy.app.binary_path, "--background", *blend, "--command", "lb_lighting", *arguments]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)


def installed_files(lb):
    """{path: time of the last change} of the extension's own folder."""
    folder = Path(lb.__file__).parents[1]
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_bake_and_clear_save_the_scene(lb, blend):
    before = installed_files(lb)
    done = run("bake", "--objects", "Cloud", "--resolution", "20", blend=[blend])
    assert done.returncode == 0, done.stderr
    assert installed_files(lb) == before
    bpy.ops.wm.open_mainfile(filepath=blend)
    density, light, _positions = baked("Cloud")
    assert light[density > 0].min() > 0
    assert (
        Path(bpy.path.abspath(bpy.data.volumes["LB Cloud"].filepath)).parent == Path(blend).parent
    )

    done = run("clear", "--delete-files", blend=[blend])
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=blend)
    assert "LB Cloud" not in bpy.data.objects
    assert not list(Path(blend).parent.glob("*_lb_*.vdb"))


def test_failure_is_one_sentence(lb, blend):
    failed = run("bake", "--objects", "Fog", blend=[blend])
    assert failed.returncode == 1
    assert failed.stderr.splitlines() == [
        "lb_lighting: The scene has no object 'Fog'; check the name."
    ]


def test_unsaved_scene_is_refused_before_the_work(lb):
    failed = run("bake")
    assert failed.returncode == 1
    assert "--output" in failed.stderr
    assert "solve" not in failed.stdout


def test_devices(lb):
    listed = run("devices")
    assert listed.returncode == 0
    assert "NumPy (no OpenCL)" in listed.stdout
