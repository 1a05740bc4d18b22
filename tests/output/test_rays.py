# SPDX-License-Identifier: GPL-3.0-or-later
"""Which rays find our light: those the eye sees directly, and none that would count it twice."""

import bpy
import numpy as np
import pytest

from lb_lighting.output.attribute import write_ambient
from lb_lighting.output.render_settings import prepare_scene
from lb_lighting.output.shading_surfaces import wire_ambient
from lb_lighting.output.shading_volumes import shade_volume
from lb_lighting.output.vdb import write_vdb
from lb_lighting.output.volume import show_volume
from lb_lighting.transport.medium import Domain
from tests.output.rendering import dark_scene, middle, plane, render, surface
from tests.scenery import source

COLOR = np.array([0.6, 0.3, 0.1])
LIGHT = np.array([2.0, 1.0, 0.5])
SKY = np.array([0.4, 0.3, 0.8])
SEEN = COLOR * LIGHT
WHITE = (1, 1, 1, 1)
FROM_ABOVE = (0, 0, 10), (0, 0, 0)
# The share that a sharp surface with a refractive index of 1.5 reflects at normal incidence.
FRESNEL = 0.04


def light(ob, all_light=False):
    """Make `ob` show LIGHT on both sides."""
    values = np.ones((2, len(ob.data.vertices), 4), np.float32)
    values[..., :3] = LIGHT
    write_ambient([ob], [values], all_light)
    wire_ambient(ob.active_material, all_light=all_light)
    return ob


def leaf(z=0.0, all_light=False):
    return light(plane(z, 40, surface("ShaderNodeBsdfDiffuse", Color=(*COLOR, 1))), all_light)


def principled(**inputs):
    material = bpy.data.materials.new("principled")
    shader = material.node_tree.nodes["Principled BSDF"]
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    return material


def water():
    names = {"Base Color": WHITE, "Roughness": 0.0, "Transmission Weight": 1.0, "IOR": 1.33}
    return principled(**names)


# What the eye looks through, and the share of light that it transmits straight.
PANES = {
    "glass": (lambda: surface("ShaderNodeBsdfGlass", Roughness=0.0, IOR=1.5, Color=WHITE), 0.96),
    "water": (water, 1 - (0.33 / 2.33) ** 2),
    "rough refraction": (
        lambda: surface("ShaderNodeBsdfRefraction", Roughness=0.3, IOR=1.0, Color=WHITE),
        1.0,
    ),
    "a hole": (lambda: surface("ShaderNodeBsdfTransparent", Color=WHITE), 1.0),
}


@pytest.mark.parametrize("name", PANES)
@pytest.mark.parametrize("bounces", [0, 4])
def test_leaves_are_seen_through_a_pane(tmp_path, name, bounces):
    """The reflected share is lost, because everything else is black."""
    scene = dark_scene(*FROM_ABOVE, width=1)
    scene.cycles.diffuse_bounces = bounces
    make, share = PANES[name]
    leaf(0)
    plane(1, 4, make())
    seen = middle(render(scene, tmp_path / "a.exr", 16, 256))
    assert seen == pytest.approx(share * SEEN, rel=0.01)


@pytest.mark.parametrize("roughness", [0.0, 0.4])
def test_leaves_are_seen_in_a_mirror(tmp_path, roughness):
    """A leaf above the camera, which looks down into a mirror."""
    scene = dark_scene((0, 0, 1), (0, 0, 0), width=1)
    leaf(2)
    color = {"Base Color": WHITE, "Metallic": 1.0, "Roughness": roughness}
    plane(0, 4, principled(**color))
    seen = middle(render(scene, tmp_path / "a.exr", 16, 256))
    # A rough mirror sends some light below its own face.
    assert seen == pytest.approx(SEEN, rel=0.02 if roughness == 0 else 0.08)
    assert np.all(seen <= 1.01 * SEEN)


