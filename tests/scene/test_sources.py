# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources of every kind, and mixtures of several in one medium."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.medium_choice import FROM_MATERIAL, MediumChoice
from lb_lighting.scene.mixture import Share, mixture, occluders, with_shadows
from lb_lighting.scene.opening import open_sources
from lb_lighting.scene.reader import Reader
from lb_lighting.scene.sources import VolumeSource
from lb_lighting.scene.surface_sources import SolidSource
from lb_lighting.transport.lights.distant import Sky, Sun
from lb_lighting.transport.medium import PRESETS, Domain, Optics
from tests import scenery

DOMAIN = Domain.around((-1, -1, -1), (1, 1, 1), 20)
LONGEST = DOMAIN.voxel_size * 20


def read(*objects, medium=FROM_MATERIAL, optical_depth=30.0, grid=""):
    """(sources, notes)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    reader = Reader(depsgraph, medium, optical_depth, grid)
    return open_sources(objects, reader), reader.notes


def share(ob, **choices):
    """The only share of an object."""
    ((source,), _notes) = read(ob, **choices)
    (only,) = source.shares(DOMAIN)
    return only


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


class TestOccluders:
    def read(self, *objects):
        sources, notes = read(*objects)
        assert all(source.shares(DOMAIN) == [] for source in sources)
        return occluders([source.occlusion(DOMAIN) for source in sources]), notes, sources

    def test_a_body_stops_light_and_reflects_its_colour(self):
        material = scenery.leaf_material(color=(0.3, 0.2, 0.1))
        (stopped, albedo), notes, _found = self.read(
            scenery.add_ball(role="OCCLUDER", material=material)
        )
        assert stopped[10, 10, 10] == 1
        assert stopped[2, 2, 2] == 0
        assert albedo == pytest.approx((0.3, 0.2, 0.1))
        assert notes == []

    def test_grey_is_one_band(self):
        (_stopped, albedo), _notes, _found = self.read(scenery.add_ball(role="OCCLUDER"))
        assert albedo == pytest.approx([0.8])

    def test_each_has_its_colour_where_it_is(self):
        balls = [
            scenery.add_ball(role="OCCLUDER", radius=0.4, material=scenery.leaf_material(color))
            for color in ((0.5, 0.2, 0.1), (0.1, 0.2, 0.5))
        ]
        balls[0].location.x, balls[1].location.x = -0.5, 0.5
        bpy.context.view_layer.update()
        (stopped, albedo), _notes, _found = self.read(*balls)
        assert stopped[5, 10, 10] == stopped[14, 10, 10] == 1
        assert albedo[:, 5, 10, 10] == pytest.approx((0.5, 0.2, 0.1))
        assert albedo[:, 14, 10, 10] == pytest.approx((0.1, 0.2, 0.5))

    def test_the_colour_of_an_object_is_weighted_by_area(self):
        ob = scenery.add_ball(role="OCCLUDER", material=scenery.leaf_material((0.6, 0.6, 0.6)))
        ob.data.materials.append(scenery.leaf_material((0.2, 0.2, 0.2)))
        upper = np.array([face.center.z > 0 for face in ob.data.polygons])
        ob.data.polygons.foreach_set("material_index", upper.astype(int))
        (_stopped, albedo), _notes, _found = self.read(ob)
        assert albedo == pytest.approx([0.4], abs=0.02)

    def test_a_material_that_cannot_be_read_is_black(self):
        ob = scenery.add_ball(role="OCCLUDER", material=scenery.leaf_material())
        nodes = ob.active_material.node_tree.nodes
        noise = nodes.new("ShaderNodeTexNoise").outputs["Color"]
        color = nodes["Principled BSDF"].inputs["Base Color"]
        ob.active_material.node_tree.links.new(noise, color)
        (_stopped, albedo), (note,), _found = self.read(ob)
        assert albedo == 0
        assert note.startswith("'ball' reflects no light. 'leaf' takes a value from the node")

    def test_a_coarse_wall_stops_light_but_shows_none(self):
        wall = bpy.data.meshes.new("wall")
        wall.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
        wall = scenery.link("wall", wall)
        wall.lb_lighting.role = "OCCLUDER"
        (stopped, _albedo), (note,), (source,) = self.read(wall)
        assert np.all(stopped[3:17, 3:17].max(axis=2) > 0.95)
        assert not source.shows_light
        assert note.startswith("'wall' shows none of the light, because its faces are larger")


class TestShadows:
    SUN, SKY = Sun((0, 0, -2), 1.0), Sky(1.0)

    def test_leaves_shade_a_sun_by_their_projected_area(self):
        result = share(scenery.add_leaves())
        sun, sky = with_shadows([self.SUN, self.SKY], [result])
        assert sun.shadow_density == pytest.approx(result.toward((0, 0, -1)))
        assert sky is self.SKY

    def test_shadow_density_has_the_units_of_a_mixture(self):
        """A share without directions keeps its density in the mixture."""
        leaf, fog = np.ones((2, 2, 2), np.float32), np.full((2, 2, 2), 3, np.float32)
        shares = [
            Share(leaf, Optics(0.5, 0.5, 0.1), lambda direction: 2 * leaf),
            Share(fog, Optics(4.0, 1.0)),
        ]
        sun, _sky = with_shadows([self.SUN, self.SKY], shares)
        density, _optics = mixture(shares)
        assert density == pytest.approx(1 + 15 * leaf)
        assert sun.shadow_density == pytest.approx(2 + 15 * leaf)

    def test_a_volume_has_no_shadow_density(self, tmp_path):
        lights = [self.SUN, self.SKY]
        assert with_shadows(lights, [share(scenery.add_fog(tmp_path))]) is lights


class TestMixture:
    ONE, TWO = np.ones((2, 2, 2), np.float32), np.full((2, 2, 2), 3, np.float32)

    DIFFER = "The materials differ in colour or in how they scatter"

    def test_the_same_optics_stay(self):
        optics = Optics((3.0, 2.0, 1.0), 0.5, 0.2)
        density, mixed = mixture([Share(self.ONE, optics), Share(self.TWO, optics)])
        assert np.array_equal(density, self.ONE + self.TWO)
        assert mixed is optics

    @pytest.mark.parametrize("sigmas", [(10.0, 1000.0), (1e-3, 5.0)])
    def test_each_keeps_its_extinction(self, sigmas):
        halves = np.zeros((2, 4, 4, 4), np.float32)
        halves[0, :2], halves[1, 2:] = 0.5, 3
        shares = [
            Share(half, Optics(sigma * albedo, sigma * (1 - albedo)))
            for half, sigma, albedo in zip(halves, sigmas, (0.9, 0.2), strict=True)
        ]
        density, mixed = mixture(shares)
        sigma_t = mixed.sigma_s + mixed.sigma_a
        assert density[0] * sigma_t == pytest.approx(0.5 * sigmas[0])
        assert density[3] * sigma_t == pytest.approx(3 * sigmas[1])

    def test_scattering_and_absorption_keep_their_sums(self):
        shares = [Share(self.ONE, Optics(4.0, 1.0, 0.5)), Share(self.TWO, Optics(2.0, 0.0, -0.1))]
        density, mixed = mixture(shares)
        mass = density.sum()
        assert mixed.sigma_s * mass == pytest.approx(8 * 4 + 24 * 2)
        assert mixed.sigma_a * mass == pytest.approx(8 * 1)
        scattering_times_g = mixed.sigma_s * mixed.g * mass
        assert scattering_times_g == pytest.approx(8 * 4 * 0.5 + 24 * 2 * -0.1)

    def test_grey_and_coloured(self):
        density, mixed = mixture(
            [Share(self.ONE, Optics(1.0, 0.0)), Share(self.ONE, Optics((0.0, 1.0, 2.0), 0.0))]
        )
        assert density == pytest.approx(self.TWO)
        assert np.multiply(mixed.sigma_s, 3) == pytest.approx((1, 2, 3))

    def test_pure_absorption_has_no_mean_cosine(self):
        _density, mixed = mixture([Share(self.ONE, Optics(0.0, s, 0.7)) for s in (1.0, 2.0)])
        assert mixed.g == 0

    def test_empty_and_clear_shares_do_not_count(self):
        optics, clear = Optics(3.0, 1.0, 0.5), Optics(0.0, 0.0, 0.0)
        nowhere = Share(0 * self.ONE, Optics((1.0, 2.0, 3.0), 0.0))
        density, mixed = mixture([Share(self.TWO, optics), Share(self.ONE, clear), nowhere])
        assert mixed is optics
        assert np.array_equal(density, self.TWO)

    @pytest.mark.parametrize(
        ("second", "is_noted"),
        [
            (Optics(2.0, 2.0, 0.5), False),
            (Optics(40.0, 40.0, 0.5), False),
            (Optics(3.0, 1.0, 0.5), True),
            (Optics((2.0, 2.0, 1.0), 2.0, 0.5), True),
            (Optics(2.0, 2.0, 0.4), True),
        ],
    )
    def test_a_mean_is_noted(self, second, is_noted):
        choice = MediumChoice(FROM_MATERIAL, 30, "")
        shares = [Share(self.ONE, Optics(2.0, 2.0, 0.5)), Share(self.ONE, second)]
        density, optics = choice.mixture(shares)
        assert np.array_equal(density, mixture(shares)[0])
        assert optics == mixture(shares)[1]
        assert [note.startswith(self.DIFFER) for note in choice.notes] == [True] * is_noted

    @pytest.mark.parametrize(
        "shares",
        [
            [],
            [Share(np.zeros((2, 2, 2)), Optics(1.0, 0.0))],
            [Share(np.ones((2, 2, 2)), Optics(0.0, 0.0))],
        ],
    )
    def test_nothing_to_light(self, shares):
        with pytest.raises(SceneError, match="no density to light here"):
            mixture(shares)

    def test_nothing_to_light_names_the_objects(self):
        shares = [Share(0 * self.ONE, Optics(1.0, 0.0), name=name) for name in ("fog", "leaves")]
        with pytest.raises(SceneError, match=r"the frame of 'fog', 'leaves', and the Domain\.$"):
            mixture(shares)
