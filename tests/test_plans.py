# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake tells of its plan, and how it keeps to the time that its quality has."""

import bpy
import pytest

from lb_lighting.options import Options
from lb_lighting.reading import read_scene
from lb_lighting.transport import Settings
from lb_lighting.transport.ordinates import source_iteration
from lb_lighting.transport.planning.planner import Plan
from tests import scenery


def task(folder, quality, anisotropy=0.0):
    """The `BakeTask` of a fog in the sun."""
    ob = scenery.add_fog(folder)
    volume = ob.active_material.node_tree.nodes["Principled Volume"]
    volume.inputs["Anisotropy"].default_value = anisotropy
    return read_scene(bpy.context, [ob], Options.of(bpy.context.scene, quality=quality))


@pytest.mark.parametrize(
    ("quality", "seconds", "times"),
    [("draft", 1.0, 4), ("draft", 8.0, 2), ("draft", 100.0, 1), ("final", 100.0, 4)],
)
def test_drafts_scatter_by_direction_as_often_as_there_is_time_for(
    quality, seconds, times, scene, tmp_path, monkeypatch
):
    monkeypatch.setattr(source_iteration, "seconds", lambda *_arguments: seconds)
    light = task(tmp_path, quality, anisotropy=0.85)
    assert light.iterations(light.problem(), Settings()) == times
    notes = [note for note in light.medium_choice.notes if "passes" in note]
    assert [f"ran {times} of 4 passes" in note for note in notes] == [True] * (times < 4)


@pytest.mark.parametrize(("error", "seconds"), [(0.14, 5.0), (0.08, 60.0)])
def test_what_a_plan_cannot_keep_to_is_a_note(error, seconds, scene, tmp_path, monkeypatch):
    warning = "It will not be as it was asked for."
    planned = Plan(Settings(), "draft", 0.1, error, seconds, 1, "here", ["a", warning], 0.1, 20.0)
    light = task(tmp_path, "draft")
    monkeypatch.setattr(type(light), "plan", lambda *_arguments: planned)
    light._settings(light.problem(), lambda **_told: None)
    assert light.medium_choice.notes[-1] == warning


def test_a_plan_that_keeps_its_word_is_no_note(scene, tmp_path):
    light = task(tmp_path, "draft")
    settings, planned = light._settings(light.problem(), lambda **_told: None)
    assert planned.meets_target
    assert planned.keeps_to_budget
    assert settings == planned.settings
    assert not any("target" in note for note in light.medium_choice.notes)


@pytest.mark.parametrize("leaves", [20, 100])
def test_small_plants_get_no_absurd_errors(leaves, scene, tmp_path):
    """Of all light that they show; scattered light alone is a few per cent of it."""
    ob = scenery.add_leaves(count=leaves)
    options = Options.of(bpy.context.scene, quality="draft", resolution=24)
    light = read_scene(bpy.context, [ob], options)
    settings, planned = light._settings(light.problem(), lambda **_told: None)
    assert planned.meets_target
    assert settings.photons is None
