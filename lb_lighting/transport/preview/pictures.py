# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a lit medium by free path sampling alone: nothing is solved or stored.

A path enters the medium from the camera. At each collision another free path is drawn towards each
sun and point light, and the light counts if the path arrives (next-event estimation); the sky
counts where a path leaves after a collision. The pictures are therefore unbiased estimates of the
solution of the transfer equation, in any density, and averaging removes the noise.

kernels/preview/preview.cl follows the paths; `NumpyEye` is its twin.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from math import prod
from time import perf_counter
from typing import Any

import numpy as np

from ...arrays import Floats, Integers, Vector
from ...errors import (
    LightError,
    MediumError,
    SettingsError,
    require_whole,
)
from .. import device as devices
from ..backend import backend_of
from ..device import Device
from ..lights.base import Light, by_band
from ..lights.distant import Sky, Sun
from ..lights.lamps import PointLight
from ..medium import Domain, Medium
from ..memory import FLOAT, Footprint, require_memory
from ..photons.free_path import path_grid, refuse_violations
from ..photons.path_grid import PathGrid, enter
from ..photons.perlin import PerlinMedium
from ..photons.tallies import Opaque

_COARSEST = 8  # spacing, in pixels, of those that are sampled first
_PIECE = 0.2  # s, the time that a piece of a picture should take
_MOST_STEPS = 2 * 10**5  # of a path, before it is abandoned: some milliseconds
_ANY = 2**30  # scatterings of a path


