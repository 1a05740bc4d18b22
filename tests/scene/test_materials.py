# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume and leaf materials as coefficients, checked against Cycles where it defines them."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene.materials import (
    Leaf,
    grey,
    has_volume,
    leaf_optics,
    tinted,
    volume_optics,
    volume_shines,
)
from lb_lighting.transport.medium import Optics
from tests.scene.trees import add_node, combine, connect, make_material, surface, volume

COLOR = (0.9, 0.6, 0.3)
TINT = (0.25, 0.04, 0.5)


def make_image(pixels, colorspace="Non-Color", is_float=True):
    height, width, _four = np.shape(pixels)
    image = bpy.data.images.new("image", width, height, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = colorspace
    image.pixels.foreach_set(np.ravel(pixels).astype(np.float32))
    return image


def add_image(tree, pixels, **settings):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = make_image(pixels, **settings)
    return node


PRINCIPLED = {"Color": COLOR, "Absorption_Color": TINT, "Density": 2.0, "Density_Attribute": ""}
COEFFICIENTS = {"Scatter_Coefficients": (1, 2, 3), "Absorption_Coefficients": (0.5, 0.1, 0)}


class TestVolume:
    def test_scatter(self):
        matter = volume_optics(
            volume("ShaderNodeVolumeScatter", Color=COLOR, Density=5.0, Anisotropy=0.7)
        )
        assert matter.optics.sigma_s == pytest.approx((4.5, 3, 1.5))
        assert matter.optics.sigma_a == (0, 0, 0)
        assert matter.optics.g == pytest.approx((0.7,) * 3)
        assert matter.density_attribute is None

    def test_absorption(self):
        matter = volume_optics(volume("ShaderNodeVolumeAbsorption", Color=COLOR, Density=5.0))
        assert matter.optics.sigma_s == (0, 0, 0)
        assert matter.optics.sigma_a == pytest.approx((0.5, 2, 3.5))

    def test_coefficients(self):
        optics = volume_optics(volume("ShaderNodeVolumeCoefficients", **COEFFICIENTS)).optics
        assert optics.sigma_s == pytest.approx((1, 2, 3))
        assert optics.sigma_a == pytest.approx((0.5, 0.1, 0))

    def test_principled(self):
        material = volume("ShaderNodeVolumePrincipled", Color=COLOR, Anisotropy=-0.3)
        matter = volume_optics(material)
        assert matter.optics.sigma_s == pytest.approx(COLOR)
        assert matter.optics.sigma_a == pytest.approx((0.1, 0.4, 0.7))
        assert matter.optics.g == pytest.approx((-0.3,) * 3)
        assert matter.density_attribute == "density"

    def test_grey_is_one_band(self):
        optics = volume_optics(volume("ShaderNodeVolumePrincipled", Color=(0.5,) * 3)).optics
        assert optics == Optics(0.5, 0.5, 0.0)

    def test_anisotropy_of_a_mixture_is_weighted_by_scattering(self):
        material = make_material()
        tree = material.node_tree
        first = add_node(tree, "ShaderNodeVolumeScatter", Color=(1, 1, 1), Anisotropy=0.8)
        second = add_node(
            tree, "ShaderNodeVolumeScatter", Color=(1, 0.5, 0), Density=3.0, Anisotropy=-0.4
        )
        dark = add_node(tree, "ShaderNodeVolumeAbsorption", Color=(0, 0, 0))
        both = combine(tree, combine(tree, first, second), dark)
        optics = volume_optics(connect(material, both, "Volume")).optics
        assert optics.sigma_s == pytest.approx((4, 2.5, 1))
        assert optics.sigma_a == pytest.approx((1, 1, 1))
        assert optics.g == pytest.approx((-0.1, 0.08, 0.8))

    def test_rayleigh_has_a_mean_cosine_of_0(self):
        material = volume("ShaderNodeVolumeScatter", _phase="RAYLEIGH", Color=COLOR)
        assert volume_optics(material).optics.g == (0, 0, 0)

    def test_other_phase_functions_are_refused(self):
        with pytest.raises(SceneError, match="Mie"):
            volume_optics(volume("ShaderNodeVolumeScatter", _phase="MIE"))

    def test_attribute_times_a_number(self):
        material = make_material()
        tree = material.node_tree
        attribute = add_node(tree, "ShaderNodeAttribute")
        attribute.attribute_name = "smoke"
        product = tree.nodes.new("ShaderNodeMath")
        product.operation = "MULTIPLY"
        tree.links.new(attribute.outputs["Factor"], product.inputs[0])
        product.inputs[1].default_value = 4
        scatter = add_node(
            tree, "ShaderNodeVolumeScatter", Color=(0.5,) * 3, Density=product.outputs[0]
        )
        matter = volume_optics(connect(material, scatter, "Volume"))
        assert matter.optics.sigma_s == pytest.approx(2)
        assert matter.density_attribute == "smoke"

    def test_volume_info(self):
        material = make_material()
        info = add_node(material.node_tree, "ShaderNodeVolumeInfo")
        scatter = add_node(
            material.node_tree, "ShaderNodeVolumeScatter", Density=info.outputs["Density"]
        )
        assert volume_optics(connect(material, scatter, "Volume")).density_attribute == "density"

    def test_node_group_with_inputs(self):
        group = bpy.data.node_groups.new("fog", "ShaderNodeTree")
        thickness = group.interface.new_socket(
            "Thickness", in_out="INPUT", socket_type="NodeSocketFloat"
        )
        group.interface.new_socket("Volume", in_out="OUTPUT", socket_type="NodeSocketShader")
        start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
        scatter = add_node(
            group, "ShaderNodeVolumeScatter", Color=(1, 1, 1), Density=start.outputs[0]
        )
        group.links.new(scatter.outputs[0], end.inputs[0])
        material = make_material()
        node = material.node_tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        node.inputs[thickness.identifier].default_value = 7
        assert volume_optics(connect(material, node, "Volume")).optics.sigma_s == 7

    def test_surface_material_has_no_volume(self):
        assert volume_optics(surface("ShaderNodeBsdfDiffuse")) is None

    @pytest.mark.parametrize(
        ("build", "message"),
        [
            (
                lambda tree: add_node(
                    tree,
                    "ShaderNodeVolumeScatter",
                    Density=tree.nodes.new("ShaderNodeTexNoise").outputs[0],
                ),
                "Noise Texture",
            ),
            (
                lambda tree: add_node(
                    tree,
                    "ShaderNodeVolumeScatter",
                    Color=tree.nodes.new("ShaderNodeTexNoise").outputs[1],
                ),
                "Noise Texture",
            ),
            (lambda tree: add_node(tree, "ShaderNodeBsdfDiffuse"), "Diffuse BSDF"),
            (
                lambda tree: add_node(tree, "ShaderNodeVolumePrincipled", Color_Attribute="color"),
                "'color'",
            ),
            (
                lambda tree: add_node(
                    tree,
                    "ShaderNodeVolumePrincipled",
                    Density=tree.nodes.new("ShaderNodeVolumeInfo").outputs["Density"],
                ),
                "clear one",
            ),
            (
                lambda tree: combine(
                    tree,
                    add_node(tree, "ShaderNodeVolumePrincipled"),
                    add_node(tree, "ShaderNodeVolumeScatter"),
                ),
                "different density attributes",
            ),
        ],
    )
    def test_unsupported_nodes_are_refused(self, build, message):
        material = make_material("fog")
        connect(material, build(material.node_tree), "Volume")
        with pytest.raises(SceneError, match="'fog'") as refusal:
            volume_optics(material)
        assert message in str(refusal.value)

    @pytest.mark.parametrize(
        ("kind", "inputs"),
        [
            ("ShaderNodeVolumePrincipled", PRINCIPLED),
            ("ShaderNodeVolumeScatter", {"Color": COLOR, "Density": 2.0}),
            ("ShaderNodeVolumeAbsorption", {"Color": COLOR, "Density": 2.0}),
            ("ShaderNodeVolumeCoefficients", COEFFICIENTS),
        ],
    )
    def test_extinction_is_that_of_cycles(self, kind, inputs, render):
        """Through a box of 1 m without light, the world has a brightness of e^-sigma_t."""
        bpy.ops.mesh.primitive_cube_add(size=1)
        material = volume(kind, **inputs)
        bpy.context.object.data.materials.append(material)
        bpy.context.scene.world.cycles_visibility.scatter = False
        background = bpy.context.scene.world.node_tree.nodes["Background"]
        background.inputs["Color"].default_value = (1, 1, 1, 1)
        background.inputs["Strength"].default_value = 1
        picture = render()
        optics = volume_optics(material).optics
        assert -np.log(picture) == pytest.approx(np.add(optics.sigma_s, optics.sigma_a), rel=0.03)


class TestEmission:
    @pytest.mark.parametrize(
        ("inputs", "expected"),
        [
            ({}, False),
            ({"Emission_Strength": 0.5}, True),
            ({"Blackbody_Intensity": 0.1}, True),
        ],
    )
    def test_principled(self, inputs, expected):
        assert volume_shines(volume("ShaderNodeVolumePrincipled", **inputs)) == expected

    def test_emission_in_a_mix_and_a_group(self):
        """Its strength is an attribute, and the factor of the mix varies."""
        material, group = make_material(), bpy.data.node_groups.new("fire", "ShaderNodeTree")
        group.interface.new_socket("Volume", in_out="OUTPUT", socket_type="NodeSocketShader")
        flame = group.nodes.new("ShaderNodeAttribute")
        flame.attribute_name = "flame"
        shader = add_node(group, "ShaderNodeEmission", Strength=flame.outputs["Factor"])
        group.links.new(shader.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
        tree = material.node_tree
        fire = tree.nodes.new("ShaderNodeGroup")
        fire.node_tree = group
        noise = tree.nodes.new("ShaderNodeTexNoise").outputs[0]
        both = combine(tree, add_node(tree, "ShaderNodeVolumeScatter"), fire, noise)
        assert volume_shines(connect(material, both, "Volume"))

    def test_nodes_that_do_not_reach_the_volume(self):
        material = volume("ShaderNodeVolumeScatter")
        assert not volume_shines(connect(material, material.node_tree.nodes[-1], "Volume"))
        glow = surface("ShaderNodeEmission", Strength=3.0)
        assert not volume_shines(glow)
        assert not has_volume(glow)
        assert not volume_shines(None)


def test_tint_turns_scattering_into_absorption():
    optics = tinted(Optics((2.0,), (1.0,), 0.9), np.array((1, 0.5, 0)))
    assert optics == Optics((2, 1, 0), (1, 2, 3), 0.9)


def test_white_tint_changes_nothing():
    assert tinted(Optics(2.0, 1.0, 0.9), np.ones(3)) == Optics(2, 1, 0.9)


class TestLeaf:
    def test_no_material(self):
        assert leaf_optics(None).optics.sigma_s == pytest.approx(0.8)

    def test_diffuse_is_opaque(self):
        leaf = leaf_optics(surface("ShaderNodeBsdfDiffuse", Color=COLOR))
        assert leaf.reflectance == pytest.approx(COLOR)
        assert leaf.transmittance == (0, 0, 0)
        assert leaf.optics.sigma_s == pytest.approx(COLOR)
        assert leaf.optics.sigma_a == pytest.approx((0.1, 0.4, 0.7))
        assert leaf.optics.g == pytest.approx((-4 / 9,) * 3)

    def test_diffuse_and_translucent_mixed(self):
        material = make_material()
        tree = material.node_tree
        mixed = combine(
            tree,
            add_node(tree, "ShaderNodeBsdfDiffuse", Color=(0.4, 0.4, 0.4)),
            add_node(tree, "ShaderNodeBsdfTranslucent", Color=(0.8, 0.8, 0.8)),
            factor=0.25,
        )
        leaf = leaf_optics(connect(material, mixed, "Surface"))
        assert leaf.reflectance == pytest.approx((0.3,) * 3)
        assert leaf.transmittance == pytest.approx((0.2,) * 3)
        assert leaf.optics.g == pytest.approx(-4 / 9 * 0.2)

    def test_principled(self):
        leaf = leaf_optics(
            surface("ShaderNodeBsdfPrincipled", Base_Color=COLOR, Transmission_Weight=0.4)
        )
        assert leaf.reflectance == pytest.approx(np.multiply(COLOR, 0.6))
        assert leaf.transmittance == pytest.approx(np.multiply(COLOR, 0.4))

    def test_black_leaf(self):
        optics = leaf_optics(surface("ShaderNodeBsdfDiffuse", Color=(0, 0, 0))).optics
        assert optics == Optics(0.0, 1.0, 0.0)

    def test_emission_does_not_count(self):
        material = make_material()
        tree = material.node_tree
        glowing = combine(
            tree,
            add_node(tree, "ShaderNodeBsdfDiffuse", Color=COLOR),
            combine(
                tree,
                add_node(tree, "ShaderNodeEmission"),
                add_node(tree, "ShaderNodeEmission"),
                factor=tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"],
            ),
        )
        assert leaf_optics(connect(material, glowing, "Surface")).reflectance == pytest.approx(
            COLOR
        )

    def test_image_and_its_alpha(self):
        """Half of the card is transparent; the colour of that half does not count."""
        material = make_material()
        tree = material.node_tree
        image = add_image(tree, [[(0.2, 0.6, 0.1, 1), (1, 0, 1, 0)]])
        card = combine(
            tree,
            add_node(tree, "ShaderNodeBsdfTransparent", Color=(1, 1, 1)),
            add_node(tree, "ShaderNodeBsdfDiffuse", Color=image.outputs["Color"]),
            factor=image.outputs["Alpha"],
        )
        leaf = leaf_optics(connect(material, card, "Surface"))
        assert leaf.coverage == pytest.approx(0.5)
        assert leaf.reflectance == pytest.approx((0.2, 0.6, 0.1))

    def test_alpha_of_principled(self):
        leaf = leaf_optics(surface("ShaderNodeBsdfPrincipled", Base_Color=COLOR, Alpha=0.25))
        assert leaf.coverage == pytest.approx(0.25)
        assert leaf.reflectance == pytest.approx(COLOR)

    def test_byte_images_are_made_linear(self):
        material = make_material()
        image = add_image(
            material.node_tree, [[(0.5, 0.25, 0, 1)]], colorspace="sRGB", is_float=False
        )
        diffuse = add_node(
            material.node_tree, "ShaderNodeBsdfDiffuse", Color=image.outputs["Color"]
        )
        leaf = leaf_optics(connect(material, diffuse, "Surface"))
        assert leaf.reflectance == pytest.approx((0.2140, 0.0508, 0), abs=3e-3)

    def test_missing_image_is_refused(self):
        material = make_material("card")
        image = material.node_tree.nodes.new("ShaderNodeTexImage")
        diffuse = add_node(
            material.node_tree, "ShaderNodeBsdfDiffuse", Color=image.outputs["Color"]
        )
        with pytest.raises(SceneError, match=r"'card'.*image"):
            leaf_optics(connect(material, diffuse, "Surface"))

    def test_more_light_out_than_in_is_refused(self):
        material = make_material("lamp")
        tree = material.node_tree
        nodes = [add_node(tree, "ShaderNodeBsdfDiffuse", Color=(0.8,) * 3) for _ in range(2)]
        with pytest.raises(SceneError, match="'lamp' reflects and transmits more light"):
            leaf_optics(connect(material, combine(tree, *nodes), "Surface"))

    def test_unknown_node_is_refused(self):
        with pytest.raises(SceneError, match=r"'matter'.*Glass"):
            leaf_optics(surface("ShaderNodeBsdfGlass"))


def test_grey_keeps_colours():
    optics = Optics((1, 2, 3), 0.5, 0.1)
    assert grey(optics) == optics
    assert grey(Optics((2, 2, 2), (1, 1, 1), 0.1)) == Optics(2.0, 1.0, 0.1)
    assert Leaf((0.5,) * 3, (0.3,) * 3).optics.sigma_a == pytest.approx(0.2)
