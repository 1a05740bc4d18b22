# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of Volume objects: read, and resampled to the lattice."""

import bpy
import numpy as np
import openvdb
import pytest
from mathutils import Euler, Matrix

from lb_lighting.errors import SceneError
from lb_lighting.scene import read_volumes, volumes
from lb_lighting.transport.medium import Domain

MATRIX = Matrix.LocRotScale((3, -1, 2), Euler((0.4, 0.9, -0.3)), (2, 0.5, 1.3))
CELL = 0.1  # m in object space


def make_grid(values, name="density", cell=CELL, offset=(0, 0, 0)):
    grid = openvdb.Vec3SGrid() if np.ndim(values) == 4 else openvdb.FloatGrid()
    grid.copyFromArray(np.ascontiguousarray(values, np.float32))
    grid.name = name
    grid.transform = openvdb.createLinearTransform(cell)
    grid.transform.postTranslate(offset)
    return grid


def make_blob(size=24, noise=0.5):
    """An asymmetric, noisy blob whose values decrease to 0 at the border of the grid."""
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, size)] * 3, indexing="ij")
    radius2 = (x - 0.1) ** 2 + (y + 0.05) ** 2 / 0.6 + z**2
    random = np.random.default_rng(0).uniform(1 - noise, 1 + noise, radius2.shape)
    return np.clip(1 - radius2 / 0.7, 0, None) * random


def mass_and_center(values, domain):
    mass = values.sum() * domain.voxel_size**3
    center = np.einsum("xyz,xyzi->i", values, domain.centers()) / values.sum()
    return mass, center


def exact_mass_and_center(values, matrix):
    """From the grid: each voxel's value times its volume, at its centre in world space."""
    positions = np.stack(np.indices(values.shape), axis=-1) * CELL
    center = np.einsum("xyz,xyzi->i", values, positions) / values.sum()
    volume = CELL**3 * abs(np.linalg.det(np.array(matrix)[:3, :3]))
    return values.sum() * volume, np.array(matrix @ Matrix.Translation(center)).T[3, :3]


