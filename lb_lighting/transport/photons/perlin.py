# SPDX-License-Identifier: GPL-3.0-or-later
"""Fractal noise as a medium: of any effective resolution, and never stored.

The noise is a sum of octaves ("Procedural media" and "Upper bound" of paper 2). Octave i has values
in [0, 1], hashed from their position, on a lattice of coarsest * 2^i cells along each edge of the
domain, trilinear in between. Its amplitude is proportional to persistence^i, and all amplitudes sum
to 1. The density is

    T(noise) = (max(0, noise - cutoff) / (1 - cutoff)) ** power.

The majorants follow from two properties. Without the octaves finer than a lattice, the noise is
trilinear in each of that lattice's cells, and the finer octaves add at most the sum of their
amplitudes, the rest. T is increasing and convex (power >= 1), so in each cell T(noise) is nowhere
above the trilinear function through the values of T(coarse noise + rest) at the corners.

kernels/photons/perlin.cl is the twin for devices.
"""

from math import floor, log2
from typing import Any

import numpy as np

from ...arrays import Floats, Integers, Spectrum, Vector
from ...errors import MediumError, require_whole
from ..medium import (
    LARGEST,
    BaseMedium,
    Medium,
    optics_by_band,
)
from .majorants import Majorants
from .random import mix_bits

FINEST = 2**15
"""The largest effective resolution: float32 still distinguishes 512 positions in a cell there."""

WEAK = {"cutoff": 0.0, "power": 1.0}
"""Weakly inhomogeneous: mean density 0.51, largest 1.7 times that, no void (median of 20 seeds)."""

STRONG = {"cutoff": 0.5, "power": 4.0}
"""Strongly inhomogeneous: mean 0.0018, largest 130 times that (80 to 250), 46 % void (34 to 62)."""

# Float32 errors of the noise (up to 15 octaves of a few roundings each, and the amplitudes), and of
# the value of a majorant, relative to its largest corner (8 coefficients, products of three).
_NOISE_MARGIN = 2e-6
_BOUND_MARGIN = 1e-5
_LEAST = 1e-30  # smallest value of a corner that is not 0, or its margin would underflow

_FINE = 128  # most cells along an edge of the majorants that give the global maximum

# The terms of a trilinear function: whether each has the factors x, y and z.
_TERMS = (
    (0, 0, 0),
    (1, 0, 0),
    (0, 1, 0),
    (0, 0, 1),
    (1, 1, 0),
    (0, 1, 1),
    (1, 0, 1),
    (1, 1, 1),
)

# The primes of xxHash distinguish octaves, frames and the three coordinates.
_OCTAVE, _FRAME = 0x9E3779B1, 0x85EBCA77
_X, _Y, _Z = (np.uint32(prime) for prime in (0xC2B2AE3D, 0x165667B1, 0x27D4EB2F))


