# SPDX-License-Identifier: GPL-3.0-or-later
"""What several materials come to in one medium: densities summed, optics averaged."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import EmptyError
from ..transport.lights.distant import Sun
from ..transport.medium import Optics
from .materials import grey

ALIKE = 1e-6  # albedos and mean cosines no further apart than that are the same


@dataclass(frozen=True)
class Share:
    """What one material adds to the medium: density (nx, ny, nz) times `Optics`.

    toward  where the density is a mean over directions: the function that takes the unit vector
            (3,) along which light travels, and returns the density that this light meets
    """

    density: np.ndarray
    optics: Optics
    toward: Callable | None = None

    @property
    def sigma_t(self):
        """1/m, the extinction coefficient at density 1 of the band that has most."""
        return float(np.max(np.add(self.optics.sigma_s, self.optics.sigma_a)))


def mixture(shares, shines=False):
    """(density (nx, ny, nz), Optics): the shares as one material, which the lattice needs.

    Shares of the same optics keep them, and their densities are summed. Otherwise the density is
    the extinction coefficient, 1/m, of each share's densest band, summed, and the optics are the
    shares' per such extinction, averaged by how much of it there is of each: so every share keeps
    its own extinction, and only albedo and g are means.

    shines  whether some of it shines, which may be all that it does: the optics are 0 then

    EmptyError where there is neither density nor anything that shines.
    """
    places, shares = shares, _present(shares)
    if not shares and shines:
        return _total(share.density for share in places), Optics(0.0, 0.0, 0.0)
    if not shares:
        raise EmptyError(
            "There is no density to light here; check the grid, the frame, the region and the "
            "material."
        )
    density = _total(
        share.density * unit for share, unit in zip(shares, _units(shares), strict=True)
    )
    if not np.ptp(_coefficients(shares), axis=1).any():
        return density, shares[0].optics
    weight = np.array([share.density.sum(dtype=float) * share.sigma_t for share in shares])
    weight /= weight.sum()
    sigma_s, sigma_a, g = _per_extinction(shares)
    scattering = weight @ sigma_s
    mean_g = np.divide(
        weight @ (sigma_s * g), scattering, out=np.zeros_like(scattering), where=scattering > 0
    )
    return density, grey(Optics(tuple(scattering), tuple(weight @ sigma_a), tuple(mean_g)))


def is_exact(shares):
    """Whether `mixture` keeps what each of the `shares` is, for they differ in density alone."""
    shares = _present(shares)
    return not shares or np.ptp(_per_extinction(shares), axis=1).max() <= ALIKE


def with_shadows(lights, shares):
    """`lights`, the suns with their `shadow_density` where one of `shares` has a `toward`."""
    shares = _present(shares)
    if not any(share.toward for share in shares):
        return lights
    return [
        replace(light, shadow_density=_shadow_density(shares, light.direction))
        if isinstance(light, Sun)
        else light
        for light in lights
    ]


def _shadow_density(shares, direction):
    """(nx, ny, nz): the density of `mixture` as light of that direction alone meets it."""
    direction = np.divide(direction, np.linalg.norm(direction))
    return _total(
        (share.toward(direction) if share.toward else share.density) * unit
        for share, unit in zip(shares, _units(shares), strict=True)
    )


def occluders(occlusions):
    """(occlusion (nx, ny, nz), albedo (1 or 3,) or (1 or 3, nx, ny, nz)): several as one.

    occlusions  what the sources' `occlusion` returned

    Where several stop light in a voxel, the albedo is their mean by how much each stops.
    """
    shares, colors = zip(*occlusions, strict=True)
    if not np.ptp(colors, axis=0).any():
        albedo = colors[0]
    else:
        total = np.maximum(np.sum(shares, axis=0), np.finfo(np.float32).tiny)
        albedo = np.clip(np.einsum("kxyz,kb->bxyz", shares, colors) / total, 0, 1)
    is_grey = not np.ptp(colors, axis=1).any()
    return np.max(shares, axis=0), albedo[:1] if is_grey else albedo


def _present(shares):
    """Those of `shares` that light meets at all."""
    return [share for share in shares if share.sigma_t and share.density.any()]


def _units(shares):
    """What the density of each share is multiplied with in a `mixture`."""
    alike = not np.ptp(_coefficients(shares), axis=1).any()
    return [1.0 if alike else share.sigma_t for share in shares]


def _total(densities):
    return np.sum(list(densities), axis=0, dtype=np.float32)


def _coefficients(shares):
    """(3, shares, bands): sigma_s, sigma_a and g."""
    values = [v for s in shares for v in (s.optics.sigma_s, s.optics.sigma_a, s.optics.g)]
    columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in values))
    return np.reshape(columns, (len(shares), 3, -1)).swapaxes(0, 1)


def _per_extinction(shares):
    """`_coefficients`, with sigma_s and sigma_a per unit of each share's `sigma_t`."""
    sigma_s, sigma_a, g = _coefficients(shares)
    sigma_t = np.array([[share.sigma_t] for share in shares])
    return np.stack([sigma_s / sigma_t, sigma_a / sigma_t, g])


def scaled(optics, largest):
    """`optics` times a factor that makes the largest sigma_t of its bands `largest`, 1/m."""
    sigma_s, sigma_a = np.atleast_1d(optics.sigma_s), np.atleast_1d(optics.sigma_a)
    factor = largest / (sigma_s + sigma_a).max()
    return Optics(tuple(sigma_s * factor), tuple(sigma_a * factor), optics.g)
