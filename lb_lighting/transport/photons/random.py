# SPDX-License-Identifier: GPL-3.0-or-later
"""The random numbers of `kernels/photons/random.cl` in NumPy, bit for bit.

xoshiro128++ (Blackman and Vigna 2021), with one stream for each ray: results depend on the seed
alone and not on the order in which a device processes the rays.
"""

import numpy as np

from ...arrays import Floats, Integers

_GOLDEN = np.uint32(0x9E3779B9)  # 2^32 / golden ratio


class RandomStreams:
    """One stream for each ray.

    seed     32 bits
    indices  (n,) the numbers of the rays
    """

    def __init__(self, seed: int, indices: Integers) -> None:
        key, index = np.uint32(seed), np.asarray(indices, np.uint32)
        with np.errstate(over="ignore"):
            a = mix_bits(index + _GOLDEN * key)
            b = mix_bits(a ^ index ^ np.uint32(0x632BE5AB))
            c = mix_bits(b + _GOLDEN)
            d = mix_bits(c ^ key) | np.uint32(1)
        self.state = np.stack([a, b, c, d])

    def next(self, rays: Integers) -> Floats:
        """The next number, uniform in (0, 1), of the streams `rays` (indices), as float64."""
        a, b, c, d = self.state[:, rays]
        bits = _rotate(a + d, 7) + a
        t = b << np.uint32(9)
        c = c ^ a
        d = d ^ b
        b = b ^ c
        a = a ^ d
        self.state[:, rays] = a, b, c ^ t, _rotate(d, 11)
        return ((bits >> np.uint32(9)) + 0.5) * 2.0**-23


def _rotate(bits: Integers, places: int) -> Integers:
    return (bits << np.uint32(places)) | (bits >> np.uint32(32 - places))


def mix_bits(h: Integers) -> Integers:
    """The finalizer of MurmurHash3, of a uint32 array."""
    h = h ^ (h >> 16)
    h *= np.uint32(0x85EBCA6B)
    h ^= h >> 13
    h *= np.uint32(0xC2B2AE35)
    h ^= h >> 16
    return h
