# SPDX-License-Identifier: GPL-3.0-or-later
"""The area of surfaces in each voxel."""

import time
from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Euler

from lb_lighting.scene import voxelize
from lb_lighting.transport.medium import Domain
from tests.scene.shapes import (
    ROTATED_SCALED,
    add_cube,
    add_mesh,
    add_object,
    add_sphere,
    area_of,
    domain_of,
    parts_of,
    triangles_of,
)


def faces_of(triangles, closed=False):
    """Stands in for the `Faces` of an object with these triangles."""
    return SimpleNamespace(triangles=triangles, closed=np.full(len(triangles), closed))


def square(half=1.0):
    """(2, 3, 3): a square about the origin that faces up."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    return half * corners[[[0, 1, 2], [0, 2, 3]]]


def turned(triangles, angles):
    return triangles @ np.array(Euler(angles).to_matrix()).T


def clipped_area(triangle, domain):
    """(nx, ny, nz) m^2: the area of a triangle (3, 3) m in each voxel, cut at the voxels' faces."""
    area = np.zeros(domain.shape)
    for voxel in np.ndindex(domain.shape):
        lower = np.add(domain.origin, np.multiply(voxel, domain.voxel_size))
        polygon = triangle
        for axis in range(3):
            polygon = halfspace(polygon, axis, lower[axis], 1)
            polygon = halfspace(polygon, axis, lower[axis] + domain.voxel_size, -1)
        fan = [(polygon[0], *polygon[i : i + 2]) for i in range(1, len(polygon) - 1)]
        area[voxel] = area_of(np.array(fan)) if fan else 0
    return area


def halfspace(polygon, axis, limit, sign):
    """The part of a convex polygon (n, 3) with sign * (coordinate - limit) of 0 or more."""
    kept = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        here, there = (sign * (point[axis] - limit) for point in (start, end))
        if here >= 0:
            kept.append(start)
        if here * there < 0:
            kept.append(start + (end - start) * here / (here - there))
    return np.array(kept).reshape(-1, 3)


