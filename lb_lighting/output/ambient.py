# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that falls on vertices, or wherever a modifier asks. Needs no Blender.

It is the scattered light that a `Field` has as its fluence and flux, or all light, see
`Field.with_unscattered`.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from .vdb import AXES

AMBIENT_ATTRIBUTE = "lb_ambient"
BACK_ATTRIBUTE = "lb_ambient_back"
WHOLE_ATTRIBUTE = "lb_whole"  # 1 where these are all light that there is
OPEN_GRID = "lb_open"
STAND_OFF = 0.75  # voxels in front of a wall: where its light is taken, not from its other side
LEAST_OPEN = 1e-3  # share of the voxels around a point, below which it is dark


@dataclass(frozen=True)
class Vertices:
    """The vertices of a surface that is to show light.

    mesh     `Mesh`, see scene/meshes.py
    to_world (4, 4), from its space to world space
    is_body  whether it is filled with light: both sides show what comes out of it
    is_wall  whether it stops all light: its two sides are lit apart from each other
    """

    mesh: object
    to_world: np.ndarray
    is_body: bool = False
    is_wall: bool = False

    def light(self, field, occlusion=None):
        """(2, n, 4) float32: irradiance / pi of the front and of the back, W/(m^2 sr), alpha 1.

        field      a `Field`: its fluence and flux are what shows; other light is Cycles' own
        occlusion  (nx, ny, nz) of the medium, whose opaque voxels are dark, or None
        """
        points, normals = self._in_world()
        if not self.is_wall:
            front, back = irradiance(field, points, normals, occlusion)
        else:
            off = STAND_OFF * field.domain.voxel_size * normals
            front, _ = irradiance(field, points + off, normals, occlusion)
            _, back = irradiance(field, points - off, normals, occlusion)
        colors = np.ones((2, len(points), 4), np.float32)
        colors[..., :3] = np.divide((back, back) if self.is_body else (front, back), np.pi)
        return colors

    def _in_world(self):
        """(points (n, 3) m, unit normals (n, 3)) in world space."""
        turn = self.to_world[:3, :3]
        # Normals turn with the cofactors, which exist for what is scaled flat, too.
        cofactors = np.cross(np.roll(turn, -1, axis=0), np.roll(turn, -2, axis=0))
        # Cycles keeps the front of what is mirrored.
        cofactors *= np.copysign(1, np.linalg.det(turn))
        normals = self.mesh.normals @ cofactors.T
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.maximum(length, np.finfo(float).tiny)
        return self.mesh.points @ turn.T + self.to_world[:3, 3], normals


def irradiance(field, points, normals, occlusion=None):
    """(front, back), each (n, bands) W/m^2: what falls on surfaces from the light of a `Field`.

    points, normals  (n, 3) m and unit vectors, world space
    occlusion        (nx, ny, nz) or None: what of each voxel holds no light

    Radiance is taken to be linear in direction, with the moments phi (fluence) and J (flux): then
    what arrives at the side of the normal n is phi/4 - J.n/2, which cannot be negative.
    """
    bands = len(field.fluence)
    moments = np.concatenate([field.fluence, field.flux.reshape(3 * bands, *field.domain.shape)])
    moments = sample(field.domain, moments, points)
    if occlusion is not None:  # voxels count by what of them is open
        moments /= np.maximum(sample(field.domain, 1 - occlusion[None], points), LEAST_OPEN)
    fluence, flux = moments[:, :bands], moments[:, bands:].reshape(-1, bands, 3)
    along = np.einsum("nba,na->nb", flux, normals)
    return np.maximum(0, fluence / 4 - along / 2), np.maximum(0, fluence / 4 + along / 2)


def sample(domain, values, points):
    """Trilinear samples of a voxel field; outside of the domain, the value at its border.

    values  (bands, nx, ny, nz), at the voxel centres of `domain`
    points  (n, 3) m, world space
    Returns (n, bands).
    """
    last = np.subtract(domain.shape, 1)
    position = np.clip(domain.to_index(points), 0, last)
    low = np.floor(position).astype(int)
    fraction = position - low
    by_voxel = np.ascontiguousarray(np.moveaxis(values, 0, -1))  # one place to look at, not many
    result = np.zeros((len(position), len(values)))
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.where(corner, fraction, 1 - fraction).prod(axis=1)
        x, y, z = np.minimum(low + corner, last).T
        result += weight[:, None] * by_voxel[x, y, z]
    return result


def ambient_axis(axis):
    """The name of the attribute of instances, and of the grid, for the axis "X", "Y" or "Z"."""
    return f"{AMBIENT_ATTRIBUTE}_{axis.lower()}"


def ambient_grids(field, occlusion=None):
    """{name: (bands, nx, ny, nz)}: what the modifier reads, of the light in a `Field`.

    occlusion  (nx, ny, nz) of the medium, whose opaque voxels are dark, or None

    With fluence phi and flux J, in W/m^2: lb_ambient is phi / (4 pi), lb_ambient_x ... are the
    components of J / (2 pi), by band; a side of normal n then has lb_ambient - lb_ambient_xyz . n,
    which is `irradiance` over pi. lb_open, (nx, ny, nz), is the share of a voxel that
    holds light.
    """
    grids = {AMBIENT_ATTRIBUTE: field.fluence / (4 * np.pi)}
    for number, axis in enumerate(AXES):
        grids[ambient_axis(axis)] = field.flux[:, number] / (2 * np.pi)
    grids[OPEN_GRID] = np.ones(field.domain.shape) if occlusion is None else 1 - occlusion
    return grids
