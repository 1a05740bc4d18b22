# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom media as presets of Blender's own system: ours, and those that the user keeps."""

import os
import re
from pathlib import Path

import bpy
import numpy as np
import pytest

import lb_lighting
from lb_lighting.errors import MediumError, SettingsError
from lb_lighting.options import Options
from lb_lighting.output.volume import baked_volumes
from lb_lighting.transport.medium import PRESETS
from tests import scenery
from tests.scenery import bake_light

OURS = Path(lb_lighting.__file__).parent / "presets" / "lb_lighting"
MEASURED = ("milk", "skim_milk", "marble")


def choose(path):
    bpy.ops.script.execute_preset(filepath=str(path), menu_idname="LB_PT_presets")
    return Options.of(bpy.context.scene)


@pytest.fixture
def user(tmp_path, monkeypatch):
    """The folder of a user's own presets."""
    monkeypatch.setenv("BLENDER_USER_SCRIPTS", str(tmp_path))
    return tmp_path / "presets" / "lb_lighting"


def test_blender_finds_ours():
    assert str(OURS) in map(os.path.normpath, bpy.utils.preset_paths("lb_lighting"))
    assert len(list(OURS.glob("*.py"))) == 8


@pytest.mark.parametrize("path", sorted(OURS.glob("*.py")), ids=lambda path: path.stem)
def test_ours_are_media_with_a_source(path):
    bpy.context.scene.lb_lighting.sigma_s = bpy.context.scene.lb_lighting.sigma_a = (9, 9, 9)
    chosen = choose(path)
    assert chosen.medium == "CUSTOM"
    assert max(chosen.sigma_a) != 9
    assert re.search(r"^# .*\b(19\d\d|20\d\d|table \d)[.,]", path.read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("name", "preset"), [("pmma", "pmma"), ("foliage_knapp_and_carter", "plant")]
)
def test_the_papers_are_its_tables(name, preset):
    chosen = choose(OURS / f"{name}.py")
    for quantity in ("sigma_s", "sigma_a", "g"):
        assert getattr(chosen, quantity) == pytest.approx(getattr(PRESETS[preset], quantity))


def test_soot_absorbs_by_the_wavelength():
    """Rayleigh's law, and the refractive index 1.57 - 0.56 i of Dalzell and Sarofim."""
    wavelength = np.array([650e-9, 550e-9, 450e-9])
    square = (1.57 - 0.56j) ** 2
    share = -((square - 1) / (square + 2)).imag
    expected = 6 * np.pi * share * 1e-6 / wavelength
    assert choose(OURS / "fire.py").sigma_a == pytest.approx(expected, rel=0.01)
    smoke = choose(OURS / "smoke.py")
    assert smoke.sigma_a == pytest.approx(7.5 * 550e-9 / wavelength, rel=0.01)
    assert np.divide(smoke.sigma_s, np.add(smoke.sigma_s, smoke.sigma_a)) == pytest.approx(
        0.25, rel=0.01
    )


@pytest.mark.parametrize("name", MEASURED)
def test_measured_media_are_in_metres(name):
    """All of them scatter after less than 2 mm, and absorb within a metre."""
    chosen = choose(OURS / f"{name}.py")
    assert chosen.optical_depth == 0
    assert min(chosen.sigma_s) > 1 / 2e-3
    assert chosen.g == (0, 0, 0)
    assert 0.05 < 1 / max(chosen.sigma_a) < 1 / min(chosen.sigma_a) < 1


def test_the_users_own_is_kept_and_removed(user):
    settings = bpy.context.scene.lb_lighting
    settings.medium, settings.optical_depth = "CUSTOM", 7
    settings.sigma_s, settings.sigma_a, settings.g = (1, 2, 3), (4, 5, 6), (0.5, 0.25, 0)
    kept = Options.of(bpy.context.scene)
    bpy.ops.lb_lighting.preset_add(name="My Fog")
    (path,) = user.glob("*.py")
    settings.medium, settings.optical_depth = "cloud", 30
    settings.sigma_s = settings.sigma_a = settings.g = (0, 0, 0)
    assert choose(path) == kept
    assert bpy.ops.lb_lighting.preset_add(name="My Fog", remove_name=True) == {"FINISHED"}
    assert not path.exists()


def test_custom_coefficients_are_taken_as_they_are(scene, tmp_path):
    bake_light(
        scenery.add_fog(tmp_path),
        medium="CUSTOM",
        sigma_s=(2, 1, 0.5),
        sigma_a=(0.1, 0.2, 0.3),
        g=(0.5, 0.25, 0),
        optical_depth=0,
    )
    (baked,) = baked_volumes(scene)
    nodes = baked.active_material.node_tree.nodes
    inputs = next(node for node in nodes if node.type == "GROUP").inputs
    assert inputs["Sigma S"].default_value[:] == pytest.approx((2, 1, 0.5))
    assert inputs["Sigma A"].default_value[:] == pytest.approx((0.1, 0.2, 0.3))
    assert inputs["G"].default_value[:] == pytest.approx((0.5, 0.25, 0))


def test_custom_coefficients_have_the_optical_depth_asked_for(scene, tmp_path):
    outcome = bake_light(
        scenery.add_fog(tmp_path), medium="CUSTOM", sigma_s=(2, 1, 1), optical_depth=5
    )
    (baked,) = baked_volumes(scene)
    nodes = baked.active_material.node_tree.nodes
    inputs = next(node for node in nodes if node.type == "GROUP").inputs
    longest = 16 * outcome.field.domain.voxel_size
    assert inputs["Sigma S"].default_value[:] == pytest.approx(np.array((5, 2.5, 2.5)) / longest)


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        ({"sigma_s": (0, 0, 0)}, SettingsError, "The custom medium is empty"),
        ({"sigma_a": (0, -1, 0)}, MediumError, "sigma_a must be between 0"),
        ({"g": (0, 1, 0)}, MediumError, "g must be between -1 and 1"),
        ({"medium": "cloud", "optical_depth": 0}, SettingsError, "optical depth must be positive"),
    ],
)
def test_what_is_no_medium_is_refused(wrong, error, said):
    with pytest.raises(error, match=said):
        Options(**{"medium": "CUSTOM", "optical_depth": 0.0} | wrong)