@pytest.mark.parametrize("kind", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTranslucent"])
def test_leaves_light_nothing_that_scatters(tmp_path, kind):
    """A surface below the camera, with a leaf above and one below, stays black."""
    scene = dark_scene((0, 0, 1), (0, 0, 0), width=1)
    scene.cycles.diffuse_bounces = scene.cycles.transmission_bounces = 8
    leaf(2)
    leaf(-1)
    plane(0, 60, surface(kind, Color=WHITE))
    assert render(scene, tmp_path / "a.exr", 16, 64).max() == 0


def test_leaves_light_nothing_by_a_mirror(tmp_path):
    """The floor's own rays find the leaf only where they were reflected."""
    scene = dark_scene((0, 0, 1), (0, 0, 0), width=1)
    scene.cycles.diffuse_bounces = 8
    plane(0, 8, surface("ShaderNodeBsdfDiffuse", Color=WHITE))
    plane(3, 8, principled(**{"Base Color": WHITE, "Metallic": 1.0, "Roughness": 0.0}))
    small = light(plane(2, 2, surface("ShaderNodeBsdfDiffuse", Color=(*COLOR, 1))))
    small.location.x = 3
    assert render(scene, tmp_path / "a.exr", 16, 64).max() == 0


def test_leaves_light_no_fog(tmp_path):
    scene = dark_scene((0, 0, 1), (0, 0, 0), width=1)
    scene.cycles.volume_bounces = 4
    leaf(2)
    fog = bpy.data.materials.new("fog")
    nodes, links = fog.node_tree.nodes, fog.node_tree.links
    nodes.clear()
    scatter, output = nodes.new("ShaderNodeVolumeScatter"), nodes.new("ShaderNodeOutputMaterial")
    scatter.inputs["Density"].default_value = 2
    links.new(scatter.outputs[0], output.inputs["Volume"])
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.context.object.data.materials.append(fog)
    assert render(scene, tmp_path / "a.exr", 16, 64).max() == 0


@pytest.mark.parametrize("way", ["camera", "pane", "mirror"])
def test_all_light_stays_all_light_behind_glass_and_in_mirrors(tmp_path, way):
    """Under a sky that the leaf's own shader must not show again."""
    scene = dark_scene((0, 0, 1), (0, 0, 0), width=1)
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (*SKY, 1)
    links.new(background.outputs[0], output.inputs["Surface"])
    if way == "mirror":
        leaf(2, all_light=True)
        plane(0, 40, principled(**{"Base Color": WHITE, "Metallic": 1.0, "Roughness": 0.0}))
        expected = SEEN
    else:
        leaf(0, all_light=True)
        expected = SEEN
    if way == "pane":
        plane(0.5, 4, surface("ShaderNodeBsdfGlass", Roughness=0.0, IOR=1.5, Color=WHITE))
        expected = (1 - FRESNEL) * SEEN + FRESNEL * SKY
    seen = middle(render(scene, tmp_path / "a.exr", 16, 64))
    assert seen == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("way", ["pane", "scatter"])
def test_what_is_added_is_seen_through_glass_but_not_by_scattered_rays(tmp_path, way):
    scene = dark_scene(*FROM_ABOVE, width=1)
    prepare_scene(scene)
    domain = Domain((-1.5, -1.5, -1.5), 0.125, (24, 24, 24))
    density = np.zeros(domain.shape, np.float32)
    density[4:20, 4:20, 4:20] = 1
    everywhere = np.broadcast_to(np.reshape(LIGHT, (-1, 1, 1, 1)), (3, *domain.shape))
    write_vdb(tmp_path / "a.vdb", domain, density, everywhere, {})
    shade_volume(show_volume(bpy.context, [source("box")], tmp_path / "a.vdb"), "ADD", 0.8, 0.1)
    if way == "pane":
        plane(2, 4, surface("ShaderNodeBsdfGlass", Roughness=0.0, IOR=1.5, Color=WHITE))
        expected = (1 - FRESNEL) * 0.8 * LIGHT * 2  # the box is 2 m deep
    else:
        plane(2, 40, surface("ShaderNodeBsdfTranslucent", Color=WHITE))
        expected = 0 * LIGHT
    seen = middle(render(scene, tmp_path / "a.exr", 16, 64))
    assert seen == pytest.approx(expected, rel=0.02)


def cut_out_leaf():
    """A surface with holes by a mask."""
    material = principled(**{"Base Color": (*COLOR, 1), "Specular IOR Level": 0.0})
    nodes, links = material.node_tree.nodes, material.node_tree.links
    checker = nodes.new("ShaderNodeTexChecker")
    checker.inputs["Scale"].default_value = 40
    links.new(checker.outputs["Factor"], nodes["Principled BSDF"].inputs["Alpha"])
    return material


@pytest.mark.parametrize("make", [lambda: surface("ShaderNodeBsdfDiffuse"), cut_out_leaf])
def test_bounces_from_leaf_to_leaf_are_left_to_the_lattice(tmp_path, make):
    """A translucent leaf above another that a lamp shines on, over a sky that shines through it.

    Glass in a scene keeps the bounces of transmission on; the picture is as that without them."""
    scene = dark_scene(*FROM_ABOVE, width=1)
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (*SKY, 1)
    links.new(background.outputs[0], output.inputs["Surface"])
    light(plane(1, 20, surface("ShaderNodeBsdfTranslucent", Color=WHITE)))
    light(plane(0, 20, make()))
    lamp = bpy.data.lights.new("lamp", "POINT")
    lamp.energy = 200
    lamp = bpy.data.objects.new("lamp", lamp)
    lamp.location.z = 0.5
    scene.collection.objects.link(lamp)
    scene.cycles.diffuse_bounces = 0
    seen = []
    for bounces in (0, 8):
        scene.cycles.transmission_bounces = bounces
        seen.append(middle(render(scene, tmp_path / f"{bounces}.exr", 16, 256)))
    assert seen[0].min() > 1
    assert seen[1] == pytest.approx(seen[0], rel=0.01)


@pytest.mark.parametrize("linked", [False, True])
def test_metal_shows_what_it_mirrors_and_no_light_of_its_own(tmp_path, linked):
    """A plane that is 3/4 metal, and mirrors a leaf above the eye."""
    scene = dark_scene((0, 0, 1), (0, 0, 0), width=1)
    leaf(2)
    material = principled(**{"Base Color": (*COLOR, 1), "Metallic": 0.75, "Roughness": 0.0})
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Specular IOR Level"].default_value = 0
    if linked:
        value = material.node_tree.nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = 0.75
        material.node_tree.links.new(value.outputs[0], shader.inputs["Metallic"])
    light(plane(0, 4, material))
    seen = middle(render(scene, tmp_path / "a.exr", 16, 256))
    assert seen == pytest.approx(0.25 * SEEN + 0.75 * COLOR * SEEN, rel=0.02)
