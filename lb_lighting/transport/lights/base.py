# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights, as plain values in SI units, and the photons that they send into a medium.

Every spectral quantity is a scalar or (bands,). A light is anything with the two members

    spectrum                          what it emits, by band; see `multiple`
    emit(count, medium, rng, band)    `count` photons of one band, drawn with a Generator of NumPy

where emit returns

    origins     (count, 3) m, world space: on the domain's faces, or where the light itself is
    directions  (count, 3) unit vectors, the way the photons travel
    power       (count,) W carried by each; the expectation of their sum is the power that the
                light sends to the domain, with that of the photons that miss it

The photons of one call are spread evenly (`strata`) and so depend on each other: a variance is
found from several calls. emit raises LightError for fewer photons than 1, and for a light whose
bands are not the medium's.

A light may have a third,

    rays(medium, band, per_edge)      the same light as rays, spread as regularly as they can be

which returns (the power of the strongest ray in W, an iterator of such triples as emit's): the
same rays at every call, about per_edge^2 or more of them through each voxel that the light reaches.
Where all that it sends comes from far away, or from everywhere, it has instead

    suns(medium, band, per_edge)      the same light as parallel light from a few directions

which returns (unit directions (n, 3) that it travels, irradiances (n,) W/m^2, the rays along a
voxel's edge that each takes).
"""

import numpy as np

from ...errors import LightError
from ..medium import LARGEST


def darkness(lights):
    """The LightError that tells why a medium is dark in some lights."""
    if any(np.any(getattr(light, "power", 0)) for light in lights):
        return LightError(
            "There is no light on what is to be lit: no lamp shines on it; turn or move one, or "
            "add a sun."
        )
    return LightError("There is no light; add a sun, or a world with a colour that is not black.")


def multiple(lights, medium, band, base):
    """The number m for which the lights emit in `band` exactly m times what they emit in `base`.

    None where there is none, so that `band` must be solved for itself. A sky that is a function
    of colours counts as such: nobody knows all its directions.
    """
    rows = [_rows(light.spectrum, medium.bands) for light in lights]
    total, total_base = (sum(row[b].sum(dtype=float) for row in rows) for b in (band, base))
    if total_base == 0:
        return None if total else 0.0
    factor = total / total_base
    return float(factor) if all(same(row[band], factor * row[base]) for row in rows) else None


def same(values, others):
    """Whether values are the same but for rounding: an emission is stored in float32, and a
    multiple of it is rounded again."""
    return np.allclose(values, others, rtol=1e-6, atol=0)


def bands_of(light):
    """How many bands the spectrum of a light has: 1 is the same in all."""
    spectrum = light.spectrum
    return np.size(spectrum(np.array((0.0, 0.0, 1.0))) if callable(spectrum) else spectrum)


def by_band(value, bands):
    """A spectral quantity as (bands,) float64; LightError if it has another number of bands."""
    value = np.atleast_1d(np.asarray(value, float))
    if value.shape not in ((1,), (bands,)):
        raise LightError(f"A light has {value.size} bands where the medium has {bands}.")
    return np.broadcast_to(value, (bands,))


def _rows(spectrum, bands):
    """(bands, n): two bands are multiples of each other where, and only where, their rows are."""
    if callable(spectrum):
        radiance = spectrum(np.array((0.0, 0.0, 1.0)))
        by_band(radiance, bands)  # refuses another number of bands
        return np.ones((bands, 1)) if np.size(radiance) == 1 else np.eye(bands)
    if np.ndim(spectrum) > 1:
        return spectrum.reshape(bands, -1)
    return by_band(spectrum, bands)[:, None]


def check_energy(value, what):
    value = np.asarray(value, float)
    bad = value[~((value >= 0) & (value <= LARGEST))]  # NaN is neither
    if bad.size:
        raise LightError(f"The {what} must be between 0 and {LARGEST:.2g}; it is {bad[0]:g}.")


def check_place(place, what):
    if len(place) != 3 or not np.all(np.isfinite(place)):
        raise LightError(f"A {what} needs a position; it has {place}.")


def check_direction(direction, what):
    length = np.linalg.norm(direction)
    if len(direction) != 3 or not np.isfinite(length) or length == 0:
        raise LightError(f"A {what} needs a direction of three numbers; it has {direction}.")


def of_band(radiance, bands, band):
    """(n,) of the radiance (n,) or (n, bands) of n directions; LightError where it cannot be."""
    check_energy(radiance, "radiance of the sky")
    radiance = radiance.reshape(len(radiance), -1)
    by_band(radiance[0], bands)  # refuses another number of bands
    return np.broadcast_to(radiance, (len(radiance), bands))[:, band]
