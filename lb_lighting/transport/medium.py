# SPDX-License-Identifier: GPL-3.0-or-later
"""The medium that light crosses: where it is, how dense, and how it scatters.

`Domain` is the box of voxels, `Optics` the material per unit density, and
`Medium` the two together with the density of each voxel.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Floats, Spectrum, Vector
from ..errors import MediumError

LARGEST = float(np.finfo(np.float32).max)  # of any quantity: devices compute in float32
DEEPEST = 1e30  # largest optical depth of a voxel's edge: float32 can still square it
SMALLEST_EDGE = 3  # voxels: a boundary node on either side and one node between them


@dataclass(frozen=True)
class Domain:
    """An axis-aligned box of cubic voxels in world space.

    origin      (3,) m, the outer corner of voxel (0, 0, 0)
    voxel_size  m, the edge of a voxel
    shape       (nx, ny, nz) voxels
    """

    origin: tuple[float, ...]
    voxel_size: float
    shape: tuple[int, ...]

    @classmethod
    def around(cls, lower: Vector, upper: Vector, resolution: int, padding: int = 2) -> "Domain":
        """The domain that holds the box from `lower` to `upper` (each (3,) m), centred on it.

        resolution  voxels along the longest edge, padding included
        padding     empty voxels kept on every side
        Raises MediumError for an empty box or too low a resolution.
        """
        lower, upper = np.asarray(lower, float), np.asarray(upper, float)
        with np.errstate(over="ignore", invalid="ignore"):  # refused in the next line
            extent = upper - lower
        if not np.all(np.isfinite(extent)) or np.any(extent < 0) or extent.max() == 0:
            raise MediumError("The region to light has no extent; select something with a size.")
        if resolution < 2 * padding + SMALLEST_EDGE:
            raise MediumError(
                f"A resolution of {resolution} voxels is too low; "
                f"use {2 * padding + SMALLEST_EDGE} or more."
            )
        voxel_size = float(extent.max() / (resolution - 2 * padding))
        # The tolerance keeps rounding from adding a voxel to an edge that divides evenly.
        inner = np.maximum(1, np.ceil(extent / voxel_size - 1e-6)).astype(int)
        shape = inner + 2 * padding
        origin = lower / 2 + upper / 2 - shape * voxel_size / 2
        return cls(tuple(map(float, origin)), voxel_size, tuple(map(int, shape)))

    @property
    def upper(self) -> tuple[float, ...]:
        """(3,) m, the corner opposite to `origin`."""
        return tuple(np.add(self.origin, np.multiply(self.shape, self.voxel_size)))

    @property
    def index_to_world(self) -> Floats:
        """(4, 4), m: from voxel indices (centres are integers) to positions in world space."""
        matrix = np.diag([self.voxel_size] * 3 + [1.0])
        matrix[:3, 3] = np.add(self.origin, self.voxel_size / 2)
        return matrix

    def to_index(self, points: Floats) -> Floats:
        """World points (..., 3) m -> continuous voxel coordinates; voxel centres are integers."""
        return (np.asarray(points, float) - self.origin) / self.voxel_size - 0.5

    def centers(self) -> Floats:
        """(nx, ny, nz, 3) m, the voxel centres."""
        axes = [
            o + (np.arange(n) + 0.5) * self.voxel_size
            for o, n in zip(self.origin, self.shape, strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


@dataclass(frozen=True)
class Optics:
    """How a material scatters at density 1: sigma_s, sigma_a (1/m) and g, scalars or by band."""

    sigma_s: tuple[float, ...] | float
    sigma_a: tuple[float, ...] | float
    g: tuple[float, ...] | float = 0.0


# The papers' materials: paper 1, section 3.2.1 (cloud), table 1 (plant), table 2 (PMMA).
PRESETS = {
    "cloud": Optics(sigma_s=0.792, sigma_a=0.008, g=0.9),
    "plant": Optics(
        sigma_s=(0.891, 0.909, 0.882), sigma_a=(0.109, 0.091, 0.118), g=(-0.231, 0.103, -0.750)
    ),
    "pmma": Optics(sigma_s=(0.99, 0.99, 0.99), sigma_a=(0.01, 0.01, 0.01), g=(0.80, -0.88, -0.88)),
}


class BaseMedium:
    """The common interface of media: coefficients by band, a position and voxels.

    sigma_s, sigma_a, g  (bands,) float64; sigma_* in 1/m at density 1
    origin               (3,) m, outer corner of voxel (0, 0, 0)
    emission             (bands, nx, ny, nz) W/m^3, or None
    occlusion            (nx, ny, nz), or None
    occlusion_albedo     (bands,) or (bands, nx, ny, nz); None without occlusion
    shift                (bands, bands), or None
    """

    sigma_s: Floats
    sigma_a: Floats
    g: Floats
    voxel_size: float  # m
    origin: tuple[float, ...]
    emission: Floats | None = None
    occlusion: Floats | None = None
    occlusion_albedo: Any = None
    shift: Floats | None = None

    @property
    def bands(self) -> int:
        """Number of bands."""
        return len(self.sigma_s)

    @property
    def shape(self) -> tuple[int, ...]:
        """(nx, ny, nz) voxels."""
        raise NotImplementedError

    @property
    def domain(self) -> Domain:
        """Where the voxels are."""
        return Domain(self.origin, self.voxel_size, self.shape)

    @property
    def sigma_t(self) -> Floats:
        """(bands,) 1/m, the extinction coefficient at density 1."""
        return self.sigma_s + self.sigma_a

    @property
    def albedo(self) -> Floats:
        """(bands,), the share of collisions that scatter; 0 where nothing collides."""
        return np.divide(
            self.sigma_s, self.sigma_t, out=np.zeros(self.bands), where=self.sigma_t > 0
        )


class Medium(BaseMedium):
    """A voxel medium; density is constant within a voxel, and outside is vacuum.

    density     (nx, ny, nz), dimensionless multiplier of the coefficients
    voxel_size  m
    sigma_s     scattering coefficient at density 1, 1/m, scalar or (bands,)
    sigma_a     absorption coefficient at density 1, 1/m, scalar or (bands,)
    g           mean cosine of the Henyey-Greenstein phase function, scalar or (bands,)
    origin      (3,) m, outer corner of voxel (0, 0, 0)
    emission    (nx, ny, nz) or (bands, nx, ny, nz), W/m^3 radiated isotropically, or None
    occlusion   (nx, ny, nz) or None, the share (0 to 1) of the light arriving at a voxel that
                opaque matter in it stops, whatever the density
    occlusion_albedo  the share (0 to 1) of the stopped light that is reflected diffusely, to the
                side that it came from; scalar, (bands,) or (bands, nx, ny, nz)
    shift       (bands, bands) or None: entry [i, j] is the share of the energy absorbed in band j
                that the medium radiates again in band i, isotropically (fluorescence); no column
                may sum to more than 1

    Attributes are the same, with sigma_s, sigma_a and g as (bands,) float64 arrays.
    Raises MediumError, which names the quantity and the place, for values that are not physical;
    nothing is clamped.
    """

    def __init__(
        self,
        density: ArrayLike,
        voxel_size: float,
        sigma_s: Spectrum,
        sigma_a: Spectrum,
        g: Spectrum = 0.0,
        origin: Vector = (0, 0, 0),
        emission: ArrayLike | None = None,
        occlusion: ArrayLike | None = None,
        occlusion_albedo: ArrayLike = 0.0,
        shift: ArrayLike | None = None,
    ) -> None:
        self.density = _grid(density, "density")
        self.voxel_size = float(voxel_size)
        if not 0 < self.voxel_size <= LARGEST:
            raise MediumError(
                f"The voxel size must be positive and at most {LARGEST:.1e} m; "
                f"it is {voxel_size} m."
            )
        self.origin = tuple(map(float, origin))
        if len(self.origin) != 3 or not np.all(np.isfinite(self.origin)):
            raise MediumError(f"The origin must be three finite coordinates; it is {origin}.")
        self.sigma_s, self.sigma_a, self.g = optics_by_band(sigma_s, sigma_a, g)
        self.emission = None if emission is None else self._emission(emission)
        self.occlusion = None if occlusion is None else self._occlusion(occlusion)
        self.occlusion_albedo = self._occlusion_albedo(occlusion_albedo)
        self.shift = None if shift is None else self._shift(shift)

    def altered(self, **changes: Any) -> "Medium":
        """The same medium, with other values for the arguments named."""
        names = ["density", "voxel_size", "sigma_s", "sigma_a", "g", "origin", "emission"]
        names += ["occlusion", "occlusion_albedo", "shift"]
        return Medium(**{name: getattr(self, name) for name in names} | changes)

    def divided(self, pieces: int) -> "Medium":
        """The same medium, each voxel divided into `pieces` along every edge."""
        grids = ("density", "emission", "occlusion", "occlusion_albedo")
        changes = {name: repeated(getattr(self, name), pieces) for name in grids}
        return self.altered(voxel_size=self.voxel_size / pieces, **changes)

    def merged(self, pieces: int) -> "Medium":
        """The same medium in voxels `pieces` times as large, each the mean of those in it.

        Empty voxels are added if the edges do not divide evenly.
        """
        changes = {name: merged(getattr(self, name), pieces) for name in ("density", "emission")}
        if self.occlusion is not None:
            opaque = merged(self.occlusion, pieces)
            changes |= {"occlusion": opaque}
            if self.occlusion_albedo.ndim == 4:
                reflected = merged(self.occlusion * self.occlusion_albedo, pieces)
                share = np.divide(reflected, opaque, out=np.zeros_like(reflected), where=opaque > 0)
                changes["occlusion_albedo"] = np.minimum(share, 1)
        return self.altered(voxel_size=self.voxel_size * pieces, **changes)

    def depth(self, sigma: float | np.floating[Any], box: Any = None) -> Floats:
        """(nx, ny, nz) float64, the optical depth of a voxel's edge by the coefficient sigma, 1/m.

        At most 1e30, so that float32 can compute with it. With a `Box`, only of the voxels in it.
        """
        density = self.density if box is None else box.of(self.density)
        return np.minimum((sigma * self.voxel_size) * density.astype(float), DEEPEST)

    def alike(self, band: int, other: int) -> bool:
        """Whether two bands have the same coefficients; their emission may differ."""
        values = (self.sigma_s, self.sigma_a, self.g, self.occlusion_albedo)
        return all(np.array_equal(v[band], v[other]) for v in values)

    @property
    def shape(self) -> tuple[int, ...]:
        """(nx, ny, nz) voxels."""
        return self.density.shape

    def _emission(self, emission: ArrayLike) -> Floats:
        emission = _float32(emission)
        if emission.shape not in (self.shape, (self.bands, *self.shape)):
            raise MediumError(
                f"The emission has shape {emission.shape}; it must be that of the density, "
                f"{self.shape}, or {(self.bands, *self.shape)}."
            )
        _refuse_bad_voxels(emission, "emission")
        return np.ascontiguousarray(np.broadcast_to(emission, (self.bands, *self.shape)))

    def _occlusion(self, occlusion: ArrayLike) -> Floats:
        occlusion = _grid(occlusion, "occlusion")
        if occlusion.shape != self.shape:
            raise MediumError(
                f"The occlusion has shape {occlusion.shape}; it must be that of the density, "
                f"{self.shape}."
            )
        if occlusion.max() > 1:
            raise MediumError(f"The occlusion must be at most 1; it reaches {occlusion.max():g}.")
        return occlusion

    def _occlusion_albedo(self, albedo: ArrayLike) -> Floats:
        """(bands,) or (bands, nx, ny, nz) float32."""
        albedo = _float32(albedo)
        if albedo.size == 1:
            albedo = np.full(self.bands, albedo.item(), np.float32)
        if albedo.shape not in ((self.bands,), (self.bands, *self.shape)):
            raise MediumError(
                f"The occlusion's albedo has shape {albedo.shape}; it must be one number, one for "
                f"each band, or {(self.bands, *self.shape)}."
            )
        if not np.all((albedo >= 0) & (albedo <= 1)):
            raise MediumError("The occlusion's albedo must lie between 0 and 1 everywhere.")
        return albedo

    def _shift(self, shift: ArrayLike) -> Floats:
        shift = np.asarray(shift, float)
        if shift.shape != (self.bands, self.bands):
            raise MediumError(
                f"The shift between bands has shape {shift.shape}; it must be "
                f"{(self.bands, self.bands)}."
            )
        if not (np.all(shift >= 0) and np.all(shift.sum(axis=0) <= 1 + 1e-9)):
            raise MediumError(
                "The shift between bands must not be negative, and no column may sum to more "
                "than 1: no band gives away more than it absorbs."
            )
        if shift.diagonal().any():
            raise MediumError(
                "The shift gives energy from a band to itself; make that part of sigma_s."
            )
        return shift


def _grid(values: ArrayLike, name: str) -> Floats:
    """`values` as a contiguous float32 grid, or a MediumError that says what is wrong with it."""
    values = np.asarray(values)
    if values.ndim != 3 or values.size == 0:
        raise MediumError(
            f"The {name} must be a grid of three dimensions with at least one voxel; "
            f"its shape is {values.shape}."
        )
    values = _float32(values)
    _refuse_bad_voxels(values, name)
    return values


def _float32(values: ArrayLike) -> Floats:
    """`values` as a contiguous float32 array, infinite where they are too large for it."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(values, np.float32)


