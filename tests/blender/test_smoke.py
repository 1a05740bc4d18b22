# SPDX-License-Identifier: GPL-3.0-or-later
"""Mantaflow's smoke onto the lattice, in a Blender that can simulate it.

The fixture `lb` is the package under test.
"""

import bpy
import numpy as np
import pytest
from scenes import center_of_mass, part, smoke

SOURCE = np.array((1.4, 2.1, 2.0))  # m, the middle of the ball that smokes
RADIUS = 0.3  # m
COLOR = (1.0, 0.5, 0.25)


def lattice(lb, ob, resolution=48):
    bounds = part(lb, "scene.smoke").world_bounds(ob, bpy.context.evaluated_depsgraph_get())
    return part(lb, "transport.medium").Domain.around(*bounds, resolution)


def read(lb, ob, domain):
    return part(lb, "scene.smoke").smoke_grids(ob, bpy.context.evaluated_depsgraph_get(), domain)


@pytest.mark.parametrize("settings", [{}, {"use_adaptive_domain": True}, {"use_noise": True}])
def test_smoke_is_where_its_source_is(lb, tmp_path, settings):
    ob = smoke(tmp_path, **settings)
    domain = lattice(lb, ob)
    density = read(lb, ob, domain)["density"]
    center = center_of_mass(density, domain.centers())
    assert density.max() > 0.5
    # Fresh smoke fills the ball, and has only begun to rise.
    assert np.abs(center - SOURCE)[:2].max() < 0.3 * domain.voxel_size
    assert 0 <= center[2] - SOURCE[2] < RADIUS


def test_mass_does_not_depend_on_the_lattice(lb, tmp_path):
    ob = smoke(tmp_path)
    domains = [lattice(lb, ob, n) for n in (20, 32, 80)]
    masses = [read(lb, ob, d)["density"].sum() * d.voxel_size**3 for d in domains]
    options = part(lb, "scene.smoke").find_domain_settings(
        ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    )
    cell = 2 * 2 * 3 / np.prod(options.domain_resolution)  # m^3, the box is 2 by 2 by 3 m
    simulated = np.empty(len(options.density_grid), np.float32)
    options.density_grid.foreach_get(simulated)
    assert masses == pytest.approx([simulated.sum() * cell] * 3, rel=1e-2)


def test_smoke_without_fire(lb, tmp_path):
    ob = smoke(tmp_path)
    grids = read(lb, ob, domain := lattice(lb, ob))
    assert not grids.get("flame", np.zeros(1)).any()
    dense = grids["density"] > 0.5
    assert grids["color"].shape == (3, *domain.shape)
    # The simulation lets a colour fade in, so that only its hue is certain.
    found = grids["color"][:, dense].mean(axis=1)
    assert found / found[0] == pytest.approx(COLOR, rel=0.01)


def test_fire(lb, tmp_path):
    ob = smoke(tmp_path, flow_type="BOTH")
    domain = lattice(lb, ob)
    grids = read(lb, ob, domain)
    assert set(grids) == {"density", "flame", "temperature", "color"}
    assert grids["flame"].max() > 0.5
    assert (
        np.abs(center_of_mass(grids["flame"], domain.centers()) - SOURCE)[:2].max()
        < domain.voxel_size
    )


def test_not_simulated_yet(lb, tmp_path):
    ob = smoke(tmp_path, cache_type="ALL")
    with pytest.raises(part(lb, "errors").SceneError, match="no smoke"):
        lattice(lb, ob)


def test_liquid_and_plain_objects_are_refused(lb, tmp_path):
    scene_error = part(lb, "errors").SceneError
    ob = smoke(tmp_path, frames=0)
    ob.modifiers[0].domain_settings.domain_type = "LIQUID"
    bpy.ops.mesh.primitive_cube_add()
    for refused in (ob, bpy.context.object):
        with pytest.raises(scene_error, match="not a gas domain"):
            part(lb, "scene.smoke").world_bounds(refused, bpy.context.evaluated_depsgraph_get())
