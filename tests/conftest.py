# SPDX-License-Identifier: GPL-3.0-or-later
"""Every test starts from an empty Blender file where Blender is there at all."""

import pytest

try:
    import bpy
except ImportError:
    bpy = None
else:
    if hasattr(bpy.utils, "expose_bundled_modules"):
        bpy.utils.expose_bundled_modules()


@pytest.fixture(autouse=True)
def empty_file():
    """An empty file without a world; the names of a previous test are gone."""
    if bpy is not None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
