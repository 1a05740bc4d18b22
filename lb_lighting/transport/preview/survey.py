# SPDX-License-Identifier: GPL-3.0-or-later
"""What the free path samplers tell of a medium before anything is baked, and what to do about it.

Rays start as light of an even sky does, by the cosine, at the border of the box that holds all
matter. Through a convex box their mean length is 4 V / S (Cauchy), and they see all of it alike.
"""

from dataclasses import dataclass
from math import ceil
from time import perf_counter

import numpy as np

from ...errors import require_whole
from ..lights.distant import Sky
from ..medium import Domain
from ..photons.free_path import SAMPLERS, FreePathSampler
from ..photons.perlin import PerlinMedium

_RAYS, _FEWEST_RAYS = 2**16, 2**8
_TIMED = 0.1  # s that a sampler is timed for, at least, unless it is done with all rays
_BINS = 48
_VOXELS_OF_NOISE = 64  # along an edge: noise itself is never summed up

# Optical depth times albedo up to which light that scattered twice and more is less than 5 % of a
# picture (7 % if the medium scatters forward, away from the camera), and albedo up to which it is
# at any depth: docs/theory/free-paths.md, "Preview".
_THIN, _DARK = 0.05, 0.04
# Edge of a voxel in transport free paths: below the first, more voxels make light no more right
# (docs/theory/physics.md, "By resolution"); above the second, voxels are divided, as they are
# above the last in diffusion lengths, where absorption fades light ("Voxels that are too thick").
_RESOLVED, _THICKEST, _DARKEST = 0.5, 3.0, 0.9
_DENSE = 10.0  # optical depth: a word only
_MOST_VOXELS = 512  # along an edge that are worth advising
_STEP = 8  # of what is advised


@dataclass(frozen=True)
class Sampling:
    """How one sampler fares.

    acceptance   real collisions over tentative ones, NaN where there were none
    rays_a_second
    preparation  s, of its bounds
    """

    acceptance: float
    rays_a_second: float
    preparation: float


@dataclass(frozen=True)
class Statistics:
    """What free paths tell of a medium, in its band of largest extinction.

    band             that band
    rays             how many were drawn
    counts           (bins,) of free paths that ended in the medium, by length
    edges            (bins + 1,) m, of the bins
    even             (bins,) counts to expect of an even medium of the same mean free path
    mean_free_path   m flown in that box for a collision; infinite where nothing collides
    in_matter        m, the mean free path where matter is: of a voxel of `voxel_depth`
    escaped          share of rays that left without a collision
    depth_mean       (3,) optical depth through the domain along x, y and z, mean of all columns
    depth_max        (3,) that of the deepest column
    voxel_depth_max  optical depth of the edge of the densest voxel
    voxel_depth      that of a voxel where matter is: mean of all, weighed by what they hold
    void             share of voxels that hold nothing
    voxels           along the longest edge
    albedo, g        of the band
    samplers         {name: `Sampling`}
    Of a PerlinMedium, depths and voxels are those of 64 points along an edge.
    """

    band: int
    rays: int
    counts: np.ndarray
    edges: np.ndarray
    even: np.ndarray
    mean_free_path: float
    in_matter: float
    escaped: float
    depth_mean: tuple
    depth_max: tuple
    voxel_depth_max: float
    voxel_depth: float
    void: float
    voxels: int
    albedo: float
    g: float
    samplers: dict


def statistics(medium, device=None, seed=0, rays=_RAYS, samplers=SAMPLERS):
    """The `Statistics` of a `Medium` or `PerlinMedium`, by free paths of `rays` rays.

    device    None for the best, or part of the label of one of `device.devices()`
    samplers  which to time, of free_path.SAMPLERS; each takes about 0.2 s, but what it prepares
    Opaque voxels are not seen. Raises SettingsError or DeviceError.
    """
    require_whole(rays, "number of rays", 1, 2**24)
    band = int(np.argmax(medium.sigma_t))
    rng = np.random.default_rng([seed, 2])
    shuffled = rng.permutation(rays)  # the sky's come in order, and some are timed alone
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


def advice(found, resolution):
    """One sentence for an artist, from `Statistics` and the voxels along a bake's longest edge."""
    depth = max(found.depth_max)
    if depth == 0:
        return "There is nothing that light could meet; raise the density, or select something."
    deep = f"optical depth {depth:.0f}" if depth >= 10 else f"optical depth {depth:.2g}"
    if depth * found.albedo <= _THIN:
        return f"Optically thin, {deep}: single scattering is enough, no bake needed."
    if found.albedo <= _DARK:
        return f"Dark, albedo {found.albedo:.2g}: single scattering is enough, no bake needed."
    thickness, fading = _of_voxel(found, resolution)
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


