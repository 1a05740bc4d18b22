# SPDX-License-Identifier: GPL-3.0-or-later
"""Each kind of light on a small cloud: our picture is as bright as that of Cycles alone.

Cycles follows light through 64 scatterings; ours is what a bake of the scene shows, at Strength 1
and without any other factor. Both pictures are of the same camera, and linear.
"""

import bpy
import numpy as np
import openvdb
import pytest
from mathutils import Vector

from lb_lighting.output.shading import restore_scene
from tests import scenery
from tests.output.rendering import dark_scene, render, silent_stdout
from tests.scene.test_lights import add_environment, add_mapping

EDGE = 16  # voxels of the cloud, 2 m
LIMIT = 0.05  # by which a picture's mean may differ
# Light of an area counts as a lobe about its mean direction, with all that is scattered: measured
# 3 % too dark, and 8 % where slats make it a beam.
LIMIT_OF_AREAS = 0.1


def cloud():
    """(EDGE, EDGE, EDGE): smooth and lopsided, 0 at the border."""
    axis = (np.arange(EDGE) + 0.5) / EDGE * 2 - 1
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    fading = np.clip(1 - x**2, 0, 1) * np.clip(1 - y**2, 0, 1) * np.clip(1 - z**2, 0, 1)
    return fading**2 * (1 + 0.5 * np.sin(4 * x + 1) * np.cos(3 * y) + 0.3 * np.sin(5 * z))


def add_cloud(folder, **grids):
    """The cloud as a Volume, with further `grids` of its size."""
    path, written = folder / "cloud.vdb", []
    for name, values in {"density": cloud(), **grids}.items():
        grid = openvdb.FloatGrid()
        grid.copyFromArray(np.ascontiguousarray(values, np.float32))
        grid.name = name
        grid.transform = openvdb.createLinearTransform(2 / EDGE)
        grid.transform.postTranslate((1 / EDGE - 1,) * 3)
        written.append(grid)
    openvdb.write(str(path), written)
    data = bpy.data.volumes.new("cloud")
    data.filepath = str(path)
    data.materials.append(scenery.volume_material(5.0, (0.9, 0.9, 0.9), 0.4))
    return scenery.link("cloud", data)


def add_lamp(kind, place, **settings):
    """One that shines on the cloud."""
    lamp = bpy.data.lights.new(kind, kind)
    for name, value in settings.items():
        setattr(lamp, name, value)
    ob = scenery.link(kind, lamp)
    ob.location = place
    ob.rotation_euler = Vector(place).to_track_quat("Z", "Y").to_euler()


def sun():
    add_lamp("SUN", (1, -2, 3), energy=3.0, color=(1, 0.8, 0.6))


def point():
    add_lamp("POINT", (-1.5, -2, 2), energy=300.0, shadow_soft_size=0.05)


def spot():
    lit = {"spot_size": 0.7, "spot_blend": 0.5, "shadow_soft_size": 0.05}
    add_lamp("SPOT", (1.5, -2, 2), energy=300.0, color=(0.5, 1, 1), **lit)


def area():
    add_lamp("AREA", (-1, 0, 2.5), energy=100.0, shape="RECTANGLE", size=2.0, size_y=1.0)


def disk_with_slats():
    add_lamp("AREA", (2, -1.5, 1), energy=100.0, shape="DISK", size=1.5, spread=1.5)


def even_world():
    world(np.ones((4, 8, 3)) * 0.6)


def panorama():
    """Dark ground, a sky that brightens to one side, a sun in it; turned by a Mapping."""
    row, column = np.mgrid[:64, :128] / 64
    sky = (row > 0.5) * (1 + 0.5 * np.sin(np.pi * column)) + 0.05
    pixels = sky[..., None].repeat(3, axis=2)
    pixels[46:48, 20:22] = 800
    add_mapping(world(pixels), "POINT", (0, 0, 2.0))


def world(pixels):
    found = bpy.context.scene.world = bpy.data.worlds.new("world")
    found.cycles_visibility.camera = False
    alpha = np.ones((*pixels.shape[:2], 1))
    return add_environment(found, np.concatenate((pixels, alpha), axis=2))


LIGHTS = [sun, point, spot, area, disk_with_slats, even_world, panorama]


def flames():
    """(EDGE, EDGE, EDGE), 0 to 1: below the middle, and hottest inside."""
    axis = (np.arange(EDGE) + 0.5) / EDGE * 2 - 1
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.clip(1 - 3 * (x**2 + y**2 + (z + 0.2) ** 2), 0, 1)


def add_fire(folder, **inputs):
    """The cloud with a fire in it; inputs of its Principled Volume, by name."""
    ob = add_cloud(folder, flame=flames(), temperature=0.5 + 3 * flames())
    tree = ob.active_material.node_tree
    volume = tree.nodes["Principled Volume"]
    for name, value in inputs.items():
        name = name.replace("_", " ")
        if isinstance(value, str):
            attribute = tree.nodes.new("ShaderNodeAttribute")
            attribute.attribute_name = value
            tree.links.new(attribute.outputs["Factor"], volume.inputs[name])
        else:
            volume.inputs[name].default_value = value
    return ob


FIRES = {
    "flame": {"Emission_Strength": "flame", "Emission_Color": (1, 0.5, 0.2, 1)},
    "black body": {"Blackbody_Intensity": 1.0, "Blackbody_Tint": (1, 0.9, 0.8, 1)},
}


def pictures(folder, ob, mode="REPLACE", size=16, samples=64):
    """Cycles' picture of the scene, and ours."""
    scene = bpy.context.scene
    cycles = scene.cycles
    cycles.max_bounces = cycles.volume_bounces = 64
    cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0
    cycles.volume_biased = False
    with silent_stdout():
        expected = render(scene, folder / "cycles.exr", size, samples)
    outcome = scenery.bake_light(ob, resolution=EDGE + 4, folder=str(folder), mode=mode, device="")
    cycles.volume_bounces = 0  # as users have it
    with silent_stdout():
        found = render(scene, folder / "ours.exr", size, 16 if mode == "REPLACE" else samples)
    restore_scene(scene)
    return expected, found, outcome


def look():
    """A black world, and a camera from the front and above."""
    eye = Vector((0, -8, 4))
    return dark_scene(eye, eye.to_track_quat("Z", "Y").to_euler(), width=2.4)


@pytest.mark.parametrize("light", LIGHTS)
def test_level_is_that_of_cycles(light, tmp_path):
    look()
    light()
    expected, found, _ = pictures(tmp_path, add_cloud(tmp_path))
    ratio = found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1))
    limit = LIMIT_OF_AREAS if light in (area, disk_with_slats) else LIMIT
    assert ratio == pytest.approx(1, abs=limit)


@pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
@pytest.mark.parametrize("kind", FIRES)
def test_level_of_a_fire_is_that_of_cycles(kind, mode, tmp_path):
    """Its own light, and what the smoke around it scatters of that; by all bands together, for
    Cycles' polynomial of colours is below zero where black bodies are dark red."""
    look()
    expected, found, outcome = pictures(tmp_path, add_fire(tmp_path, **FIRES[kind]), mode)
    assert outcome.notes == []
    assert found.sum() / expected.sum() == pytest.approx(1, abs=LIMIT)
