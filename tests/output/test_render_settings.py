# SPDX-License-Identifier: GPL-3.0-or-later
"""Render settings and the visibility of sources are restored."""

import bpy
import pytest

from lb_lighting.output.render_settings import prepare_scene, restore_scene
from lb_lighting.output.sources import hide_source, show_source


@pytest.mark.parametrize("biased", [True, False])
def test_scene_is_given_back(biased):
    scene = bpy.context.scene
    scene.cycles.volume_biased = biased
    keys = list(scene.keys())
    prepare_scene(scene)
    prepare_scene(scene)
    assert scene.cycles.volume_biased
    restore_scene(scene)
    assert scene.cycles.volume_biased is biased
    assert list(scene.keys()) == keys
    restore_scene(scene)


@pytest.mark.parametrize("hidden", [(False, False), (True, False), (False, True)])
def test_source_is_given_back(hidden):
    ob = bpy.data.objects.new("source", None)
    ob.hide_viewport, ob.hide_render = hidden
    hide_source(ob)
    hide_source(ob)
    assert (ob.hide_viewport, ob.hide_render) == (True, True)
    show_source(ob)
    assert (ob.hide_viewport, ob.hide_render) == hidden
    assert list(ob.keys()) == []
