# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes out: light and density as an OpenVDB file, and the Volume object that shows it."""

import os
import tempfile
import uuid
from pathlib import Path

import bpy
import numpy as np

from ..errors import OutputError
from ..transport.lights import PointLight, Sun
from .ours import TAG, is_ours

LIGHT_GRID = "lb_light"
AXES = ("X", "Y", "Z")
DENSITY_GRID = "density"
CREATOR = "LB Lighting"
RESULT = "lb_lighting_result"  # on a source: the baked Volume object that shows its light
STAMP = "lb_lighting:"  # keeps our metadata apart from OpenVDB's own keys (name, class, ...)

# Cubic interpolation, the widest that Cycles has, reads two voxels away.
MARGIN = 2
_SPHERE = np.float32(4 * np.pi)  # sr


def volume_light(field, lights, mode):
    """What a baked volume shows of the light in the `Field` of `lights`: (light, others, beams).

    light   (bands, nx, ny, nz) W/(m^2 sr), mean radiance of what comes from many directions
    others  {name of a grid: (bands, nx, ny, nz)}: lb_flux_x ... are the components of the net flux
            of that light over its fluence, from 0 to 1; lb_direct_1 ... the mean radiance,
            W/(m^2 sr), of the unscattered light that comes from one direction
    beams   the Sun or PointLight of each lb_direct

    Over its source ("ADD") a volume shows scattered light alone: Cycles scatters the rest there.
    Of the paper's field all is shown as if it came evenly from all sides.
    """
    fluence, flux, beams = field.fluence, field.flux, []
    if field.by_light is None:
        return (fluence + field.direct) / _SPHERE, {}, []
    if mode == "REPLACE":
        of_beam = [isinstance(light, Sun | PointLight) for light in lights]
        beams = [light for light, is_beam in zip(lights, of_beam, strict=True) if is_beam]
        unscattered = field.by_light[of_beam]
        # Rounding leaves less than nothing where beams are all there is.
        fluence = fluence + np.maximum(field.direct - unscattered.sum(axis=0), 0)
        if field.direct_flux is not None:
            toward = [_toward(light, field.domain) for light in beams]
            own = sum(d * v[:, None] for d, v in zip(toward, unscattered, strict=True))
            flux = flux + field.direct_flux - own
    drift = _drift(fluence, flux)
    others = {flux_grid(axis): drift[:, number] for number, axis in enumerate(AXES)}
    for number in range(1, len(beams) + 1):
        others[direct_grid(number)] = unscattered[number - 1] / _SPHERE
    return fluence / _SPHERE, others, beams


def _toward(light, domain):
    """Unit vectors (3, 1, 1, 1) or (3, nx, ny, nz): where a beam's light goes in each voxel."""
    if isinstance(light, Sun):
        toward = np.reshape(light.direction, (3, 1, 1, 1))
    else:
        toward = np.moveaxis(domain.centers() - light.position, -1, 0)
    length = np.linalg.norm(toward, axis=0)
    return np.divide(toward, length, out=np.zeros(toward.shape), where=length > 0)


def _drift(fluence, flux):
    """(bands, 3, nx, ny, nz), at most 1 long: the flux over the fluence, (bands, nx, ny, nz)."""
    total = fluence[:, None]
    drift = np.divide(flux, total, out=np.zeros_like(flux), where=total > 0)
    return drift / np.maximum(np.linalg.norm(drift, axis=1, keepdims=True), 1)


def flux_grid(axis):
    """The name of the grid of light's mean direction along the axis "X", "Y" or "Z"."""
    return f"lb_flux_{axis.lower()}"


def direct_grid(number):
    """The name of the grid of the unscattered light of beam `number`, from 1."""
    return f"lb_direct_{number}"


def write_vdb(path, domain, density, light, metadata, others=None):
    """Write the grids `density`, `lb_light` and others to `path`, whole or not at all.

    domain    the `Domain` of all
    density   (nx, ny, nz), dimensionless
    light     (1 or 3, nx, ny, nz) mean radiance, W/(m^2 sr)
    metadata  {name: str, int or float}, the settings that made it, stamped on file and grids
    others    {name: (1 or 3, nx, ny, nz)}, see `volume_light`

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
        grids = _grids(domain, density, {LIGHT_GRID: light} | (others or {}))
        _write_checked(temporary, grids, metadata)
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


def _grids(domain, density, colors):
    """All that `write_vdb` writes as OpenVDB grids, sparse where there is nothing to light."""
    near = _near(np.asarray(density) > 0, MARGIN)[..., None].repeat(3, axis=-1)
    grids = [_grid(DENSITY_GRID, domain, np.asarray(density, np.float32), 0)]
    grids[0].gridClass = _openvdb().GridClass.FOG_VOLUME
    for name, values in colors.items():
        values = np.moveaxis(np.broadcast_to(values, (3, *domain.shape)), 0, -1)
        values = np.pad(values, [(MARGIN, MARGIN)] * 3 + [(0, 0)], mode="edge")
        values *= near
        grids.append(_grid(name, domain, values, MARGIN))
    return grids


def _grid(name, domain, values, margin):
    """An OpenVDB grid of `values` that begin `margin` voxels outside of the domain.

    values  (nx, ny, nz) or (nx, ny, nz, 3)
    """
    openvdb = _openvdb()
    grid = openvdb.FloatGrid() if values.ndim == 3 else openvdb.Vec3SGrid()
    grid.copyFromArray(np.ascontiguousarray(values, np.float32), ijk=(-margin,) * 3)
    grid.name = name
    # As ours, OpenVDB's voxel centres are at integers; its matrices multiply from the right.
    grid.transform = openvdb.createLinearTransform(domain.index_to_world.T.tolist())
    return grid


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
