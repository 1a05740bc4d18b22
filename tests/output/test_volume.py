# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked volumes: the file, the object that shows it, and their removal."""

import os
import tempfile
from pathlib import Path

import bpy
import numpy as np
import pytest

from lb_lighting.errors import OutputError
from lb_lighting.output.sources import forget, lost_sources, sources_shown_by
from lb_lighting.output.vdb import (
    DENSITY_GRID,
    LIGHT_GRID,
    direct_grid,
    flux_grid,
    read_metadata,
    write_vdb,
)
from lb_lighting.output.volume import (
    baked_path,
    baked_volumes,
    default_folder,
    delete_baked_file,
    remove_baked,
    show_volume,
)
from lb_lighting.output.volume_light import volume_light
from lb_lighting.transport.field import Field, Report, ScatteringMoments
from lb_lighting.transport.lights.distant import Sky, Sun
from lb_lighting.transport.lights.lamps import PointLight
from lb_lighting.transport.medium import Domain, Medium
from lb_lighting.transport.ordinates.quadrature import harmonics, polynomials
from lb_lighting.transport.solver import solve
from tests.scenery import read_only, source

needs_posix = pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs POSIX users")

FLUX = ("lb_flux_x", "lb_flux_y", "lb_flux_z")
SETTINGS = {"model": "paper", "resolution": 64, "g": 0.1}


@pytest.fixture
def domain():
    return Domain((-1.0, 2.0, 0.5), 0.25, (7, 8, 9))


@pytest.fixture
def density(domain):
    density = np.zeros(domain.shape, np.float32)
    density[1:4, 2:4, 0:3] = np.random.default_rng(1).uniform(0.5, 1, (3, 2, 3))
    return density


@pytest.fixture
def light(domain):
    return np.random.default_rng(2).uniform(0.5, 1, (3, *domain.shape)).astype(np.float32)


def read_grid(path, name):
    import openvdb

    return openvdb.read(str(path), name)


def voxels(grid, start, shape):
    array = np.zeros(shape, np.float32)
    grid.copyToArray(array, ijk=start)
    return array


def test_density_is_written_as_it_is(tmp_path, domain, density, light):
    write_vdb(tmp_path / "a.vdb", domain, density, light, {})
    grid = read_grid(tmp_path / "a.vdb", DENSITY_GRID)
    assert np.array_equal(voxels(grid, (0, 0, 0), domain.shape), density)
    assert grid.activeVoxelCount() == np.count_nonzero(density)


def test_light_reaches_two_voxels_beyond_density_and_the_domain(tmp_path, domain, density, light):
    write_vdb(tmp_path / "a.vdb", domain, density, light, {})
    grid = read_grid(tmp_path / "a.vdb", LIGHT_GRID)
    measured = voxels(grid, (0, 0, 0), (*domain.shape, 3))
    lit = np.zeros(domain.shape, bool)
    lit[:6, :6, :5] = True
    assert np.array_equal(measured, np.moveaxis(light * lit, 0, -1))
    beyond = voxels(grid, (2, 2, -2), (1, 1, 2, 3))
    assert np.array_equal(beyond[0, 0], np.tile(light[:, 2, 2, 0], (2, 1)))


def test_other_grids_are_written_likewise(tmp_path, domain, density, light):
    others = {direct_grid(1): 2 * light, flux_grid("X"): light[:1]}
    write_vdb(tmp_path / "a.vdb", domain, density, light, {}, others)
    for name, expected in ((direct_grid(1), 2 * light), (flux_grid("X"), light[[0, 0, 0]])):
        measured = voxels(read_grid(tmp_path / "a.vdb", name), (0, 0, 0), (6, 6, 5, 3))
        assert np.array_equal(measured, np.moveaxis(expected[:, :6, :6, :5], 0, -1))


