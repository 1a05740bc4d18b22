# SPDX-License-Identifier: GPL-3.0-or-later
"""What Cycles makes of our output, against what it must be by arithmetic."""

import bpy
import numpy as np
import pytest

from lb_lighting.output.attribute import write_ambient
from lb_lighting.output.shading import prepare_scene, shade_volume, wire_ambient
from lb_lighting.output.volume import (
    DENSITY_GRID,
    baked_volumes,
    fresh_path,
    show_volume,
    write_vdb,
)
from lb_lighting.transport.medium import Domain
from tests.output.rendering import centroid, dark_scene, middle, render
from tests.scenery import source

FROM_ABOVE = (0, 0, 10), (0, 0, 0)
DEPTH = 2.0  # m, of the box
BOX = Domain((-1.5, -1.5, -1.5), 0.125, (24, 24, 24))
SIGMA_S = np.array([0.8, 0.5, 0.2])
SIGMA_A = np.array([0.1, 0.3, 0.6])
LIGHT = np.array([2.0, 1.0, 0.5])


def emission_absorption():
    """(3,) W/(m^2 sr) that leaves the box of uniform light straight through its faces."""
    sigma_t = SIGMA_S + SIGMA_A
    return LIGHT * SIGMA_S / sigma_t * (1 - np.exp(-sigma_t * DEPTH))


def box(path, light=LIGHT):
    """A homogeneous cube of `DEPTH` in uniform light, as a baked volume."""
    density = np.zeros(BOX.shape, np.float32)
    density[4:20, 4:20, 4:20] = 1
    light = np.broadcast_to(np.reshape(light, (-1, 1, 1, 1)), (3, *BOX.shape))
    write_vdb(path, BOX, density, light, {})
    return show_volume(bpy.context, [source("box")], path)


def plane(z, width, material):
    mesh = bpy.data.meshes.new("plane")
    h = width / 2
    mesh.from_pydata([(-h, -h, z), (h, -h, z), (h, h, z), (-h, h, z)], [], [(0, 1, 2, 3)])
    mesh.materials.append(material)
    ob = bpy.data.objects.new("plane", mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def surface(kind, **inputs):
    material = bpy.data.materials.new(kind)
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def test_replace_is_the_emission_absorption_integral(tmp_path):
    scene = dark_scene(*FROM_ABOVE, width=2)
    prepare_scene(scene)
    shade_volume(box(tmp_path / "a.vdb"), "REPLACE", SIGMA_S, SIGMA_A, strength=0.5)
    picture = render(scene, tmp_path / "a.exr", 48, 4)
    assert middle(picture) == pytest.approx(0.5 * emission_absorption(), rel=0.01)


def test_replace_is_free_of_noise(tmp_path):
    scene = dark_scene(*FROM_ABOVE, width=1)
    prepare_scene(scene)
    shade_volume(box(tmp_path / "a.vdb"), "REPLACE", SIGMA_S, SIGMA_A)
    picture = render(scene, tmp_path / "a.exr", 32, 1)
    assert np.all(picture.std(axis=(0, 1)) < 0.02 * picture.mean(axis=(0, 1)))


@pytest.mark.parametrize("biased", [True, False])
def test_add_is_the_emission_once(tmp_path, biased):
    scene = dark_scene(*FROM_ABOVE, width=2)
    scene.cycles.volume_biased = biased
    shade_volume(box(tmp_path / "a.vdb"), "ADD", SIGMA_S, SIGMA_A)
    picture = render(scene, tmp_path / "a.exr", 24, 64)
    assert middle(picture) == pytest.approx(SIGMA_S * LIGHT * DEPTH, rel=0.01)


def scattering_cube():
    """A medium of the user that fills the box, with Cycles' own scattering."""
    cube = bpy.data.meshes.new("cube")
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    cube.from_pydata(corners, [], faces)
    material = bpy.data.materials.new("cube")
    nodes = material.node_tree.nodes
    nodes.clear()
    medium, output = (
        nodes.new("ShaderNodeVolumeCoefficients"),
        nodes.new("ShaderNodeOutputMaterial"),
    )
    medium.inputs["Scatter Coefficients"].default_value = SIGMA_S
    medium.inputs["Absorption Coefficients"].default_value = SIGMA_A
    material.node_tree.links.new(medium.outputs[0], output.inputs["Volume"])
    cube.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("cube", cube))


def test_add_over_the_scattering_medium_counts_its_light_once(tmp_path):
    """Cycles would scatter the emission again, but for the gate by camera rays."""
    scene = dark_scene(*FROM_ABOVE, width=1)
    scattering_cube()
    shade_volume(box(tmp_path / "a.vdb"), "ADD", SIGMA_S, SIGMA_A)
    picture = render(scene, tmp_path / "a.exr", 32, 64)
    assert picture.mean(axis=(0, 1)) == pytest.approx(emission_absorption(), rel=0.02)


@pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
def test_mirrors_see_what_replaces_but_not_what_is_added(tmp_path, mode):
    scene = dark_scene((5, 0, 10), (0, 0, 0), width=1)
    mirror = plane(0, 4, surface("ShaderNodeBsdfGlossy", Roughness=0.0, Color=(1, 1, 1, 1)))
    mirror.location.x, mirror.rotation_euler.y = 5, -np.pi / 4
    prepare_scene(scene)
    shade_volume(box(tmp_path / "a.vdb"), mode, SIGMA_S, SIGMA_A)
    expected = emission_absorption() if mode == "REPLACE" else (0, 0, 0)
    picture = render(scene, tmp_path / "a.exr", 16, 4)
    assert middle(picture) == pytest.approx(expected, rel=0.01)


def test_a_second_bake_is_shown(tmp_path):
    scene = dark_scene(*FROM_ABOVE, width=1)
    prepare_scene(scene)
    shade_volume(box(fresh_path(tmp_path, "box")), "ADD", SIGMA_S, SIGMA_A)
    before = render(scene, tmp_path / "a.exr", 16, 1).mean()
    ob = box(fresh_path(tmp_path, "box"), light=3 * LIGHT)
    assert baked_volumes(scene) == [ob]
    after = render(scene, tmp_path / "a.exr", 16, 1).mean()
    assert after == pytest.approx(3 * before, rel=0.01)


BLOB_CENTER = np.array([0.35, -0.2, 0.15])


def blob(points):
    """A smooth lopsided density at `points` (..., 3) m."""
    turn = np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]])
    local = (points - BLOB_CENTER) @ turn / (0.35, 0.2, 0.25)
    return np.exp(-0.5 * np.sum(local**2, axis=-1)) * (1 + 0.5 * np.tanh(local[..., 0]))


def source_volume(path):
    """A user's Volume object of the blob: its own fine grid, scale and turn, glowing by density."""
    import openvdb

    grid = openvdb.FloatGrid()
    volume = bpy.data.volumes.new("source")
    ob = bpy.data.objects.new("source", volume)
    ob.location, ob.rotation_euler, ob.scale = BLOB_CENTER, (0.4, 0.2, 0.9), (2, 2, 2)
    bpy.context.scene.collection.objects.link(ob)
    bpy.context.view_layer.update()
    indices = np.moveaxis(np.indices((100, 100, 100)), 0, -1) - 50
    to_world = np.array(ob.matrix_world)
    grid.transform = openvdb.createLinearTransform(0.015)
    points = 0.015 * indices @ to_world[:3, :3].T + to_world[:3, 3]
    values = np.ascontiguousarray(blob(points), np.float32)
    grid.copyFromArray(values, ijk=(-50, -50, -50))
    grid.name = DENSITY_GRID
    openvdb.write(str(path), [grid])
    volume.filepath = str(path)
    volume.render.space = "WORLD"  # or else Cycles divides the density by the object's scale

    material = surface("ShaderNodeVolumeCoefficients")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    medium, density = nodes["Volume Coefficients"], nodes.new("ShaderNodeAttribute")
    density.attribute_name = DENSITY_GRID
    for name in ("Absorption Coefficients", "Scatter Coefficients"):
        medium.inputs[name].default_value = (0, 0, 0)
    links.new(density.outputs["Factor"], medium.inputs["Emission Coefficients"])
    links.new(medium.outputs[0], nodes["Material Output"].inputs["Volume"])
    links.remove(nodes["Material Output"].inputs["Surface"].links[0])
    volume.materials.append(material)
    return ob


def test_baked_volume_lies_on_its_source(tmp_path):
    scene = dark_scene((6, -6, 6), (np.arctan(np.sqrt(2)), 0, np.pi / 4), width=4)
    prepare_scene(scene)
    original = source_volume(tmp_path / "source.vdb")
    seen = render(scene, tmp_path / "source.exr", 64, 16)
    bpy.data.objects.remove(original)

    domain = Domain.around((-1.1, -1.3, -1), (1.7, 1.1, 1.2), 32)
    density = blob(domain.centers())
    write_vdb(tmp_path / "baked.vdb", domain, density, np.ones((1, *domain.shape)), {})
    baked = show_volume(bpy.context, [source("source")], tmp_path / "baked.vdb")
    shade_volume(baked, "ADD", 1.0, 0.0)
    found = render(scene, tmp_path / "baked.exr", 64, 16)

    voxel = domain.voxel_size / (4 / 64)  # in pixels
    assert centroid(found) == pytest.approx(centroid(seen), abs=0.1 * voxel)
    assert found.mean() == pytest.approx(seen.mean(), rel=0.01)


def ambient_plane(radiance, material):
    ob = plane(0, 2, material)
    field = np.broadcast_to(np.reshape(radiance, (-1, 1, 1, 1)), (3, *BOX.shape))
    write_ambient([ob], bpy.context.evaluated_depsgraph_get(), BOX, field)
    wire_ambient(material, strength=2.0)
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


def test_ambient_light_does_not_light_its_surroundings(tmp_path):
    scene = dark_scene((0, 0, 0.5), (0, 0, 0), width=1)
    lit = ambient_plane(LIGHT, surface("ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1)))
    plane(-1, 8, surface("ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1)))
    seen = middle(render(scene, tmp_path / "a.exr", 16, 4))
    assert seen == pytest.approx(2 * LIGHT, rel=0.01)
    lit.location.z = 1  # behind the camera, above the floor
    assert render(scene, tmp_path / "b.exr", 16, 4).max() == 0