class TestSurfaceArea:
    @pytest.mark.parametrize("resolution", [12, 64])
    def test_sum_is_the_area_of_the_mesh(self, resolution):
        sphere = add_sphere()
        sphere.matrix_world = ROTATED_SCALED
        triangles = triangles_of(sphere)
        area = voxelize.surface_area(triangles, domain_of(triangles, resolution))
        assert area.sum() == pytest.approx(area_of(triangles), rel=1e-3)

    def test_large_triangles_have_the_exact_moments(self):
        """A flat square, tilted, against its exact centroid and second moments."""
        square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
        turn = np.array(Euler((0.5, 0.3, 0.7)).to_matrix())
        triangles = (square[[[0, 1, 2], [0, 2, 3]]] @ turn.T) + 0.123
        domain = domain_of(triangles, 48)
        area = voxelize.surface_area(triangles, domain)
        centers = domain.centers()
        centroid = np.einsum("xyz,xyzi->i", area, centers) / area.sum()
        assert np.abs(centroid - 0.123).max() < 0.02 * domain.voxel_size
        moments = np.einsum("xyz,xyzi,xyzj->ij", area, centers - 0.123, centers - 0.123)
        exact = turn @ np.diag([4 / 3, 4 / 3, 0]) @ turn.T
        # The voxel centres replace the points in each voxel, which adds h^2/12 on the diagonal.
        exact += np.eye(3) * 4 * domain.voxel_size**2 / 12
        assert moments == pytest.approx(exact, abs=3e-3)

    def test_area_of_each_voxel_along_a_plane(self):
        """A plane along the lattice has the same area in each voxel, within the sampling error."""
        square = np.array([[0, 0, 3.4], [8, 0, 3.4], [8, 8, 3.4], [0, 8, 3.4]])
        triangles = square[[[0, 1, 2], [0, 2, 3]]]
        area = voxelize.surface_area(triangles, Domain((0, 0, 0), 1.0, (8, 8, 8)))
        assert area[:, :, 3] == pytest.approx(np.ones((8, 8)), abs=0.2)
        assert area.sum() == pytest.approx(64)

    def test_leaves_smaller_than_a_voxel(self):
        leaf = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
        domain = Domain((0, 0, 0), 1.0, (4, 4, 4))
        area = voxelize.surface_area(leaf[None] + (2.4, 1.4, 3.4), domain)
        assert area[2, 1, 3] == pytest.approx(0.005)
        assert np.count_nonzero(area) == 1

    def test_outside_is_dropped(self):
        """Only half of the square lies in the domain."""
        far = np.array([[0, -1e4, 0.5], [1e4, 0, 0.5], [0, 1e4, 0.5]])
        domain = Domain((-2, -2, 0), 0.125, (32, 32, 8))
        area = voxelize.surface_area(far[None], domain)
        assert area.sum() == pytest.approx(8, rel=1e-2)
        assert not area[:16].any()

    def test_nothing(self):
        domain = Domain((0, 0, 0), 1.0, (4, 4, 4))
        assert not voxelize.surface_area(np.empty((0, 3, 3)), domain).any()

    def test_weights_multiply_the_area(self):
        """For triangles of all sizes: large triangles are cut, and their pieces keep the weight."""
        random = np.random.default_rng(2)
        triangles = np.concatenate([random.normal(0, s, (20, 3, 3)) for s in (0.1, 1, 4)])
        weight = random.uniform(size=60)
        domain = domain_of(triangles, 48)
        area = voxelize.surface_area(triangles, domain, weight)
        each = [area_of(triangle[None]) for triangle in triangles]
        assert area.sum() == pytest.approx(weight @ each, rel=1e-3)

    def test_area_of_each_voxel_is_that_of_exact_clipping(self):
        """For triangles smaller and larger than a voxel, some of them across the border."""
        triangles = (
            np.random.default_rng(3).uniform(-1, 1, (40, 3, 3))
            * np.repeat([0.5, 4], 20)[:, None, None]
        )
        domain = Domain((-3.5, -2.5, -4.5), 1.0, (7, 5, 9))
        exact = sum(clipped_area(triangle, domain) for triangle in triangles)
        area = voxelize.surface_area(triangles, domain)
        assert area.shape == domain.shape
        assert np.linalg.norm(area - exact) < 0.08 * np.linalg.norm(exact)
        finer = voxelize.surface_area(triangles, domain, samples=32)
        assert np.linalg.norm(finer - exact) < 0.005 * np.linalg.norm(exact)

    def test_the_same_triangles_give_the_same_bits(self):
        triangles = np.random.default_rng(4).uniform(0, 1, (5000, 3, 3))
        domain = domain_of(triangles, 17)
        first, second = (voxelize.surface_area(triangles, domain) for _ in range(2))
        assert np.array_equal(first, second)

    def test_on_the_border_of_the_domain(self):
        """A face between two voxels belongs to the upper one, which may lie outside."""
        domain = Domain((0, 0, 0), 1.0, (4, 3, 5))
        face = np.array([[0, 0, 0], [4, 0, 0], [0, 3, 0]], float)
        assert voxelize.surface_area(face[None], domain)[:, :, 0].sum() == pytest.approx(6)
        assert voxelize.surface_area(face[None] + (0, 0, 2), domain)[
            :, :, 2
        ].sum() == pytest.approx(6)
        assert not voxelize.surface_area(face[None] + (0, 0, 5), domain).any()

    @pytest.mark.filterwarnings("error")
    def test_triangles_without_area(self):
        point, line = np.full((3, 3), 1.5), np.outer([0, 1, 3], [1, 1, 1])
        domain = Domain((0, 0, 0), 1.0, (4, 4, 4))
        assert not voxelize.surface_area(np.stack([point, line, 9 * line]), domain).any()

    def test_a_million_triangles_in_seconds(self):
        random = np.random.default_rng(1)
        triangles = random.uniform(0, 1, (1_000_000, 1, 3)) + random.normal(
            0, 0.005, (1_000_000, 3, 3)
        )
        domain = domain_of(triangles, 128)
        start = time.perf_counter()
        area = voxelize.surface_area(triangles, domain)
        assert time.perf_counter() - start < 30
        assert area.sum() == pytest.approx(area_of(triangles), rel=1e-3)


