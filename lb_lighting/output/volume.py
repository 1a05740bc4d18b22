# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes out: light and density as an OpenVDB file, and the Volume object that shows it."""

import os
import tempfile
import uuid
from pathlib import Path

import bpy
import numpy as np

from ..errors import OutputError
from .ours import TAG, is_ours

LIGHT_GRID = "lb_light"
DENSITY_GRID = "density"
CREATOR = "LB Lighting"
RESULT = "lb_lighting_result"  # on a source: the baked Volume object that shows its light
STAMP = "lb_lighting:"  # keeps our metadata apart from OpenVDB's own keys (name, class, ...)

# Cubic interpolation, the widest that Cycles has, reads two voxels away.
MARGIN = 2


def write_vdb(path, domain, density, light, metadata):
    """Write the grids `lb_light` and `density` to `path`, whole or not at all.

    domain    the `Domain` of both
    density   (nx, ny, nz), dimensionless
    light     (1 or 3, nx, ny, nz) mean radiance, W/(m^2 sr)
    metadata  {name: str, int or float}, the settings that made it, stamped on file and grids

    Light is kept within two voxels of any density, continued outwards at the domain's
    faces, so that interpolation does not darken the border of a cloud.
    Raises OutputError for a folder or disk that cannot take the file, and for a file
    already there that is not ours.
    """
    path = Path(path)
    if path.exists() and not is_baked_file(path):
        raise OutputError(f"{path} was not written by LB Lighting; choose another file name.")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        _write_checked(temporary, _grids(domain, density, light), metadata)
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(
            f"{path} could not be written; choose a folder that is writable and has free space."
        ) from error
    finally:
        if temporary.exists():
            temporary.unlink()


def fresh_path(folder, source_name):
    """A .vdb path in `folder` for the light of the object `source_name`, new at every call.

    Blender keeps what it once read from a path until it quits, even when the file is
    rewritten or deleted; so no bake may use the path of an earlier one.
    """
    return Path(folder) / f"{bpy.path.clean_name(source_name)}_lb_{uuid.uuid4().hex[:8]}.vdb"


def read_metadata(path):
    """{name: value} that `write_vdb` stamped on the file at `path`; OutputError if it did not."""
    if not is_baked_file(path):
        raise OutputError(f"{path} was not written by LB Lighting; bake it again.")
    found = _openvdb().readMetadata(str(path))
    return {key.removeprefix(STAMP): found[key] for key in found if key.startswith(STAMP)}


def is_baked_file(path):
    """True if `path` is a file that `write_vdb` wrote."""
    try:
        return _openvdb().readMetadata(str(path)).get("creator") == CREATOR
    except OSError:
        return False


def show_volume(context, sources, path):
    """The Volume object that shows the file at `path` as the light of the objects `sources`.

    Sources that had one keep it, and each later bake brings a `fresh_path`; two that had one
    each now share the first. Call `forget` for those that an older bake had and this has not.
    """
    scene = context.scene
    older = [ob for ob in baked_volumes(scene) if any(s.get(RESULT) == ob for s in sources)]
    ob = older[0] if older else _new_volume(scene, sources[0].name)
    for other in older[1:]:
        remove_baked(other)
    for source in sources:
        source[RESULT] = ob
    ob.data.filepath = _stored_path(path)
    return ob


def baked_volumes(scene):
    """The Volume objects in `scene` that `show_volume` made."""
    return [ob for ob in scene.objects if ob.type == "VOLUME" and is_ours(ob)]


def sources_of(scene, baked):
    """The objects in `scene` whose light the Volume object `baked` shows."""
    return [ob for ob in scene.objects if ob.get(RESULT) == baked]


def lost_sources(scene):
    """The objects in `scene` that were lit, and whose light has since been removed."""
    return [ob for ob in scene.objects if RESULT in ob and ob[RESULT] is None]


def forget(source):
    """The object `source` has no light any more."""
    if RESULT in source:
        del source[RESULT]


def baked_path(ob):
    """The path of the file that the baked Volume object shows."""
    return Path(bpy.path.abspath(ob.data.filepath))


