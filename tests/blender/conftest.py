# SPDX-License-Identifier: GPL-3.0-or-later
"""Every test here runs in a real Blender, against the extension as its user has it installed."""

import importlib

import addon_utils
import bpy
import pytest

EXTENSION = "bl_ext.user_default.lb_lighting"


@pytest.fixture(autouse=True)
def empty_file():
    """An empty file; unlike factory settings it leaves the extension enabled."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)


@pytest.fixture(scope="session")
def lb():
    """The installed package, as `lb_lighting` in the checkout."""
    on_disk, loaded = addon_utils.check(EXTENSION)
    assert on_disk
    assert loaded
    return importlib.import_module(f"{EXTENSION}.lb_lighting")