def _refuse_bad_voxels(values: Floats, name: str) -> None:
    for bad, what in ((~np.isfinite(values), "not finite"), (values < 0, "negative")):
        count = np.count_nonzero(bad)
        if count:
            voxel = tuple(int(i) for i in np.argwhere(bad)[0])
            raise MediumError(
                f"The {name} is {what} in {count} of {values.size} voxels, "
                f"first at {voxel}; repair the grid and try again."
            )


def optics_by_band(
    sigma_s: Spectrum, sigma_a: Spectrum, g: Spectrum
) -> tuple[Floats, Floats, Floats]:
    """The coefficients broadcast to (bands,) float64, refused where they are not physical."""
    named = {
        "sigma_s": np.atleast_1d(np.asarray(sigma_s, float)),
        "sigma_a": np.atleast_1d(np.asarray(sigma_a, float)),
        "g": np.atleast_1d(np.asarray(g, float)),
    }
    try:
        bands = np.broadcast_shapes(*(v.shape for v in named.values()))
    except ValueError:
        bands = ()
    if len(bands) != 1 or bands[0] == 0:
        shapes = ", ".join(f"{name} {v.shape}" for name, v in named.items())
        raise MediumError(f"The coefficients must agree on the number of bands; got {shapes}.")
    for name, values in named.items():
        good = np.abs(values) < 1 if name == "g" else (values >= 0) & (values <= LARGEST)
        if not np.all(good):
            band = int(np.argmin(good))
            rule = "between -1 and 1" if name == "g" else f"between 0 and {LARGEST:.1e}"
            raise MediumError(f"{name} must be {rule}; in band {band} it is {values[band]}.")
    scattering, absorption, cosine = (np.broadcast_to(v, bands).copy() for v in named.values())
    return scattering, absorption, cosine


