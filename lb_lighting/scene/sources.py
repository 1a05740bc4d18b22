# SPDX-License-Identifier: GPL-3.0-or-later
"""What a selected object is to the light: a volume, smoke, foliage, a solid or an occluder."""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from mathutils import Vector

from ..errors import SceneError
from ..transport.medium import PRESETS, Optics
from . import smoke, volumes, voxelize
from .materials import has_surface, leaf_optics, volume_optics

FROM_MATERIAL = "MATERIAL"
SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "EMPTY"}


@dataclass(frozen=True)
class Share:
    """What one material adds to the medium: density (nx, ny, nz) times `Optics`."""

    density: np.ndarray
    optics: Optics


@dataclass
class Reader:
    """How sources are read: the choices of the user, and what to tell about them.

    medium         FROM_MATERIAL, or the name of one of PRESETS for everything
    optical_depth  of a straight line as long as the domain through density 1, for presets in
                   volumes and solids; foliage has its own, from its leaves
    grid           name of the grid to read, or "" for the one that the material names
    """

    depsgraph: object
    medium: str
    optical_depth: float
    grid: str
    notes: list = field(default_factory=list)

    def volume_optics(self, ob, material):
        """The `VolumeOptics` to use, or None where a preset stands in for the material."""
        if self.medium != FROM_MATERIAL:
            return None
        found = volume_optics(material) if material else None
        if found is None:
            self.notes.append(f"'{ob.name}' has no volume material; the preset stands in.")
        return found

    def preset(self, fallback, length):
        """The chosen preset (or `fallback`), scaled to `optical_depth` over `length` metres."""
        preset = PRESETS[fallback if self.medium == FROM_MATERIAL else self.medium]
        return _scaled(preset, self.optical_depth / length)


def open_sources(objects, reader):
    """The sources that the original `objects` are; SceneError names one that is none."""
    if not objects:
        raise SceneError("Nothing is selected; select a volume, a smoke domain or a mesh.")
    surfaces = [ob for ob in objects if _is_surface(ob)]
    parts = defaultdict(list)
    for part in voxelize.world_parts(reader.depsgraph, surfaces):
        parts[part.object].append(part)
    return [_open(ob, parts.get(ob, []), reader) for ob in objects]


def _is_surface(ob):
    return ob.type in SURFACE_TYPES and not smoke.find_domain_settings(ob)


def _open(ob, parts, reader):
    if ob.type == "VOLUME":
        return VolumeSource(ob, reader)
    if smoke.find_domain_settings(ob):
        return SmokeSource(ob, reader)
    if not _is_surface(ob) or not any(len(part.triangles) for part in parts):
        raise SceneError(
            f"'{ob.name}' has neither a volume nor faces; "
            "select a volume, a smoke domain or a mesh."
        )
    return _SURFACES[_surface_role(ob, parts)](ob, parts, reader)


def _surface_role(ob, parts):
    """The role that the user gave, or else solid where a volume fills it, and foliage if not."""
    role = ob.lb_lighting.role
    if role != "AUTO":
        return role
    filled = any(part.material and volume_optics(part.material) for part in parts)
    return "SOLID" if filled else "FOLIAGE"


class _Source:
    """ob, bounds ((lower, upper) in m), and what they put on a lattice.

    is_volume  whether its light is shown by a lit volume in its place, or on its surface
    """

    is_volume = False

    def shares(self, domain):
        """[Share] on the lattice of `domain`."""
        return []

    def occlusion(self, domain):
        """(nx, ny, nz), the share of each voxel's light that is stopped, or None."""
        return None


class VolumeSource(_Source):
    """A Volume object: one grid of it."""

    is_volume = True

    def __init__(self, ob, reader):
        self.ob, self.reader = ob, reader
        self.material = reader.volume_optics(ob, ob.active_material)
        named = self.material.density_attribute if self.material else None
        self.grid = volumes.load_grid(ob, reader.depsgraph, reader.grid or named or "density")
        self.matrix = ob.evaluated_get(reader.depsgraph).matrix_world
        self.bounds = volumes.world_bounds(self.grid, self.matrix)

    def shares(self, domain):
        density = volumes.resample(self.grid, self.matrix, domain)
        if self.material and self.ob.data.render.space == "OBJECT":
            # A material's coefficients are then per unit of the object's own space.
            density /= (self.matrix.to_3x3() @ Vector((1, 1, 1)).normalized()).length
        return [_volume_share(density, self, domain)]


