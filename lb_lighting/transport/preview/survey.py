# SPDX-License-Identifier: GPL-3.0-or-later
"""Statistics of a medium from free path samples, before anything is baked, and advice from them.

Rays start like the light of a uniform sky, cosine-distributed, at the border of the box that holds
all matter. Their mean length through a convex box is 4 V / S (Cauchy), and they sample it evenly.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from time import perf_counter
from typing import Any

import numpy as np

from ...arrays import Array, Floats
from ...errors import require_whole
from ..device import Device
from ..lights.distant import Sky
from ..medium import BaseMedium, Domain, Medium
from ..photons.free_path import SAMPLERS, FreePathSampler
from ..photons.perlin import PerlinMedium

_RAYS, _FEWEST_RAYS = 2**16, 2**8
_TIMED = 0.1  # s, the least time of timing a sampler, unless all rays take less
_BINS = 48
_VOXELS_OF_NOISE = 64  # along an edge: noise itself is never integrated

# Optical depth times albedo up to which multiply scattered light is less than 5 % of a picture
# (7 % if the medium scatters forward, away from the camera), and the albedo up to which this holds
# at any depth: docs/theory/free-paths.md, "Preview".
_THIN, _DARK = 0.05, 0.04
# Edge of a voxel in transport mean free paths: below the first, more voxels do not improve light
# (docs/theory/physics.md, "By resolution"); above the second, voxels are divided, as they are above
# the last, in diffusion lengths, because of absorption ("Voxels that are too thick").
_RESOLVED, _THICKEST, _DARKEST = 0.5, 3.0, 0.9
_DENSE = 10.0  # optical depth from which a medium is called dense
_MOST_VOXELS = 512  # along an edge, the largest number that is advised
_STEP = 8  # of the numbers of voxels that are advised


@dataclass(frozen=True)
class Sampling:
    """The speed of one sampler.

    acceptance   real collisions over tentative ones, NaN where there were none
    rays_a_second
    preparation  s, for its majorants
    """

    acceptance: float
    rays_a_second: float
    preparation: float


@dataclass(frozen=True)
class Statistics:
    """Statistics of a medium's free paths, in the band of its largest extinction.

    band             that band
    rays             number of rays that were drawn
    counts           (bins,) of free paths that ended in the medium, by length
    edges            (bins + 1,) m, of the bins
    even             (bins,) expected counts of a homogeneous medium of the same mean free path
    mean_free_path   m flown in that box for each collision; infinite where nothing collides
    in_matter        m, the mean free path inside matter: in a voxel of `voxel_depth`
    escaped          share of rays that left without a collision
    depth_mean       (3,) optical depth through the domain along x, y and z, mean of all columns
    depth_max        (3,) that of the deepest column
    voxel_depth_max  optical depth of the edge of the densest voxel
    voxel_depth      mean of that over all voxels, weighted by their density
    void             share of voxels that are empty
    voxels           along the longest edge
    albedo, g        of the band
    samplers         {name: `Sampling`}
    Of a PerlinMedium, depths and voxels are those of 64 points along an edge.
    """

    band: int
    rays: int
    counts: Floats
    edges: Floats
    even: Floats
    mean_free_path: float
    in_matter: float
    escaped: float
    depth_mean: tuple[float, ...]
    depth_max: tuple[float, ...]
    voxel_depth_max: float
    voxel_depth: float
    void: float
    voxels: int
    albedo: float
    g: float
    samplers: dict[str, Sampling]


def statistics(
    medium: Medium | PerlinMedium,
    device: Device | str | None = None,
    seed: int = 0,
    rays: int = _RAYS,
    samplers: Sequence[str] = SAMPLERS,
) -> Statistics:
    """The `Statistics` of a medium, from free paths of a number of rays.

    device    None for the best, or part of the label of one of `device.devices()`
    samplers  those of free_path.SAMPLERS to time; each takes about 0.2 s after its preparation
    Opaque voxels are ignored. Raises SettingsError or DeviceError.
    """
    require_whole(rays, "number of rays", 1, 2**24)
    band = int(np.argmax(medium.sigma_t))
    rng = np.random.default_rng([seed, 2])
    shuffled = rng.permutation(rays)  # the sky emits in order, and a part of them is timed
    box = _Box(medium)
    origins, directions = (v[shuffled] for v in Sky(1.0).emit(rays, box, rng, 0)[:2])
    sampler = FreePathSampler(medium, "supervoxel_constant", device, band=band)
    lengths = sampler.sample(origins, directions, seed)
    return Statistics(
        band=band,
        rays=rays,
        **_of_paths(lengths, _chords(box.domain, origins, directions)),
        **_of_voxels(medium, band),
        albedo=float(medium.albedo[band]),
        g=float(medium.g[band]),
        samplers={
            name: _timed(medium, name, sampler.device, band, (origins, directions), seed)
            for name in samplers
        },
    )


def advice(measured: Statistics, resolution: int) -> str:
    """One sentence for an artist, from `Statistics` and the voxels along a bake's longest edge."""
    depth = max(measured.depth_max)
    if depth == 0:
        return "There is nothing that light could meet; raise the density, or select something."
    deep = f"optical depth {depth:.0f}" if depth >= 10 else f"optical depth {depth:.2g}"
    if depth * measured.albedo <= _THIN:
        return f"Optically thin, {deep}: single scattering is enough, no bake needed."
    if measured.albedo <= _DARK:
        return f"Dark, albedo {measured.albedo:.2g}: single scattering is enough, no bake needed."
    thickness, fading = _of_voxel(measured, resolution)
    too_thick = max(thickness / _THICKEST, fading / _DARKEST)
    needed, resolving = (_voxels(resolution * n) for n in (too_thick, thickness / _RESOLVED))
    if too_thick > 1 and needed > _MOST_VOXELS:
        return f"As good as solid, {deep}: lower its density, or give it a surface instead."
    if too_thick > 1:
        return f"Very dense, {deep}: {resolution} voxels are too thick for its light, use {needed}."
    if thickness <= _RESOLVED:
        word = "Dense" if depth >= _DENSE else "Moderate"
        return f"{word}, {deep}: bake it, {resolution} voxels resolve its light."
    if resolving <= _MOST_VOXELS:
        return f"Dense, {deep}: {resolving} voxels resolve it, {resolution} give its smooth light."
    return f"Very dense, {deep}: {resolution} voxels give its smooth light, but not its lit skin."


