# SPDX-License-Identifier: GPL-3.0-or-later
"""Ambient light on meshes: sampled where the vertices are in world space."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from lb_lighting.errors import OutputError
from lb_lighting.output.ambient import irradiance, sample
from lb_lighting.output.attribute import (
    AMBIENT_ATTRIBUTE,
    BACK_ATTRIBUTE,
    read_vertices,
    remove_ambient,
    write_ambient,
)
from lb_lighting.transport.field import Field, Report
from lb_lighting.transport.medium import Domain

DOMAIN = Domain((-4.0, -4.0, -4.0), 0.5, (16, 16, 16))


def linear_field():
    """x + 2 y + 3 z + 30, its double and its triple, which trilinear interpolation reproduces."""
    field = DOMAIN.centers() @ (1, 2, 3) + 30
    return np.stack([field, 2 * field, 3 * field])


def expected(points):
    return np.outer(np.asarray(points) @ (1, 2, 3) + 30, (1, 2, 3))


def add(mesh, name="ob"):
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def triangle():
    mesh = bpy.data.meshes.new("triangle")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0.5)], [], [(0, 1, 2)])
    return mesh


def written(mesh, name=AMBIENT_ATTRIBUTE):
    attribute = mesh.attributes[name]
    assert (attribute.domain, attribute.data_type) == ("POINT", "FLOAT_COLOR")
    colors = np.empty(4 * len(mesh.vertices), np.float32)
    attribute.data.foreach_get("color", colors)
    colors = colors.reshape(-1, 4)
    assert np.all(colors[:, 3] == 1)
    return colors[:, :3]


def world_vertices(ob):
    return [ob.matrix_world @ vertex.co for vertex in ob.data.vertices]


def field_of(fluence, flux=None):
    """A `Field` of scattered light: fluence (bands, nx, ny, nz), flux the same for all voxels."""
    flux = np.zeros((len(fluence), 3)) if flux is None else np.asarray(flux)
    everywhere = np.broadcast_to(flux[..., None, None, None], (*flux.shape, *DOMAIN.shape))
    return Field(DOMAIN, fluence, 0 * fluence, everywhere, Report("physical", "none"))


def write(objects, radiance=None, **options):
    """Light of that radiance from all sides reaches both sides."""
    radiance = linear_field() if radiance is None else radiance
    write_field(objects, field_of(4 * np.pi * radiance), **options)


def write_field(objects, field, **options):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    sides = [read_vertices(ob, depsgraph, **options).light(field) for ob in objects]
    write_ambient(objects, sides)


def test_sample_is_exact_on_linear_fields():
    points = np.random.default_rng(1).uniform(-3.7, 3.7, (50, 3))
    assert sample(DOMAIN, linear_field(), points) == pytest.approx(expected(points))


def test_sample_continues_the_border_outwards():
    field = linear_field()
    assert sample(DOMAIN, field, [(9, 9, 9)]) == pytest.approx(field[:, -1:, -1, -1].T)
    assert sample(DOMAIN, field, [(-9, 0.25, 0.25)]) == pytest.approx(field[:, :1, 8, 8].T)


def test_vertices_are_lit_where_they_are_in_the_world():
    ob = add(triangle())
    ob.location, ob.rotation_euler, ob.scale = (1, -1, 0.5), (0.3, 0.5, 0.7), (1, 2, 0.5)
    write([ob])
    assert written(ob.data) == pytest.approx(expected(world_vertices(ob)), abs=1e-5)


def test_gray_light_is_gray():
    ob = add(triangle())
    write([ob], linear_field()[:1])
    assert np.ptp(written(ob.data), axis=1) == pytest.approx(0)


def test_light_from_all_sides_is_the_same_on_both():
    ob = add(triangle())
    write([ob])
    assert written(ob.data, BACK_ATTRIBUTE) == pytest.approx(written(ob.data))


NORMALS = np.array([(0, 0, 1.0), (0, 0, -1), (1, 0, 0), (0, 0.6, -0.8)])


@pytest.mark.parametrize("radiance", [lambda d: 1 + 0 * d[2], lambda d: 1 + 0.7 * d[2]])
def test_irradiance_is_that_of_radiance_linear_in_direction(radiance):
    """Against the integral over the hemisphere; d is the direction in which light travels."""
    height = (np.arange(400) + 0.5) / 200 - 1
    turn = 2 * np.pi * np.arange(64) / 64
    d = np.stack([
        np.outer(np.sqrt(1 - height**2), np.cos(turn)),
        np.outer(np.sqrt(1 - height**2), np.sin(turn)),
        np.outer(height, np.ones(64)),
    ])  # fmt: skip
    shine, solid_angle = radiance(d), 4 * np.pi / (400 * 64)
    fluence, flux = shine.sum() * solid_angle, (d * shine).sum(axis=(1, 2)) * solid_angle
    onto = np.einsum("axy,na->nxy", d, NORMALS)
    front, back = (
        (np.maximum(0, sign * onto) * shine).sum(axis=(1, 2)) * solid_angle for sign in (-1, 1)
    )
    field = field_of(np.full((1, *DOMAIN.shape), fluence), flux[None])
    sides = irradiance(field, np.zeros((4, 3)), NORMALS)
    assert sides[0][:, 0] == pytest.approx(front, rel=1e-3)
    assert sides[1][:, 0] == pytest.approx(back, rel=1e-3)


def test_irradiance_is_not_negative():
    field = field_of(np.ones((1, *DOMAIN.shape)), [(0, 0, 0.9)])
    front, back = irradiance(field, np.zeros((1, 3)), np.array([(0, 0, 1.0)]))
    assert front == 0
    assert back == pytest.approx(0.7)


def test_opaque_voxels_do_not_count():
    """Half of the voxels around the point are opaque and dark; the others are lit."""
    lit = np.ones((1, *DOMAIN.shape))
    lit[:, 8:] = 0
    occlusion = 1 - lit[0]
    front, _back = irradiance(field_of(lit), np.zeros((1, 3)), NORMALS[:1], occlusion)
    assert front == pytest.approx(1 / 4)
    front, _back = irradiance(field_of(lit), np.full((1, 3), 2.0), NORMALS[:1], occlusion)
    assert front == 0


def slope():
    """A triangle whose normal is (-1, 0, 1)."""
    mesh = bpy.data.meshes.new("slope")
    mesh.from_pydata([(0, 0, 0), (1, 0, 1), (0, 1, 0)], [], [(0, 1, 2)])
    return mesh


def flux_field():
    """One band, of flux 0.4 upwards."""
    return field_of(np.ones((1, *DOMAIN.shape)), [(0, 0, 0.4)])


@pytest.mark.parametrize(
    ("matrix", "up"),
    [
        (Matrix(), np.sqrt(1 / 2)),
        (Matrix.Rotation(np.pi, 4, "X"), -np.sqrt(1 / 2)),
        (Matrix.Diagonal((1, 1, -1, 1)), -np.sqrt(1 / 2)),
        (Matrix.Diagonal((-1, 1, 1, 1)), np.sqrt(1 / 2)),
        (Matrix.Diagonal((1, 1, 2, 1)), np.sqrt(1 / 5)),
    ],
    ids=["as it is", "upside down", "mirrored along z", "mirrored along x", "stretched"],
)
def test_sides_follow_the_normals_in_the_world(matrix, up):
    ob = add(slope())
    ob.matrix_world = matrix
    write_field([ob], flux_field())
    assert written(ob.data) == pytest.approx((1 / 4 - 0.2 * up) / np.pi)
    assert written(ob.data, BACK_ATTRIBUTE) == pytest.approx((1 / 4 + 0.2 * up) / np.pi)


def test_bodies_show_what_comes_out_of_them():
    ob = add(slope())
    write_field([ob], flux_field(), is_body=True)
    for name in (AMBIENT_ATTRIBUTE, BACK_ATTRIBUTE):
        assert written(ob.data, name) == pytest.approx((1 / 4 + 0.2 * np.sqrt(1 / 2)) / np.pi)


def test_modifiers_move_the_vertices():
    ob = add(triangle())
    modifier = ob.modifiers.new("move", "DISPLACE")
    modifier.direction, modifier.strength, modifier.mid_level = "X", 1.5, 0
    write([ob])
    moved = np.add(world_vertices(ob), (1.5, 0, 0))
    assert written(ob.data) == pytest.approx(expected(moved), abs=1e-5)


def test_modifiers_that_add_vertices_pass_the_light_on():
    ob = add(triangle())
    ob.modifiers.new("array", "ARRAY")
    write([ob])
    assert written(ob.data) == pytest.approx(expected(world_vertices(ob)), abs=1e-5)
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert len(written(evaluated)) == 6


def test_sharers_of_a_mesh_get_their_mean():
    mesh = triangle()
    left, right, other = add(mesh), add(mesh), add(mesh)
    left.location.x, right.location.x, other.location.x = -1, 2, 3
    write([left, right])
    mean = np.mean([world_vertices(left), world_vertices(right)], axis=0)
    assert written(mesh) == pytest.approx(expected(mean), abs=1e-5)


def test_a_second_write_replaces_the_first():
    ob = add(triangle())
    ob.data.attributes.new(AMBIENT_ATTRIBUTE, "FLOAT", "FACE")
    write([ob])
    write([ob], np.full((1, *DOMAIN.shape), 0.5))
    assert written(ob.data) == pytest.approx(0.5)


@pytest.mark.parametrize("painted", [True, False])
def test_remove_leaves_the_mesh_as_it_was(painted):
    ob = add(triangle())
    if painted:
        ob.data.color_attributes.new("paint", "BYTE_COLOR", "CORNER")

    def state():
        colors = ob.data.color_attributes
        return ob.data.attributes.keys(), colors.active_color_name, colors.default_color_name

    before = state()
    write([ob])
    assert state()[1:] == before[1:]
    remove_ambient(ob)
    assert state() == before
    remove_ambient(ob)


def test_what_is_not_a_mesh_is_refused_before_anything_is_written():
    mesh = add(triangle())
    empty = add(None, "nothing")
    with pytest.raises(OutputError, match="'nothing' is not a mesh"):
        write_ambient([mesh, empty], [np.ones((2, 3, 1)), np.ones((2, 0, 1))])
    assert AMBIENT_ATTRIBUTE not in mesh.data.attributes
    remove_ambient(empty)


def test_a_mesh_that_was_changed_meanwhile_is_refused_before_anything_is_written():
    uncut, cut = add(triangle()), add(triangle(), "cut")
    with pytest.raises(OutputError, match=r"^The mesh of 'cut' changed during the bake; bake"):
        write_ambient([uncut, cut], [np.ones((2, 3, 1)), np.ones((2, 4, 1))])
    assert AMBIENT_ATTRIBUTE not in uncut.data.attributes


def test_edit_mode_is_refused():
    ob = add(triangle())
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(OutputError, match="leave Edit Mode"):
        write([ob])


def test_linked_mesh_is_refused(tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {triangle()})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.meshes = ["triangle"]
    with pytest.raises(OutputError, match="make it local"):
        write([add(linked.meshes[0])])
