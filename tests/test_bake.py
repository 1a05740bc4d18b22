# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes from end to end: every kind of source, baked, baked again, and removed."""

import bpy
import numpy as np
import openvdb
import pytest

from lb_lighting.options import Options
from lb_lighting.output.vdb import DENSITY_GRID, read_metadata
from lb_lighting.reading import read_scene
from tests import scenery
from tests.baking import baked, shader
from tests.scenery import bake_light, read_grid


def light_by_height(outcome):
    """(nz - 2 padding,): the mean fluence of the layers of the domain, from below."""
    return outcome.field.fluence[0].mean(axis=(0, 1))[2:-2]


# The grids of two beams, where the medium scatters forwards.
BEAMS = {"lb_direct_1", "lb_direct_2", "lb_forward_1", "lb_forward_2"}


class TestVolume:
    def test_material_is_read_and_light_falls_off_away_from_the_sun(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        outcome = bake_light(ob)
        assert outcome.path.parent == tmp_path
        light = light_by_height(outcome)
        assert light[-1] > 1.2 * light[0]
        assert shader(baked())["Sigma S"].default_value[:] == pytest.approx((3.6,) * 3)
        assert shader(baked())["Sigma A"].default_value[0] == pytest.approx(0.4)

    def test_preset_has_the_optical_depth_asked_for(self, scene, tmp_path):
        bake_light(scenery.add_fog(tmp_path), medium="cloud", optical_depth=10, padding=1)
        sigma = [shader(baked())[name].default_value[0] for name in ("Sigma S", "Sigma A")]
        longest = 2 * 16 / 14  # m, of the domain
        assert sum(sigma) * longest == pytest.approx(10)
        assert sigma[0] / sum(sigma) == pytest.approx(0.99)

    def test_a_missing_material_is_noted(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path, material=False))
        assert "'fog' has no volume material; the preset 'cloud' was used." in outcome.notes

    def test_grey_is_one_band(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path))
        assert outcome.field.fluence.shape == (1, 16, 16, 16)
        light, _first = read_grid(outcome.path)
        assert np.array_equal(light[..., 0], light[..., 1])
        assert np.array_equal(light[..., 0], light[..., 2])

    def test_a_coloured_sun_colours_grey_fog_and_is_solved_once(self, scene, tmp_path):
        bpy.data.lights["sun"].color = (1, 0.5, 0)
        field = bake_light(scenery.add_fog(tmp_path)).field
        assert field.report.runs == 1
        assert field.fluence[1] == pytest.approx(field.fluence[0] / 2, rel=1e-6)
        assert not field.fluence[2].any()

    def test_coloured_fog_colours_white_light(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.data.materials[0] = scenery.volume_material(color=(0.9, 0.5, 0.1))
        means = bake_light(ob).field.fluence.mean(axis=(1, 2, 3))
        assert means[0] > means[1] > means[2]

    def test_file_is_aligned_with_its_source(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.location, ob.rotation_euler, ob.scale = (3, -2, 1), (0.3, 0.2, 0.5), (1, 0.5, 0.7)
        outcome = bake_light(ob)
        density, first = read_grid(outcome.path, DENSITY_GRID)
        domain = outcome.field.domain
        weights = density / density.sum()
        indices = np.stack(np.indices(density.shape), axis=-1) + first
        center = domain.origin + (np.einsum("xyz,xyzi->i", weights, indices) + 0.5) * (
            domain.voxel_size
        )
        assert np.abs(center - ob.location).max() < 0.1 * domain.voxel_size
        assert baked().matrix_world.translation[:] == (0, 0, 0)

    def test_the_residual_is_reported_while_solving(self, scene, tmp_path):
        ob, stages = scenery.add_fog(tmp_path), []
        ob.data.materials[0] = scenery.volume_material(60.0, (0.99, 0.99, 0.99))
        task = read_scene(bpy.context, [ob], Options.of(scene))
        lit = task.run(lambda **said: stages.append(said["stage"]), tmp_path)
        assert stages[:2] == ["Filling voxels", "Solving"]
        residuals = [
            stage[len("Solving (residual ") : -2] for stage in stages if "residual" in stage
        ]
        assert np.all(np.diff(np.array(residuals, float)) <= 0)
        assert 100 * lit.report.residual < float(residuals[-1]) < 100

    def test_a_quality_is_planned_for(self, scene, tmp_path):
        fog = scenery.add_fog(tmp_path, 0.003 * scenery.ball())
        outcome = bake_light(fog, quality="final")
        assert outcome.plan.settings.scattering == "single"
        assert not outcome.field.fluence.any()
        assert read_metadata(outcome.path)["expected_error"] == pytest.approx(outcome.plan.error)
        assert any("No lattice" in line for line in outcome.report_lines)

    def test_what_a_quality_plans_is_left_alone_by_hand(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path), scattering="single")
        assert outcome.plan is None
        assert outcome.field.report.steps == 0

    def test_metadata_holds_the_settings(self, scene, tmp_path):
        metadata = read_metadata(bake_light(scenery.add_fog(tmp_path), strength=0.5).path)
        assert metadata["resolution"] == 16
        assert metadata["strength"] == 0.5
        assert metadata["model"] == "physical"
        assert metadata["device"] == "NumPy (no OpenCL)"

    def test_each_lamp_has_its_own_uncollided_light(self, scene, tmp_path):
        lamp = scenery.link("point", bpy.data.lights.new("point", "POINT"))
        lamp.location = (0, 0, 5)
        bpy.data.lights["point"].energy = 40 * np.pi * 25  # 10 W/m^2 in the middle of a void
        path = bake_light(scenery.add_fog(tmp_path)).path
        sun, point = (read_grid(path, f"lb_direct_{n}")[0][..., 0] * 4 * np.pi for n in (1, 2))
        assert sun.max() == pytest.approx(3, rel=1e-3)
        assert point.max() == pytest.approx(10 * 5**2, rel=0.02)  # W/sr times 4 pi: none is lost
        nodes = baked().active_material.node_tree.nodes
        assert {node.label for node in nodes if node.label} == BEAMS

    def test_directional_scattering_of_what_scatters_forwards(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Anisotropy"].default_value = 0.85
        outcome, stages = bake_light(ob), []
        assert any("Directional scattering took" in line for line in outcome.report_lines)
        moments = {f"lb_moment_{n}" for n in range(1, 9)}
        names = {grid.name for grid in openvdb.readAllGridMetadata(str(outcome.path))}
        assert names == {"density", "lb_light", "lb_direct_1", "lb_forward_1", *moments}
        nodes = baked().active_material.node_tree.nodes
        labels = {node.label for node in nodes if node.label}
        assert labels == {"LB Moments", "lb_direct_1", "lb_forward_1"}

        def progress(stage, fraction):
            stages.append((fraction, stage))

        left = bake_light(ob, gather=False)
        names = {grid.name for grid in openvdb.readAllGridMetadata(str(left.path))}
        assert not names & moments
        assert not any("Directional scattering took" in line for line in left.report_lines)
        bake_light(ob, quality="preview", progress=progress)
        assert stages == sorted(stages, key=lambda stage: stage[0])
        assert "Directional scattering" in {stage for _, stage in stages}

    @pytest.mark.parametrize(
        "changes",
        [{"anisotropy": 0.5}, {"scattering": "single"}, {"mode": "ADD", "model": "paper"}],
    )
    def test_no_directional_scattering_where_it_changes_little(self, scene, tmp_path, changes):
        ob, changes = scenery.add_fog(tmp_path), dict(changes)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Anisotropy"].default_value = changes.pop("anisotropy", 0.85)
        assert "gather" not in bake_light(ob, **changes).field.report.seconds

    def test_of_the_paper_all_light_is_one(self, scene, tmp_path):
        outcome = bake_light(scenery.add_fog(tmp_path), model="paper")
        assert outcome.field.report.model == "paper"
        light, _first = read_grid(outcome.path)
        assert light.max() == pytest.approx(outcome.field.fluence.max() / (4 * np.pi), rel=0.2)
        assert len(baked().active_material.node_tree.nodes) == 2

    def test_spots_are_beams_and_areas_are_not(self, scene, tmp_path):
        for kind in ("SPOT", "AREA"):
            lamp = scenery.link(kind, bpy.data.lights.new(kind, kind))
            lamp.location = (0, 0, 5)
        outcome = bake_light(scenery.add_fog(tmp_path))
        spot, area = outcome.field.by_light[1:, 0]
        assert spot.any()
        assert area.any()
        nodes = baked().active_material.node_tree.nodes
        assert {node.label for node in nodes if node.label} == BEAMS
        assert not outcome.notes or "not read" not in " ".join(outcome.notes)

    def test_own_light_needs_no_lamp(self, scene, tmp_path):
        bpy.data.objects.remove(bpy.data.objects["sun"])
        ob = scenery.add_fog(tmp_path)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Emission Strength"].default_value = 3
        inputs["Emission Color"].default_value = (1, 0.5, 0, 1)
        outcome = bake_light(ob)
        shone, _first = read_grid(outcome.path, "lb_emission")
        assert shone.max(axis=(0, 1, 2)) == pytest.approx((3, 1.5, 0), rel=1e-5)
        entered = outcome.field.report.energy["entered"]
        radiated = 4 * np.pi * shone.sum(axis=(0, 1, 2)) * outcome.field.domain.voxel_size**3
        assert entered == pytest.approx(radiated, rel=1e-4)
        with pytest.raises(KeyError, match="lb_emission"):  # there Cycles shows it
            read_grid(bake_light(ob, mode="ADD").path, "lb_emission")

    def test_the_papers_model_has_no_fire(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        inputs = ob.active_material.node_tree.nodes["Principled Volume"].inputs
        inputs["Emission Strength"].default_value = 3
        note = "The paper model leaves out the light of fire; choose Physical to bake it."
        assert note in bake_light(ob, model="paper").notes

    def test_coefficients_per_unit_of_object_space(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        world = bake_light(ob).field
        ob.scale = (2, 2, 2)
        ob.data.render.space = "OBJECT"
        # Twice as large and half as dense: the same light.
        assert bake_light(ob).field.fluence == pytest.approx(world.fluence, rel=1e-5)
        ob.data.render.space = "WORLD"
        assert bake_light(ob).field.fluence[0][:, :, 2].mean() < world.fluence[0][:, :, 2].mean()

    def test_domain_object_gives_the_bounds(self, scene, tmp_path):
        ob = scenery.add_fog(tmp_path)
        box = scenery.add_ball("box", radius=1)
        box.scale, box.location = (2, 2, 2), (1, 0, 0)
        scene.lb_lighting.domain = box
        domain = bake_light(ob).field.domain
        assert np.add(domain.origin, domain.upper) / 2 == pytest.approx((1, 0, 0), abs=1e-5)
        assert domain.voxel_size == pytest.approx(4 / 12)
