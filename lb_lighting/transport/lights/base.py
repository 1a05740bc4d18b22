# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface of lights: plain values in SI units, sampled as photons, rays or parallel beams."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from ...arrays import Array, Booleans, Floats, Spectrum, Vector
from ...errors import LightError
from ..medium import LARGEST, BaseMedium, Domain

type Photons = tuple[Floats, Floats, Floats]
"""Origins (n, 3) in m, unit directions (n, 3), and powers (n,) in W."""

type Directional = Callable[[Floats], Any]
"""A radiance in W/(m^2 sr) as a function of the unit vector towards the sky."""

_AT_ONCE = 2**18  # rays in one piece of `Light.rays`
# `Light.rays` of a light without regular rays: their largest number; and their number for each
# voxel face on half of the domain's border, as a multiple of per_edge^2.
_MOST_RAYS, _RAYS_A_FACE = 2**22, 4


class Light(ABC):
    """A light source. Subclasses need `spectrum` and `emit`; other members have defaults.

    Lights are values: they do not change, and methods that alter one return another light.
    Derive from `DistantLight` or `LocalLight` to give a light regular beams or rays instead of
    random ones: the error of its uncollided light is then much smaller.
    """

    is_beam: ClassVar[bool] = False
    """Whether the uncollided light in each voxel comes from a single direction."""

    shadow_density: Floats | None = None
    """(nx, ny, nz), replaces the medium's density for this light's uncollided light; or None."""

    @property
    @abstractmethod
    def spectrum(self) -> Any:
        """What the light emits by band: a scalar for all bands, (bands,), (bands, nx, ny, nz), or a
        function of directions. `multiple` compares the bands of lights by it."""

    @abstractmethod
    def emit(self, count: int, medium: BaseMedium, rng: np.random.Generator, band: int) -> Photons:
        """Draw photons of one band.

        Returns origins (count, 3) in m, on the faces of the domain or where the light is; unit
        directions (count, 3) of travel; and the power of each photon (count,) in W. The expected
        sum of the powers is the power that the light sends towards the domain, including photons
        that miss it.
        The photons of one call form a low-discrepancy sequence (`r_sequence`) and are not
        independent: estimate a variance from several calls.
        Raises LightError for a count below 1, or if the bands do not match the medium's.
        """

    def rays(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[float, Iterator[Photons]]:
        """The light as rays, the same at every call.

        per_edge  rays along a voxel's edge
        Returns the largest power of a ray in W, and an iterator of pieces, each as of `emit`. By
        default the rays are photons of `emit`, drawn with a fixed seed.
        """
        nx, ny, nz = medium.shape
        faces = nx * ny + ny * nz + nz * nx
        count = min(_MOST_RAYS, _RAYS_A_FACE * per_edge**2 * faces)
        origins, directions, power = self.emit(count, medium, np.random.default_rng(0), band)
        pieces = (slice(first, first + _AT_ONCE) for first in range(0, count, _AT_ONCE))
        return float(power.max()), ((origins[n], directions[n], power[n]) for n in pieces)

    def parts(self) -> Sequence["Light"]:
        """Lights that add up to this one; each gets a cast of its rays or beams."""
        return [self]

    def with_shadow_density(self, change: Callable[[Floats], Floats]) -> Self:
        """The same light after `change` of its shadow density, if it has one."""
        return self

    def softness(self, domain: Domain) -> Floats | None:
        """(nx, ny, nz), the share of the uncollided light of `rays` that counts in each voxel; None
        if all of it does."""
        return None

    def is_soft_within(self, domain: Domain) -> bool:
        """Whether the light stands in the domain and has a `softness` there."""
        return False

    def hardened(self) -> Self:
        """The same light without `softness`."""
        return self


class DistantLight(Light):
    """A light that comes from far away or from everywhere: it is cast as parallel beams."""

    @abstractmethod
    def suns(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[Floats, Floats, int]:
        """The light as parallel beams from a few directions.

        per_edge  rays along a voxel's edge
        Returns unit directions (n, 3) of travel, irradiances (n,) in W/m^2, and the rays of each
        beam along a voxel's edge.
        """


class LocalLight(Light):
    """A lamp: its `spectrum` is a power in W, and its rays are regular.

    About per_edge^2 or more of them cross each voxel that the light reaches.
    """

    @abstractmethod
    def rays(self, medium: BaseMedium, band: int, per_edge: int) -> tuple[float, Iterator[Photons]]:
        """As of `Light.rays`."""


def darkness(lights: Iterable[Light]) -> LightError:
    """The LightError that explains why a medium is dark."""
    if any(isinstance(light, LocalLight) and np.any(light.spectrum) for light in lights):
        return LightError(
            "There is no light on what is to be lit: no lamp shines on it; turn or move one, or "
            "add a sun."
        )
    return LightError("There is no light; add a sun, or a world with a colour that is not black.")


def multiple(lights: Sequence[Light], medium: BaseMedium, band: int, base: int) -> float | None:
    """The number m for which the lights emit in `band` exactly m times what they emit in `base`.

    None if there is no such number: then `band` has to be solved, too. It is also None for a sky
    that is a function of directions with several bands, as not all its values are known.
    """
    rows = [_rows(light.spectrum, medium.bands) for light in lights]
    total, total_base = (sum(row[b].sum(dtype=float) for row in rows) for b in (band, base))
    if total_base == 0:
        return None if total else 0.0
    factor = total / total_base
    return float(factor) if all(same(row[band], factor * row[base]) for row in rows) else None


def same(values: Array | float, others: Array | float) -> bool:
    """Whether values agree up to rounding: an emission is stored in float32, and a multiple of it
    is rounded again."""
    return np.allclose(values, others, rtol=1e-6, atol=0)


def bands_of(light: Light) -> int:
    """The number of bands of a light's spectrum; 1 if all bands are equal."""
    spectrum = light.spectrum
    return np.size(spectrum(np.array((0.0, 0.0, 1.0))) if callable(spectrum) else spectrum)


def by_band(value: Spectrum, bands: int) -> Floats:
    """A spectral quantity as (bands,) float64; LightError if it has another number of bands."""
    value = np.atleast_1d(np.asarray(value, float))
    if value.shape not in ((1,), (bands,)):
        raise LightError(f"A light has {value.size} bands where the medium has {bands}.")
    return np.broadcast_to(value, (bands,))


def _rows(spectrum: Any, bands: int) -> Floats:
    """(bands, n): two bands are multiples of each other exactly if their rows are."""
    if callable(spectrum):
        radiance = spectrum(np.array((0.0, 0.0, 1.0)))
        by_band(radiance, bands)  # refuses another number of bands
        return np.ones((bands, 1)) if np.size(radiance) == 1 else np.eye(bands)
    if np.ndim(spectrum) > 1:
        return np.reshape(spectrum, (bands, -1))
    return by_band(spectrum, bands)[:, None]


def check_energy(value: Spectrum, what: str) -> None:
    """Raise LightError if a power, radiance or irradiance is negative, NaN or too large."""
    value = np.asarray(value, float)
    is_bad: Booleans = ~((value >= 0) & (value <= LARGEST))  # NaN is neither
    bad = value[is_bad]
    if bad.size:
        raise LightError(f"The {what} must be between 0 and {LARGEST:.2g}; it is {bad[0]:g}.")


def check_place(place: Vector, what: str) -> None:
    """Raise LightError unless `place` is three finite numbers."""
    if len(place) != 3 or not np.all(np.isfinite(place)):
        raise LightError(f"A {what} needs a position; it has {place}.")


def check_direction(direction: Vector, what: str) -> None:
    """Raise LightError unless `direction` is three finite numbers, not all 0."""
    length = np.linalg.norm(direction)
    if len(direction) != 3 or not np.isfinite(length) or length == 0:
        raise LightError(f"A {what} needs a direction of three numbers; it has {direction}.")


def of_band(radiance: Floats, bands: int, band: int) -> Floats:
    """(n,): one band of the radiance (n,) or (n, bands) of n directions.

    Raises LightError if a radiance is not valid or has another number of bands.
    """
    check_energy(radiance, "radiance of the sky")
    radiance = radiance.reshape(len(radiance), -1)
    by_band(radiance[0], bands)  # refuses another number of bands
    return np.broadcast_to(radiance, (len(radiance), bands))[:, band]
