# SPDX-License-Identifier: GPL-3.0-or-later
"""The .vdb file of a lit volume. Needs no Blender; the solver's process writes it."""

import os
import shutil
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import openvdb

from ..arrays import Array, Booleans, Floats
from ..errors import OutputError
from ..transport.medium import Domain

LIGHT_GRID = "lb_light"
AXES = ("X", "Y", "Z")
DENSITY_GRID = "density"
EMISSION_GRID = "lb_emission"  # W/(m^3 sr), the medium's own emission
CREATOR = "LB Lighting"
STAMP = "lb_lighting:"  # prefix of our metadata, against OpenVDB's own keys (name, class, …)
TOKEN = "token"  # of the bake that wrote the file
END = b"\0LB Lighting wrote all of this."  # ends a complete file; readers of OpenVDB ignore it

# Cubic interpolation, the widest that Cycles has, reads two voxels away.
MARGIN = 2

type Metadata = Mapping[str, str | int | float]


def flux_grid(axis: str) -> str:
    """The name of the grid of light's mean direction along the axis "X", "Y" or "Z"."""
    return f"lb_flux_{axis.lower()}"


def moment_grid(number: int) -> str:
    """The name of the grid of the light's moment with polynomial `number`, from 1, see
    `quadrature.polynomials`."""
    return f"lb_moment_{number}"


def direct_grid(number: int) -> str:
    """The name of the grid of the uncollided light of beam `number`, from 1."""
    return f"lb_direct_{number}"


def forward_grid(number: int) -> str:
    """The name of the grid of the light of beam `number`, from 1, that has scattered only by small
    angles."""
    return f"lb_forward_{number}"


def write_vdb(
    path: Path | str,
    domain: Domain,
    density: Array,
    light: Array,
    metadata: Metadata,
    others: Mapping[str, Array] | None = None,
    everywhere: Mapping[str, Array] | None = None,
    token: str | None = None,
) -> None:
    """Write the grids `density`, `lb_light` and others to `path`, completely or not at all.

    domain    of all grids
    density   (nx, ny, nz), dimensionless
    light     (1 or 3, nx, ny, nz) mean radiance, W/(m^2 sr)
    metadata  the settings of the bake, stored in the file and in each grid
    others    {name: (1 or 3, nx, ny, nz)}, see `volume_light`
    everywhere  {name: the same, or (nx, ny, nz)}, see `ambient_grids`: stored in all voxels
    token     of the bake, which sets its files apart from those of other processes, see `new_token`

    Light in `light` and `others` is stored within two voxels of any density, and continued outwards
    at the domain's faces, so that interpolation does not darken the border of a cloud.
    Raises OutputError for a folder or disk that cannot take the file, and for an existing file that
    is not ours.
    """
    grids = _grids(domain, density, {LIGHT_GRID: light, **(others or {})})
    grids += [_full_grid(name, domain, v) for name, v in (everywhere or {}).items()]
    _write(Path(path), grids, metadata, token)


def write_empty(path: Path | str, metadata: Metadata, like: Path | str) -> None:
    """Write an empty frame to `path`: the grids of a `write_vdb` file, without any voxels.

    like  path of a complete file that has the same grids
    """
    grids = []
    for other in openvdb.readAllGridMetadata(str(like)):
        grid = type(other)()
        grid.name, grid.transform, grid.gridClass = other.name, other.transform, other.gridClass
        grids.append(grid)
    _write(Path(path), grids, metadata)


def _write(path: Path, grids: list[Any], metadata: Metadata, token: str | None = None) -> None:
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


def new_token() -> str:
    """A text that no other bake has."""
    return uuid.uuid4().hex[:12]


def unfinished(path: Path | str, token: str) -> Path:
    """The path at which the bake of that token writes the file `path` until it is complete."""
    return Path(path).with_name(f".{Path(path).name}.{token}.part")


def link_or_copy(old: Path, new: Path) -> None:
    """Make the file `old` available at `new` too, completely or not at all. Raises OSError."""
    try:
        os.link(old, new)
    except OSError:  # on another disk, or on one without links
        part = unfinished(new, new_token())
        try:
            shutil.copy2(old, part)
            os.replace(part, new)
        finally:
            part.unlink(missing_ok=True)


