# SPDX-License-Identifier: GPL-3.0-or-later
"""Every test here runs in a real Blender, against the extension as its user has it installed."""

import importlib

import addon_utils
import bpy
import pytest
from scenes import EXTENSION, camera, render, volume_material, volume_object, write_ball


def empty():
    """An empty file; unlike factory settings it leaves the extension enabled."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)


@pytest.fixture(autouse=True)
def empty_file():
    empty()


@pytest.fixture(scope="session")
def lb():
    """The installed package, as `lb_lighting` in the checkout."""
    on_disk, loaded = addon_utils.check(EXTENSION)
    assert on_disk
    assert loaded
    return importlib.import_module(f"{EXTENSION}.lb_lighting")


@pytest.fixture(scope="session")
def cycles_shows_grids(tmp_path_factory):
    """Whether Cycles was built with NanoVDB: some distributions' shows no grid at all."""
    empty()
    folder = tmp_path_factory.mktemp("control")
    write_ball(folder / "ball.vdb", center=(0, 0, 0))
    volume_object(folder / "ball.vdb", volume_material(emission=1.0))
    camera(target=(0, 0, 0), width=1)
    return render(folder / "control.exr", "CYCLES", size=16)[..., :3].any()