def remove_baked(ob):
    """Remove a Volume object that `show_volume` made, with its datablock and our materials."""
    volume = ob.data
    materials = [material for material in volume.materials if material and is_ours(material)]
    bpy.data.objects.remove(ob)
    # The user may have put our data to use elsewhere; then it stays.
    for block in (volume, *materials):
        if not block.users:
            bpy.data.batch_remove([block])


def delete_baked_file(path):
    """Delete the file at `path` if `write_vdb` wrote it; OutputError if that cannot be done."""
    if not is_baked_file(path):
        return
    try:
        Path(path).unlink()
    except OSError as error:
        raise OutputError(f"{path} could not be deleted; make its folder writable.") from error


def default_folder():
    """The folder for results: the .blend's, or the extension's own while the file is unsaved."""
    if bpy.data.filepath:
        return Path(bpy.data.filepath).parent
    if __package__.startswith("bl_ext."):
        extension = ".".join(__package__.split(".")[:3])
        return Path(bpy.utils.extension_path_user(extension, path="baked", create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path="lb_lighting", create=True))


def require_writable(folder):
    """OutputError, before any work, for a folder that is not there or takes no files."""
    if not Path(folder).is_dir():
        raise OutputError(f"The folder {folder} does not exist; choose another or make it.")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"Nothing can be written to {folder}; choose a folder that is writable."
        ) from error


def _stored_path(path):
    """`path` as the .blend keeps it: relative to it, unless it is unsaved or on another drive."""
    try:
        return bpy.path.relpath(str(path)) if bpy.data.filepath else str(path)
    except ValueError:
        return str(path)


def _new_volume(scene, source_name):
    volume = bpy.data.volumes.new(f"LB {source_name}")
    ob = bpy.data.objects.new(volume.name, volume)
    volume[TAG] = ob[TAG] = "baked volume"
    scene.collection.objects.link(ob)
    return ob


def _openvdb():
    # Blender offers the module only once it runs, and the bpy wheel only when asked.
    import openvdb

    return openvdb


def _grids(domain, density, light):
    """`lb_light` and `density` as OpenVDB grids, sparse where there is nothing to light."""
    openvdb = _openvdb()
    # As ours, OpenVDB's voxel centres are at integers; its matrices multiply from the right.
    transform = openvdb.createLinearTransform(domain.index_to_world.T.tolist())

    density = np.asarray(density, np.float32)
    light = np.pad(light, [(0, 0)] + [(MARGIN, MARGIN)] * 3, mode="edge")
    light = np.where(_near(density > 0, MARGIN), light, 0)
    colors = np.broadcast_to(np.moveaxis(light, 0, -1), (*light.shape[1:], 3))

    light_grid, density_grid = openvdb.Vec3SGrid(), openvdb.FloatGrid()
    light_grid.copyFromArray(np.ascontiguousarray(colors, np.float32), ijk=(-MARGIN,) * 3)
    density_grid.copyFromArray(np.ascontiguousarray(density))
    light_grid.name, density_grid.name = LIGHT_GRID, DENSITY_GRID
    for grid in (light_grid, density_grid):
        grid.transform = transform
    density_grid.gridClass = openvdb.GridClass.FOG_VOLUME
    return [light_grid, density_grid]


def _near(mask, margin):
    """`mask` grown by `margin` voxels in every direction, in an array larger by that margin."""
    mask = np.pad(mask, 2 * margin)
    for axis in range(3):
        windows = np.lib.stride_tricks.sliding_window_view(mask, 2 * margin + 1, axis)
        mask = windows.any(axis=-1)
    return mask


def _write_checked(path, grids, metadata):
    """Write `grids` to `path`; OSError if they did not get there."""
    stamps = {STAMP + name: value for name, value in metadata.items()}
    for grid in grids:
        grid.updateMetadata(stamps)
    _openvdb().write(str(path), grids, {"creator": CREATOR, **stamps})
    # OpenVDB truncates silently on a full disk; one byte more, which its readers ignore,
    # makes the system say so.
    with open(path, "ab") as file:
        file.write(b"\0")
        file.flush()
        os.fsync(file.fileno())
