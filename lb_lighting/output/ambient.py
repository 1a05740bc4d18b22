# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that falls on vertices, and the grids from which a modifier computes it anywhere.

It is the scattered light of a `Field`, as its fluence and flux, or all light, see
`Field.with_uncollided`. Needs no Blender.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Floats
from ..scene.meshes import Mesh
from ..transport.field import Field
from ..transport.medium import Domain
from .vdb import AXES

AMBIENT_ATTRIBUTE = "lb_ambient"
BACK_ATTRIBUTE = "lb_ambient_back"
WHOLE_ATTRIBUTE = "lb_whole"  # 1 where the others contain all light
OPEN_GRID = "lb_open"
STAND_OFF = 0.75  # voxels; the distance from a wall at which its light is sampled on either side
LEAST_OPEN = 1e-3  # open share of the voxels around a point below which the point is dark


@dataclass(frozen=True)
class Vertices:
    """The vertices of a surface that will show light.

    mesh     its mesh
    to_world (4, 4), its space to world space
    is_body  whether light fills it: both sides show the light that leaves it
    is_wall  whether it is opaque: its two sides are lit separately
    """

    mesh: Mesh
    to_world: Floats
    is_body: bool = False
    is_wall: bool = False

    def light(self, field: Field, occlusion: Floats | None = None) -> Floats:
        """(2, n, 4) float32: irradiance / pi of the front and the back, W/(m^2 sr), with alpha 1.

        field      its fluence and flux are shown; Cycles adds other light
        occlusion  (nx, ny, nz) of the medium, whose opaque voxels are dark, or None
        """
        points, normals = self._in_world()
        if not self.is_wall:
            front, back = irradiance(field, points, normals, occlusion)
        else:
            offset = STAND_OFF * field.domain.voxel_size * normals
            front, _ = irradiance(field, points + offset, normals, occlusion)
            _, back = irradiance(field, points - offset, normals, occlusion)
        colors = np.ones((2, len(points), 4), np.float32)
        colors[..., :3] = np.divide((back, back) if self.is_body else (front, back), np.pi)
        return colors

    def _in_world(self) -> tuple[Floats, Floats]:
        """(points (n, 3) m, unit normals (n, 3)) in world space."""
        linear = self.to_world[:3, :3]
        # Transform normals by the cofactors, which exist even for a flat scale.
        cofactors = np.cross(np.roll(linear, -1, axis=0), np.roll(linear, -2, axis=0))
        # Cycles keeps the front of a mirrored mesh.
        cofactors *= np.copysign(1, np.linalg.det(linear))
        normals = self.mesh.normals @ cofactors.T
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.maximum(length, np.finfo(float).tiny)
        return self.mesh.points @ linear.T + self.to_world[:3, 3], normals


def irradiance(
    field: Field, points: Floats, normals: Floats, occlusion: Floats | None = None
) -> tuple[Floats, Floats]:
    """(front, back), each (n, bands) W/m^2: the light of a `Field` that falls on surfaces.

    points, normals  (n, 3) m and unit vectors, world space
    occlusion        (nx, ny, nz) or None: the share of each voxel that holds no light

    Radiance is assumed to be linear in direction, with the moments phi (fluence) and J (flux).
    Then phi/4 - J.n/2 arrives at the side of the normal n; it is clipped at 0.
    """
    assert field.flux is not None  # only a trace can lack it
    bands = len(field.fluence)
    moments = np.concatenate([field.fluence, field.flux.reshape(3 * bands, *field.domain.shape)])
    moments = sample(field.domain, moments, points)
    if occlusion is not None:  # weigh voxels by their open share
        moments /= np.maximum(sample(field.domain, 1 - occlusion[None], points), LEAST_OPEN)
    fluence, flux = moments[:, :bands], moments[:, bands:].reshape(-1, bands, 3)
    along = np.einsum("nba,na->nb", flux, normals)
    return np.maximum(0, fluence / 4 - along / 2), np.maximum(0, fluence / 4 + along / 2)


def sample(domain: Domain, values: Floats, points: Floats) -> Floats:
    """Trilinear samples of a voxel field; outside the domain, the value at its border.

    values  (bands, nx, ny, nz), at the voxel centres of `domain`
    points  (n, 3) m, world space
    Returns (n, bands).
    """
    last = np.subtract(domain.shape, 1)
    position = np.clip(domain.to_index(points), 0, last)
    low = np.floor(position).astype(int)
    fraction = position - low
    by_voxel = np.ascontiguousarray(np.moveaxis(values, 0, -1))  # reads one place, not many
    result = np.zeros((len(position), len(values)))
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.where(corner, fraction, 1 - fraction).prod(axis=1)
        x, y, z = np.minimum(low + corner, last).T
        result += weight[:, None] * by_voxel[x, y, z]
    return result


def ambient_axis(axis: str) -> str:
    """The name of the attribute of instances, and of the grid, for the axis "X", "Y" or "Z"."""
    return f"{AMBIENT_ATTRIBUTE}_{axis.lower()}"


def ambient_grids(field: Field, occlusion: Floats | None = None) -> dict[str, Array]:
    """{name: (bands, nx, ny, nz)}: the grids that the modifier reads.

    occlusion  (nx, ny, nz) of the medium, whose opaque voxels are dark, or None

    With fluence phi and flux J, in W/m^2: lb_ambient is phi / (4 pi), and lb_ambient_x, _y and _z
    are the components of J / (2 pi), by band. A side of normal n then gets
    lb_ambient - lb_ambient_xyz . n, which is `irradiance` over pi. lb_open, (nx, ny, nz), is the
    share of a voxel that holds light.
    """
    assert field.flux is not None
    grids: dict[str, Array] = {AMBIENT_ATTRIBUTE: field.fluence / (4 * np.pi)}
    for number, axis in enumerate(AXES):
        grids[ambient_axis(axis)] = field.flux[:, number] / (2 * np.pi)
    grids[OPEN_GRID] = np.ones(field.domain.shape) if occlusion is None else 1 - occlusion
    return grids