class TestVolumeLight:
    SHAPE = 2, 3, 4, 5
    LIGHTS = (Sun((0, 0, -1), 1.0), Sky(1.0), PointLight((0, 0, 9), 1.0))

    def field(self, glow=0.0, apart=True):
        """ScatteringMoments light of 1 with a flux of 0.5, and the light of lights and medium."""
        by_light = np.stack([np.full(self.SHAPE, value, np.float32) for value in (2.1, 3.1, 4.1)])
        flux = np.zeros((2, 3, *self.SHAPE[1:]), np.float32)
        flux[:, 2] = -0.5
        return Field(
            Domain((0, 0, 0), 1.0, self.SHAPE[1:]),
            np.ones(self.SHAPE, np.float32),
            by_light.sum(axis=0) + np.float32(glow),
            flux,
            Report("physical", "none"),
            by_light=by_light if apart else None,
        )

    def radiance(self, fluence):
        return pytest.approx(np.full(self.SHAPE, fluence / (4 * np.pi)), rel=1e-6)

    def test_replace_has_beams_apart_and_all_else_together(self):
        light, others, beams = volume_light(self.field(glow=0.5), self.LIGHTS, "REPLACE")
        assert light == self.radiance(4.6)
        assert beams == [self.LIGHTS[0], self.LIGHTS[2]]
        assert others.keys() == {*FLUX, "lb_direct_1", "lb_direct_2"}
        assert others["lb_direct_1"] == self.radiance(2.1)
        squares = np.sum(
            (Domain((0, 0, 0), 1.0, self.SHAPE[1:]).centers() - (0, 0, 9)) ** 2, axis=-1
        )
        expected = np.broadcast_to(4.1 / (4 * np.pi) * squares, self.SHAPE)
        assert others["lb_direct_2"] == pytest.approx(expected, rel=0.01)
        assert others["lb_flux_z"] == pytest.approx(np.full(self.SHAPE, -0.5 / 4.6), rel=1e-6)
        assert not others["lb_flux_x"].any()

    def test_beams_alone_leave_nothing_less_than_nothing(self):
        field = self.field()
        field.by_light = field.by_light[::2]
        field.direct = 0.999999 * field.by_light.sum(axis=0)
        light, _others, _beams = volume_light(field, self.LIGHTS[::2], "REPLACE")
        assert light == self.radiance(1.0)

    def test_add_has_scattered_light_alone(self):
        light, others, beams = volume_light(self.field(), self.LIGHTS, "ADD")
        assert light == self.radiance(1.0)
        assert others.keys() == set(FLUX)
        assert others["lb_flux_z"] == pytest.approx(-0.5)
        assert beams == []

    @pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
    def test_light_of_small_angles_stays_with_its_beam(self, mode):
        """It is no longer part of the light from many directions, nor of its flux."""
        field = self.field()
        field.direct_flux = np.zeros_like(field.flux)
        field.direct_flux[:, 2] = -2.1  # the sun's, without those of the others
        field.forward = np.zeros_like(field.by_light)
        field.forward[0] = 0.25
        lights = [self.LIGHTS[0], Sky(1.0), Sky(1.0)]
        light, others, beams = volume_light(field, lights, mode, g=(0.6, 1.0))
        assert beams == [self.LIGHTS[0]]
        assert others["lb_forward_1"] == self.radiance(0.25)
        even = 0.75 + (7.2 if mode == "REPLACE" else 0)
        assert light == self.radiance(even)
        for band, straight in enumerate((0.8, 1.0)):
            expected = np.full(self.SHAPE[1:], (-0.5 + 0.25 * straight) / even)
            assert others["lb_flux_z"][band] == pytest.approx(expected, abs=1e-6)

    def test_light_of_small_angles_is_no_more_than_there_is(self):
        field = self.field()
        field.forward = 3 * np.ones_like(field.by_light)
        light, others, _beams = volume_light(field, self.LIGHTS, "ADD")
        assert others["lb_forward_1"] == self.radiance(1)
        assert not light.any()

    @pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
    def test_light_that_was_gathered_is_shown_by_its_moments(self, mode):
        field = self.field()
        field.direct_flux = np.zeros_like(field.flux)
        field.direct_flux[:, 2] = -2.1  # the sun's; the skies' light has none
        moments = np.arange(9.0).reshape(9, 1, 1, 1) + np.ones((2, 9, *self.SHAPE[1:]))
        lobes = 0.25 * np.ones((1, *self.SHAPE))
        field.scattered = ScatteringMoments(moments, lobes, np.full(2, 0.6), 4)
        lights = [self.LIGHTS[0], Sky(1.0), Sky(1.0)]
        light, others, beams = volume_light(field, lights, mode, g=0.85)
        assert beams == [self.LIGHTS[0]]
        assert others["lb_forward_1"] == self.radiance(0.25)
        assert not set(FLUX) & others.keys()
        even = 7.2 if mode == "REPLACE" else 0
        towards = np.array((0.6, 0.0, 0.8))
        expected = np.arange(1.0, 10) @ harmonics(towards) + even / (4 * np.pi)
        shown = [light, *(others[f"lb_moment_{n}"] for n in range(1, 9))]
        measured = np.tensordot(polynomials(towards), np.array(shown), axes=1)
        assert measured == pytest.approx(np.full(self.SHAPE, expected), rel=1e-5)

    def test_flux_is_no_more_than_the_fluence(self):
        field = self.field()
        field.flux[0] *= 3
        field.fluence[:, 0] = field.flux[:, :, 0] = 0
        flux = volume_light(field, self.LIGHTS, "ADD")[1]["lb_flux_z"]
        assert not flux[:, 0].any()
        assert flux[0, 1:] == pytest.approx(-1)
        assert flux[1, 1:] == pytest.approx(-0.5)

    def test_in_a_white_furnace_light_has_no_direction(self):
        medium = Medium(np.ones((6, 7, 8)), 1.0, 0.5, 0.0, 0.85)
        field = solve(medium, [Sky(1.0)])
        assert (
            np.abs(field.flux).max() > 0.1
        )  # uncollided light flows in, scattered light flows out
        light, others, _beams = volume_light(field, [Sky(1.0)], "REPLACE")
        assert light == pytest.approx(1, rel=1e-5)
        for name in FLUX:
            assert others[name] == pytest.approx(0, abs=1e-6)

    @pytest.mark.parametrize("mode", ["REPLACE", "ADD"])
    def test_light_without_a_known_direction_comes_from_everywhere(self, mode):
        light, others, beams = volume_light(self.field(apart=False), self.LIGHTS, mode)
        assert light == self.radiance(10.3)
        assert (others, beams) == ({}, [])


