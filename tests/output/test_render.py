# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' pictures of baked volumes, compared with analytic values."""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Vector

from lb_lighting.output.render_settings import prepare_scene
from lb_lighting.output.shading_volumes import shade_volume
from lb_lighting.output.vdb import (
    DENSITY_GRID,
    direct_grid,
    flux_grid,
    forward_grid,
    moment_grid,
    write_vdb,
)
from lb_lighting.output.volume import baked_volumes, fresh_path, show_volume
from lb_lighting.transport.lights.distant import Sun
from lb_lighting.transport.lights.lamps import PointLight, SpotLight
from lb_lighting.transport.medium import Domain
from lb_lighting.transport.ordinates.quadrature import polynomials
from tests.output.rendering import centroid, dark_scene, middle, plane, render, surface
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
    """Cycles would scatter the emission again if it were not limited to camera rays."""
    scene = dark_scene(*FROM_ABOVE, width=1)
    scattering_cube()
    shade_volume(box(tmp_path / "a.vdb"), "ADD", SIGMA_S, SIGMA_A)
    picture = render(scene, tmp_path / "a.exr", 32, 64)
    assert picture.mean(axis=(0, 1)) == pytest.approx(emission_absorption(), rel=0.02)


@pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
def test_mirrors_see_what_replaces_and_what_is_added(tmp_path, mode):
    scene = dark_scene((5, 0, 10), (0, 0, 0), width=1)
    mirror = plane(0, 4, surface("ShaderNodeBsdfGlossy", Roughness=0.0, Color=(1, 1, 1, 1)))
    mirror.location.x, mirror.rotation_euler.y = 5, -np.pi / 4
    prepare_scene(scene)
    shade_volume(box(tmp_path / "a.vdb"), mode, SIGMA_S, SIGMA_A)
    expected = emission_absorption() if mode == "REPLACE" else SIGMA_S * LIGHT * DEPTH
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


THIN = 1e-3  # 1/m, too thin to change the light


BEAMS = {
    "sun": [Sun((0.3, 0.2, -0.9), (1.0, 2.0, 0.5))],
    "point": [PointLight((1.0, 0.5, 2.5), (40.0, 20.0, 30.0))],
    "spot": [SpotLight((1.0, 0.5, 2.5), (-0.4, -0.3, -1.0), (40.0, 20.0, 30.0), 1.1, 0.8)],
    "two suns and a point": [
        Sun((0.0, 0.0, -1.0), (1.0, 0.2, 0.1)),
        Sun((0.0, 3.0, 1.0), (0.1, 0.2, 1.0)),
        PointLight((-2.0, 0.0, 0.0), (5.0, 10.0, 1.0)),
    ],
}


def uncollided(beam):
    """(3, nx, ny, nz): the grid of an unattenuated light, W/(m^2 sr) for a sun, else W/sr."""
    if isinstance(beam, Sun):
        light = np.ones(BOX.shape)
    else:
        way = BOX.centers() - beam.position
        light = np.full(BOX.shape, 1 / (4 * np.pi))
    if isinstance(beam, SpotLight):
        cosine = (
            way @ beam.direction / np.linalg.norm(beam.direction) / np.linalg.norm(way, axis=-1)
        )
        edge = np.cos(beam.angle / 2)
        share = np.clip((cosine - edge) / (beam.blend * (1 - edge)), 0, 1)
        light *= 3 * share**2 - 2 * share**3
    return np.multiply.outer(np.broadcast_to(beam.spectrum, 3), light) / (4 * np.pi)


def lamp(beam):
    """A Blender lamp with the same light."""
    kind = {Sun: "SUN", PointLight: "POINT", SpotLight: "SPOT"}[type(beam)]
    data = bpy.data.lights.new("lamp", kind)
    data.color = np.broadcast_to(beam.spectrum, 3) / 100
    data.energy = 100
    ob = bpy.data.objects.new("lamp", data)
    if kind == "SUN":
        data.angle = 0
    else:
        data.shadow_soft_size = 0
        ob.location = beam.position
    if kind != "POINT":
        ob.rotation_euler = Vector(beam.direction).to_track_quat("-Z", "Y").to_euler()
    if kind == "SPOT":
        data.spot_size, data.spot_blend = beam.angle, beam.blend
    bpy.context.scene.collection.objects.link(ob)


