# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights, as plain values in SI units; every spectral quantity is a scalar or (bands,)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import LightError
from .medium import LARGEST


@dataclass(frozen=True)
class Sun:
    """Parallel light from far away.

    direction   (3,), the way the light travels; any length but 0
    irradiance  W/m^2 on a surface that faces it, scalar or (bands,)
    """

    direction: tuple
    irradiance: tuple | float

    def __post_init__(self):
        length = np.linalg.norm(self.direction)
        if len(self.direction) != 3 or not np.isfinite(length) or length == 0:
            raise LightError(f"A sun needs a direction of three numbers; it has {self.direction}.")
        _check_energy(self.irradiance, "irradiance of a sun")

    @property
    def spectrum(self):
        """The irradiance, scalar or (bands,)."""
        return self.irradiance


@dataclass(frozen=True)
class Sky:
    """Light from everywhere outside.

    radiance  W/(m^2 sr), scalar or (bands,), or a function that takes the unit vector (3,)
              towards the sky and returns that
    """

    radiance: tuple | float | Callable

    def __post_init__(self):
        if not callable(self.radiance):
            _check_energy(self.radiance, "radiance of the sky")

    @property
    def spectrum(self):
        """The radiance, scalar or (bands,), or the function that it is."""
        return self.radiance

    def towards(self, direction):
        """The radiance, W/(m^2 sr), that arrives from `direction` ((3,), pointing at the sky)."""
        if not callable(self.radiance):
            return self.radiance
        radiance = self.radiance(np.asarray(direction, float))
        _check_energy(radiance, "radiance of the sky")
        return radiance


@dataclass(frozen=True)
class PointLight:
    """Light from a point, the same in all directions.

    position  (3,) m
    power     W, scalar or (bands,)
    """

    position: tuple
    power: tuple | float

    def __post_init__(self):
        if len(self.position) != 3 or not np.all(np.isfinite(self.position)):
            raise LightError(f"A point light needs a position; it has {self.position}.")
        _check_energy(self.power, "power of a point light")

    @property
    def spectrum(self):
        """The power, scalar or (bands,)."""
        return self.power


def by_band(value, bands):
    """A spectral quantity as (bands,) float64; LightError if it has another number of bands."""
    value = np.atleast_1d(np.asarray(value, float))
    if value.shape not in ((1,), (bands,)):
        raise LightError(f"A light has {value.size} bands where the medium has {bands}.")
    return np.broadcast_to(value, (bands,))


def _check_energy(value, what):
    value = np.asarray(value, float)
    if not np.all((value >= 0) & (value <= LARGEST)):  # NaN is neither
        raise LightError(f"The {what} must be between 0 and {LARGEST:.2g}; it is {value}.")