def test_gray_light_is_written_to_all_bands(tmp_path, domain, density, light):
    write_vdb(tmp_path / "a.vdb", domain, density, light[:1], {})
    measured = voxels(read_grid(tmp_path / "a.vdb", LIGHT_GRID), (2, 2, 1), (1, 1, 1, 3))
    assert np.all(measured == light[0, 2, 2, 1])


@pytest.mark.parametrize("name", [LIGHT_GRID, DENSITY_GRID])
def test_voxel_centers_are_where_the_domain_has_them(tmp_path, domain, density, light, name):
    write_vdb(tmp_path / "a.vdb", domain, density, light, {})
    transform = read_grid(tmp_path / "a.vdb", name).transform
    centers = domain.centers()
    for voxel in ((0, 0, 0), (6, 7, 8)):
        assert transform.indexToWorld(voxel) == pytest.approx(centers[voxel])


def test_metadata_is_read_back(tmp_path, domain, density, light):
    write_vdb(tmp_path / "a.vdb", domain, density, light, SETTINGS)
    assert read_metadata(tmp_path / "a.vdb") == SETTINGS
    stamped = read_grid(tmp_path / "a.vdb", LIGHT_GRID).metadata
    assert stamped["lb_lighting:model"] == "paper"


@pytest.mark.parametrize("content", [None, b"", b"not a volume"])
def test_metadata_of_another_file_is_refused(tmp_path, content):
    path = tmp_path / "a.vdb"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(OutputError, match="was not written by LB Lighting"):
        read_metadata(path)


def test_a_file_of_the_user_is_not_overwritten(tmp_path, domain, density, light):
    import openvdb

    path = tmp_path / "mine.vdb"
    openvdb.write(str(path), [openvdb.FloatGrid()])
    before = path.read_bytes()
    with pytest.raises(OutputError, match="choose another file name"):
        write_vdb(path, domain, density, light, {})
    assert path.read_bytes() == before