def _of_voxel(measured: Statistics, resolution: int) -> tuple[float, float]:
    """A voxel's edge in transport mean free paths, and in diffusion lengths.

    It is weighted by the albedo, as in `subdivision`.
    """
    transport = 1 - measured.albedo * measured.g
    depth = measured.voxel_depth * (measured.voxels / resolution) * measured.albedo
    return depth * transport, depth * np.sqrt(3 * (1 - measured.albedo) * transport)


def histogram_picture(measured: Statistics, width: int = 240, height: int = 80) -> Floats:
    """(height, width, 4) float32: bars of free paths, the lower row first, and a line for `even`.

    The picture is for a dark background, which shows through. Bars and line share one scale: the
    highest of both fills the picture's height.
    """
    values = np.concatenate([measured.counts, measured.even])
    scale = (height - 2) / max(values.max(), 1)
    place = (np.arange(width) + 0.5) * (len(measured.counts) / width)
    bars = measured.counts[place.astype(int)] * scale
    if width >= 4 * len(measured.counts):
        gaps = np.diff(place.astype(int), append=len(measured.counts)) > 0
        bars[gaps] = 0
    middles = np.arange(len(measured.even)) + 0.5
    line = np.interp(place, middles, measured.even) * scale
    rows = np.arange(height)[:, None]
    picture = np.zeros((height, width, 4), np.float32)
    picture[...] = (*_BAR, 0)
    picture[..., 3] = np.clip(bars - rows, 0, 1)
    _draw(picture, (rows == 0) * 1.0, _AXIS)
    # In each column as high as the line rises or falls there, or it would have gaps.
    low, high = line - _reach(line), line + _reach(line)
    _draw(picture, np.clip(np.minimum(rows + 1 - low, high - rows), 0, 1), _LINE)
    return picture


_BAR, _LINE, _AXIS = (0.35, 0.55, 0.85), (1.0, 0.6, 0.15), (0.7, 0.7, 0.7)


def _reach(line: Floats) -> Floats:
    return 0.75 + np.abs(np.gradient(line)) / 2


