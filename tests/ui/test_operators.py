# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake and Clear as the user has them, and the properties that they read."""

import math
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from lb_lighting import bake, job
from lb_lighting.options import FOLIAGE, MODES, Options
from lb_lighting.output.volume import baked_path, baked_volumes
from lb_lighting.scene.medium_choice import CUSTOM, FROM_MATERIAL
from lb_lighting.transport.medium import PRESETS
from lb_lighting.transport.solver import MODELS, Settings
from lb_lighting.ui import preferences, properties, running
from tests import scenery
from tests.scenery import bake_light, snapshot


def choices(group, name):
    return [item.identifier for item in group.bl_rna.properties[name].enum_items]


class TestProperties:
    def test_a_new_scene_has_the_defaults_of_the_options(self):
        assert Options.of(bpy.context.scene) == Options()

    def test_every_option_is_the_scenes(self, tmp_path):
        scene = bpy.context.scene
        box = scenery.link("box", None)
        chosen = {
            "resolution": 32,
            "padding": 3,
            "medium": "plant",
            "sigma_s": (1.0, 2.0, 3.5),
            "sigma_a": (0.25, 0.5, 0.0),
            "g": (0.5, 0.0, -0.5),
            "optical_depth": 12.5,
            "grid": "smoke",
            "mode": "ADD",
            "foliage": "MODIFIER",
            "sky": True,
            "strength": 0.5,
            "model": "paper",
            "quality": "preview",
            "scattering": "single",
            "rays": 0.5,
            "merge": 2,
            "photons": 1000,
            "tolerance": 0.125,
            "handover": 2.0,
            "gather": False,
            "keep_absorbed": True,
            "device": "GPU",
            "folder": str(tmp_path),
        }
        for name, value in chosen.items():
            setattr(scene.lb_lighting, name, value)
        scene.lb_lighting.domain = box
        chosen["domain"] = "box"
        assert chosen.keys() == {field.name for field in fields(Options)}
        assert Options.of(scene) == Options(**chosen)

    def test_folder_may_be_relative_to_the_blend(self):
        folder = properties.SceneProperties.bl_rna.properties["folder"]
        assert folder.is_path_supports_blend_relative

    def test_changes_come_before_the_scenes_own(self):
        bpy.context.scene.lb_lighting.resolution = 32
        options = Options.of(bpy.context.scene, resolution=48, padding=None)
        assert (options.resolution, options.padding) == (48, 2)

    def test_choices_are_those_that_bake_knows(self):
        assert choices(properties.SceneProperties, "medium") == [
            FROM_MATERIAL,
            CUSTOM,
            *PRESETS,
        ]
        assert choices(properties.SceneProperties, "model") == list(MODELS)
        assert choices(properties.SceneProperties, "mode") == [
            choice.identifier for choice in MODES
        ]
        assert choices(properties.SceneProperties, "foliage") == [
            choice.identifier for choice in FOLIAGE
        ]

    def test_settings_are_saved_in_the_file(self, tmp_path):
        scene = bpy.context.scene
        ob = scenery.link("box", None)
        scene.lb_lighting.resolution, ob.lb_lighting.role = 40, "OCCLUDER"
        path = str(tmp_path / "scene.blend")
        bpy.ops.wm.save_as_mainfile(filepath=path)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=path)
        assert bpy.context.scene.lb_lighting.resolution == 40
        assert bpy.data.objects["box"].lb_lighting.role == "OCCLUDER"

    def test_devices_are_offered_as_they_are_typed(self):
        assert "NumPy (no OpenCL)" in properties._search_devices(None, None, "numpy")
        assert properties._search_devices(None, None, "abacus") == []


class TestBake:
    @pytest.mark.parametrize("context", ["EXEC_DEFAULT", "INVOKE_DEFAULT"])
    def test_does_the_whole_job(self, scene, tmp_path, context, capfd):
        fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
        scenery.select(fog, leaves)
        assert bpy.ops.lb_lighting.bake(context) == {"FINISHED"}
        assert fog.hide_render
        assert scenery.ambient(leaves).mean() > 0
        assert "Info: Lit 16 x 16 x 16 voxels, 2 colour bands, " in capfd.readouterr().out

    def test_notes_are_warnings(self, scene, tmp_path, capfd):
        scenery.select(scenery.add_fog(tmp_path, material=False))
        bpy.ops.lb_lighting.bake()
        printed = capfd.readouterr().out
        assert "Warning: 'fog' has no volume material; the preset 'cloud' was used." in printed
        assert "Warning: Solved with NumPy; an OpenCL driver" in printed

    def test_again_without_a_new_selection(self, scene, tmp_path):
        scenery.select(scenery.add_fog(tmp_path))
        bpy.ops.lb_lighting.bake()
        (ob,) = baked_volumes(scene)
        first = ob.data.filepath
        scene.lb_lighting.resolution = 12
        assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
        assert baked_volumes(scene) == [ob]
        assert ob.data.filepath != first

    def test_is_off_without_a_selection(self, scene):
        assert not bpy.ops.lb_lighting.bake.poll()
        with pytest.raises(RuntimeError, match="Select a volume, a smoke domain or a mesh"):
            bpy.ops.lb_lighting.bake()

    def test_undo(self, scene, tmp_path):
        fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
        scenery.select(fog, leaves)
        bpy.ops.ed.undo_push(message="before")
        before = snapshot()
        bpy.ops.lb_lighting.bake("EXEC_DEFAULT", True)
        lit = snapshot()
        assert lit != before
        bpy.ops.ed.undo()
        assert snapshot() == before
        bpy.ops.ed.redo()
        assert snapshot() == lit