def _of_voxel(found, resolution):
    """A voxel's edge in transport free paths, and in diffusion lengths, weighed by the albedo as
    `physical` does."""
    transport = 1 - found.albedo * found.g
    depth = found.voxel_depth * (found.voxels / resolution) * found.albedo
    return depth * transport, depth * np.sqrt(3 * (1 - found.albedo) * transport)


def histogram_picture(found, width=240, height=80):
    """(height, width, 4) float32: bars of free paths, the lower row first, and a line for `even`.

    For a dark background, which shows through. Bars and line have one scale, the highest of both
    being the picture's height.
    """
    values = np.concatenate([found.counts, found.even])
    scale = (height - 2) / max(values.max(), 1)
    place = (np.arange(width) + 0.5) * (len(found.counts) / width)
    bars = found.counts[place.astype(int)] * scale
    if width >= 4 * len(found.counts):
        gaps = np.diff(place.astype(int), append=len(found.counts)) > 0
        bars[gaps] = 0
    middles = np.arange(len(found.even)) + 0.5
    line = np.interp(place, middles, found.even) * scale
    rows = np.arange(height)[:, None]
    picture = np.zeros((height, width, 4), np.float32)
    picture[...] = (*_BAR, 0)
    picture[..., 3] = np.clip(bars - rows, 0, 1)
    _draw(picture, (rows == 0) * 1.0, _AXIS)
    # As high in a column as the line rises or falls there, or it would have holes.
    low, high = line - _reach(line), line + _reach(line)
    _draw(picture, np.clip(np.minimum(rows + 1 - low, high - rows), 0, 1), _LINE)
    return picture


_BAR, _LINE, _AXIS = (0.35, 0.55, 0.85), (1.0, 0.6, 0.15), (0.7, 0.7, 0.7)


def _reach(line):
    return 0.75 + np.abs(np.gradient(line)) / 2


def _draw(picture, cover, color):
    """Lay a colour over a picture that is not multiplied by its alpha, where it covers."""
    alpha = cover + picture[..., 3] * (1 - cover)
    share = np.divide(cover, alpha, out=np.zeros_like(alpha), where=alpha > 0)[..., None]
    picture[..., :3] += share * (np.array(color) - picture[..., :3])
    picture[..., 3] = alpha


def _voxels(count):
    """Rounded up to what is easily said."""
    return _STEP * ceil(count / _STEP)


class _Box:
    """What lights ask of a medium, for the box that holds all its matter."""

    bands = 1

    def __init__(self, medium):
        self.domain = medium.domain
        matter = None if isinstance(medium, PerlinMedium) else np.argwhere(medium.density)
        if matter is not None and len(matter):
            lower, upper = matter.min(axis=0), matter.max(axis=0) + 1
            origin = np.add(medium.origin, lower * medium.voxel_size)
            self.domain = Domain(tuple(origin), medium.voxel_size, tuple(upper - lower))


def _chords(domain, origins, directions):
    """(n,) m from points on the domain's border to where rays leave it."""
    ends = np.where(directions >= 0, domain.upper, domain.origin)
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = np.where(directions == 0, np.inf, (ends - origins) / directions)
    return np.maximum(exits.min(axis=1), 0)


def _of_paths(lengths, chords):
    """What the lengths (n,) of free paths in m tell, of rays whose chords are (n,) m."""
    collided = np.isfinite(lengths)
    flown = np.where(collided, lengths, chords)
    mean = float(flown.sum()) / collided.sum() if collided.any() else np.inf
    furthest = lengths[collided].max() if collided.any() else chords.max()
    counts, edges = np.histogram(lengths[collided], _BINS, (0, furthest))
    # Of each ray e^(-x/mean) is left at x, up to where it leaves.
    left = np.array([np.exp(-np.minimum(edge, chords) / mean).sum() for edge in edges])
    return {
        "counts": counts,
        "edges": edges,
        "even": -np.diff(left),
        "mean_free_path": mean,
        "escaped": float(np.mean(np.isinf(lengths))),
    }


def _of_voxels(medium, band):
    """Depths of a medium's columns and voxels."""
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


def _timed(medium, name, device, band, rays, seed):
    """The `Sampling` of a sampler, by as many of the rays as it takes to tell."""
    start = perf_counter()
    sampler = FreePathSampler(medium, name, device, band=band)
    preparation = perf_counter() - start
    sampler.sample(rays[0][:1], rays[1][:1])  # builds its program
    some = min(_FEWEST_RAYS, len(rays[0]))
    while True:
        start = perf_counter()
        lengths, particles = sampler.count(rays[0][:some], rays[1][:some], seed)
        seconds = perf_counter() - start
        if seconds >= _TIMED or some == len(rays[0]):
            break
        some = min(4 * some, len(rays[0]))
    real = np.count_nonzero(np.isfinite(lengths))
    return Sampling(real / particles if particles else np.nan, some / seconds, preparation)