def _draw(picture: Floats, cover: Floats, color: tuple[float, float, float]) -> None:
    """Lay a colour over a picture of unassociated alpha, by its coverage."""
    alpha = cover + picture[..., 3] * (1 - cover)
    share = np.divide(cover, alpha, out=np.zeros_like(alpha), where=alpha > 0)[..., None]
    picture[..., :3] += share * (np.array(color) - picture[..., :3])
    picture[..., 3] = alpha


def _voxels(count: float) -> int:
    """Rounded up to a multiple of _STEP."""
    return _STEP * ceil(count / _STEP)


class _Box(BaseMedium):
    """The part of a medium's interface that lights need, for the box that holds all its matter."""

    sigma_s = sigma_a = g = np.zeros(1)

    def __init__(self, medium: BaseMedium) -> None:
        self.origin, self.voxel_size, self._shape = medium.origin, medium.voxel_size, medium.shape
        matter = np.argwhere(medium.density) if isinstance(medium, Medium) else ()
        if len(matter):
            lower, upper = np.min(matter, axis=0), np.max(matter, axis=0) + 1
            self.origin = tuple(np.add(medium.origin, lower * medium.voxel_size))
            self._shape = tuple(upper - lower)

    @property
    def shape(self) -> tuple[int, ...]:
        return self._shape


def _chords(domain: Domain, origins: Floats, directions: Floats) -> Floats:
    """(n,) m from points on the domain's border to where rays leave it."""
    ends = np.where(directions >= 0, domain.upper, domain.origin)
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = np.where(directions == 0, np.inf, (ends - origins) / directions)
    return np.maximum(exits.min(axis=1), 0)


def _of_paths(lengths: Floats, chords: Floats) -> dict[str, Any]:
    """Statistics of the lengths (n,) m of free paths, of rays whose chords are (n,) m."""
    collided = np.isfinite(lengths)
    flown = np.where(collided, lengths, chords)
    mean = float(flown.sum()) / collided.sum() if collided.any() else np.inf
    furthest = float(lengths[collided].max() if collided.any() else chords.max())
    collisions: Array = lengths[collided]
    counts, edges = np.histogram(collisions, _BINS, (0, furthest))
    # The share e^(-x/mean) of each ray remains at x, up to where it leaves.
    left = np.array([np.exp(-np.minimum(edge, chords) / mean).sum() for edge in edges])
    return {
        "counts": counts,
        "edges": edges,
        "even": -np.diff(left),
        "mean_free_path": mean,
        "escaped": float(np.mean(np.isinf(lengths))),
    }


def _of_voxels(medium: Medium | PerlinMedium, band: int) -> dict[str, Any]:
    """Optical depths of a medium's columns and voxels."""
    if isinstance(medium, PerlinMedium):
        medium = medium.voxels(_VOXELS_OF_NOISE)
    depth = medium.depth(medium.sigma_t[band])
    columns = [depth.sum(axis=axis) for axis in range(3)]
    typical = float((depth**2).sum() / depth.sum()) if depth.any() else 0.0
    return {
        "depth_mean": tuple(float(c.mean()) for c in columns),
        "depth_max": tuple(float(c.max()) for c in columns),
        "voxel_depth_max": float(depth.max()),
        "voxel_depth": typical,
        "in_matter": medium.voxel_size / typical if typical else np.inf,
        "void": float(np.mean(depth == 0)),
        "voxels": max(medium.shape),
    }


def _timed(
    medium: Medium | PerlinMedium,
    name: str,
    device: Device,
    band: int,
    rays: tuple[Floats, Floats],
    seed: int,
) -> Sampling:
    """The `Sampling` of a sampler, from as many of the rays as a timing needs."""
    start = perf_counter()
    sampler = FreePathSampler(medium, name, device, band=band)
    preparation = perf_counter() - start
    sampler.sample(rays[0][:1], rays[1][:1])  # builds its program
    count = min(_FEWEST_RAYS, len(rays[0]))
    while True:
        start = perf_counter()
        lengths, particles = sampler.count(rays[0][:count], rays[1][:count], seed)
        seconds = perf_counter() - start
        if seconds >= _TIMED or count == len(rays[0]):
            break
        count = min(4 * count, len(rays[0]))
    real = np.count_nonzero(np.isfinite(lengths))
    return Sampling(real / particles if particles else np.nan, count / seconds, preparation)
