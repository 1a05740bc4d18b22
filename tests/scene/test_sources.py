# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources of every kind on a lattice."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.medium_choice import FROM_MATERIAL
from lb_lighting.scene.sources import VolumeSource
from lb_lighting.scene.surface_sources import SolidSource
from lb_lighting.transport.medium import PRESETS, Optics
from tests import scenery
from tests.scene.mixtures import DOMAIN, read, share

LONGEST = DOMAIN.voxel_size * 20


def add_nodes(ob, kind, material=None):
    """Replace the geometry of `ob` by that of a single geometry node."""
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    geometry = tree.nodes.new(kind).outputs[0]
    if material:
        setter = tree.nodes.new("GeometryNodeSetMaterial")
        setter.inputs["Material"].default_value = material
        tree.links.new(geometry, setter.inputs[0])
        geometry = setter.outputs[0]
    tree.links.new(geometry, tree.nodes.new("NodeGroupOutput").inputs[0])
    ob.modifiers.new("nodes", "NODES").node_group = tree


def extinction(optics):
    return np.max(np.add(optics.sigma_s, optics.sigma_a))


class TestRoles:
    @pytest.mark.parametrize(
        ("make", "kind"),
        [
            (lambda folder: scenery.add_fog(folder), "VolumeSource"),
            (lambda folder: scenery.add_leaves(), "FoliageSource"),
            (lambda folder: scenery.add_leaves(material=False), "FoliageSource"),
            (lambda folder: scenery.add_ball(material=scenery.volume_material()), "SolidSource"),
            (lambda folder: scenery.add_ball(role="SOLID"), "SolidSource"),
            (lambda folder: scenery.add_ball(role="OCCLUDER"), "OccluderSource"),
            (
                lambda folder: scenery.add_ball(role="FOLIAGE", material=scenery.volume_material()),
                "FoliageSource",
            ),
        ],
    )
    def test_role_of_an_object(self, tmp_path, make, kind):
        ((source,), _notes) = read(make(tmp_path))
        assert type(source).__name__ == kind

    def test_a_solid_without_a_surface_is_shown_as_a_volume(self):
        fog, glass = scenery.volume_material(), scenery.volume_material()
        nodes = glass.node_tree.nodes
        surface = nodes.new("ShaderNodeBsdfGlass").outputs[0]
        output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
        glass.node_tree.links.new(surface, output.inputs["Surface"])
        balls = [scenery.add_ball(role="SOLID", material=m) for m in (fog, glass, None)]
        sources, _notes = read(*balls)
        assert [source.is_volume for source in sources] == [True, False, False]
        assert [source.shows_light for source in sources] == [False, True, True]

    def test_surfaces_show_light(self, tmp_path):
        fog, leaves = scenery.add_fog(tmp_path), scenery.add_leaves()
        balls = [scenery.add_ball(role=role) for role in ("OCCLUDER", "SOLID")]
        sources, _notes = read(fog, leaves, *balls)
        assert [source.shows_light for source in sources] == [False, True, True, True]
        assert [source.is_body for source in sources] == [False, False, False, True]

    @pytest.mark.parametrize("how", ["object", "eye", "collection"])
    def test_a_hidden_object_is_named(self, how):
        ob = scenery.add_leaves()
        if how == "object":
            ob.hide_viewport = True
        elif how == "eye":
            ob.hide_set(True)
        else:
            collection = bpy.data.collections.new("off")
            bpy.context.scene.collection.children.link(collection)
            bpy.context.scene.collection.objects.unlink(ob)
            collection.objects.link(ob)
            bpy.context.view_layer.layer_collection.children["off"].exclude = True
        with pytest.raises(SceneError, match=r"^'leaves' is hidden; show it to light it\.$"):
            read(ob)

    def test_a_preset_replaces_nodes_that_cannot_be_read(self):
        material = scenery.volume_material()
        noise = material.node_tree.nodes.new("ShaderNodeTexNoise").outputs[0]
        principled = material.node_tree.nodes["Principled Volume"]
        material.node_tree.links.new(noise, principled.inputs["Density"])
        ((source,), _notes) = read(scenery.add_ball(material=material), medium="cloud")
        assert type(source) is SolidSource

    def test_a_curve_is_lit_by_its_surface(self):
        bpy.ops.curve.primitive_bezier_circle_add()
        curve = bpy.context.object
        curve.data.bevel_depth = 0.1
        ((source,), _notes) = read(curve)
        lower, upper = source.bounds
        assert upper - lower == pytest.approx((2.2, 2.2, 0.2), abs=0.05)
        assert not source.is_volume

    def test_an_instance_belongs_to_the_object_that_makes_it(self):
        leaves = scenery.add_leaves()
        collection = bpy.data.collections.new("tree")
        collection.objects.link(leaves)
        bpy.context.scene.collection.objects.unlink(leaves)
        instance = scenery.link("instance", None)
        instance.instance_type, instance.instance_collection = "COLLECTION", collection
        instance.location = (0, 0, 7)
        bpy.context.view_layer.update()
        ((source,), _notes) = read(instance)
        assert np.mean(source.bounds, axis=0) == pytest.approx((0, 0, 7), abs=0.2)

    def test_nothing(self):
        with pytest.raises(SceneError, match=r"^Nothing is selected; select"):
            read()