class TestAnimation:
    def test_bakes_the_range_of_the_scene(self, scene, tmp_path, capfd):
        scenery.select(scenery.add_fog(tmp_path))
        scene.frame_start, scene.frame_end = 3, 4
        assert bpy.ops.lb_lighting.bake_animation() == {"FINISHED"}
        (ob,) = baked_volumes(scene)
        folder = baked_path(ob).parent
        assert sorted(path.name for path in folder.iterdir()) == [
            "frame_0003.vdb", "frame_0004.vdb"
        ]  # fmt: skip
        with pytest.raises(RuntimeError, match="The frames 3 to 4 are all baked"):
            bpy.ops.lb_lighting.bake_animation()
        scene.lb_lighting.overwrite = True
        assert bpy.ops.lb_lighting.bake_animation() == {"FINISHED"}
        assert baked_path(ob).parent != folder


class TestEstimate:
    @pytest.mark.parametrize("model", MODELS)
    def test_tells_what_a_bake_takes_and_changes_nothing(self, scene, tmp_path, capfd, model):
        scenery.select(scenery.add_fog(tmp_path))
        scene.lb_lighting.model = model
        before = snapshot()
        assert bpy.ops.lb_lighting.estimate() == {"FINISHED"}
        assert "Info: A bake takes about " in capfd.readouterr().out
        assert snapshot() == before
        shape, seconds, depth = running.last[:3]
        assert shape.startswith("16 x 16 x 16 voxels of 0.167 m, ")
        assert seconds.endswith(" s on NumPy (no OpenCL)")
        # sigma_t is 4/m, the density at most 1, and the grid is 2 m wide.
        a_voxel, across = (float(word) for word in depth.split() if word[0].isdigit())
        assert 0.8 * 4 / 6 < a_voxel < 1.01 * 4 / 6
        line = scenery.ball()[4, 4].sum() * 4 * 2 / scenery.EDGE
        assert across == pytest.approx(line, rel=0.05)


class TestQuality:
    def test_a_bake_tells_what_was_chosen_and_why(self, scene, tmp_path, capfd):
        scenery.select(scenery.add_fog(tmp_path))
        scene.lb_lighting.quality = "preview"
        assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
        assert any("of the visible light" in line for line in running.last)
        assert any("the target is 20%" in line for line in running.last)
        assert running.plan.quality == "preview"

    def test_customize_takes_over_what_was_chosen(self, scene, monkeypatch):
        chosen = Settings(rays=2.0, merge=4, handover=math.inf, photons=1234, tolerance=0.25)
        monkeypatch.setattr(running, "plan", SimpleNamespace(settings=chosen))
        assert bpy.ops.lb_lighting.customize() == {"FINISHED"}
        options = Options.of(scene)
        assert (options.quality, options.merge, options.photons) == ("CUSTOM", 4, 1234)
        assert options.rays == 2
        assert (options.scattering, options.handover) == ("multiple", 1000)
        assert options.tolerance == 0.25

    def test_customize_needs_a_plan(self, monkeypatch):
        monkeypatch.setattr(running, "plan", None)
        with pytest.raises(RuntimeError, match="Estimate or bake first"):
            bpy.ops.lb_lighting.customize()


class TestCancel:
    @pytest.mark.parametrize(
        ("work", "name"), [(bake.Baking, "bake"), (bake.Estimating, "estimate")]
    )
    def test_tells_what_was_cancelled(self, scene, tmp_path, processes, work, name):
        fog = scenery.add_fog(tmp_path)
        scenery.select(fog)
        before = snapshot()
        running.start(work(bpy.context, [fog], Options.of(scene)))
        for operator in (bpy.ops.lb_lighting.bake, bpy.ops.lb_lighting.preview):
            with pytest.raises(RuntimeError, match="A bake or an estimate is running; cancel"):
                operator()
        assert bpy.ops.lb_lighting.cancel() == {"FINISHED"}
        name = {bake.Baking: "bake", bake.Estimating: "estimate"}[work]
        assert running.last == (f"The {name} was cancelled; nothing was changed",)
        assert processes[0].poll() is not None
        assert snapshot() == before
        assert not bpy.ops.lb_lighting.cancel.poll()


class TestDevices:
    def test_are_listed_in_the_preferences(self, capfd):
        assert bpy.ops.lb_lighting.find_devices() == {"FINISHED"}
        labels = [line.rsplit(":", 1)[0] for line in preferences._found]  # what is free changes
        assert labels == [line.rsplit(":", 1)[0] for line in job.device_lines()]
        assert f"Info: The best device is {preferences._found[0]}" in capfd.readouterr().out


