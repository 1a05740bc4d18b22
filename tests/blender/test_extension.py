# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension: what it brings, and that it goes when it is disabled."""

import importlib.util
from pathlib import Path

import addon_utils
import bpy
import pytest
from scenes import EXTENSION, part, sun, volume_material, volume_object, write_ball

DRIVERS = list(Path("/etc/OpenCL/vendors").glob("*.icd"))


def test_pyopencl_is_the_bundled_one(lb):
    wheels = Path(bpy.utils.user_resource("EXTENSIONS"), ".local")
    assert Path(importlib.util.find_spec("pyopencl").origin).is_relative_to(wheels)


@pytest.mark.skipif(not DRIVERS, reason="no OpenCL driver is installed on this machine")
def test_bake_uses_the_opencl_driver(lb, tmp_path):
    write_ball(tmp_path / "ball.vdb", center=(0, 0, 0))
    cloud = volume_object(tmp_path / "ball.vdb", volume_material(density=5.0))
    sun((0, 0, -1))
    bake = part(lb, "bake")
    options = bake.Options(resolution=20, folder=str(tmp_path))
    device = bake.bake(bpy.context, [cloud], options).field.report.device
    assert "NumPy" not in device
    assert any(line.startswith(device) for line in part(lb, "job").device_lines())


def refuse(error):
    raise error


def registered():
    """Names of our classes, and of the types that carry our properties."""
    classes = {name for name in dir(bpy.types) if name.startswith("LB_")}
    return classes | {
        t.__name__ for t in bpy.types.ID.__subclasses__() if hasattr(t, "lb_lighting")
    }


def test_disable_and_enable_twice(lb):
    enabled = registered()
    assert {"LB_LIGHTING_OT_bake", "LB_PT_lighting", "Scene", "Object"} <= enabled
    for _ in range(2):
        addon_utils.disable(EXTENSION, handle_error=refuse)
        assert registered() == set()
        addon_utils.enable(EXTENSION, handle_error=refuse)
        assert registered() == enabled
