# SPDX-License-Identifier: GPL-3.0-or-later
"""The .vdb of a lit volume: its density, and what its shader needs to know of the light.

Needs no Blender, and is written by the solver's process.
"""

import os
import shutil
import uuid
from pathlib import Path

import numpy as np
import openvdb

from ..errors import OutputError
from ..transport.box import Box
from ..transport.lights.distant import Sun
from ..transport.ordinates.moments import beside_beams, of_lobes, way_of
from ..transport.ordinates.quadrature import FACTORS

LIGHT_GRID = "lb_light"
AXES = ("X", "Y", "Z")
DENSITY_GRID = "density"
EMISSION_GRID = "lb_emission"  # W/(m^3 sr), what the medium shines with by itself
CREATOR = "LB Lighting"
STAMP = "lb_lighting:"  # keeps our metadata apart from OpenVDB's own keys (name, class, ...)
TOKEN = "token"  # of the bake that wrote the file
END = b"\0LB Lighting wrote all of this."  # of a file, which no reader sees

# Cubic interpolation, the widest that Cycles has, reads two voxels away.
MARGIN = 2
_SPHERE = np.float32(4 * np.pi)  # sr


def volume_light(field, lights, mode, g=0.0):
    """What a baked volume shows of the light in the `Field` of `lights`: (light, others, beams).

    g       mean cosine of the medium's phase function, scalar or (bands,)
    light   (bands, nx, ny, nz) W/(m^2 sr), mean radiance of what comes from many directions
    others  {name of a grid: (bands, nx, ny, nz)}: lb_flux_x ... are the components of the net flux
            of that light over its fluence, from 0 to 1; lb_direct_1 ... the mean radiance of the
            unscattered light that comes from one direction, and lb_forward_1 ... of what has
            scattered by small angles alone since: in W/(m^2 sr) of a sun; in W/sr, over the lamp's
            falloff with a core of a voxel, of a point or spot
    beams   the Sun, PointLight or SpotLight of each lb_direct

    Where it was gathered what light is scattered to, lb_light and lb_moment_1 ... are that, in
    W/(m^2 sr), one for each of `directions.polynomials`; there is no net flux, and lb_forward_1 ...
    are of its lobes.
    Over its source ("ADD") a volume shows scattered light alone: Cycles scatters the rest there.
    Of the paper's field all is shown as if it came evenly from all sides.
    """
    if field.by_light is None:
        return (field.fluence + field.direct) / _SPHERE, {}, []
    numbers = [n for n, light in enumerate(lights) if light.is_beam]
    beams, grids = [lights[n] for n in numbers], []
    if mode == "REPLACE":
        grids.append((direct_grid, field.by_light[numbers]))
    show = _lobe_of_flux if field.scattered is None else _moments
    light, others, ahead = show(field, numbers, beams, mode, g)
    if ahead.any():
        grids.append((forward_grid, ahead))
    for name, own in grids:
        for number, (beam, values) in enumerate(zip(beams, own, strict=True), 1):
            # About a lamp light falls off too fast to be read between voxels; the rest is even.
            steep = 1 if isinstance(beam, Sun) else _falloff(beam, field.domain)
            others[name(number)] = values / (_SPHERE * steep)
    return light, others, beams if grids else []


def _lobe_of_flux(field, numbers, beams, mode, g):
    """(light, others, light that went on forwards by beam): the rest as a lobe about its flux."""
    fluence, flux = field.fluence, field.flux
    if mode == "REPLACE":
        direct = field.direct - field.by_light[numbers].sum(axis=0)
        # Rounding leaves less than nothing where beams are all there is.
        fluence = fluence + np.maximum(direct, 0)
        if field.direct_flux is not None:
            flux = flux + field.direct_flux
            for beam, own in zip(beams, field.by_light[numbers], strict=True):
                flux = flux - way_of(beam, field.domain) * own[:, None]
    ahead = np.zeros((0,))
    if field.forward is not None:
        ahead = np.minimum(field.forward[numbers], field.fluence)
    # Light that was scattered ahead once has the mean cosine g, and counts as 1 in the lattice.
    straight = (1 + np.reshape(g, (-1, 1, 1, 1))) / 2
    for beam, own in zip(beams, ahead, strict=True) if ahead.any() else ():
        fluence = fluence - own
        # Left in the flux, it would hide light that comes back the other way.
        flux = flux - way_of(beam, field.domain) * (straight * own)[:, None]
    fluence = np.maximum(fluence, 0)  # of several beams forward light may be more than there is
    drift = _drift(fluence, flux)
    others = {flux_grid(axis): drift[:, number] for number, axis in enumerate(AXES)}
    return fluence / _SPHERE, others, ahead