class TestPointsWithin:
    @pytest.mark.parametrize("count", [1, 2, 3, 18, 100, 1023])
    def test_fill_the_triangle_about_its_centre(self, count):
        points = voxelize._points_within(count)
        assert points.shape == (3, count)
        assert points.min() >= 0
        assert points.sum(axis=0) == pytest.approx(1)
        assert points.mean(axis=1) == pytest.approx(1 / 3, abs=1e-3)


class TestClosed:
    @pytest.mark.parametrize(
        ("add", "closed"),
        [
            (lambda: bpy.ops.mesh.primitive_uv_sphere_add(), True),
            (lambda: bpy.ops.mesh.primitive_cylinder_add(radius=0.1, end_fill_type="NGON"), True),
            (
                lambda: bpy.ops.mesh.primitive_cylinder_add(radius=0.1, end_fill_type="NOTHING"),
                True,
            ),
            (lambda: bpy.ops.mesh.primitive_plane_add(), False),
            (lambda: bpy.ops.mesh.primitive_grid_add(x_subdivisions=90, y_subdivisions=90), False),
            (lambda: bpy.ops.mesh.primitive_cone_add(end_fill_type="NOTHING"), False),
        ],
        ids=["sphere", "cylinder", "long pipe", "plane", "fine grid", "open cone"],
    )
    def test_of_a_shape(self, add, closed):
        add()
        (part,) = parts_of(bpy.context.object)
        assert part.faces.closed.shape == part.faces.triangles.shape[:1]
        assert np.all(part.faces.closed == closed)

    def test_many_small_holes_do_not_add_up(self):
        """As at the branches of a tree: a hundredth of the faces is missing."""
        ball = add_sphere(5).data
        shape = bmesh.new()
        shape.from_mesh(ball)
        bmesh.ops.delete(shape, geom=list(shape.faces)[::100], context="FACES")
        shape.to_mesh(ball)
        (part,) = parts_of(bpy.context.object)
        assert part.faces.closed.all()

    def test_each_piece_of_an_instanced_mesh_is_closed_or_open(self):
        parent = add_object(add_mesh([(0, 0, 0), (9, 0, 0)], []), "parent")
        parent.instance_type = "VERTS"
        cube, leaf = add_cube(), add_mesh([(5, 0, 0), (6, 0, 0), (5, 1, 0)], [(0, 1, 2)])
        leaf = add_object(leaf, "leaf")
        with bpy.context.temp_override(active_object=cube, selected_editable_objects=[cube, leaf]):
            bpy.ops.object.join()
        cube.parent = parent
        (part,) = parts_of(parent)
        sheets = part.faces.triangles[~part.faces.closed]
        assert (len(part.faces.triangles), len(sheets)) == (26, 2)
        assert sheets[..., 0].min() == pytest.approx(5)


