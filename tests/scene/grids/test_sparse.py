# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids as in real files: sparse, with stray voxels and invalid values."""

import pickle
import tracemalloc
from functools import partial

import bpy
import numpy as np
import openvdb
import pytest
from mathutils import Euler, Matrix

from lb_lighting.errors import SceneError
from lb_lighting.scene import volumes
from lb_lighting.scene.emission import Glow, shining
from lb_lighting.scene.grids.resample import Cells, translation
from lb_lighting.scene.grids.sparse import Matter, SparseCells
from lb_lighting.scene.medium_choice import FROM_MATERIAL
from lb_lighting.scene.opening import open_sources
from lb_lighting.scene.reader import Reader
from lb_lighting.transport.medium import Domain
from tests import scenery
from tests.scenery import bake_light, read_grid

TURNED = Matrix.LocRotScale((3, -1, 2), Euler((0.4, 0.9, -0.3)), (2, 0.5, 1.3))
ANYWHERE = np.eye(4), (0, 0, 0), (8, 8, 8)
STRAY = "has voxels far from the others that are too thin to be seen"


@pytest.fixture
def scene(scene):
    """A scene with few voxels, because these tests do not check the light."""
    scene.lb_lighting.resolution = 8
    return scene


def puff(size=24):
    """(size, size, size): density that decreases to 0 at the faces of the grid."""
    axis = (np.arange(size) + 0.5) / size * 2 - 1
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return ((1 - x**2) * (1 - y**2) * (1 - z**2)).astype(np.float32)


def make_grid(values=None, kind=openvdb.FloatGrid, name="density", background=None):
    grid = kind() if background is None else kind(background)
    if values is not None:
        grid.copyFromArray(np.ascontiguousarray(values))
    grid.name, grid.transform = name, openvdb.createLinearTransform(2 / 24)
    return grid


def scatter(places, size=16, seed=0):
    """A grid with random blocks at the `places`."""
    grid, random = make_grid(), np.random.default_rng(seed)
    for place in places:
        values = random.uniform(0.5, 1, (size,) * 3).astype(np.float32)
        grid.copyFromArray(values, ijk=tuple(map(int, place)))
    return grid


def dense(grid, matrix, domain):
    """The same as `Cells`, with the voxels that `domain` needs."""
    cells = volumes.cells_of(grid, matrix)
    lower, upper = cells.near(domain)
    values = np.empty(upper - lower, np.float32)
    grid.copyToArray(values, tuple(map(int, lower)))
    return Cells(values, cells.index_to_world @ translation(lower))


def add_volume(folder, *grids, material=True, name="fog"):
    path = folder / f"{name}.vdb"
    openvdb.write(str(path), list(grids))
    data = bpy.data.volumes.new(name)
    data.filepath = str(path)
    if material:
        data.materials.append(scenery.volume_material())
    return scenery.link(name, data)


def read(ob, medium=FROM_MATERIAL, grid=""):
    """(the source of `ob`, its notes)."""
    reader = Reader(bpy.context.evaluated_depsgraph_get(), medium, 30.0, grid)
    (source,) = open_sources([ob], reader)
    return source, reader.notes


def size_of(source):
    return np.ptp(source.bounds, axis=0) * 24 / 2  # voxels