def _moments(field, numbers, beams, mode, g):
    """(light, others, lobes by beam) as it was gathered."""
    moments = field.scattered.moments
    if mode == "REPLACE":
        box, ways = Box.all(field.domain.shape), [way_of(beam, field.domain) for beam in beams]
        g = np.broadcast_to(g, len(moments))
        moments = moments + np.array(
            [
                of_lobes(*beside_beams(field, band, numbers, ways, box), own)
                for band, own in enumerate(g)
            ],
            np.float32,
        )
    moments = moments * FACTORS.astype(np.float32).reshape(-1, 1, 1, 1)
    others = {moment_grid(n): moments[:, n] for n in range(1, len(FACTORS))}
    return moments[:, 0], others, field.scattered.lobes


def _falloff(lamp, domain):
    return lamp.mean_falloff(domain, core=domain.voxel_size).astype(np.float32)


def _drift(fluence, flux):
    """(bands, 3, nx, ny, nz), at most 1 long: the flux over the fluence, (bands, nx, ny, nz)."""
    total = fluence[:, None]
    drift = np.divide(flux, total, out=np.zeros_like(flux), where=total > 0)
    return drift / np.maximum(np.linalg.norm(drift, axis=1, keepdims=True), 1)


def flux_grid(axis):
    """The name of the grid of light's mean direction along the axis "X", "Y" or "Z"."""
    return f"lb_flux_{axis.lower()}"


def moment_grid(number):
    """The name of the grid of the light that counts for one of `directions.polynomials`, from 1."""
    return f"lb_moment_{number}"


def direct_grid(number):
    """The name of the grid of the unscattered light of beam `number`, from 1."""
    return f"lb_direct_{number}"


def forward_grid(number):
    """The name of the grid of the light of beam `number`, from 1, that has scattered by small
    angles alone."""
    return f"lb_forward_{number}"


def write_vdb(path, domain, density, light, metadata, others=None, everywhere=None, token=None):
    """Write the grids `density`, `lb_light` and others to `path`, whole or not at all.

    domain    the `Domain` of all
    density   (nx, ny, nz), dimensionless
    light     (1 or 3, nx, ny, nz) mean radiance, W/(m^2 sr)
    metadata  {name: str, int or float}, the settings that made it, stamped on file and grids
    others    {name: (1 or 3, nx, ny, nz)}, see `volume_light`
    everywhere  {name: the same, or (nx, ny, nz)}, see `ambient_grids`: kept in all voxels
    token     of the bake, which tells its files from those that other processes write, see
              `new_token`; or None

    Other light is kept within two voxels of any density, continued outwards at the domain's
    faces, so that interpolation does not darken the border of a cloud.
    Raises OutputError for a folder or disk that cannot take the file, and for a file
    already there that is not ours.
    """
    grids = _grids(domain, density, {LIGHT_GRID: light} | (others or {}))
    grids += [_full_grid(name, domain, v) for name, v in (everywhere or {}).items()]
    _write(Path(path), grids, metadata, token)


def write_empty(path, metadata, like):
    """Write to `path` what `write_vdb` would where there is nothing at all.

    like  path of a whole file that has the same grids
    """
    grids = []
    for other in openvdb.readAllGridMetadata(str(like)):
        grid = type(other)()
        grid.name, grid.transform, grid.gridClass = other.name, other.transform, other.gridClass
        grids.append(grid)
    _write(Path(path), grids, metadata)


