# SPDX-License-Identifier: GPL-3.0-or-later
"""Mantaflow's smoke onto the lattice, in a Blender that can simulate it.

The fixture `lb` is the package under test.
"""

import bpy
import numpy as np
import pytest
from scenes import center_of_mass, part, smoke, volume_material

SOURCE = np.array((1.4, 2.1, 2.0))  # m, the middle of the ball that smokes
RADIUS = 0.3  # m
COLOR = (1.0, 0.5, 0.25)


def lattice(lb, ob, resolution=48):
    bounds = part(lb, "scene.smoke").world_bounds(ob, bpy.context.evaluated_depsgraph_get())
    return part(lb, "transport.medium").Domain.around(*bounds, resolution)


def read(lb, ob, domain, name="density"):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return part(lb, "scene.smoke").read_grid(ob, depsgraph, name).on(domain)


def share(lb, ob, domain, medium):
    """(the one share of the smoke, notes)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    reader = part(lb, "scene.reader").Reader(depsgraph, medium, 30.0, "")
    (source,) = part(lb, "scene.opening").open_sources([ob], reader)
    (found,) = source.shares(domain)
    return found, reader.notes


@pytest.mark.parametrize("settings", [{}, {"use_adaptive_domain": True}, {"use_noise": True}])
def test_smoke_is_where_its_source_is(lb, tmp_path, settings):
    ob = smoke(tmp_path, **settings)
    domain = lattice(lb, ob)
    density = read(lb, ob, domain)
    center = center_of_mass(density, domain.centers())
    assert density.max() > 0.5
    # Fresh smoke fills the ball, and has only begun to rise.
    assert np.abs(center - SOURCE)[:2].max() < 0.3 * domain.voxel_size
    assert 0 <= center[2] - SOURCE[2] < RADIUS


def test_mass_does_not_depend_on_the_lattice(lb, tmp_path):
    ob = smoke(tmp_path)
    domains = [lattice(lb, ob, n) for n in (20, 32, 80)]
    masses = [read(lb, ob, d).sum() * d.voxel_size**3 for d in domains]
    options = part(lb, "scene.smoke").find_domain_settings(
        ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    )
    cell = 2 * 2 * 3 / np.prod(options.domain_resolution)  # m^3, the box is 2 by 2 by 3 m
    simulated = np.empty(len(options.density_grid), np.float32)
    options.density_grid.foreach_get(simulated)
    assert masses == pytest.approx([simulated.sum() * cell] * 3, rel=1e-2)


def test_smoke_without_fire(lb, tmp_path):
    ob = smoke(tmp_path)
    found, notes = share(lb, ob, lattice(lb, ob), "cloud")
    assert notes == []
    sigma_s, sigma_a = np.array(found.optics.sigma_s), np.array(found.optics.sigma_a)
    assert sigma_s / sigma_s[0] == pytest.approx(COLOR, rel=0.02)
    assert sigma_s + sigma_a == pytest.approx([found.sigma_t] * 3)
    assert sigma_s[0] / found.sigma_t == pytest.approx(0.99)


def test_white_smoke_is_one_band(lb, tmp_path):
    ob = smoke(tmp_path, color=(1, 1, 1))
    optics = share(lb, ob, lattice(lb, ob), "cloud")[0].optics
    assert np.size(optics.sigma_s) == 1
    assert optics.sigma_s / (optics.sigma_s + optics.sigma_a) == pytest.approx(0.99)


def test_material_wins_over_the_colour_of_the_simulation(lb, tmp_path):
    ob = smoke(tmp_path)
    ob.data.materials.append(volume_material(density=2.0))
    optics = share(lb, ob, lattice(lb, ob), "MATERIAL")[0].optics
    assert (optics.sigma_s, optics.sigma_a) == pytest.approx((1.9, 0.1))


def test_fire(lb, tmp_path):
    ob = smoke(tmp_path, flow_type="BOTH")
    domain = lattice(lb, ob)
    flame = read(lb, ob, domain, "flame")
    assert flame.max() > 0.5
    center = center_of_mass(flame, domain.centers())
    assert np.abs(center - SOURCE)[:2].max() < domain.voxel_size
    notes = share(lb, ob, domain, "cloud")[1]
    note_on_fire = "The fire of 'Cube' emits no light; give its material a Blackbody Intensity."
    assert notes == [note_on_fire]
    with pytest.raises(
        part(lb, "errors").SceneError,
        match=r"no grid 'smoke'; choose one of: density, flame, temperature\.$",
    ):
        read(lb, ob, domain, "smoke")


def test_fire_shines_by_its_temperature(lb, tmp_path):
    """As bright as Stefan's and Boltzmann's law, in Cycles' scale, says of each cell."""
    ob = smoke(tmp_path, flow_type="BOTH")
    ob.data.materials.append(volume_material(density=2.0))
    inputs = ob.data.materials[0].node_tree.nodes["Principled Volume"].inputs
    inputs["Blackbody Intensity"].default_value = 1
    depsgraph = bpy.context.evaluated_depsgraph_get()
    reader = part(lb, "scene.reader").Reader(depsgraph, "MATERIAL", 30.0, "")
    (source,) = part(lb, "scene.opening").open_sources([ob], reader)
    assert reader.notes == []
    domain = lattice(lb, ob)
    emission = source.emission(domain)
    kelvin = 1000.0 * source.fire["temperature"].values.astype(float)
    assert kelvin.max() > 1500
    luminance = np.tensordot((0.2126, 0.7152, 0.0722), emission, axes=1)
    cells = source.fire["temperature"].index_to_world
    expected = (5.670373e-14 / np.pi * kelvin**4).sum() * abs(np.linalg.det(cells[:3, :3]))
    assert luminance.sum() * domain.voxel_size**3 == pytest.approx(expected, rel=0.03)


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
