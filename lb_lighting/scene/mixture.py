# SPDX-License-Identifier: GPL-3.0-or-later
"""Several materials as one medium: densities are summed, optics averaged. Needs no Blender."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Floats, Vector
from ..errors import EmptyError
from ..transport.lights.base import Light
from ..transport.lights.distant import Sun
from ..transport.medium import Optics
from .materials import grey
from .remarks import listed

ALIKE = 1e-6  # largest difference of albedos and mean cosines that count as equal


@dataclass(frozen=True)
class Share:
    """What one material adds to the medium: `Optics` times a density.

    density  (nx, ny, nz)
    toward   if the density is a mean over directions: a function of the unit vector (3,) along
             which light travels, which returns the density for this light
    name     of the object, or "" if it has none
    """

    density: Floats
    optics: Optics
    toward: Callable[[Floats], Floats] | None = None
    name: str = ""

    @property
    def sigma_t(self) -> float:
        """1/m, see `max_extinction`."""
        return max_extinction(self.optics)


def max_extinction(optics: Optics) -> float:
    """1/m, the largest extinction coefficient of the bands at density 1."""
    return float(np.max(np.add(optics.sigma_s, optics.sigma_a)))


def mixture(shares: Sequence[Share], shines: bool = False) -> tuple[Floats, Optics]:
    """(density (nx, ny, nz), Optics): the shares as the single material that the lattice needs.

    If all shares have the same optics, the mixture has them, too, and the density is the sum.
    Otherwise the density is the extinction coefficient, 1/m, in the densest band of each share,
    summed. The optics are those per unit of this extinction, averaged with the total extinction of
    each share as weight. So each share keeps its extinction; only albedo and g are means.

    shines  whether a source emits light, which may be all that it does; the optics are then 0

    Raises EmptyError if there is neither density nor emission.
    """
    present = _present(shares)
    if not present and shines:
        return _total(share.density for share in shares), Optics(0.0, 0.0, 0.0)
    if not present:
        raise EmptyError(_no_density(shares))
    density = _total(
        share.density * unit for share, unit in zip(present, _units(present), strict=True)
    )
    if not np.ptp(_coefficients(present), axis=1).any():
        return density, present[0].optics
    # Average the optics.
    weight = np.array([share.density.sum(dtype=float) * share.sigma_t for share in present])
    weight /= weight.sum()
    sigma_s, sigma_a, g = _per_extinction(present)
    scattering = weight @ sigma_s
    mean_g = np.divide(
        weight @ (sigma_s * g), scattering, out=np.zeros_like(scattering), where=scattering > 0
    )
    return density, grey(Optics(tuple(scattering), tuple(weight @ sigma_a), tuple(mean_g)))


def _no_density(shares: Sequence[Share]) -> str:
    """The sentence for `shares` that are all empty, or that there are none of."""
    names = list(dict.fromkeys(share.name for share in shares if share.name))
    if not names:
        advice = "occluders only stop light, so select a volume, foliage or a solid, too"
    else:
        advice = f"check the material, the grid and the frame of {listed(names)}, and the Domain"
    return f"There is no density to light here; {advice}."


def is_exact(shares: Sequence[Share]) -> bool:
    """Whether the `shares` differ only in density, so that their `mixture` is no average."""
    present = _present(shares)
    return not present or bool(np.ptp(_per_extinction(present), axis=1).max() <= ALIKE)


def with_shadows(lights: Sequence[Light], shares: Sequence[Share]) -> Sequence[Light]:
    """`lights`; if one of the `shares` has a `toward`, the suns get their `shadow_density`."""
    present = _present(shares)
    if not any(share.toward for share in present):
        return lights
    return [
        replace(light, shadow_density=_shadow_density(present, light.direction))
        if isinstance(light, Sun)
        else light
        for light in lights
    ]


def _shadow_density(shares: Sequence[Share], direction: Vector) -> Floats:
    """(nx, ny, nz): the density of `mixture` for light of this direction alone."""
    direction = np.divide(direction, np.linalg.norm(direction))
    return _total(
        (share.toward(direction) if share.toward else share.density) * unit
        for share, unit in zip(shares, _units(shares), strict=True)
    )


def occluders(occlusions: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """(occlusion (nx, ny, nz), albedo (1 or 3,) or (1 or 3, nx, ny, nz)): all `occlusions` in one.

    occlusions  see `Source.occlusion`

    If several occlude a voxel, its albedo is their mean, weighted by the share each stops.
    """
    shares, colors = zip(*occlusions, strict=True)
    if not np.ptp(colors, axis=0).any():
        albedo = colors[0]
    else:
        total = np.maximum(np.sum(shares, axis=0), np.finfo(np.float32).tiny)
        albedo = np.clip(np.einsum("kxyz,kb->bxyz", shares, colors) / total, 0, 1)
    is_grey = not np.ptp(colors, axis=1).any()
    return np.max(shares, axis=0), albedo[:1] if is_grey else albedo


def _present(shares: Iterable[Share]) -> list[Share]:
    """Those of `shares` that have both density and extinction."""
    return [share for share in shares if share.sigma_t and share.density.any()]


def _units(shares: Sequence[Share]) -> list[float]:
    """The factor on the density of each share in a `mixture`."""
    are_alike = not np.ptp(_coefficients(shares), axis=1).any()
    return [1.0 if are_alike else share.sigma_t for share in shares]


def _total(densities: Iterable[Floats]) -> Floats:
    total: Floats = np.sum(list(densities), axis=0, dtype=np.float32)
    return total


def _coefficients(shares: Sequence[Share]) -> Floats:
    """(3, shares, bands): sigma_s, sigma_a and g."""
    values = [v for s in shares for v in (s.optics.sigma_s, s.optics.sigma_a, s.optics.g)]
    columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in values))
    return np.reshape(columns, (len(shares), 3, -1)).swapaxes(0, 1)


def _per_extinction(shares: Sequence[Share]) -> Floats:
    """`_coefficients`, with sigma_s and sigma_a per unit of the `sigma_t` of each share."""
    sigma_s, sigma_a, g = _coefficients(shares)
    sigma_t = np.array([[share.sigma_t] for share in shares])
    return np.stack([sigma_s / sigma_t, sigma_a / sigma_t, g])


def scaled(optics: Optics, largest: float) -> Optics:
    """`optics`, scaled to the `max_extinction` `largest`, 1/m."""
    sigma_s, sigma_a = np.atleast_1d(optics.sigma_s), np.atleast_1d(optics.sigma_a)
    factor = largest / (sigma_s + sigma_a).max()
    return Optics(tuple(sigma_s * factor), tuple(sigma_a * factor), optics.g)
