# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces as sources: foliage, solids and occluders, as values; see `sources`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import ClassVar

import numpy as np

from ..arrays import Floats, Vector
from ..transport.medium import Domain, Optics
from . import enclosure, meshes, voxelize
from .grids.resample import Box
from .materials import VolumeOptics
from .meshes import Faces
from .mixture import Share
from .sources import Emission, Source, longest
from .triangles import longest_edge

COARSEST = 4  # voxels: the longest edge of an occluder's faces whose corners can show light


@dataclass(eq=False, kw_only=True)
class SurfaceSource(Source):
    """Faces, one `Faces` for each of its materials.

    lights_instances  whether a modifier of the object can light all its instances
    """

    faces: Sequence[Faces]
    lights_instances: bool

    @cached_property
    def bounds(self) -> Box:
        return meshes.world_bounds(self.faces)

    @property
    def triangles(self) -> Floats:
        """(n, 3, 3) m, of all its faces."""
        return np.concatenate([faces.triangles for faces in self.faces])


@dataclass(eq=False, kw_only=True)
class FoliageSource(SurfaceSource):
    """Leaves, or any surfaces with space between them.

    leaves     for each of `faces`: (share of its area that is not transparent, `Optics` at an
               extinction of 1 1/m)
    instanced  names of the materials that it instances, None for an instance without a material
    """

    leaves: Sequence[tuple[float, Optics]]
    instanced: Sequence[str | None]

    shows_light = True
    is_foliage = True

    def shares(self, domain: Domain) -> list[Share]:
        return [
            self._share_of(faces, *leaf, domain)
            for faces, leaf in zip(self.faces, self.leaves, strict=True)
        ]

    def _share_of(self, faces: Faces, coverage: float, optics: Optics, domain: Domain) -> Share:
        density = partial(_leaf_density, faces, coverage, domain)
        return Share(density(), optics, density, self.name)


def _leaf_density(
    faces: Faces, coverage: float, domain: Domain, direction: Floats | None = None
) -> Floats:
    """(nx, ny, nz) 1/m, see `foliage_density`."""
    return voxelize.foliage_density(faces, domain, direction) * coverage


@dataclass(eq=False, kw_only=True)
class SolidSource(SurfaceSource):
    """A closed body of a translucent material.

    shows_light  whether its material has a surface
    material     its `VolumeOptics`, or None for a preset
    glows        the emission of the material
    """

    shows_light: bool
    material: VolumeOptics | None
    glows: Sequence[Emission]

    preset: ClassVar[str] = "pmma"
    is_body = True

    @property
    def is_volume(self) -> bool:
        return not self.shows_light

    @property
    def shines(self) -> bool:
        return bool(self.glows)

    def shares(self, domain: Domain) -> list[Share]:
        fraction = enclosure.solid_fraction(self.triangles, domain)
        if self.material is None:
            optics = self.choice.scaled_optics(self.preset, longest(domain))
            return [Share(fraction, optics, name=self.name)]
        return [Share(fraction, self.material.optics, name=self.name)]

    def emission(self, domain: Domain) -> Floats | None:
        if not self.glows:
            return None
        radiance = sum(glow.radiance({}) for glow in self.glows if not glow.needed)
        fraction = enclosure.solid_fraction(self.triangles, domain)
        return np.multiply.outer(radiance * np.ones(3), fraction)


@dataclass(eq=False, kw_only=True)
class OccluderSource(SurfaceSource):
    """A body or a wall that stops all light and reflects a share of it.

    colors  [(3,)], the reflectance of each of `faces`
    """

    colors: Sequence[Vector]

    shows_light = True
    is_wall = True

    def occlusion(self, domain: Domain) -> tuple[Floats, Floats] | None:
        triangles = self.triangles
        if longest_edge(triangles) > COARSEST * domain.voxel_size:
            self.shows_light = False
            self.choice.notes.append(
                f"'{self.name}' shows none of the light, because its faces are larger than "
                f"{COARSEST} voxels; subdivide it to light it."
            )
        closed = np.concatenate([faces.closed for faces in self.faces])
        areas = [faces.area for faces in self.faces]
        weights = areas if any(areas) else None
        color: Floats = np.average(np.array(self.colors), axis=0, weights=weights)
        share = voxelize.opaque_share(triangles, closed, domain)
        return (share, color) if share.any() else None