class TestClear:
    def test_after_a_bake(self, scene, tmp_path):
        scenery.select(scenery.add_fog(tmp_path), scenery.add_leaves())
        before = snapshot()
        bpy.ops.lb_lighting.bake()
        assert bpy.ops.lb_lighting.clear(delete_files=True) == {"FINISHED"}
        assert snapshot() == before
        assert [path.name for path in tmp_path.glob("*.vdb")] == ["fog.vdb"]

    def test_nothing_to_clear(self, scene, capfd):
        assert bpy.ops.lb_lighting.clear() == {"CANCELLED"}
        assert "Nothing to clear: this scene has no LB light" in capfd.readouterr().out


def bounces(scene):
    kinds = ("volume", "diffuse", "transmission")
    return tuple(getattr(scene.cycles, f"{kind}_bounces") for kind in kinds)


class TestUse:
    @pytest.fixture
    def chosen(self, scene):
        """The user's own bounces."""
        scene.cycles.volume_bounces, scene.cycles.diffuse_bounces = 2, 3
        scene.cycles.transmission_bounces = 5
        return scene

    def test_nothing_is_baked(self, chosen):
        assert not bpy.ops.lb_lighting.use.poll()

    def test_of_a_volume_surfaces_keep_their_bounces(self, chosen, tmp_path):
        bake_light(scenery.add_fog(tmp_path))
        bpy.ops.lb_lighting.use()
        assert bounces(chosen) == (0, 3, 5)
        assert chosen.cycles.volume_biased
        bpy.ops.lb_lighting.use()
        assert bounces(chosen) == (2, 3, 5)
        assert chosen.cycles.volume_biased  # the bake's own

    @pytest.mark.parametrize("foliage", [choice.identifier for choice in FOLIAGE])
    def test_of_leaves_there_and_back(self, chosen, foliage):
        bake_light(scenery.add_leaves(), foliage=foliage)
        before = snapshot()
        bpy.ops.lb_lighting.use()
        assert bounces(chosen) == (0, 0, 0)
        bpy.ops.lb_lighting.use()
        assert snapshot() == before
        assert not chosen.cycles.volume_biased

    @pytest.mark.parametrize("shader", ["ShaderNodeBsdfGlass", "ShaderNodeBsdfPrincipled"])
    def test_glass_stays_clear(self, chosen, shader):
        bake_light(scenery.add_leaves())
        glass = bpy.data.materials.new("glass").node_tree.nodes.new(shader)
        if shader == "ShaderNodeBsdfPrincipled":
            glass.inputs["Transmission Weight"].default_value = 1
        bpy.ops.lb_lighting.use()
        assert bounces(chosen) == (0, 0, 5)

    def test_another_bake_does_not_take_it_for_the_users(self, chosen, tmp_path):
        sources = scenery.add_fog(tmp_path), scenery.add_leaves()
        before = snapshot()
        bake_light(*sources)
        bpy.ops.lb_lighting.use()
        bake_light(*sources)
        assert bounces(chosen) == (0, 0, 0)
        bpy.ops.lb_lighting.clear()
        assert snapshot() == before
        assert not bpy.ops.lb_lighting.use.poll()


def select_the_sun(scene):
    scenery.select(bpy.data.objects["sun"])


def lose_the_file(scene):
    bpy.data.volumes["fog"].filepath = "//nowhere.vdb"


def ask_for_smoke(scene):
    scene.lb_lighting.grid = "smoke"


def ask_for_no_voxels(scene):
    scene.lb_lighting.resolution = 0


def ask_for_too_many_voxels(scene):
    scene.lb_lighting.resolution = 2**31 - 1


def switch_off_the_sun(scene):
    bpy.data.lights["sun"].energy = 0


def write_nowhere(scene):
    scene.lb_lighting.folder = str(Path(scene.lb_lighting.folder) / "nowhere")


def ask_for_an_abacus(scene):
    scene.lb_lighting.device = "abacus"


BAD = {
    select_the_sun: "'sun' has neither a volume nor faces; select a volume",
    lose_the_file: "The volume file '//nowhere.vdb' of 'fog' cannot be read",
    ask_for_smoke: "'fog' has no grid 'smoke'; choose one of: density.",
    ask_for_no_voxels: "A resolution of 0 voxels is too low; use 7 or more.",
    ask_for_too_many_voxels: "the largest resolution that fits is ",
    switch_off_the_sun: "The scene has no light; add a lamp",
    write_nowhere: "nowhere does not exist; choose another or create it.",
    ask_for_an_abacus: "There is no device called 'abacus'; choose one of: ",
}


@pytest.mark.parametrize("spoil", BAD, ids=lambda spoil: spoil.__name__)
def test_bad_input_is_one_sentence_and_no_change(scene, tmp_path, spoil):
    scenery.select(scenery.add_fog(tmp_path))
    spoil(scene)
    before, files = snapshot(), set(tmp_path.iterdir())
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.lb_lighting.bake()
    (line,) = str(caught.value).splitlines()
    assert line.startswith("Error: ")
    assert BAD[spoil] in line
    assert snapshot() == before
    assert set(tmp_path.iterdir()) == files
