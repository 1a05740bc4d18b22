# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' pictures of lit surfaces, compared with analytic values."""

import bpy
import numpy as np
import pytest

from lb_lighting.output.attribute import read_vertices, remove_ambient, write_ambient
from lb_lighting.output.shading_surfaces import wire_ambient
from lb_lighting.transport.field import Field, Report
from tests.output.rendering import dark_scene, middle, plane, render, surface
from tests.output.test_render import BOX, FROM_ABOVE, LIGHT


def light_plane(ob, radiance, flux=0.0, all_light=False):
    """Put ambient light of a mean radiance, (3,), and an upward flux, W/m^2, on a plane."""
    fluence = 4 * np.pi * np.broadcast_to(np.reshape(radiance, (-1, 1, 1, 1)), (3, *BOX.shape))
    upwards = np.zeros((3, 3, *BOX.shape))
    upwards[:, 2] = flux
    field = Field(BOX, fluence, 0 * fluence, upwards, Report("physical", "none"))
    vertices = read_vertices(ob, bpy.context.evaluated_depsgraph_get())
    write_ambient([ob], [vertices.light(field)], all_light)
    wire_ambient(ob.active_material, strength=2.0, all_light=all_light)


def ambient_plane(radiance, material):
    ob = plane(0, 2, material)
    light_plane(ob, radiance)
    return ob


COLOR = np.array([0.1, 0.6, 0.3])


OTHER = np.array([0.5, 0.2, 0.4])


def principled(alpha):
    return surface("ShaderNodeBsdfPrincipled", **{"Base Color": (*COLOR, 1), "Alpha": alpha})


def principled_with_linked_alpha(alpha):
    material = principled(1.0)
    nodes = material.node_tree.nodes
    value = nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = alpha
    material.node_tree.links.new(value.outputs[0], nodes["Principled BSDF"].inputs["Alpha"])
    return material


