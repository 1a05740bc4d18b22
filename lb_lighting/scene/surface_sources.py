# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces as sources: foliage, solids and occluders; see `sources`."""

from functools import cached_property

import numpy as np

from ..errors import SceneError
from . import voxelize
from .materials import has_surface
from .mixture import Share, scaled
from .reader import FROM_MATERIAL
from .sources import Source, longest

COARSEST = 4  # voxels: faces of an occluder with longer edges cannot carry light on their corners


class _SurfaceSource(Source):
    """dimensions        that it has at least where it is not scaled to nothing
    lights_instances  whether a modifier of the object can light all that it instances
    """

    dimensions = 2

    def __init__(self, ob, parts, reader):
        super().__init__(ob, reader)
        self.faces = [part.faces for part in parts]
        for faces in self.faces:
            faces.refuse_broken(self.dimensions)
        # A modifier of the object sees the instances that modifiers make, and no others.
        duplicates = ob.instance_type != "NONE" or len(ob.particle_systems)
        instanced = any(part.instanced for part in parts)
        self.lights_instances = self.is_foliage and instanced and not duplicates
        if self.shows_light and ob.type == "MESH" and instanced and not self.lights_instances:
            reader.notes.append(
                f"The instances of '{ob.name}' shade and colour the light, but show none of it "
                "themselves; make them real to light them."
            )

    @cached_property
    def bounds(self):
        return voxelize.world_bounds(self.faces)

    @property
    def triangles(self):
        """(n, 3, 3) m, of all its faces."""
        return np.concatenate([faces.triangles for faces in self.faces])


class FoliageSource(_SurfaceSource):
    """Leaves, or any surface that lets light through between its pieces.

    instanced  names of the materials of what it instances, None where that has none
    """

    shows_light = True
    is_foliage = True

    def __init__(self, ob, parts, reader):
        super().__init__(ob, parts, reader)
        self.leaves = [self._leaf(part) for part in parts]
        self.instanced = [part.material and part.material.name for part in parts if part.instanced]

    def _leaf(self, part):
        """(share of the faces that is not a hole, Optics at 1/m of extinction)."""
        if self.reader.medium != FROM_MATERIAL:
            return 1.0, scaled(self.reader.chosen(), 1.0)
        leaf = self.reader.leaf(part)
        return leaf.coverage, leaf.optics

    def shares(self, domain):
        return [
            self._share(faces, *leaf, domain)
            for faces, leaf in zip(self.faces, self.leaves, strict=True)
        ]

    def _share(self, faces, coverage, optics, domain):
        def density(direction=None):
            return voxelize.foliage_density(faces, domain, direction) * coverage

        return Share(density(), optics, density)


class SolidSource(_SurfaceSource):
    """A closed body of a translucent material."""

    preset = "pmma"
    is_body = True
    dimensions = 3

    def __init__(self, ob, parts, reader):
        materials = [part.material for part in parts]
        self.shows_light = any(map(has_surface, materials))
        super().__init__(ob, parts, reader)
        self.material = reader.volume_optics(ob, materials, self.preset)
        if self.material and self.material.needs_grid:
            raise SceneError(
                f"The density of '{ob.name}' follows the attribute "
                f"'{self.material.density_attribute}', which a mesh does not have inside, so "
                "Cycles renders nothing of it; give its material a plain density."
            )
        self.glows = reader.glows(ob, materials, self.material)

    @property
    def is_volume(self):
        return not self.shows_light

    def shares(self, domain):
        fraction = voxelize.solid_fraction(self.triangles, domain)
        if self.material is None:
            return [Share(fraction, self.reader.preset(self.preset, longest(domain)))]
        return [Share(fraction, self.material.optics)]

    def emission(self, domain):
        if not self.glows:
            return None
        radiance = sum(glow.radiance({}) for glow in self.glows if not glow.needed)
        fraction = voxelize.solid_fraction(self.triangles, domain)
        return np.multiply.outer(radiance * np.ones(3), fraction)


class OccluderSource(_SurfaceSource):
    """A body or a wall that stops all light, and throws back the share that its colour says."""

    shows_light = True
    is_wall = True

    def __init__(self, ob, parts, reader):
        super().__init__(ob, parts, reader)
        self.colors = reader.occluder_colors(ob, parts)

    def occlusion(self, domain):
        triangles = self.triangles
        if voxelize.longest_edge(triangles) > COARSEST * domain.voxel_size:
            self.shows_light = False
            self.reader.notes.append(
                f"'{self.name}' shows none of the light, for its faces are larger than "
                f"{COARSEST} voxels; subdivide it to light it."
            )
        closed = np.concatenate([faces.closed for faces in self.faces])
        areas = [faces.area for faces in self.faces]
        color = np.average(self.colors, axis=0, weights=areas if any(areas) else None)
        stopped = voxelize.opaque_share(triangles, closed, domain)
        return (stopped, color) if stopped.any() else None