class TestFoliageDensity:
    DOMAIN = Domain((-1, -1, -1), 0.5, (4, 4, 4))

    def test_is_half_the_area_per_volume(self):
        leaf = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]) + 0.1
        density = voxelize.foliage_density(faces_of(leaf[None]), self.DOMAIN)
        assert density[2, 2, 2] == pytest.approx(0.005 / 0.125 / 2)

    def test_a_closed_body_has_its_mean_projected_area(self):
        """It is S/4 for any convex body (Cauchy)."""
        sphere = 0.1 * triangles_of(add_sphere()) + 0.25
        density = voxelize.foliage_density(faces_of(sphere, closed=True), self.DOMAIN)
        assert density[2, 2, 2] == pytest.approx(np.pi * 0.1**2 / 0.125, rel=0.01)

    @pytest.mark.parametrize("closed", [True, False])
    def test_towards_a_light_it_is_the_projected_area(self, closed):
        tilted = turned(0.2 * square() + 0.1, (0.6, 0, 0))
        density = voxelize.foliage_density(faces_of(tilted, closed), self.DOMAIN, (0, 0, -1))
        shown = 0.4**2 * np.cos(0.6) / (2 if closed else 1)
        assert density.sum() * 0.125 == pytest.approx(shown, rel=1e-3)

    def test_the_mean_over_all_directions(self):
        tilted = turned(0.3 * square(), (0.6, 0.2, 0))
        height = (np.arange(1000) + 0.5) / 500 - 1  # a spiral around the sphere
        turn, radius = 2.399963 * np.arange(1000), np.sqrt(1 - height**2)
        directions = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
        faces = faces_of(tilted)
        each = [voxelize.foliage_density(faces, self.DOMAIN, d).sum() for d in directions]
        isotropic = voxelize.foliage_density(faces, self.DOMAIN).sum()
        assert np.mean(each) == pytest.approx(isotropic, rel=0.01)


class TestOpaqueShare:
    DOMAIN = Domain((-8, -8, -8), 1.0, (16, 16, 16))

    def share(self, triangles, closed=False):
        return voxelize.opaque_share(triangles, np.full(len(triangles), closed), self.DOMAIN)

    @pytest.mark.parametrize(("facing", "row"), [((0, 0, 0), 7), ((np.pi, 0, 0), 8)])
    def test_a_wall_between_voxels_is_behind_its_front(self, facing, row):
        share = self.share(turned(square(20), facing))
        assert share[:, :, row].min() > 0.99
        share[:, :, row] = 0
        assert not share.any()

    def test_a_wall_inside_of_voxels_fills_them(self):
        assert self.share(square(20) + 0.4)[:, :, 8].min() > 0.99

    @pytest.mark.parametrize(
        "angles", [(0.2, 0, 0), (0.4, 0.4, 0), (np.pi / 4, 0, 0), (0.8, 0.6, 0)]
    )
    def test_a_wall_against_the_lattice_leaks_little(self, angles):
        share = self.share(turned(square(40), angles) + 0.3)
        through = (1 - share.astype(float)).prod(axis=2)[5:11, 5:11]
        assert through.mean() < 0.06

    def test_a_small_sheet_stops_its_area(self):
        assert self.share(0.25 * square() + 0.5)[8, 8, 8] == pytest.approx(0.25, rel=1e-3)

    def test_a_body_is_full_inside(self):
        share = self.share(3 * triangles_of(add_sphere()), closed=True)
        assert share[8, 8, 8] == share[6, 8, 8] == 1
        assert share[2, 8, 8] == share[13, 13, 8] == 0

    @pytest.mark.parametrize("radius", [0.05, 0.1])
    def test_a_thin_body_stops_its_mean_projected_area(self, radius):
        """S/4 for a rod, of 3/2 for a voxel."""
        bpy.ops.mesh.primitive_cylinder_add(radius=radius, depth=10)
        rod = turned(triangles_of(bpy.context.object), (0.4, 0.3, 0.2)) + 0.3
        stopped = self.share(rod, closed=True).sum() * 1.5 / (2 * np.pi * radius * 10 / 4)
        assert 0.99 < stopped < 1.1  # more if a sample point lies inside

    def test_the_walls_of_an_open_body_stop_light(self):
        """A wide pipe, open at both ends."""
        bpy.ops.mesh.primitive_cylinder_add(radius=8.3, depth=20, end_fill_type="NOTHING")
        pipe = triangles_of(bpy.context.object) + 0.1
        domain = Domain((-16, -16, -16), 1.0, (32, 32, 32))
        share = voxelize.opaque_share(pipe, np.full(len(pipe), True), domain)
        assert share[16, 16, 16] == 0
        assert np.all((1 - share[:16, 16, 12:20]).prod(axis=0) < 0.05)

    def test_outside_of_the_domain(self):
        assert not self.share(square() + 20).any()