class TestBlocks:
    PLACES = np.random.default_rng(2).integers(-90, 90, (20, 3))

    @pytest.mark.parametrize("matrix", [Matrix.Identity(4), TURNED], ids=["straight", "turned"])
    @pytest.mark.parametrize("resolution", [12, 50])
    def test_the_result_is_that_of_a_dense_grid(self, matrix, resolution):
        grid = scatter(self.PLACES)
        grid.fill((-40, -40, 70), (80, 80, 80), 0.3)  # leaves large tiles
        lower, upper = volumes.world_bounds(grid, matrix)
        domains = [
            Domain.around(lower, upper, resolution, 2),
            Domain.around(lower + (upper - lower) / 3, upper, resolution),
        ]
        for domain in domains:
            resampled = volumes.resample(grid, matrix, domain)
            assert resampled.any()
            assert resampled == pytest.approx(
                dense(grid, matrix, domain).on(domain), rel=1e-5, abs=1e-6
            )

    def test_memory_depends_on_the_lattice(self):
        """The box of the grid alone is 12 GB."""
        grid = scatter([(0, 0, 0), (1484, 1484, 1484), *self.PLACES * 5 + 700])
        domain = Domain.around(*volumes.world_bounds(grid, np.eye(4)), 32, 1)
        tracemalloc.start()
        try:
            resampled = volumes.resample(grid, np.eye(4), domain)
            Matter.of(volumes.cells_of(grid, np.eye(4)))
            _now, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 32e6
        mass = resampled.sum() * domain.voxel_size**3
        assert mass == pytest.approx(0.75 * grid.activeVoxelCount() * (2 / 24) ** 3, rel=0.01)

    def test_much_coarser_lattices(self):
        """A block of the grid lies within one voxel, or across two."""
        grid = scatter([(0, 0, 0), (70, 0, 0)])
        for shift in (0, 0.3):
            domain = Domain((-1000 * (1 + shift),) * 3, 1000, (3, 3, 3))
            resampled = volumes.resample(grid, np.eye(4), domain)
            mass = resampled.sum() * domain.voxel_size**3
            assert mass == pytest.approx(0.75 * 2 * 16**3 * (2 / 24) ** 3, rel=0.01)

    def test_voxels_millions_apart(self):
        grid = scatter([(0, 0, 0), (9_000_000, -9_000_000, 0)])
        matter = Matter.of(volumes.cells_of(grid, np.eye(4)))
        assert len(matter.bricks) == 16
        assert matter.mean.sum() == pytest.approx(16 * 0.75, rel=0.01)

    @pytest.mark.parametrize("fine", [False, True])
    def test_emission_by_another_grid(self, fine):
        """The other grid has the same lattice, or a finer one."""
        flame, other = scatter(self.PLACES), scatter(self.PLACES + 3, 24, seed=1)
        if fine:
            other = make_grid()
            other.transform = openvdb.createLinearTransform(2 / 48)
            other.fill((-100, -100, -100), (100, 100, 100), 0.5)
        domain = Domain.around(*volumes.world_bounds(flame, TURNED), 16, 2)

        class Product(Glow):
            grids = property(lambda self: ["flame", "other"])

            def radiance(self, values):
                return np.multiply.outer(values["flame"] * values["other"], self.color)

        radiances = []
        for cells in (volumes.cells_of, partial(dense, domain=domain)):
            grids = {"flame": cells(flame, TURNED), "other": cells(other, TURNED)}
            radiances.append(shining([Product((1, 2, 3))], grids, grids["flame"], domain))
        assert radiances[0].any()
        assert radiances[0] == pytest.approx(radiances[1], rel=1e-4, abs=1e-5)

    def test_only_the_path_crosses_to_the_solver(self, tmp_path):
        source, _notes = read(add_volume(tmp_path, scatter(self.PLACES, 32)))
        assert len(pickle.dumps(source.grid)) < 1000


class TestKinds:
    DOMAIN = Domain((-1 / 24,) * 3, 2 / 24, (6, 6, 6))

    @pytest.mark.parametrize(
        ("kind", "value"),
        [
            (openvdb.DoubleGrid, 0.5),
            (openvdb.BoolGrid, True),
            (openvdb.Int32Grid, 3),
            (openvdb.Vec3SGrid, (0.0, 1.0, 2.0)),
        ],
        ids=lambda kind: getattr(kind, "__name__", None),
    )
    def test_every_type_of_number_is_density(self, tmp_path, kind, value):
        grid = make_grid(kind=kind)
        grid.fill((0, 0, 0), (5, 5, 5), value)
        source, notes = read(add_volume(tmp_path, grid))
        (share,) = source.shares(self.DOMAIN)
        assert share.density == pytest.approx(np.full((6, 6, 6), np.mean(value)))
        assert notes == []

    def test_points_are_refused(self):
        with pytest.raises(SceneError, match="'dots' holds points, not values; choose another"):
            SparseCells(make_grid(kind=openvdb.PointDataGrid, name="dots"), *ANYWHERE)

    def test_a_file_that_is_cut_short_is_refused(self, tmp_path):
        ob = add_volume(tmp_path, scatter([(0, 0, 0)], 64))
        path = tmp_path / "fog.vdb"
        source, _notes = read(ob)
        path.write_bytes(path.read_bytes()[:20_000])
        with pytest.raises(SceneError, match=r"'density' of .*fog\.vdb cannot be read; save"):
            _ = source.bounds