class SmokeSource(_Source):
    """The domain of a gas simulation, at the current frame."""

    is_volume = True

    def __init__(self, ob, reader):
        self.ob, self.reader = ob, reader
        self.material = reader.volume_optics(ob, ob.active_material)
        self.bounds = smoke.world_bounds(ob, reader.depsgraph)

    def shares(self, domain):
        grids = smoke.smoke_grids(self.ob, self.reader.depsgraph, domain)
        named = self.material.density_attribute if self.material else None
        name = self.reader.grid or named or "density"
        if name not in grids:
            known = ", ".join(grids)
            raise SceneError(f"'{self.ob.name}' has no grid '{name}'; choose one of: {known}.")
        if "flame" in grids and grids["flame"].any():
            self.reader.notes.append(
                f"The fire of '{self.ob.name}' shines in the render, but does not light its smoke."
            )
        return [_volume_share(grids[name], self, domain)]


class _SurfaceSource(_Source):
    def __init__(self, ob, parts, reader):
        self.ob, self.parts, self.reader = ob, parts, reader
        self.bounds = voxelize.world_bounds(parts)


class FoliageSource(_SurfaceSource):
    """Leaves, or any surface that lets light through between its pieces."""

    def shares(self, domain):
        return [self._share(part, domain) for part in self.parts if len(part.triangles)]

    def _share(self, part, domain):
        density = voxelize.foliage_density(part.triangles, domain)
        if self.reader.medium != FROM_MATERIAL:
            return Share(density, _scaled(PRESETS[self.reader.medium], 1.0))
        leaf = leaf_optics(part.material)
        return Share(density * leaf.coverage, leaf.optics)


class SolidSource(_SurfaceSource):
    """A closed body of a translucent material."""

    @property
    def is_volume(self):
        return not any(has_surface(part.material) for part in self.parts)

    def shares(self, domain):
        material = next((part.material for part in self.parts if part.material), None)
        found = self.reader.volume_optics(self.ob, material)
        fraction = voxelize.solid_fraction(_triangles(self.parts), domain)
        return [
            Share(fraction, found.optics if found else self.reader.preset("pmma", _longest(domain)))
        ]


class OccluderSource(_SurfaceSource):
    """A closed body that stops all light."""

    def occlusion(self, domain):
        return voxelize.solid_fraction(_triangles(self.parts), domain)


_SURFACES = {"FOLIAGE": FoliageSource, "SOLID": SolidSource, "OCCLUDER": OccluderSource}


def mixture(shares):
    """(density (nx, ny, nz), Optics): the shares as one material, which the lattice needs.

    The density is the sum; the coefficients are means, weighed by how much there is of each
    share, so they are exact where all shares have the same optics. SceneError for no density.
    """
    mass = np.array([share.density.sum(dtype=float) for share in shares])
    if not mass.sum():
        raise SceneError(
            "There is no density to light here; check the grid, the frame and the region."
        )
    columns = [
        np.broadcast_arrays(*map(np.atleast_1d, (s.optics.sigma_s, s.optics.sigma_a, s.optics.g)))
        for s in shares
    ]
    bands = max(len(column[0]) for column in columns)
    sigma_s, sigma_a, g = (
        np.array([np.broadcast_to(column[i], bands) for column in columns], float) for i in range(3)
    )
    weight = mass[:, None] / mass.sum()
    scattering = (weight * sigma_s).sum(axis=0)
    mean_g = np.divide(
        (weight * sigma_s * g).sum(axis=0), scattering, out=np.zeros(bands), where=scattering > 0
    )
    density = np.sum([share.density for share in shares], axis=0, dtype=np.float32)
    return density, Optics(tuple(scattering), tuple((weight * sigma_a).sum(axis=0)), tuple(mean_g))


def _volume_share(density, source, domain):
    if source.material is None:
        return Share(density, source.reader.preset("cloud", _longest(domain)))
    if source.material.density_attribute is None and not source.reader.grid:
        density = (density > 0).astype(np.float32)  # a homogeneous material fills the grid
    return Share(density, source.material.optics)


def _scaled(optics, largest):
    """`optics` times a factor that makes the largest sigma_t of its bands `largest`, 1/m."""
    sigma_s, sigma_a = np.atleast_1d(optics.sigma_s), np.atleast_1d(optics.sigma_a)
    factor = largest / (sigma_s + sigma_a).max()
    return Optics(tuple(sigma_s * factor), tuple(sigma_a * factor), optics.g)


def _triangles(parts):
    return np.concatenate([part.triangles for part in parts])


def _longest(domain):
    """m, the longest edge of the domain."""
    return domain.voxel_size * max(domain.shape)