def leftovers(path: Path | str, token: str) -> list[Path]:
    """The files, complete or not, that the bake of that token wrote for `path`.

    A file that another process has since written to `path` is not among them.
    """
    is_its_file = read_whole(path).get(TOKEN) == token
    return [unfinished(path, token), *([Path(path)] if is_its_file else [])]


def read_whole(path: Path | str) -> dict[str, Any]:
    """The metadata of a complete file as `read_metadata` returns it.

    {} for a file that is incomplete, damaged, missing or not ours.
    """
    try:
        with open(path, "rb") as file:
            file.seek(-len(END), os.SEEK_END)
            is_complete = file.read() == END
        return read_metadata(path) if is_complete else {}
    except (OSError, OutputError):
        return {}


def read_metadata(path: Path | str) -> dict[str, Any]:
    """{name: value} that `write_vdb` stored in the file at `path`. Raises OutputError for a file
    that is not ours."""
    metadata = _metadata(path)
    if metadata.get("creator") != CREATOR:
        raise OutputError(f"{path} was not written by LB Lighting; bake it again.")
    return {key.removeprefix(STAMP): metadata[key] for key in metadata if key.startswith(STAMP)}


def is_baked_file(path: Path | str) -> bool:
    """True if `write_vdb` wrote the file at `path`."""
    return bool(_metadata(path).get("creator") == CREATOR)


def _metadata(path: Path | str) -> dict[str, Any]:
    """All metadata of a file, or {} if it cannot be read."""
    try:
        metadata: dict[str, Any] = openvdb.readMetadata(str(path))
        return metadata
    except Exception:  # OpenVDB may raise anything for a damaged file
        return {}


def _grids(domain: Domain, density: Array, colors: Mapping[str, Array]) -> list[Any]:
    """The density and the `colors` as OpenVDB grids, sparse where there is nothing to light."""
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


def _full_grid(name: str, domain: Domain, values: Array) -> Any:
    """An OpenVDB grid of all `values`, (nx, ny, nz) or, for colours, (1 or 3, nx, ny, nz)."""
    if values.ndim == 4:
        values = np.moveaxis(np.broadcast_to(values, (3, *domain.shape)), 0, -1)
    return _grid(name, domain, values, margin=0)


def _grid(name: str, domain: Domain, values: Floats, margin: int) -> Any:
    """An OpenVDB grid of `values` that begin `margin` voxels outside the domain.

    values  (nx, ny, nz) or (nx, ny, nz, 3)
    """
    grid = openvdb.FloatGrid() if values.ndim == 3 else openvdb.Vec3SGrid()
    grid.copyFromArray(np.ascontiguousarray(values, np.float32), ijk=(-margin,) * 3)
    grid.name = name
    # OpenVDB's voxel centres are at integers, like ours; its matrices multiply from the right.
    grid.transform = openvdb.createLinearTransform(domain.index_to_world.T.tolist())
    return grid


def _near(mask: Booleans, margin: int) -> Booleans:
    """`mask` grown by `margin` voxels in every direction, in an array larger by that margin."""
    mask = np.pad(mask, 2 * margin)
    for axis in range(3):
        windows = np.lib.stride_tricks.sliding_window_view(mask, 2 * margin + 1, axis)
        mask = windows.any(axis=-1)
    return mask


def _write_checked(path: Path, grids: Iterable[Any], metadata: Metadata) -> None:
    """Write `grids` to `path`. Raises OSError if the file is incomplete."""
    grids = list(grids)
    stamps = {STAMP + name: value for name, value in metadata.items()}
    for grid in grids:
        grid.updateMetadata(stamps)
    openvdb.write(str(path), grids, {"creator": CREATOR, **stamps})
    # OpenVDB truncates silently on a full disk. These bytes make the system report that, and mark
    # the file as complete.
    with open(path, "ab") as file:
        file.write(END)
        file.flush()
        os.fsync(file.fileno())
    try:  # after a part that was not written comes nothing, so the last grid proves the others
        openvdb.read(str(path), grids[-1].name)
    except (LookupError, RuntimeError) as error:
        raise OSError(f"{path} is incomplete") from error