class TestValues:
    DOMAIN = Domain((-1 / 24,) * 3, 2 / 24, (24, 24, 24))

    @pytest.mark.parametrize(
        ("value", "what"), [(-3, "negative"), (np.nan, "not finite"), (np.inf, "not finite")]
    )
    def test_invalid_values_count_as_0(self, tmp_path, value, what):
        grid, zero = make_grid(puff()), puff()
        zero[3, 3, 3:5] = 0
        for voxel in ((3, 3, 3), (3, 3, 4)):  # copyFromArray would drop NaN
            grid.getAccessor().setValueOn(voxel, value)
        source, notes = read(add_volume(tmp_path, grid))
        (share,) = source.shares(self.DOMAIN)
        assert share.density == pytest.approx(zero, abs=1e-6)
        note = f"The grid 'density' of 'fog' has 2 voxels that are {what}; this counts as 0."
        assert notes == [note]

    def test_a_level_set_is_fog_inside(self, tmp_path):
        ball = openvdb.createLevelSetSphere(1.0, center=(0.3, 0, 0), voxelSize=0.05)
        ball.name = "density"
        source, notes = read(add_volume(tmp_path, ball))
        domain = Domain.around(*source.bounds, 40, 2)
        (share,) = source.shares(domain)
        assert share.density.max() == pytest.approx(1)
        centers = domain.centers() - (0.3, 0, 0)
        radius = np.linalg.norm(centers, axis=-1)
        assert share.density[radius < 0.75].min() == pytest.approx(1)
        assert share.density[radius > 1.12].max() == 0
        beginning = "The grid 'density' of 'fog' is a level set; its inside is lit as fog of"
        assert [note.startswith(beginning) for note in notes] == [True]

    def test_the_background_counts_as_0(self, tmp_path):
        grid = make_grid(background=0.25)
        grid.copyFromArray(np.full((8, 8, 8), 2, np.float32))
        grid.copyFromArray(np.full((8, 8, 8), 2, np.float32), ijk=(16, 16, 16))
        source, notes = read(add_volume(tmp_path, grid))
        (share,) = source.shares(self.DOMAIN)
        assert set(np.unique(np.round(share.density, 5))) == {0, 2}
        note = "The grid 'density' of 'fog' has the value 0.25 where it is empty; this counts as 0."
        assert notes == [note]

    def test_a_grid_without_density_is_left_out(self, scene, tmp_path):
        nothing, leaves = add_volume(tmp_path, make_grid(-puff())), scenery.add_leaves()
        with pytest.raises(SceneError, match="'density' of 'fog' has no values above 0; choose"):
            bake_light(nothing)
        outcome = bake_light(nothing, leaves)
        assert any(note.startswith("'fog' is left out. The grid") for note in outcome.notes)
        assert not nothing.hide_viewport

    @pytest.mark.parametrize("value", [np.nan, -1])
    def test_a_bake_notes_and_shows_it(self, scene, tmp_path, value):
        values = scenery.ball()
        values[3, 3, 3] = value
        outcome = bake_light(scenery.add_fog(tmp_path, values))
        assert any("has 1 voxel that is" in note for note in outcome.notes)
        density, _first = read_grid(outcome.path, "density")
        assert np.isfinite(density).all()
        assert density.min() >= 0


