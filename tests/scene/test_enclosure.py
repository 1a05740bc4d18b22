# SPDX-License-Identifier: GPL-3.0-or-later
"""The space that closed surfaces enclose, in each voxel."""

from math import pi

import numpy as np
import pytest
from mathutils import Euler, Matrix

from lb_lighting.errors import SceneError
from lb_lighting.scene import enclosure
from lb_lighting.transport.medium import Domain
from tests.scene.shapes import ROTATED_SCALED, add_cube, add_sphere, domain_of, triangles_of


def volume_of(triangles):
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.einsum("ni,ni->", a, np.cross(b, c)) / 6


class TestSolidFraction:
    def test_volume_of_a_cube_and_a_sphere(self):
        for ob in (add_cube(), add_sphere()):
            ob.matrix_world = ROTATED_SCALED
            triangles = triangles_of(ob)
            domain = domain_of(triangles)
            fraction = enclosure.solid_fraction(triangles, domain)
            volume = fraction.sum() * domain.voxel_size**3
            assert volume == pytest.approx(volume_of(triangles), rel=1e-2)
            assert (fraction.min(), fraction.max()) == (0, 1)
            centroid = np.einsum("xyz,xyzi->i", fraction, domain.centers()) / fraction.sum()
            assert np.abs(centroid - triangles.mean(axis=(0, 1))).max() < 0.1 * domain.voxel_size

    def test_faces_along_the_lattice(self):
        """A cube whose faces cut voxels at 0.3 of their edge."""
        domain = Domain((0, 0, 0), 1.0, (9, 9, 9))
        triangles = triangles_of(add_cube(matrix=Matrix.Translation((4.5,) * 3)))
        corners = (triangles - 4.5) * 5.4 + 4.5  # from 1.8 to 7.2
        fraction = enclosure.solid_fraction(corners, domain)
        profile = fraction[:, 4, 4]
        assert profile == pytest.approx([0, 0.2, 1, 1, 1, 1, 1, 0.2, 0], abs=1e-3)

    @pytest.mark.parametrize("removed", [1, 20])
    def test_small_holes_are_closed(self, removed):
        triangles = triangles_of(add_sphere())
        fraction = enclosure.solid_fraction(triangles[removed:], domain := domain_of(triangles, 64))
        assert fraction.sum() * domain.voxel_size**3 == pytest.approx(4 / 3 * pi, rel=0.1)

    def test_overlapping_shells_count_once(self):
        ball = triangles_of(add_sphere())
        both = np.concatenate([ball, ball + np.array([0.5, 0, 0])])
        domain = domain_of(both, 48)
        lens = pi * (4 + 0.5) * (2 - 0.5) ** 2 / 12
        volume = enclosure.solid_fraction(both, domain).sum() * domain.voxel_size**3
        assert volume == pytest.approx(2 * 4 / 3 * pi - lens, rel=0.02)

    def test_open_shells_that_meet(self):
        """The ball alone is not enough, if the hemisphere beside it leaks."""
        ball = triangles_of(add_sphere())
        bowl = ball[ball[..., 2].max(axis=1) < 0.98]
        small = ball * 0.2 + np.array([1.3, 0, 0])
        domain = domain_of(np.concatenate([bowl, small]), 24)
        volume = enclosure.solid_fraction(np.concatenate([bowl, small]), domain).sum()
        assert volume * domain.voxel_size**3 == pytest.approx(4.1, rel=0.15)

    def test_open_mesh_is_refused(self):
        cube = triangles_of(add_cube())
        corner = cube[(cube.max(axis=1) == cube.min(axis=1)).any(axis=1)][:4]
        with pytest.raises(SceneError, match=r"^The mesh is not closed, or .* foliage instead\.$"):
            enclosure.solid_fraction(corner, domain_of(cube))

    @pytest.mark.parametrize("turn", [(0, 0, 0), (0.4, 0.9, -0.3)])
    def test_flat_mesh_is_refused(self, turn):
        matrix = Euler(turn).to_matrix().to_4x4() @ Matrix.Diagonal((1, 1, 0, 1))
        triangles = triangles_of(add_cube(matrix=matrix))
        with pytest.raises(SceneError, match=r"^The mesh is flat; give it a thickness"):
            enclosure.solid_fraction(triangles, domain_of(triangles))

    def test_outside_of_the_domain(self):
        domain = Domain((10, 10, 10), 0.5, (4, 4, 4))
        assert not enclosure.solid_fraction(triangles_of(add_cube()), domain).any()
