# SPDX-License-Identifier: GPL-3.0-or-later
"""Mantaflow's smoke from the simulation to the picture."""

import bpy
import numpy as np
import pytest
from mathutils import Vector
from scenes import baked, camera, center_of_mass, render, smoke, sun, volume_material, world

MIDDLE, WIDTH = (1, 2, 3), 4  # m, of the picture
VOXELS = 32


@pytest.fixture
def domain(lb, tmp_path):
    """A plume in the light of a sun from the right; a dim sky."""
    sun((-1, 0, -0.3))
    world(0.02)
    camera(MIDDLE, WIDTH)
    ob = smoke(tmp_path, frames=20)
    ob.data.materials.append(volume_material(density=8.0))
    bpy.context.scene.lb_lighting.resolution = VOXELS
    bpy.context.scene.lb_lighting.folder = str(tmp_path)
    return ob


def simulated_center(ob):
    """(3,) m, the smoke's centre of mass by the simulation's own cells."""
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    settings = evaluated.modifiers[0].domain_settings
    cells = np.empty(len(settings.density_grid), np.float32)
    settings.density_grid.foreach_get(cells)
    shape = np.array(settings.domain_resolution)
    density = cells.reshape(shape[::-1]).transpose()  # x runs fastest
    box = np.array(evaluated.bound_box)
    share = (np.moveaxis(np.indices(shape), 0, -1) + 0.5) / shape
    center = center_of_mass(density, box.min(axis=0) + share * np.ptp(box, axis=0))
    return np.array(evaluated.matrix_world @ Vector(center))


def bake(mode):
    bpy.context.scene.lb_lighting.mode = mode
    assert bpy.ops.lb_lighting.bake() == {"FINISHED"}


def emitted_center(picture):
    """(x, z) m, the middle of what is brighter than the sky."""
    glow = np.clip(picture[..., :3].mean(axis=2) - 0.05, 0, None)
    rows, columns = np.indices(glow.shape)
    middle = np.array([(columns * glow).sum(), (rows * glow).sum()]) / glow.sum()
    return (middle + 0.5) / len(glow) * WIDTH - WIDTH / 2 + (MIDDLE[0], MIDDLE[2])


@pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
def test_light_is_in_the_smoke_and_comes_from_the_sun(domain, mode):
    simulated = simulated_center(domain)  # before the bake hides it: hidden smoke has no cells
    bake(mode)
    density, light, positions = baked(domain.name)
    voxel = positions[1, 0, 0, 0] - positions[0, 0, 0, 0]
    center = center_of_mass(density, positions)
    assert np.abs(center - simulated).max() < 0.1 * voxel
    dense, sunny = density > 0.3, positions[..., 0] > center[0]
    assert light[dense].min() > 0
    assert light[dense & sunny].mean() > 1.2 * light[dense & ~sunny].mean()
    assert domain.hide_render == (mode == "REPLACE")


@pytest.mark.parametrize("engine", ["BLENDER_EEVEE", "CYCLES"])
def test_picture(cycles_shows_grids, domain, tmp_path, engine):
    if engine == "CYCLES" and not cycles_shows_grids:
        pytest.skip("this Blender's Cycles is built without NanoVDB: it shows no volume grids")
    pictures = {"without": render(tmp_path / f"smoke_without_{engine}.exr", engine)}
    for mode in ("REPLACE", "ADD"):
        bake(mode)
        pictures[mode] = render(tmp_path / f"smoke_{mode}_{engine}.exr", engine)

    density, _light, positions = baked(domain.name)
    x, _y, z = center_of_mass(density, positions)
    for mode in ("REPLACE", "ADD"):
        found = emitted_center(pictures[mode])
        # Light leans to the sun's side, not further than the plume is wide.
        assert 0 <= found[0] - x < 0.3
        assert abs(found[1] - z) < 0.2
    brightness = {name: picture[..., :3].mean() for name, picture in pictures.items()}
    assert brightness["ADD"] > 1.2 * brightness["without"]