class TestStrays:
    """Invisible matter does not set the voxel size."""

    def add(self, folder, *strays, values=None, far=500, **options):
        grid = make_grid(puff() if values is None else values)
        for number, value in enumerate(strays):
            grid.getAccessor().setValueOn((far, far + number, -far), value)
        return add_volume(folder, grid, **options)

    @pytest.mark.parametrize("far", [300, 5000])
    @pytest.mark.parametrize("value", [1e-6, 1e-3])
    def test_a_far_voxel_of_nearly_nothing_is_left_out(self, tmp_path, value, far):
        source, notes = read(self.add(tmp_path, value, far=far))
        assert size_of(source) == pytest.approx((24, 24, 24))
        assert [STRAY in note for note in notes] == [True]
        assert notes[0].startswith("'fog' has voxels far")

    @pytest.mark.parametrize("medium", ["cloud", FROM_MATERIAL])
    def test_strays_with_a_preset(self, tmp_path, medium):
        source, _notes = read(self.add(tmp_path, 1e-6, 1e-6), medium=medium)
        assert size_of(source) == pytest.approx((24, 24, 24))

    def test_dust_all_around_is_left_out(self, tmp_path):
        """It is a tenth of all density, but no ray meets much of it."""
        values = np.full((240, 240, 240), 2e-6, np.float32)
        values[108:132, 108:132, 108:132] = puff()
        source, notes = read(self.add(tmp_path, values=values))
        assert size_of(source).max() <= 24 + 2 * 8
        assert [STRAY in note for note in notes] == [True]

    def test_fog_that_is_thin_everywhere_stays_whole(self, tmp_path):
        for value in (1e-3, 1e-8):
            values = np.full((100, 20, 20), value, np.float32)
            source, notes = read(self.add(tmp_path, values=values))
            assert size_of(source) == pytest.approx((100, 20, 20))
            assert notes == []

    def test_a_veil_beside_dense_fog_stays(self, tmp_path):
        """The veil has an optical depth of 1/10, the fog of about 1000."""
        values = np.full((100, 20, 20), 0.1 * 12 / 20 / 4, np.float32)
        values[:20] = 1000 * 12 / 20 / 4
        source, notes = read(self.add(tmp_path, values=values))
        assert size_of(source) == pytest.approx((100, 20, 20))
        assert notes == []

    def test_a_small_puff_far_away_stays(self, tmp_path):
        grid = make_grid(puff())
        grid.copyFromArray(np.full((6, 6, 6), 0.5, np.float32), ijk=(300, 0, 0))
        source, notes = read(add_volume(tmp_path, grid))
        assert size_of(source)[0] == pytest.approx(306, abs=8)
        assert notes == []

    def test_a_homogeneous_material_shows_strays(self, tmp_path):
        ob = self.add(tmp_path, *[1e-6] * 64, far=100)
        nodes = ob.active_material.node_tree.nodes
        nodes["Principled Volume"].inputs["Density Attribute"].default_value = ""
        source, [note] = read(ob)
        assert np.all(size_of(source) > 90)
        assert "reads no grid" in note

    def test_emission_is_not_left_out(self, tmp_path):
        """Not even without density."""
        flame = make_grid(name="flame")
        flame.copyFromArray(np.full((8, 8, 8), 1, np.float32), ijk=(104, 0, 0))
        stray = make_grid(puff())
        stray.getAccessor().setValueOn((500, 500, 500), 1e-6)
        ob = add_volume(tmp_path, stray, flame)
        tree = ob.active_material.node_tree
        attribute = tree.nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "flame"
        strength = tree.nodes["Principled Volume"].inputs["Emission Strength"]
        tree.links.new(attribute.outputs["Factor"], strength)
        source, _notes = read(ob)
        assert size_of(source) == pytest.approx((112, 24, 24))
        domain = Domain.around(*source.bounds, 56)
        assert source.emission(domain)[0].max() == pytest.approx(1, abs=0.1)

    def test_a_soft_edge_is_not_noted(self, tmp_path):
        values = np.full((100, 24, 24), 1e-7, np.float32)
        values[5:95] = 0.5
        source, notes = read(self.add(tmp_path, values=values))
        assert size_of(source) == pytest.approx((100, 24, 24))
        assert notes == []

    def test_a_bake_lights_the_puff(self, scene, tmp_path):
        outcome = bake_light(self.add(tmp_path, 1e-6))
        assert outcome.result.domain.voxel_size <= 24 / 4 * 2 / 24
        assert any(STRAY in note for note in outcome.notes)
