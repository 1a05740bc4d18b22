# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoke domains that cannot be read; simulations need a whole Blender (tests/blender)."""

import bpy
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene import smoke


def test_a_plain_object_is_no_domain():
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    assert smoke.find_domain_settings(cube) is None
    with pytest.raises(SceneError, match="'Cube' is not a gas domain"):
        smoke.world_bounds(cube, bpy.context.evaluated_depsgraph_get())


def test_a_flow_object_is_no_domain():
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.modifiers.new("smoke", "FLUID").fluid_type = "FLOW"
    assert smoke.find_domain_settings(bpy.context.object) is None