@dataclass(frozen=True)
class View:
    """A camera.

    matrix       (3, 4) or (4, 4): as columns, its axes to the right, up and back, and its position
                 in m: the unscaled `matrix_world` of a Blender camera
    height       of the picture, m; with perspective, of the view at a distance of 1
    size         (width, height) in pixels
    perspective  whether rays start at the camera's position instead of a plane through it
    """

    matrix: Floats
    height: float
    size: tuple[int, int] = (160, 120)
    perspective: bool = False

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, float)
        fits = matrix.shape in ((3, 4), (4, 4)) and np.all(np.isfinite(matrix))
        if not fits or not 0 < self.height < np.inf:
            raise SettingsError("A view needs a matrix of 3 or 4 rows of 4, and a height.")
        for edge in self.size:
            require_whole(edge, "picture's edge in pixels", 1, 2**14)
        object.__setattr__(self, "matrix", matrix)

    @classmethod
    def onto(
        cls,
        domain: Domain,
        direction: Vector,
        up: Vector = (0, 0, 1),
        size: tuple[int, int] = (160, 120),
    ) -> "View":
        """A view of a whole `Domain` without perspective, along `direction` (3,)."""
        back = -np.divide(direction, np.linalg.norm(direction))
        right = np.cross(up, back)
        if np.linalg.norm(right) < 1e-6:  # from above or below
            right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(back, right), back])
        extent = np.subtract(domain.upper, domain.origin)
        width, height, depth = np.abs(axes) @ extent
        center = np.add(domain.origin, extent / 2) + back * depth
        height = max(height, width * size[1] / size[0])
        return cls(np.column_stack([axes.T, center]), float(height), (size[0], size[1]))

    def rays(self, pixels: Integers, within: Floats) -> tuple[Floats, Floats]:
        """Origins in m and directions, (n, 3) each, of rays through pixels (n,), counted row by row
        from the lower left; `within` (n, 2) are the places in the pixels, in [0, 1)."""
        columns, rows = self.size
        place = np.stack([pixels % columns, pixels // columns], axis=1) + within
        x, y = ((place - np.divide(self.size, 2)) * (self.height / rows)).T
        right, up, back, position = self.matrix[:3].T
        on_plane = x[:, None] * right + y[:, None] * up
        if self.perspective:
            return np.tile(position, (len(x), 1)), on_plane - back
        return position + on_plane, np.tile(-back, (len(x), 1))


@dataclass(frozen=True)
class Picture:
    """The mean of all paths so far.

    pixels   (height, width, 4) float32, the lower row first as in Blender: linear red, green and
             blue, W/(m^2 sr), and the share of rays that met something. It excludes the light of
             the background, so it can be composited over any background
    samples  mean number of paths per pixel
    lost     share of paths that were abandoned because they took too long; their light is missing
    """

    pixels: Floats
    samples: float
    lost: float


def pictures(
    medium: Medium | PerlinMedium,
    lights: Sequence[Light],
    view: View,
    device: Device | str | None = None,
    seed: int = 0,
    *,
    sampler: str = "supervoxel_constant",
    scatterings: int | None = None,
) -> Iterator[Picture]:
    """An endless series of ever better `Picture`s; the generator may be closed at any time.

    medium       of one band or three, with its emission and opaque voxels (those on the domain's
                 faces are seen from inside only). Its shift between bands is ignored
    lights       `Sun`s, `Sky`s and `PointLight`s; the shadow density of a sun is ignored
    view         `View`
    device       None for the best, or part of the label of one of `device.devices()`
    seed         0 to 2^32 - 1; on a given device, it determines pictures of whole samples
    sampler      one of free_path.SAMPLERS; the default is the quickest to prepare
    scatterings  the largest number of scatterings; 1 for single scattering, None for all
    The first picture is coarse; the first with a sample in each pixel follows soon. Each picture
    takes about another fifth of a second.
    Raises MediumError, LightError, SettingsError, DeviceError, or SolverError where the density
    exceeds its majorant, which would bias the pictures.
    """
    require_whole(seed, "seed", 0, 2**32 - 1)
    if scatterings is not None:
        require_whole(scatterings, "number of scatterings", 1, _ANY)
    least = -(-prod(view.size) // _COARSEST**2)
    camera = _Camera(medium, lights, view, devices.choose(device), sampler, scatterings or _ANY)
    order, piece = _coarse_first(view.size), least
    sums, samples = np.zeros((len(order), 4)), np.zeros(len(order), int)
    for sample in count():
        rng = np.random.default_rng([seed, sample])
        within, stream = rng.random((len(order), 2)), rng.integers(2**32)
        first = 0
        while first < len(order):
            pixels = order[first : first + piece]
            start = perf_counter()
            sums[pixels] += camera(pixels, within[pixels], int(stream))
            faster = _PIECE / max(perf_counter() - start, 1e-6)
            samples[pixels] += 1
            first += piece
            piece = int(np.clip(piece * np.clip(faster, 0.25, 4), least, len(order)))
            done = int(samples.sum())
            yield Picture(_filled(sums, samples, view.size), done / len(order), camera.lost / done)


class _Camera:
    """Takes one sample of pixels at a time; holds the state that all samples share."""

    def __init__(
        self,
        medium: Medium | PerlinMedium,
        lights: Sequence[Light],
        view: View,
        device: Device,
        sampler: str,
        scatterings: int,
    ) -> None:
        if medium.bands not in (1, 3):
            raise MediumError(f"A preview shows one band or three; the medium has {medium.bands}.")
        require_memory(device, medium.shape, lambda shape: _footprint(shape, medium))
        self.medium, self.view, self.scatterings = medium, view, scatterings
        self.lost: Any = 0.0  # a sum of NumPy floats, in their precision
        self.skies = [light.seen(medium.bands) for light in lights if isinstance(light, Sky)]
        self.grid = path_grid(medium, sampler, device=device)
        emission, opaque = _shining(medium), _opaque(medium)
        targets = _targets(lights, medium, self.grid)
        self.eye = backend_of(device).eye(self.grid, targets, emission, opaque)
        optics = list(zip(medium.sigma_t, medium.g, strict=True))
        self.alike = [[n for n, o in enumerate(optics) if o == shared] for shared in {*optics}]

    def __call__(self, pixels: Integers, within: Floats, stream: int) -> Floats:
        """(n, 4): light in three bands, and whether the path met something, for each pixel."""
        origins, directions = self.view.rays(pixels, within)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        _, inside, hit = enter(self.grid, origins, directions)
        sample = np.zeros((len(pixels), 4))
        if not hit.any():
            return sample
        rays = np.concatenate([inside[hit], directions[hit]], axis=1, dtype=np.float32).T
        for bands in self.alike:
            light, met = self._see(np.ascontiguousarray(rays), pixels[hit], stream, bands[0])
            channels = bands if self.medium.bands == 3 else [0, 1, 2]
            sample[np.ix_(np.flatnonzero(hit), channels)] = light[:, channels]
            sample[hit, 3] += met * (len(bands) / self.medium.bands)
        return sample

    def _see(self, rays: Floats, pixels: Integers, stream: int, band: int) -> tuple[Floats, Floats]:
        """Light in three bands, (n, 3), and whether something was met, for the paths of a band."""
        medium = self.medium
        seen, left, violations = self.eye.see(
            *(rays, pixels, self.grid.per_depth(band), stream, _MOST_STEPS, self.scatterings),
            *(np.broadcast_to(medium.albedo, 3), medium.g[band]),
        )
        refuse_violations(violations)
        self.lost += left[:, 3].sum() / len(self.alike)
        for radiance in self.skies:
            seen[:, :3] += left[:, 4:7] * radiance(left[:, :3])
        return seen[:, :3], seen[:, 3]


def _footprint(shape: Sequence[int], medium: Medium | PerlinMedium) -> Footprint:
    """The memory of pictures of a medium of `shape` voxels."""
    voxels = 0 if isinstance(medium, PerlinMedium) else prod(shape)
    shining, opaque = medium.emission is not None, medium.occlusion is not None
    buffers = {
        "density and its majorants": 2 * FLOAT * voxels,
        "emission": 4 * FLOAT * voxels * shining,
        "opaque voxels": 5 * FLOAT * voxels * opaque,
    }
    return Footprint(buffers, {"density and its majorants": 2 * FLOAT * voxels})


def _targets(lights: Sequence[Light], medium: Medium | PerlinMedium, grid: PathGrid) -> Floats:
    """(n, 8) float32: the suns and point lights, in the format of kernels/preview/preview.cl."""
    targets: list[tuple[float, ...]] = []
    for light in lights:
        if isinstance(light, Sun):
            toward = -np.divide(light.direction, np.linalg.norm(light.direction))
            place, scale = (*toward, 0), 1.0
        elif isinstance(light, PointLight):
            place, scale = (*grid.fine_from_world(light.position), 1), 4 * np.pi
            scale = 1 / (scale * medium.voxel_size**2)
        elif isinstance(light, Sky):
            continue
        else:
            raise LightError(f"A preview shows suns, skies and point lights; leave {light!r} out.")
        sent = np.broadcast_to(by_band(light.spectrum, medium.bands), 3)
        targets.append((*place, *(scale * sent), 0))
    return np.array(targets, np.float32).reshape(-1, 8)


def _shining(medium: Medium | PerlinMedium) -> Floats | None:
    """(voxels, 4) float32 W/(m^2 sr) that the medium emits over a voxel's edge; or None."""
    if medium.emission is None:
        return None
    return _three_bands(medium.emission * np.float32(medium.voxel_size / (4 * np.pi)))


def _opaque(medium: Medium | PerlinMedium) -> Opaque | None:
    """(occlusion (nx, ny, nz), its albedo (voxels, 4)), float32; or None."""
    if medium.occlusion is None:
        return None
    albedo = np.asarray(medium.occlusion_albedo)
    albedo = albedo[:, None, None, None] if albedo.ndim == 1 else albedo
    albedo = np.broadcast_to(albedo, (medium.bands, *medium.shape))
    return medium.occlusion, _three_bands(albedo)


def _three_bands(grids: Floats) -> Floats:
    """Grids of one band or three, (bands, nx, ny, nz), as (voxels, 4); the last column is empty."""
    bands, *shape = grids.shape
    values = np.zeros((prod(shape), 4), np.float32)
    values[:, :3] = grids.reshape(bands, -1).T
    return values


def _coarse_first(size: tuple[int, int]) -> Integers:
    """The pixels of a picture: those of a coarse lattice first, then of ever finer ones."""
    columns, rows = size
    y, x = np.indices((rows, columns)).reshape(2, -1)
    place = x | y | _COARSEST
    return np.argsort(-(place & -place), kind="stable")  # largest power of two in both


def _filled(sums: Floats, samples: Integers, size: tuple[int, int]) -> Floats:
    """(height, width, 4) float32: means; pixels without samples take those of coarser lattices."""
    columns, rows = size
    means = sums / np.maximum(samples, 1)[:, None]
    pixels = means.astype(np.float32).reshape(rows, columns, 4)
    empty = samples.reshape(rows, columns) == 0
    stride = _COARSEST // 2
    while stride and empty.any():
        y, x = np.nonzero(empty[::stride, ::stride])
        y, x, coarse = y * stride, x * stride, 2 * stride
        pixels[y, x] = pixels[y - y % coarse, x - x % coarse]
        stride //= 2
    return pixels