def add_volume(path):
    data = bpy.data.volumes.new("volume")
    data.filepath = str(path)
    ob = bpy.data.objects.new("volume", data)
    bpy.context.collection.objects.link(ob)
    return ob


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def make_fog_cube(ob, side=1.0):
    """Make `ob` a cube of fog of density 3 by geometry nodes."""
    tree = bpy.data.node_groups.new("fog", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cube, end = tree.nodes.new("GeometryNodeVolumeCube"), tree.nodes.new("NodeGroupOutput")
    cube.inputs["Density"].default_value = 3
    cube.inputs["Min"].default_value, cube.inputs["Max"].default_value = [-side] * 3, [side] * 3
    tree.links.new(cube.outputs[0], end.inputs[0])
    ob.modifiers.new("fog", "NODES").node_group = tree


class TestSources:
    def test_file(self, tmp_path):
        values = make_blob(8)
        path = tmp_path / "blob.vdb"
        openvdb.write(str(path), [make_grid(values), make_grid(np.ones((4, 4, 4, 3)), "color")])
        ob = add_volume(path)
        assert sorted(read_volumes.grid_names(ob, depsgraph())) == ["color", "density"]
        assert read_volumes.find_grid(ob, depsgraph(), "color").vdb.background == (0, 0, 0)
        read_back = np.empty_like(values, np.float32)
        read_volumes.find_grid(ob, depsgraph()).vdb.copyToArray(read_back)
        assert read_back == pytest.approx(values)

    def test_sequence_at_the_current_frame(self, tmp_path):
        for frame in (1, 2, 3):
            grid = make_grid(np.full((4, 4, 4), frame))
            openvdb.write(str(tmp_path / f"smoke_{frame:04d}.vdb"), [grid])
        ob = add_volume(tmp_path / "smoke_0001.vdb")
        ob.data.is_sequence, ob.data.frame_duration = True, 3
        for frame in (2, 3):
            bpy.context.scene.frame_set(frame)
            assert read_volumes.find_grid(ob, depsgraph()).vdb.evalMinMax()[1] == frame

    @pytest.mark.parametrize("kind", ["volume", "mesh"])
    def test_made_by_geometry_nodes(self, kind):
        ob = add_volume("")
        if kind == "mesh":
            ob = bpy.data.objects.new("mesh", bpy.data.meshes.new("mesh"))
            bpy.context.collection.objects.link(ob)
        make_fog_cube(ob)
        ob.matrix_world = Matrix.Translation((5, 0, 0))
        assert read_volumes.grid_names(ob, depsgraph()) == ["density"]
        grid = read_volumes.find_grid(ob, depsgraph()).vdb
        domain = Domain((3.5, -1.5, -1.5), 0.1, (30, 30, 30))
        values = volumes.resample(grid, ob.matrix_world, domain)
        assert values.max() == pytest.approx(3)
        assert mass_and_center(values, domain)[1] == pytest.approx([5, 0, 0], abs=0.01)

    def test_modifiers_override_the_file(self, tmp_path):
        openvdb.write(str(tmp_path / "file.vdb"), [make_grid(np.ones((4, 4, 4)))])
        ob = add_volume(tmp_path / "file.vdb")
        make_fog_cube(ob)
        assert read_volumes.find_grid(ob, depsgraph()).vdb.evalMinMax()[1] == 3

    def test_missing_file_is_named(self, tmp_path):
        ob = add_volume(tmp_path / "gone.vdb")
        with pytest.raises(SceneError, match=r"gone\.vdb"):
            read_volumes.find_grid(ob, depsgraph())

    def test_unknown_grid_lists_those_that_exist(self, tmp_path):
        path = tmp_path / "blob.vdb"
        openvdb.write(str(path), [make_grid(np.ones((4, 4, 4)), n) for n in ("density", "heat")])
        with pytest.raises(SceneError, match=r"no grid 'smoke'.*density.*heat"):
            read_volumes.find_grid(add_volume(path), depsgraph(), "smoke")

    def test_grids_without_a_name_are_not_offered(self, tmp_path):
        path = tmp_path / "blob.vdb"
        openvdb.write(str(path), [make_grid(np.ones((4, 4, 4)), "")])
        with pytest.raises(SceneError, match=r"no grid 'density'; .* have no names; name the grid"):
            read_volumes.find_grid(add_volume(path), depsgraph())

    def test_a_frame_outside_of_a_sequence_is_reported(self, tmp_path):
        openvdb.write(str(tmp_path / "blob_0001.vdb"), [make_grid(np.ones((4, 4, 4)))])
        ob = add_volume(tmp_path / "blob_0001.vdb")
        ob.data.is_sequence, ob.data.frame_start, ob.data.frame_duration = True, 5, 1
        bpy.context.scene.frame_set(2)
        with pytest.raises(SceneError, match="shows no file of its sequence at this frame"):
            read_volumes.grid_names(ob, depsgraph())

    def test_volume_without_a_file(self):
        with pytest.raises(SceneError, match="no grids"):
            read_volumes.grid_names(add_volume(""), depsgraph())

    def test_objects_without_a_volume(self):
        for data in (bpy.data.meshes.new("mesh"), None):
            ob = bpy.data.objects.new("plain", data)
            bpy.context.collection.objects.link(ob)
            with pytest.raises(SceneError, match=r"'plain.*' has no volume"):
                read_volumes.grid_names(ob, depsgraph())


class TestResample:
    @pytest.mark.parametrize("ratio", [0.5, 1, 1.7, 3, 5])
    @pytest.mark.parametrize("matrix", [MATRIX, Matrix.Scale(0.7, 4)])
    def test_mass_and_center_are_kept(self, ratio, matrix):
        """`ratio` is the voxel size of the domain over that of the grid, in world space."""
        values = make_blob()
        grid = make_grid(values)
        mass, center = exact_mass_and_center(values, matrix)
        lower, upper = volumes.world_bounds(grid, matrix)
        voxel = ratio * CELL * abs(matrix.determinant()) ** (1 / 3)
        domain = Domain.around(lower, upper, int((upper - lower).max() / voxel) + 4)
        found_mass, found_center = mass_and_center(volumes.resample(grid, matrix, domain), domain)
        assert found_mass == pytest.approx(mass, rel=1e-2)
        assert np.abs(found_center - center).max() < 0.1 * domain.voxel_size

    def test_the_lattice_of_the_grid_itself_gives_its_values(self):
        values = make_blob(8)
        grid = make_grid(values, offset=(1, 2, 3))
        domain = Domain(tuple(np.array((1, 2, 3)) - CELL / 2), CELL, values.shape)
        resampled = volumes.resample(grid, Matrix.Identity(4), domain)
        assert resampled.dtype == np.float32
        assert resampled == pytest.approx(values, abs=1e-5)

    def test_a_domain_that_holds_a_part(self):
        values = make_blob(16)
        whole = Domain((0, 0, 0), CELL, (16, 16, 16))
        part = Domain((0.4, 0.4, 0.4), CELL, (6, 6, 6))
        matrix = Matrix.Translation((0.03, 0.02, 0))
        resampled = [volumes.resample(make_grid(values), matrix, d) for d in (whole, part)]
        assert resampled[1] == pytest.approx(resampled[0][4:10, 4:10, 4:10], abs=1e-5)

    def test_a_domain_elsewhere(self):
        domain = Domain((50, 50, 50), CELL, (4, 4, 4))
        assert not volumes.resample(make_grid(make_blob(8)), Matrix.Identity(4), domain).any()

    def test_vector_grid(self):
        values = make_blob(8)[..., None] * (1, 2, 3)
        domain = Domain((-CELL / 2,) * 3, CELL, (8, 8, 8))
        resampled = volumes.resample(make_grid(values, "color"), Matrix.Identity(4), domain)
        assert resampled == pytest.approx(np.moveaxis(values, -1, 0), abs=1e-5)

    def test_empty_grid_is_refused(self):
        with pytest.raises(SceneError, match="'density' is empty"):
            volumes.world_bounds(make_grid(np.zeros((4, 4, 4))), Matrix.Identity(4))


def test_bounds_reach_to_the_outer_faces_of_the_voxels():
    grid = make_grid(np.ones((4, 6, 8)))
    lower, upper = volumes.world_bounds(grid, Matrix.Translation((1, 0, 0)) @ Matrix.Scale(2, 4))
    assert lower == pytest.approx([0.9, -0.1, -0.1])
    assert upper == pytest.approx([1.7, 1.1, 1.5])
