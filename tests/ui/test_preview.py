# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview as the user has it: it ends with any change, and leaves nothing in the file."""

import bpy
import numpy as np
import pytest

from lb_lighting.job import Job
from lb_lighting.options import Options
from lb_lighting.reading import read_scene
from lb_lighting.tasks import preview as task
from lb_lighting.ui import preview
from tests import scenery
from tests.scenery import snapshot


@pytest.fixture
def fog(scene, tmp_path, monkeypatch):
    """A cloud, selected, to be looked at for a few samples on the best device."""
    scene.lb_lighting.device = ""
    ob = scenery.add_fog(tmp_path)
    scenery.select(ob)
    bpy.context.view_layer.update()
    return ob


def begun(fog, noise=False):
    """A job under way that has shown a picture."""
    job = Job(
        task.Preview(read_scene(bpy.context, [fog], Options.of(bpy.context.scene)), None, noise)
    )
    preview.start(job)
    while task.PICTURE not in preview._icons:
        assert preview.look() is not None, preview._failed
    return job


@pytest.mark.parametrize("noise", [False, True])
def test_a_picture_and_a_survey_come_one_after_the_other(fog, noise):
    before = snapshot()
    job = begun(fog, noise)
    picture = preview._load(job, task.PICTURE)
    assert picture.shape[2] == 4
    assert picture[..., 3].max() > 0
    while preview._survey is None:
        assert preview.look() is not None, preview._failed
    found = preview._survey.statistics
    assert found.counts.sum() == pytest.approx(found.rays * (1 - found.escaped), abs=0.5)
    assert preview._survey.advice.endswith(".")
    assert set(found.samplers) == {
        "ray_march", "woodcock", "supervoxel_constant", "supervoxel_linear"
    }  # fmt: skip
    preview.stop()
    assert job._process.poll() is not None
    assert snapshot() == before


@pytest.mark.parametrize("change", ["move", "frame", "setting", "file"])
def test_any_change_ends_it(fog, scene, change):
    job = begun(fog)
    if change == "move":
        fog.location.x = 1
        bpy.context.view_layer.update()
    elif change == "frame":
        scene.frame_set(5)
    elif change == "setting":
        scene.lb_lighting.resolution = 20
        assert preview.look() is None
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
    assert preview._job is None
    assert job._process.poll() is not None


def test_what_cannot_be_looked_at_is_one_sentence(fog, scene):
    scene.lb_lighting.device = "abacus"
    preview.start(Job(task.Preview(read_scene(bpy.context, [fog], Options.of(scene)), None)))
    while preview.look() is not None:
        pass
    assert preview._failed.startswith("There is no device called 'abacus'; choose one of: ")


def test_what_is_behind_is_dim_and_light_is_as_displays_have_it():
    picture = np.zeros((1, 3, 4), np.float32)
    picture[0, 1] = (0.5, 0.5, 0.5, 1)
    picture[0, 2] = (9, 9, 9, 1)
    shown = preview._over(picture)[0, :, 0]
    assert shown == pytest.approx([0.2477, 0.7354, 1], abs=1e-3)  # sRGB, IEC 61966-2-1


def test_is_off_without_a_selection(scene):
    assert not bpy.ops.lb_lighting.preview.poll()


def test_nothing_of_it_stays_where_the_extension_is_disabled(fog):
    begun(fog)
    while preview._survey is None:
        assert preview.look() is not None, preview._failed
    preview.unregister()
    preview.register()
    assert preview._job is None
    assert preview._survey is None
    assert len(preview._icons) == 0
