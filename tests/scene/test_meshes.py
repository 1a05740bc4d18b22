# SPDX-License-Identifier: GPL-3.0-or-later
"""The triangles and normals computed from a mesh in memory, compared with Blender's."""

import bpy
import numpy as np
import pytest

from lb_lighting.scene.read_meshes import read_mesh, vertices
from tests import scenery


def spread(faces, height=0.3, seed=0):
    """A mesh of separate faces (points), bent by about `height` m."""
    rng = np.random.default_rng(seed)
    points, corners = [], []
    for number, face in enumerate(faces):
        corners.append(range(len(points), len(points) + len(face)))
        points += [(x + 3 * number, y, height * rng.normal()) for x, y in face]
    mesh = bpy.data.meshes.new("spread")
    mesh.from_pydata(points, [], [list(c) for c in corners])
    return mesh


SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
TRIANGLE = SQUARE[:3]
DARTS = [np.roll([(0, 0), (2, 0), (0.5, 0.5), (0, 2)], n, axis=0).tolist() for n in range(4)]
STAR = [((1 + n % 2) * np.cos(n), (1 + n % 2) * np.sin(n)) for n in np.arange(6) * np.pi / 3]
MESHES = {
    "triangles": [TRIANGLE] * 5,
    "quads": [SQUARE, *DARTS],
    "both": [TRIANGLE, *DARTS, TRIANGLE, SQUARE],
    "more corners": [SQUARE, STAR, TRIANGLE, *DARTS],
}


def blenders(mesh):
    """(the points (n, 3) of each of its triangles, (n,) their slots, (m, 3) its normals)."""
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    return (
        np.array([triangle.vertices for triangle in triangles]),
        np.array([triangle.material_index for triangle in triangles]),
        np.array([normal.vector for normal in mesh.vertex_normals]),
    )


@pytest.mark.parametrize("faces", MESHES.values(), ids=MESHES.keys())
@pytest.mark.parametrize("height", [0, 0.3])
def test_triangles_and_normals_are_blenders(faces, height):
    mesh = spread(faces, height)
    corners, _slots, normals = blenders(mesh)
    read = read_mesh(mesh)
    np.testing.assert_array_equal(read.corners, corners)
    assert read.normals == pytest.approx(normals, abs=1e-5)


def test_quads_bent_at_random():
    rng = np.random.default_rng(1)
    mesh = spread(rng.normal(size=(500, 4, 2)), 1.0)
    corners, _slots, normals = blenders(mesh)
    read = read_mesh(mesh)
    assert np.mean(read.corners[1::2, 0] != read.corners[::2, 0]) > 0.1  # flipped
    np.testing.assert_array_equal(read.corners, corners)
    # Blender's arccosine is an approximation.
    assert read.normals == pytest.approx(normals, abs=5e-3)


@pytest.mark.parametrize("cut", [False, True])
def test_points_that_faces_share(cut):
    """For a dented ball without its first face."""
    mesh = scenery.add_ball().data
    points = np.array([vertex.co for vertex in mesh.vertices])
    points *= np.random.default_rng(2).uniform(0.8, 1.2, (len(points), 1))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.update()
    if cut:
        faces = [list(face.vertices) for face in mesh.polygons][1:]
        mesh = bpy.data.meshes.new("cut")
        mesh.from_pydata(points.tolist(), [], faces)
    corners, _slots, normals = blenders(mesh)
    read = read_mesh(mesh)
    np.testing.assert_array_equal(read.corners, corners)
    assert read.normals == pytest.approx(normals, abs=1e-4)
    assert read.closed.all()


def test_slots():
    """Slots that do not exist count as the last one."""
    mesh = spread(MESHES["both"])
    assert not read_mesh(mesh).slot.any()
    for number, face in enumerate(mesh.polygons):
        face.material_index = number % 4
    _corners, slots, _normals = blenders(mesh)
    assert len(set(slots)) == 4
    np.testing.assert_array_equal(read_mesh(mesh, 3).slot, np.minimum(slots, 2))


def test_in_edit_mode():
    """Edit Mode hides the attributes."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3)
    ob = bpy.context.object
    for number, face in enumerate(ob.data.polygons):
        face.material_index = number % 2
    ob.modifiers.new("smooth", "SUBSURF")

    def read():
        return read_mesh(ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data, 2)

    expected = read()
    bpy.ops.object.mode_set(mode="EDIT")
    mesh = read()
    assert len(mesh.points) == 49
    for name in ("points", "corners", "slot"):
        np.testing.assert_array_equal(getattr(mesh, name), getattr(expected, name))


def test_without_faces_or_points():
    empty = bpy.data.meshes.new("empty")
    loose = bpy.data.meshes.new("loose")
    loose.from_pydata([(1, 2, 3), (2, 2, 3)], [(0, 1)], [])
    for mesh, points in ((empty, 0), (loose, 2)):
        read = read_mesh(mesh)
        assert (len(read.points), len(read.corners), len(read.slot)) == (points, 0, 0)
        assert not read.normals.any()


def test_a_modifier_that_keeps_the_points_moves_them():
    ob = scenery.add_leaves(count=5)
    modifier = ob.modifiers.new("moved", "DISPLACE")
    modifier.direction, modifier.strength = "Z", 1.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    original = np.array([vertex.co for vertex in ob.data.vertices])
    mesh, _to_world = vertices(ob, depsgraph)
    assert mesh.points == pytest.approx(np.add(original, (0, 0, 0.5)), abs=1e-6)
    ob.modifiers.new("more", "SUBSURF")
    mesh, _to_world = vertices(ob, bpy.context.evaluated_depsgraph_get())
    assert mesh.points == pytest.approx(original)