def test_missing_folder_is_one_sentence(tmp_path, domain, density, light):
    with pytest.raises(OutputError, match="could not be written; choose a folder"):
        write_vdb(tmp_path / "nowhere" / "a.vdb", domain, density, light, {})


@pytest.fixture
def shared_folder():
    """A folder that every user can access, unlike pytest's own."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@needs_posix
def test_read_only_folder_is_one_sentence(shared_folder, domain, density, light):
    expected = pytest.raises(OutputError, match="choose a folder that is writable")
    with read_only(shared_folder), expected:
        write_vdb(shared_folder / "a.vdb", domain, density, light, {})
    assert os.listdir(shared_folder) == []


@needs_posix
def test_file_that_cannot_be_deleted_is_one_sentence(shared_folder, domain, density, light):
    path = shared_folder / "a.vdb"
    write_vdb(path, domain, density, light, {})
    expected = pytest.raises(OutputError, match="make its folder writable")
    with read_only(shared_folder), expected:
        delete_baked_file(path)
    assert path.exists()


def test_full_disk_leaves_the_old_file_whole(tmp_path, domain, density, light):
    resource = pytest.importorskip("resource")
    path = tmp_path / "a.vdb"
    write_vdb(path, domain, density, light, SETTINGS)
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
    try:
        with pytest.raises(OutputError, match="free space"):
            write_vdb(path, domain, density, light, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.vdb"]


def test_one_volume_object_per_source(tmp_path, domain, density, light):
    path = tmp_path / "a.vdb"
    write_vdb(path, domain, density, light, {})
    cloud = show_volume(bpy.context, [source("cloud")], path)
    assert show_volume(bpy.context, [source("cloud")], path) == cloud
    smoke = show_volume(bpy.context, [source("smoke")], path)
    assert baked_volumes(bpy.context.scene) == [cloud, smoke]
    cloud.data.grids.load()
    assert {grid.name for grid in cloud.data.grids} == {LIGHT_GRID, DENSITY_GRID}


def test_path_is_relative_to_a_saved_file(tmp_path, domain, density, light):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert default_folder() == tmp_path
    path = default_folder() / "a.vdb"
    write_vdb(path, domain, density, light, {})
    ob = show_volume(bpy.context, [source("cloud")], path)
    assert ob.data.filepath == "//a.vdb"


def test_folder_of_an_unsaved_file_exists():
    assert default_folder().is_dir()


def test_remove_takes_only_what_is_ours(tmp_path, domain, density, light):
    path = tmp_path / "a.vdb"
    write_vdb(path, domain, density, light, {})
    mine = bpy.data.objects.new("mine", bpy.data.volumes.new("mine"))
    bpy.context.scene.collection.objects.link(mine)
    ob = show_volume(bpy.context, [mine], path)
    ob.data.materials.append(bpy.data.materials.new("mine"))
    assert baked_path(ob) == path
    remove_baked(ob)
    assert list(bpy.data.objects) == [mine]
    assert list(bpy.data.volumes) == [mine.data]
    assert bpy.data.materials.keys() == ["mine"]
    assert path.exists()
    assert lost_sources(bpy.context.scene) == [mine]
    forget(mine)
    assert lost_sources(bpy.context.scene) == []


def test_a_volume_that_joins_two_takes_the_place_of_both(tmp_path, domain, density, light):
    path = tmp_path / "a.vdb"
    write_vdb(path, domain, density, light, {})
    first, second = source("first"), source("second")
    kept = show_volume(bpy.context, [first], path)
    show_volume(bpy.context, [second], path)
    assert show_volume(bpy.context, [first, second], path) == kept
    assert baked_volumes(bpy.context.scene) == [kept]
    first.name = "renamed"
    assert sources_shown_by(bpy.context.scene, kept) == [first, second]


def test_only_our_files_are_deleted(tmp_path, domain, density, light):
    import openvdb

    mine, ours = tmp_path / "mine.vdb", tmp_path / "ours.vdb"
    openvdb.write(str(mine), [openvdb.FloatGrid()])
    write_vdb(ours, domain, density, light, {})
    for path in (mine, ours, tmp_path / "gone.vdb"):
        delete_baked_file(path)
    assert mine.exists()
    assert not ours.exists()