def repeated(grid: Any, times: int) -> Any:
    """A grid (..., nx, ny, nz) with each voxel repeated along every edge; others unchanged."""
    if np.ndim(grid) >= 3:
        for axis in (-3, -2, -1):
            grid = grid.repeat(times, axis=axis)
    return grid


def deepest(depth: Floats) -> float:
    """The largest sum of a grid (nx, ny, nz) along a line through it, along any axis."""
    return float(max(depth.sum(axis=axis).max() for axis in range(3)))


def merged(grid: Any, pieces: int) -> Any:
    """The means of cubes of `pieces` voxels of a grid (..., nx, ny, nz), padded with zeros at the
    upper ends where the cubes do not fit; None stays None."""
    if grid is None:
        return None
    *outer, nx, ny, nz = grid.shape
    behind = [(0, 0)] * len(outer) + [(0, -n % pieces) for n in (nx, ny, nz)]
    split = [part for n in (nx, ny, nz) for part in (-(-n // pieces), pieces)]
    return np.pad(grid, behind).reshape(*outer, *split).mean(axis=(-5, -3, -1))


def paper_units(medium: Medium) -> Medium:
    """The same medium in the units of the paper's lattice: probabilities instead of 1/m.

    The paper has no unit of length: sigma x density is the share of light that collides on its
    way through a voxel. In a medium of sigma_t per metre that share is 1 - exp(-sigma_t density
    h), with h the voxel size, which is never over 1, so the lattice is stable. The densest band
    (largest sigma_t) is taken exactly; the others keep their ratio to it.
    """
    largest = float(medium.sigma_t.max())
    if largest == 0:
        return medium
    return medium.altered(
        density=-np.expm1(-largest * medium.voxel_size * medium.density.astype(float)),
        sigma_s=medium.sigma_s / largest,
        sigma_a=medium.sigma_a / largest,
    )
