# SPDX-License-Identifier: GPL-3.0-or-later
"""Ambient light on meshes: sampled where the vertices are in world space."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import OutputError
from lb_lighting.output.attribute import (
    AMBIENT_ATTRIBUTE,
    remove_ambient,
    sample,
    write_ambient,
)
from lb_lighting.transport.medium import Domain

DOMAIN = Domain((-4.0, -4.0, -4.0), 0.5, (16, 16, 16))


def linear_field():
    """x + 2 y + 3 z, and its double and triple: trilinear interpolation has it exactly."""
    field = DOMAIN.centers() @ (1, 2, 3)
    return np.stack([field, 2 * field, 3 * field])


def expected(points):
    return np.outer(np.asarray(points) @ (1, 2, 3), (1, 2, 3))


def add(mesh, name="ob"):
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def triangle():
    mesh = bpy.data.meshes.new("triangle")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0.5)], [], [(0, 1, 2)])
    return mesh


def written(mesh):
    attribute = mesh.attributes[AMBIENT_ATTRIBUTE]
    assert (attribute.domain, attribute.data_type) == ("POINT", "FLOAT_COLOR")
    colors = np.empty(4 * len(mesh.vertices), np.float32)
    attribute.data.foreach_get("color", colors)
    colors = colors.reshape(-1, 4)
    assert np.all(colors[:, 3] == 1)
    return colors[:, :3]


def world_vertices(ob):
    return [ob.matrix_world @ vertex.co for vertex in ob.data.vertices]


def write(objects, radiance=None):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    write_ambient(objects, depsgraph, DOMAIN, linear_field() if radiance is None else radiance)


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
    with pytest.raises(OutputError, match="nothing is not a mesh"):
        write([mesh, empty])
    assert AMBIENT_ATTRIBUTE not in mesh.data.attributes
    remove_ambient(empty)


def test_edit_mode_is_refused():
    ob = add(triangle())
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(OutputError, match="leave it"):
        write([ob])


def test_linked_mesh_is_refused(tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {triangle()})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.meshes = ["triangle"]
    with pytest.raises(OutputError, match="make it local"):
        write([add(linked.meshes[0])])