def mixed(material, other, factor):
    """`material` with the closure `other` of the colour OTHER mixed to it."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    target = nodes["Material Output"].inputs["Surface"]
    closure, mix = nodes.new(other), nodes.new("ShaderNodeMixShader")
    closure.inputs["Color"].default_value = (*OTHER, 1)
    mix.inputs[0].default_value = factor
    links.new(target.links[0].from_socket, mix.inputs[1])
    links.new(closure.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], target)
    return material


def closure(kind):
    return surface(kind, Color=(*COLOR, 1))


# A surface, and the share of diffuse light that it sends to the eye.
REFLECTANCES = {
    "diffuse": (lambda: closure("ShaderNodeBsdfDiffuse"), COLOR),
    "translucent": (lambda: closure("ShaderNodeBsdfTranslucent"), COLOR),
    "subsurface": (lambda: closure("ShaderNodeSubsurfaceScattering"), COLOR),
    "glossy": (lambda: closure("ShaderNodeBsdfGlossy"), 0 * COLOR),
    "principled": (lambda: principled(1.0), COLOR),
    "cut out by alpha": (lambda: principled(0.02), 0.02 * COLOR),
    "cut out by linked alpha": (lambda: principled_with_linked_alpha(0.02), 0.02 * COLOR),
    "alpha beyond 1": (lambda: principled_with_linked_alpha(5.0), COLOR),
    "cut out by a mix": (
        lambda: mixed(principled(1.0), "ShaderNodeBsdfTransparent", 0.98),
        0.02 * COLOR,
    ),
    "leaf": (
        lambda: mixed(closure("ShaderNodeBsdfDiffuse"), "ShaderNodeBsdfTranslucent", 0.3),
        0.7 * COLOR + 0.3 * OTHER,
    ),
}


@pytest.mark.parametrize("name", REFLECTANCES)
def test_ambient_is_reflectance_times_mean_radiance(tmp_path, name):
    scene = dark_scene(*FROM_ABOVE, width=1)
    make, reflectance = REFLECTANCES[name]
    ambient_plane(LIGHT, make())
    picture = render(scene, tmp_path / "a.exr", 16, 1)
    assert middle(picture) == pytest.approx(2 * reflectance * LIGHT, rel=0.01, abs=1e-6)


FLUX = 2.5  # W/m^2, upwards, so onto the plane from below


def leaf():
    """A diffuse and a translucent closure, added."""
    material = closure("ShaderNodeBsdfDiffuse")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    through, both = nodes.new("ShaderNodeBsdfTranslucent"), nodes.new("ShaderNodeAddShader")
    through.inputs["Color"].default_value = (*OTHER, 1)
    target = nodes["Material Output"].inputs["Surface"]
    links.new(target.links[0].from_socket, both.inputs[0])
    links.new(through.outputs[0], both.inputs[1])
    links.new(both.outputs[0], target)
    return material


@pytest.mark.parametrize(
    ("turn", "scale"),
    [(0, 1), (np.pi, 1), (0, -1)],
    ids=["front", "back", "mirrored"],
)
def test_each_side_shows_the_light_that_it_gets(tmp_path, turn, scale):
    """The eye is above: it sees light from above reflected, and light from below transmitted."""
    scene = dark_scene(*FROM_ABOVE, width=1)
    ob = plane(0, 2, leaf())
    ob.rotation_euler.x, ob.scale.z = turn, scale
    bpy.context.view_layer.update()
    light_plane(ob, LIGHT, FLUX)
    above, below = (np.pi * LIGHT + sign * FLUX / 2 for sign in (-1, 1))
    expected = (COLOR * above + OTHER * below) / np.pi
    picture = render(scene, tmp_path / "a.exr", 16, 1)
    assert middle(picture) == pytest.approx(2 * expected, rel=0.01)


SKY = np.array([0.4, 0.3, 0.8])


def under_sky(width):
    scene = dark_scene(*FROM_ABOVE, width=width)
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (*SKY, 1)
    links.new(background.outputs[0], output.inputs["Surface"])
    return scene


@pytest.mark.parametrize("name", ["diffuse", "translucent", "subsurface", "leaf"])
def test_what_shows_all_light_shows_none_of_the_skys_again(tmp_path, name):
    """An unlit object with the same material shows the sky's light as before."""
    scene, (make, reflectance) = under_sky(width=1), REFLECTANCES[name]
    ob = plane(0, 2, make())
    before = render(scene, tmp_path / "a.exr", 16, 256)
    light_plane(ob, LIGHT, all_light=True)
    lit = render(scene, tmp_path / "b.exr", 16, 4)
    assert middle(lit) == pytest.approx(2 * reflectance * LIGHT, rel=0.01)
    remove_ambient(ob)
    after = render(scene, tmp_path / "c.exr", 16, 256)
    assert middle(after) == pytest.approx(middle(before), rel=1e-3)
    assert middle(before).min() > 0.01


def test_the_gloss_of_what_shows_all_light_stays(tmp_path):
    scene = under_sky(width=1)
    light_plane(plane(0, 2, principled(1.0)), LIGHT, all_light=True)
    gloss = middle(render(scene, tmp_path / "a.exr", 16, 256)) - 2 * COLOR * LIGHT
    # The Fresnel reflectance at normal incidence is .04 at a refractive index of 1.5.
    assert gloss == pytest.approx(0.04 * SKY, rel=0.25)


def test_ambient_light_does_not_light_its_surroundings(tmp_path):
    scene = dark_scene((0, 0, 0.5), (0, 0, 0), width=1)
    lit = ambient_plane(LIGHT, surface("ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1)))
    plane(-1, 8, surface("ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1)))
    seen = middle(render(scene, tmp_path / "a.exr", 16, 4))
    assert seen == pytest.approx(2 * LIGHT, rel=0.01)
    lit.location.z = 1  # behind the camera, above the floor
    assert render(scene, tmp_path / "b.exr", 16, 4).max() == 0