class PerlinMedium(BaseMedium):
    """A cube of fractal noise, surrounded by vacuum.

    resolution        N, cells of the finest lattice along an edge: coarsest * 2^k, at most 32768
    size              m, the edge of the cube
    sigma_s, sigma_a  scattering and absorption at density 1, 1/m, scalar or (bands,)
    g                 mean cosine of the Henyey-Greenstein phase function, scalar or (bands,)
    origin            (3,) m, the lower corner of the cube
    cutoff            noise up to which the density is 0, from 0 to 0.999
    power             1 to 64; the larger, the rarer high densities are
    persistence       amplitude of an octave over that of the next coarser one, 0 to 1
    coarsest          cells of the coarsest lattice along an edge
    seed              0 to 2^32 - 1
    time              in frames: lattice values are linear in time between those of whole frames

    The attributes are these, and those of a `Medium` with N^3 voxels, except that the density is a
    function. Raises MediumError for values outside these ranges.
    """

    def __init__(
        self,
        resolution: int,
        size: float,
        sigma_s: Spectrum,
        sigma_a: Spectrum,
        g: Spectrum = 0.0,
        origin: Vector = (0, 0, 0),
        cutoff: float = 0.0,
        power: float = 1.0,
        persistence: float = 0.5,
        coarsest: int = 4,
        seed: int = 0,
        time: float = 0.0,
    ) -> None:
        self.coarsest = _whole(coarsest, "coarsest lattice", 1, FINEST)
        self.resolution = _whole(resolution, "resolution", self.coarsest, FINEST)
        self.octaves = self._octave(self.resolution, "resolution") + 1
        self.seed = _whole(seed, "seed", 0, 2**32 - 1)
        self.cutoff = _as_on_devices(_between(cutoff, "cutoff", 0, 0.999))
        self.power = _as_on_devices(_between(power, "power", 1, 64))
        self.persistence = _as_on_devices(_between(persistence, "persistence", 0, 1))
        self.time = _between(time, "time", -(2**30), 2**30)
        self.size = float(size)
        self.voxel_size = self.size / self.resolution  # m, the edge of a cell of the finest lattice
        if not 0 < self.size <= LARGEST:
            raise MediumError(
                f"The size must be positive and at most {LARGEST:.1e} m; it is {size} m."
            )
        self.origin = tuple(map(float, origin))
        if len(self.origin) != 3 or not np.all(np.isfinite(self.origin)):
            raise MediumError(f"The origin must be three finite coordinates; it is {origin}.")
        self.sigma_s, self.sigma_a, self.g = optics_by_band(sigma_s, sigma_a, g)

    @property
    def shape(self) -> tuple[int, int, int]:
        return (self.resolution,) * 3

    @property
    def amplitudes(self) -> Floats:
        """(octaves,), from the coarsest to the finest; they sum to 1."""
        relative = self.persistence ** np.arange(self.octaves)
        return relative / relative.sum()

    def lattice(self, octave: int) -> Floats:
        """(n + 1, n + 1, n + 1) float64 in [0, 1): an octave at the points of its lattice."""
        index = np.arange(self.coarsest * 2**octave + 1, dtype=np.uint32)
        x, y, z = index[:, None, None] * _X, index[:, None] * _Y, index * _Z
        keys = self._keys(octave)
        values = (share * _value(mix_bits(mix_bits(key ^ x) ^ y) ^ z) for share, key in keys)
        return sum(values, np.zeros(()))

    def noise(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """float64 in [0, 1) at coordinates that broadcast, in cells of the finest lattice.

        The coordinates are arrays of one dimension or more, with values from 0 to N.
        """
        noise: Any = 0
        for octave, amplitude in enumerate(self.amplitudes):
            edge = 2 ** (self.octaves - 1 - octave)
            for share, key in self._keys(octave):
                noise = noise + amplitude * share * _trilinear(key, x / edge, y / edge, z / edge)
        return noise

    def density_at(self, points: Floats) -> Floats:
        """(...) float64 in [0, 1] at points (..., 3) in cells of the finest lattice, 0 to N."""
        points = np.asarray(points, float)
        return self._density(self.noise(*points.reshape(-1, 3).T)).reshape(points.shape[:-1])

    def voxels(self, resolution: int) -> Medium:
        """The `Medium` of resolution^3 voxels with the density at their centres."""
        centers = (np.arange(resolution) + 0.5) * (self.resolution / resolution)
        density = np.empty((resolution,) * 3, np.float32)
        for layer, x in zip(density, centers[:, None], strict=True):  # a layer fits the cache
            layer[...] = self._density(self.noise(x, centers[:, None], centers))
        return Medium(
            density, self.size / resolution, self.sigma_s, self.sigma_a, self.g, self.origin
        )

    def constant_majorants(self, cells: int) -> Majorants:
        """The `Majorants` with one value in each of cells^3 super-voxels.

        cells  coarsest * 2^k, at most N; or 1, for the global maximum
        """
        values = _largest(self._corners(cells)) * (1 + _BOUND_MARGIN)
        return Majorants(self.resolution // cells, values.astype(np.float32), float(values.mean()))

    def linear_majorants(self, cells: int) -> Majorants:
        """The `Majorants` with a trilinear function in each of cells^3 super-voxels.

        cells  coarsest * 2^k, at most N; or 1, for the global maximum
        """
        corners = self._corners(cells)
        values = np.empty((cells, cells, cells, len(_TERMS)), np.float32)
        mean = 0.0
        for n, term in enumerate(_TERMS):
            coefficient = _difference(corners, term)
            if not any(term):
                coefficient = coefficient + _BOUND_MARGIN * _largest(corners)
            values[..., n] = coefficient
            mean += coefficient.mean() / 2 ** sum(term)
        return Majorants(self.resolution // cells, values, float(mean))

    @property
    def device_arguments(self) -> tuple[np.generic, ...]:
        """The values of PERLIN_PARAMETERS of kernels/photons/perlin.cl, in their order."""
        return (
            np.uint32(self.seed),
            np.int32(floor(self.time)),
            np.float32(self.time % 1),
            np.int32(self.octaves),
            np.float32(self.amplitudes[0]),
            np.float32(self.persistence),
            np.float32(self.cutoff),
            np.float32(self.power),
        )

    def _octave(self, cells: int, what: str) -> int:
        """The octave whose lattice has `cells` along an edge; MediumError if there is none."""
        octave = round(log2(cells / self.coarsest))
        if cells != self.coarsest * 2**octave:
            raise MediumError(
                f"The {what} must be the coarsest lattice, {self.coarsest}, times a power of two; "
                f"it is {cells}."
            )
        return octave

    def _keys(self, octave: int) -> list[tuple[float, Integers]]:
        """[(share, key)]: weights and hash keys of an octave in the frames around `time`."""
        frame, later = floor(self.time), self.time % 1
        octave_key = mix_bits(_words(self.seed ^ (octave + 1) * _OCTAVE))
        keys = [(1 - later, mix_bits(octave_key ^ _words(frame * _FRAME)))]
        if later:
            keys.append((later, mix_bits(octave_key ^ _words((frame + 1) * _FRAME))))
        return keys

    def _density(self, noise: Floats) -> Floats:
        return np.maximum(0, (noise - self.cutoff) / (1 - self.cutoff)) ** self.power

    def _corners(self, cells: int) -> Floats:
        """(cells + 1, ...): the majorant at the corners of the super-voxels."""
        if cells == 1 < self.coarsest:
            return np.full((2, 2, 2), self._corners(self._fine_cells()).max())
        _whole(cells, "number of super-voxels along an edge", self.coarsest, self.resolution)
        last = self._octave(cells, "number of super-voxels along an edge")
        noise = self.amplitudes[0] * self.lattice(0)
        for octave in range(1, last + 1):
            noise = _refined(noise)
            noise += self.amplitudes[octave] * self.lattice(octave)
        density = self._density(noise + self.amplitudes[last + 1 :].sum() + _NOISE_MARGIN)
        return np.where(density > 0, np.maximum(density, _LEAST), 0)

    def _fine_cells(self) -> int:
        """Cells along an edge of the lattice that gives the global maximum."""
        cells = self.coarsest
        while 2 * cells <= min(_FINE, self.resolution):
            cells *= 2
        return cells


def _whole(value: float, what: str, lowest: int, highest: int) -> int:
    require_whole(value, what, lowest, highest, MediumError)
    return int(value)


def _between(value: float, what: str, lowest: float, highest: float) -> float:
    value = float(value)
    if not lowest <= value <= highest:  # NaN is neither
        raise MediumError(f"The {what} must be between {lowest} and {highest}; it is {value}.")
    return value


def _as_on_devices(value: float) -> float:
    """Rounded to float32, so that a cutoff near 1 is the same on devices."""
    return float(np.float32(value))


def _words(value: int) -> Integers:
    """(1,) uint32: the lower bits of a whole number. Arrays wrap without a warning."""
    return np.array([value & 0xFFFFFFFF], np.uint32)


def _value(h: Integers) -> Floats:
    """A lattice value in [0, 1), with the 24 bits that float32 holds."""
    return (mix_bits(h) >> 8) * 2.0**-24


def _trilinear(key: Integers, x: Floats, y: Floats, z: Floats) -> Floats:
    """The octave of `key` at coordinates in cells of its lattice."""
    (x0, x1, fx), (y0, y1, fy), (z0, z1, fz) = _cell(x, _X), _cell(y, _Y), _cell(z, _Z)

    def along_z(row: Integers) -> Floats:
        low = _value(row ^ z0)
        return low + fz * (_value(row ^ z1) - low)

    def along_yz(plane: Integers) -> Floats:
        low = along_z(mix_bits(plane ^ y0))
        return low + fy * (along_z(mix_bits(plane ^ y1)) - low)

    low = along_yz(mix_bits(key ^ x0))
    return low + fx * (along_yz(mix_bits(key ^ x1)) - low)


def _cell(coordinate: Floats, prime: np.uint32) -> tuple[Integers, Integers, Floats]:
    """The hash terms of the two lattice points around a coordinate, and the weight of the second.

    Coordinates are hashed one by one, with mixing in between. A hash of one sum of products would
    make the noise periodic: 2^45 points of the finest lattice cannot have distinct 32-bit sums.
    """
    index = np.floor(coordinate)
    low = index.astype(np.int64).astype(np.uint32)
    return low * prime, (low + np.uint32(1)) * prime, coordinate - index


def _refined(values: Floats) -> Floats:
    """Values at the points of a lattice, interpolated to those of one twice as fine (trilinear)."""
    for _ in range(3):  # each turn refines the first axis and makes it the last
        fine = np.empty((2 * len(values) - 1, *values.shape[1:]))
        fine[::2] = values
        fine[1::2] = (values[:-1] + values[1:]) / 2
        values = fine.transpose(1, 2, 0)
    return np.ascontiguousarray(values)


def _largest(corners: Floats) -> Floats:
    """The largest of the eight corners of each cell."""
    for _ in range(3):
        corners = np.maximum(corners[:-1], corners[1:]).transpose(1, 2, 0)
    return corners


def _difference(corners: Floats, term: tuple[int, ...]) -> Floats:
    """The coefficient of a term of the trilinear functions through the corners."""
    for with_coordinate in term:
        corners = np.diff(corners, axis=0) if with_coordinate else corners[:-1]
        corners = corners.transpose(1, 2, 0)
    return corners
