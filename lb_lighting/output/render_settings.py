# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' render settings for baked light, and the way back to the user's."""

import bpy

from ..ours import give_back, is_overridden, override
from .closures import is_clear
from .shading_surfaces import is_lit
from .volume import baked_volumes

VOLUME_BOUNCES = "cycles.volume_bounces"


def prepare_scene(scene: bpy.types.Scene) -> None:
    """Make Cycles march through volumes: "REPLACE" then renders fast and without noise."""
    if hasattr(scene, "cycles"):  # Cycles is an add-on, and can be disabled
        override(scene, "cycles.volume_biased", True)


def restore_scene(scene: bpy.types.Scene) -> None:
    """Restore the settings that `prepare_scene` and `use_light` changed."""
    give_back(scene)


def use_light(scene: bpy.types.Scene) -> None:
    """Remove the bounces that baked light already contains from the render settings.

    Cycles marches through volumes, which scatter once in "ADD" and not at all in "REPLACE". Baked
    light on surfaces contains their diffuse bounces, and those through translucent surfaces. What
    is behind glass still needs transmission bounces, so they stay if any material is clear.
    """
    prepare_scene(scene)
    override(scene, VOLUME_BOUNCES, 0)
    lit = [ob for ob in scene.objects if is_lit(ob)]
    if lit:
        override(scene, "cycles.diffuse_bounces", 0)
    if lit and not any(map(is_clear, bpy.data.materials)):
        override(scene, "cycles.transmission_bounces", 0)


def uses_light(scene: bpy.types.Scene) -> bool:
    """True after `use_light`, until the settings are restored."""
    return is_overridden(scene, VOLUME_BOUNCES)


def leave_light(scene: bpy.types.Scene) -> None:
    """Restore the settings that `use_light` changed, and keep those that baked volumes need."""
    restore_scene(scene)
    if any(not ob.hide_render for ob in baked_volumes(scene)):
        prepare_scene(scene)
