# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes take what renders show, and refuse what they cannot read."""

import os
import tempfile
from pathlib import Path

import bpy
import numpy as np
import pytest

from lb_lighting import bake
from lb_lighting.clearing import clear
from lb_lighting.errors import (
    DeviceError,
    LightError,
    MediumError,
    OutputError,
    SceneError,
    SettingsError,
    SolverError,
)
from lb_lighting.options import Options
from tests import scenery
from tests.baking import fog
from tests.output import rendering
from tests.scenery import bake_light, snapshot


class TestRendered:
    @pytest.fixture
    def picture(self, tmp_path):
        """A function that renders the scene from the side: (16, 16) linear radiance."""
        rendering.dark_scene((0, -5, 0), (np.pi / 2, 0, 0), 2.4)

        def render():
            path = tmp_path / "picture.exr"
            return rendering.render(bpy.context.scene, path, 16, 4).mean(axis=2)

        return render

    @pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
    def test_a_cloud_is_brighter_on_the_side_of_the_sun(self, scene, tmp_path, picture, mode):
        bake_light(scenery.add_fog(tmp_path), mode=mode)
        bpy.data.objects["sun"].hide_render = True  # what is left is the baked light
        light = picture()
        below, above = light[3:8, 4:12].mean(), light[8:13, 4:12].mean()
        assert below > 0.01
        assert above > 1.1 * below

    def test_leaves_glow_in_baked_light_alone(self, scene, picture):
        ob = scenery.add_leaves()
        bake_light(ob)
        bpy.data.objects["sun"].hide_render = True
        glow = picture().mean()
        clear(bpy.context)
        assert glow > 1e-4
        assert not picture().any()

    def test_a_filled_mesh_is_seen(self, scene, picture):
        bake_light(scenery.add_ball(material=scenery.volume_material()))
        bpy.data.objects["sun"].hide_render = True
        assert picture()[6:10, 6:10].min() > 0.01


def missing_file(folder):
    ob = scenery.add_fog(folder)
    ob.data.filepath = str(folder / "nowhere.vdb")
    return [ob]


def mesh_without_faces(_folder):
    return [scenery.link("points", bpy.data.meshes.new("points"))]


def linked(folder):
    """Leaves whose mesh and material are another file's."""
    path = str(folder / "library.blend")
    mesh = bpy.data.meshes.new("twig")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 1)], [], [(0, 1, 2)])
    mesh.materials.append(scenery.leaf_material())
    bpy.data.libraries.write(path, {mesh})
    bpy.data.batch_remove([mesh, mesh.materials[0]])
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.meshes = there.meshes
    return [scenery.link("twig", here.meshes[0])]


def linked_material(folder):
    ob = linked(folder)[0]
    ob.data = ob.data.copy()
    return [ob]


def linked_object(folder):
    path = str(folder / "library.blend")
    bpy.data.libraries.write(path, {scenery.add_fog(folder, name="haze")})
    bpy.data.objects.remove(bpy.data.objects["haze"])
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["haze"]
    bpy.context.scene.collection.objects.link(here.objects[0])
    return here.objects


BAD_SOURCES = {
    "nothing": (lambda folder: [], {}, SceneError, "Nothing is selected; "),
    "empty": (
        lambda folder: [scenery.link("none", None)],
        {},
        SceneError,
        "'none' has neither a volume nor faces; ",
    ),
    "camera": (
        lambda folder: [scenery.link("eye", bpy.data.cameras.new("eye"))],
        {},
        SceneError,
        "'eye' has neither a volume nor faces; ",
    ),
    "no faces": (mesh_without_faces, {}, SceneError, "'points' has neither a volume nor faces; "),
    "missing file": (missing_file, {}, SceneError, "nowhere.vdb' of 'fog' cannot be read"),
    "no such grid": (
        fog,
        {"grid": "smoke"},
        SceneError,
        "'fog' has no grid 'smoke'; choose one of: density",
    ),
    "no density": (
        lambda folder: [scenery.add_ball(role="OCCLUDER")],
        {},
        SceneError,
        "There is no density to light here; ",
    ),
    "linked object": (
        linked_object,
        {},
        OutputError,
        "'haze' is linked from another file; make it local.",
    ),
    "linked mesh": (linked, {}, OutputError, "The mesh of 'twig' is linked from another file; "),
    "linked material": (
        linked_material,
        {},
        OutputError,
        "The material 'leaf' is linked from another file; ",
    ),
    "missing folder": (
        fog,
        {"folder": "nowhere"},
        OutputError,
        "nowhere does not exist; choose another or create it.",
    ),
    "unknown medium": (fog, {"medium": "milk"}, SettingsError, "There is no medium called 'milk'"),
    "unknown mode": (fog, {"mode": "MULTIPLY"}, SettingsError, "There is no mode called"),
    "unknown domain": (fog, {"domain": "box"}, SettingsError, "There is no object 'box' to use"),
    "no padding": (fog, {"padding": 0}, SettingsError, "The padding must be 1 voxel or more"),
    "no depth": (fog, {"optical_depth": 0}, SettingsError, "The optical depth must be positive"),
}