def thin_box(path, beams=(), light=0.0, down=0.0, others=None):
    """The box in the light of the beams, and evenly in `light` with that net flux downwards, and
    with others {name of a grid: (3,)}."""
    density = np.zeros(BOX.shape, np.float32)
    density[4:20, 4:20, 4:20] = 1
    grids = {direct_grid(n): uncollided(beam) for n, beam in enumerate(beams, 1)}
    for name, values in {flux_grid("Z"): np.negative(down), **(others or {})}.items():
        grids[name] = even(values)
    write_vdb(path, BOX, density, even(light), {}, grids)
    return show_volume(bpy.context, [source("box")], path)


def even(values):
    """(3, nx, ny, nz) of a value, or of (3,)."""
    return np.broadcast_to(np.reshape(values, (-1, 1, 1, 1)), (3, *BOX.shape))


def scattering_material(g):
    """The thin medium in Cycles, with the density of the grid."""
    material = bpy.data.materials.new("thin")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    density, extinction = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeMath")
    density.attribute_name = DENSITY_GRID
    extinction.operation = "MULTIPLY"
    extinction.inputs[1].default_value = THIN
    links.new(density.outputs["Factor"], extinction.inputs[0])
    medium, output = nodes.new("ShaderNodeVolumeScatter"), nodes.new("ShaderNodeOutputMaterial")
    medium.inputs["Color"].default_value = (1, 1, 1, 1)
    medium.inputs["Anisotropy"].default_value = g
    links.new(extinction.outputs[0], medium.inputs["Density"])
    links.new(medium.outputs[0], output.inputs["Volume"])
    return material


def look_from(angle):
    """A dark scene seen from 10 m away, `angle` from the zenith in the plane of x and z."""
    eye = Euler((0, angle, 0)).to_matrix() @ Vector((0, 0, 10))
    return dark_scene(eye, (0, angle, 0), width=1.2)


@pytest.mark.parametrize(
    ("beams", "angle"),
    [("sun", 0.3), ("sun", 2.6), ("point", 1.0), ("spot", 1.0), ("two suns and a point", 2.0)],
)
def test_replace_scatters_beams_as_cycles_does(tmp_path, beams, angle):
    """Each at its angle to the eye; Cycles' noise is below 0.5 % of the mean."""
    scene, g, beams = look_from(angle), 0.6, BEAMS[beams]
    ob = thin_box(tmp_path / "a.vdb", beams)
    shade_volume(ob, "REPLACE", THIN, 0.0, g, beams)
    scene.cycles.volume_biased = True
    measured = render(scene, tmp_path / "a.exr", 16, 4).mean(axis=(0, 1))

    ob.data.materials[0] = scattering_material(g)
    for beam in beams:
        lamp(beam)
    scene.cycles.volume_biased = False  # marching is too noisy for so thin a medium
    expected = render(scene, tmp_path / "b.exr", 16, 256).mean(axis=(0, 1))
    assert measured == pytest.approx(expected, rel=0.02)


def henyey_greenstein(cosine, g):
    """1/sr."""
    return (1 - g**2) / (1 + g**2 - 2 * g * cosine) ** 1.5 / (4 * np.pi)


@pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
def test_scattered_light_goes_on_the_way_that_its_flux_tells(tmp_path, mode):
    """That of one direction, whose flux is 1, as a beam; else the mean cosines are multiplied."""
    angle, g = 0.3, np.array([0.6, 0.0, -0.4])
    scene = look_from(angle)
    prepare_scene(scene)
    for flux in (1.0, np.array([0.7, 0.2, 0.5]), 0.0):
        ob = thin_box(fresh_path(tmp_path, "box"), light=2.0, down=flux)
        shade_volume(ob, mode, THIN, 0.0, g)
        phase = henyey_greenstein(-np.cos(angle), flux * g)
        expected = 4 * np.pi * 2.0 * phase * THIN * DEPTH / np.cos(angle)
        picture = render(scene, tmp_path / "a.exr", 16, 4)
        assert middle(picture) == pytest.approx(expected, rel=0.01)