def _write(path, grids, metadata, token=None):
    if path.exists() and not is_baked_file(path):
        raise OutputError(f"{path} was not written by LB Lighting; choose another file name.")
    temporary = unfinished(path, token or new_token())
    try:
        _write_checked(temporary, grids, {**metadata, TOKEN: token} if token else metadata)
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(
            f"{path} could not be written; choose a folder that is writable and has free space."
        ) from error
    finally:
        if temporary.exists():
            temporary.unlink()


def new_token():
    """A text that no other bake has."""
    return uuid.uuid4().hex[:12]


def unfinished(path, token):
    """Where the bake of that token keeps the file that is to be `path` until it is whole."""
    return Path(path).with_name(f".{Path(path).name}.{token}.part")


def link_or_copy(old, new):
    """Let the file `old` be found at `new`, too, whole or not at all. Raises OSError."""
    try:
        os.link(old, new)
    except OSError:  # another disk, or one without links
        part = unfinished(new, new_token())
        try:
            shutil.copy2(old, part)
            os.replace(part, new)
        finally:
            part.unlink(missing_ok=True)


def leftovers(path, token):
    """[Path]: the files that the bake of that token has made of `path`, whole or not.

    What another process has written to `path` since is not among them.
    """
    is_own = read_whole(path).get(TOKEN) == token
    return [unfinished(path, token), *([Path(path)] if is_own else [])]


def read_whole(path):
    """As `read_metadata`, but nothing of a file that is damaged, missing or not ours."""
    try:
        with open(path, "rb") as file:
            file.seek(-len(END), os.SEEK_END)
            is_whole = file.read() == END
        return read_metadata(path) if is_whole else {}
    except (OSError, OutputError):
        return {}


def read_metadata(path):
    """{name: value} that `write_vdb` stamped on the file at `path`; OutputError if it did not."""
    found = _metadata(path)
    if found.get("creator") != CREATOR:
        raise OutputError(f"{path} was not written by LB Lighting; bake it again.")
    return {key.removeprefix(STAMP): found[key] for key in found if key.startswith(STAMP)}


def is_baked_file(path):
    """True if `path` is a file that `write_vdb` wrote."""
    return _metadata(path).get("creator") == CREATOR


def _metadata(path):
    """{name: value} of a file, and nothing of one that cannot be read."""
    try:
        return openvdb.readMetadata(str(path))
    except Exception:  # what OpenVDB makes of a damaged file is anything
        return {}


def _grids(domain, density, colors):
    """All that `write_vdb` writes as OpenVDB grids, sparse where there is nothing to light."""
    seen = np.asarray(density) > 0
    if EMISSION_GRID in colors:
        seen |= colors[EMISSION_GRID].any(axis=0)
    near = _near(seen, MARGIN)[..., None].repeat(3, axis=-1)
    grids = [_grid(DENSITY_GRID, domain, np.asarray(density, np.float32), 0)]
    grids[0].gridClass = openvdb.GridClass.FOG_VOLUME
    for name, values in colors.items():
        values = np.moveaxis(np.broadcast_to(values, (3, *domain.shape)), 0, -1)
        values = np.pad(values, [(MARGIN, MARGIN)] * 3 + [(0, 0)], mode="edge")
        values *= near
        grids.append(_grid(name, domain, values, MARGIN))
    return grids


def _full_grid(name, domain, values):
    """An OpenVDB grid of all `values`, (nx, ny, nz) or, of colours, (1 or 3, nx, ny, nz)."""
    if values.ndim == 4:
        values = np.moveaxis(np.broadcast_to(values, (3, *domain.shape)), 0, -1)
    return _grid(name, domain, values, margin=0)


def _grid(name, domain, values, margin):
    """An OpenVDB grid of `values` that begin `margin` voxels outside of the domain.

    values  (nx, ny, nz) or (nx, ny, nz, 3)
    """
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
    openvdb.write(str(path), grids, {"creator": CREATOR, **stamps})
    # OpenVDB truncates silently on a full disk; some bytes more, which its readers ignore, make
    # the system say so, and tell what is whole.
    with open(path, "ab") as file:
        file.write(END)
        file.flush()
        os.fsync(file.fileno())
    try:  # after a part that was not written nothing is, so the last grid tells of all
        openvdb.read(str(path), grids[-1].name)
    except (LookupError, RuntimeError) as error:
        raise OSError(f"{path} is not whole") from error