class TestBadInput:
    """One sentence, the scene as it was, and no file."""

    def refused(self, objects, error, sentence, **changes):
        before = snapshot()
        files = set(Path(bpy.context.scene.lb_lighting.folder).iterdir())
        stages = []
        with pytest.raises(error) as caught:
            bake_light(*objects, progress=lambda *status: stages.append(status[0]), **changes)
        assert not any(stage.startswith("Solving") for stage in stages)
        assert sentence in str(caught.value)
        assert "\n" not in str(caught.value)
        assert snapshot() == before
        assert set(Path(bpy.context.scene.lb_lighting.folder).iterdir()) == files

    @pytest.mark.parametrize("name", BAD_SOURCES)
    def test_is_refused_before_the_solve(self, scene, tmp_path, name):
        make, changes, error, sentence = BAD_SOURCES[name]
        self.refused(make(tmp_path), error, sentence, **changes)

    def test_no_light(self, scene, tmp_path):
        bpy.data.lights["sun"].energy = 0
        self.refused(fog(tmp_path), LightError, "The scene has no light; add a lamp")

    def test_resolution_of_nothing(self, scene, tmp_path):
        sentence = "A resolution of 0 voxels is too low; use 7 or more."
        self.refused(fog(tmp_path), MediumError, sentence, resolution=0)

    def test_too_fine_for_the_memory(self, scene, tmp_path):
        sentence = "the largest resolution that fits is "
        self.refused(fog(tmp_path), DeviceError, sentence, resolution=20_000)

    @pytest.mark.parametrize("strength", [-1.0, float("nan")])
    def test_strength_below_nothing(self, scene, tmp_path, strength):
        with pytest.raises(SettingsError, match="strength must not be negative"):
            bake_light(scenery.add_fog(tmp_path), strength=strength)

    def test_too_small_to_write(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.scale = (1e-5, 1e-5, 1e-5)
        bpy.context.view_layer.update()
        with pytest.raises(SceneError, match="scale the scene up"):
            bake_light(ob)

    def test_domain_without_a_size(self, scene, tmp_path):
        scenery.link("empty", None)
        with pytest.raises(SettingsError, match="has no size; choose a mesh"):
            bake_light(scenery.add_fog(tmp_path), domain="empty")

    def test_unknown_device(self, scene, tmp_path):
        sentence = "There is no device called 'abacus'; choose one of: "
        self.refused(fog(tmp_path), DeviceError, sentence, device="abacus")

    def test_a_solver_that_is_killed(self, scene, tmp_path, processes):
        objects, before = fog(tmp_path), snapshot()
        options = Options.of(scene, resolution=40)
        with pytest.raises(SolverError, match="ended by signal 9; nothing was changed"):
            bake.bake(bpy.context, objects, options, lambda *_progress: processes[-1].kill())
        assert snapshot() == before
        assert [path.name for path in tmp_path.iterdir()] == ["fog.vdb"]

    def test_edit_mode(self, scene):
        ob = scenery.add_leaves()
        bpy.context.view_layer.objects.active = ob
        bpy.ops.object.mode_set(mode="EDIT")
        with pytest.raises(OutputError, match="'leaves' is in Edit Mode; leave Edit Mode"):
            bake_light(ob)

    @pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs POSIX users")
    def test_read_only_folder(self, scene):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            objects = fog(folder)
            scene.lb_lighting.folder = str(folder)
            with scenery.read_only(folder):
                self.refused(objects, OutputError, " is not writable; choose another")