class TestVolumes:
    def test_material(self, tmp_path):
        result = share(scenery.add_fog(tmp_path))
        assert result.optics == Optics(pytest.approx(3.6), pytest.approx(0.4), pytest.approx(0.3))
        assert result.density.max() == pytest.approx(1, abs=0.1)

    def test_a_homogeneous_material_fills_the_grid(self, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.active_material.node_tree.nodes["Principled Volume"].inputs[
            "Density Attribute"
        ].default_value = ""
        assert set(np.unique(share(ob).density)) == {0, 1}

    @pytest.mark.parametrize("name", PRESETS)
    def test_preset(self, tmp_path, name):
        result = share(scenery.add_fog(tmp_path), medium=name, optical_depth=12)
        assert extinction(result.optics) * LONGEST == pytest.approx(12)
        preset = PRESETS[name]
        ratio = np.divide(result.optics.sigma_s, preset.sigma_s)
        assert ratio == pytest.approx(np.divide(result.optics.sigma_a, preset.sigma_a))
        assert np.ptp(ratio) == pytest.approx(0, abs=1e-9)
        assert result.optics.g == preset.g

    def test_a_missing_material_is_noted(self, tmp_path):
        (_found, notes) = read(scenery.add_fog(tmp_path, material=False))
        assert notes == ["'fog' has no volume material; the preset 'cloud' was used."]

    @pytest.mark.parametrize("medium", [FROM_MATERIAL, "cloud"])
    def test_emission(self, tmp_path, medium):
        ob = scenery.add_fog(tmp_path)
        ((source,), notes) = read(ob, medium=medium)
        assert source.emission(DOMAIN) is None
        principled = ob.active_material.node_tree.nodes["Principled Volume"]
        principled.inputs["Emission Strength"].default_value = 2
        ((source,), notes) = read(ob, medium=medium)
        assert notes == []
        assert source.emission(DOMAIN)[:, 10, 10, 10] == pytest.approx((2, 2, 2))
        assert not source.emission(DOMAIN)[:, 0].any()

    def test_emission_that_cannot_be_read_is_noted(self, tmp_path):
        ob = scenery.add_fog(tmp_path)
        tree = ob.active_material.node_tree
        noise = tree.nodes.new("ShaderNodeTexNoise")
        strength = tree.nodes["Principled Volume"].inputs["Emission Strength"]
        tree.links.new(noise.outputs[0], strength)
        ((source,), notes) = read(ob)
        assert source.emission(DOMAIN) is None
        assert len(notes) == 1
        assert "'fog' emits light, but that light is not baked" in notes[0]

    def test_emission_in_object_space(self, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.scale, ob.data.render.space = (2, 2, 2), "OBJECT"
        principled = ob.active_material.node_tree.nodes["Principled Volume"]
        principled.inputs["Emission Strength"].default_value = 2
        ((source,), _) = read(ob)
        assert source.emission(DOMAIN)[:, 10, 10, 10] == pytest.approx((1, 1, 1))

    def test_a_volume_scaled_to_nothing_is_refused(self, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.scale, ob.rotation_euler = (1, 0, 1), (0.3, 0.2, 0.1)
        with pytest.raises(SceneError, match=r"^'fog' is scaled to nothing along an axis; give"):
            read(ob)

    def test_made_by_the_nodes_of_a_mesh(self):
        ob, fog = scenery.add_ball(), scenery.volume_material(density=2.0)
        add_nodes(ob, "GeometryNodeVolumeCube", fog)
        ob.location = (0.2, 0, 0)
        ob.lb_lighting.role = "FOLIAGE"
        ((source,), notes) = read(ob)
        assert type(source) is VolumeSource
        assert notes == []
        assert np.mean(source.bounds, axis=0) == pytest.approx((0.2, 0, 0), abs=0.05)
        (result,) = source.shares(DOMAIN)
        assert extinction(result.optics) == pytest.approx(2)
        assert result.density[8:12, 8:12, 8:12] == pytest.approx(1, rel=1e-3)

    def test_made_by_nodes_that_set_no_material(self):
        ob = scenery.add_ball(material=scenery.volume_material(density=3.0))
        add_nodes(ob, "GeometryNodeVolumeCube")
        ((source,), notes) = read(ob)
        assert extinction(source.shares(DOMAIN)[0].optics) == pytest.approx(3)
        (note,) = notes
        assert note.startswith("The nodes of 'ball' give their volume no material, and Cycles")
        assert "it was lit with 'fog'" in note


class TestSurfaces:
    def test_foliage_ignores_the_optical_depth(self):
        ob = scenery.add_leaves()
        by_material, by_preset = share(ob), share(ob, medium="plant", optical_depth=5)
        assert np.array_equal(by_material.density, by_preset.density)
        assert extinction(by_material.optics) == pytest.approx(1)
        assert extinction(by_preset.optics) == pytest.approx(1)

    def test_leaves_with_holes_are_thinner(self):
        ob = scenery.add_leaves()
        whole = share(ob).density.sum()
        ob.active_material.node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.25
        assert share(ob).density.sum() == pytest.approx(whole / 4)

    def test_each_material_is_a_share(self):
        ob = scenery.add_leaves()
        ob.data.materials.append(scenery.leaf_material(color=(0.5, 0.1, 0.1)))
        ob.data.polygons.foreach_set("material_index", np.arange(200) % 2)
        ((source,), _notes) = read(ob)
        green, red = source.shares(DOMAIN)
        assert green.optics.sigma_s == pytest.approx((0.1, 0.5, 0.1))
        assert red.optics.sigma_s == pytest.approx((0.5, 0.1, 0.1))

    def test_a_solid_is_full_inside(self):
        result = share(scenery.add_ball(role="SOLID"), optical_depth=7)
        volume = result.density.sum() * DOMAIN.voxel_size**3
        assert volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.05)
        assert extinction(result.optics) * LONGEST == pytest.approx(7)

    def test_a_solid_is_filled_by_the_first_material_that_has_a_volume(self):
        ob = scenery.add_ball(material=scenery.leaf_material())
        ob.data.materials.append(scenery.volume_material(density=5.0))
        ob.data.polygons[0].material_index = 1
        ((source,), notes) = read(ob)
        assert extinction(source.shares(DOMAIN)[0].optics) == pytest.approx(5)
        assert notes == []
        ob.data.materials.append(scenery.volume_material(density=6.0))
        ob.data.polygons[1].material_index = 2
        note = "'ball' has several volume materials; the first was used."
        assert read(ob)[1] == [note]

    @pytest.mark.parametrize("role", ["FOLIAGE", "SOLID", "OCCLUDER"])
    def test_instances_of_a_mesh_are_noted(self, role):
        parent, child = scenery.add_ball(role=role), scenery.add_ball("child", radius=0.1)
        child.parent = parent
        assert len(read(parent, medium="cloud")[1]) == 0
        parent.instance_type = "VERTS"
        notes = read(parent, medium="cloud")[1]
        assert [note.startswith("The instances of 'ball' shade") for note in notes] == [True]

    def test_leaves_are_denser_towards_light_that_faces_them(self):
        mesh = bpy.data.meshes.new("flat")
        corners = [(x, y, 0.05) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        mesh.materials.append(scenery.leaf_material())
        inputs = mesh.materials[0].node_tree.nodes["Principled BSDF"].inputs
        inputs["Alpha"].default_value = 0.5
        result = share(scenery.link("flat", mesh))
        assert result.toward((0, 0, 1.0)) == pytest.approx(2 * result.density)
        assert not result.toward((1.0, 0, 0)).any()
        assert result.density.sum() * DOMAIN.voxel_size**3 == pytest.approx(0.5 / 2, rel=1e-3)