def test_moments_are_shown_by_their_polynomials_of_the_way_to_the_eye(tmp_path):
    """Over the lobes of beams; in a band where all is less than nothing, nothing."""
    angle, beam = 0.3, BEAMS["sun"]
    scene = look_from(angle)
    prepare_scene(scene)
    shown = np.outer(np.linspace(0.1, 0.9, 9), (1.0, 0.5, -1.0))
    others = {moment_grid(n): shown[n] for n in range(1, 9)} | {forward_grid(1): np.full(3, 0.2)}
    ob = thin_box(tmp_path / "a.vdb", light=shown[0], others=others)
    shade_volume(ob, "REPLACE", THIN, 0.0, 0.85, beam, lobes=0.5)
    eye = np.array((np.sin(angle), 0, np.cos(angle)))
    way = np.divide(beam[0].direction, np.linalg.norm(beam[0].direction))
    lobe = 0.2 * 4 * np.pi * henyey_greenstein(way @ eye, 0.5)
    expected = np.maximum(polynomials(eye) @ shown + lobe, 0) * THIN * DEPTH / np.cos(angle)
    assert expected[0] > expected[1] > expected[2] == 0
    picture = middle(render(scene, tmp_path / "a.exr", 16, 4))
    assert picture == pytest.approx(expected, rel=0.01, abs=1e-6)


def test_many_beams_and_a_g_for_each_band(tmp_path):
    angle, g = 0.3, np.array([0.6, 0.0, -0.4])
    scene = look_from(angle)
    prepare_scene(scene)
    turns = np.arange(12) * np.pi / 6
    beams = [Sun((np.cos(turn), np.sin(turn), -1.0), 2.0) for turn in turns]
    shade_volume(thin_box(tmp_path / "a.vdb", beams), "REPLACE", THIN, 0.0, g, beams)
    eye = np.array((np.sin(angle), 0, np.cos(angle)))
    cosines = np.array([beam.direction for beam in beams]) @ eye / np.sqrt(2)
    phase = sum(henyey_greenstein(cosine, g) for cosine in cosines)
    expected = 2 * phase * THIN * DEPTH / np.cos(angle)
    assert middle(render(scene, tmp_path / "a.exr", 16, 4)) == pytest.approx(expected, rel=0.01)


def test_a_second_bake_has_its_own_beams(tmp_path):
    ob = thin_box(tmp_path / "a.vdb")
    shade_volume(ob, "REPLACE", THIN, 0.0, 0.6, BEAMS["two suns and a point"])
    shade_volume(ob, "REPLACE", THIN, 0.0, 0.6, BEAMS["sun"])
    nodes = ob.active_material.node_tree.nodes
    assert len(nodes) == 6  # the light, its output, one beam, uncollided and forward, with grids
    shade_volume(ob, "REPLACE", THIN, 0.0, 0.0, BEAMS["sun"])
    assert len(nodes) == 4  # no forward light
    shade_volume(ob, "ADD", THIN, 0.0, 0.6)
    assert len(nodes) == 2


BLOB_CENTER = np.array([0.35, -0.2, 0.15])


def blob(points):
    """A smooth lopsided density at `points` (..., 3) m."""
    turn = np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]])
    local = (points - BLOB_CENTER) @ turn / (0.35, 0.2, 0.25)
    return np.exp(-0.5 * np.sum(local**2, axis=-1)) * (1 + 0.5 * np.tanh(local[..., 0]))


def source_volume(path):
    """A user's Volume object of the blob: a fine grid, scaled, rotated, glowing by density."""
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
    volume.render.space = "WORLD"  # otherwise Cycles divides the density by the object's scale

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
    measured = render(scene, tmp_path / "baked.exr", 64, 16)

    voxel = domain.voxel_size / (4 / 64)  # in pixels
    assert centroid(measured) == pytest.approx(centroid(seen), abs=0.1 * voxel)
    assert measured.mean() == pytest.approx(seen.mean(), rel=0.01)
