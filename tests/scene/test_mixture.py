# SPDX-License-Identifier: GPL-3.0-or-later
"""Occluders, shadows, and mixtures of several materials in one medium."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.medium_choice import FROM_MATERIAL, MediumChoice
from lb_lighting.scene.mixture import Share, mixture, occluders, with_shadows
from lb_lighting.transport.lights.distant import Sky, Sun
from lb_lighting.transport.medium import Optics
from tests import scenery
from tests.scene.mixtures import DOMAIN, read, share


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
