# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes and smoke domains as sources of what is lit; surfaces are in `surface_sources`.

Sources are made in Blender, and take from it what they need as arrays, which is quick. All else
(`bounds`, `shares`, `occlusion`) needs no Blender, and is done in the solver's process.
"""

from functools import cached_property

import numpy as np

from ..errors import SceneError
from . import smoke, volumes
from .emission import shining
from .grids.resample import averaged
from .grids.sparse import Matter
from .materials import first_volume, has_volume, tinted
from .mixture import Share
from .reader import FROM_MATERIAL

WORTHWHILE = 0.9  # of a volume's longest edge, over which nothing thin is left out


class Source:
    """name and place of its object, bounds ((lower, upper) in m), what it puts on a lattice.

    uid          the object's number for the session
    place        (4, 4), the object's space to world space
    is_volume    whether a lit volume in its place shows its light
    shows_light  whether its surface shows its light
    is_foliage   whether it is surfaces that light passes between
    lights_instances  whether a modifier of the object can light all that it instances
    is_body      whether that light is what comes out of it, not what falls on it
    is_wall      whether it stops all light
    glows        [Glow | BlackBody], see scene/emission.py
    """

    is_volume = False
    shows_light = False
    is_foliage = False
    lights_instances = False
    is_body = False
    is_wall = False
    glows = ()

    def __init__(self, ob, reader):
        self.name, self.uid, self.reader = ob.name, ob.session_uid, reader
        self.place = np.array(ob.evaluated_get(reader.depsgraph).matrix_world)
        if not np.isfinite(self.place).all():
            raise SceneError(
                f"'{ob.name}' has a location, rotation or scale that is not a number; clear it."
            )

    def shares(self, domain):
        """[Share] on the lattice of `domain`."""
        return []

    def occlusion(self, domain):
        """((nx, ny, nz), (3,)): the share of the light that comes to a voxel which is stopped
        there, and the share of that which goes back; or None."""
        return None

    def emission(self, domain):
        """(3, nx, ny, nz) W/(m^3 sr) that it shines with by itself, or None."""
        return None

    @property
    def shines(self):
        return bool(self.glows)


class _GridSource(Source):
    """A density grid that a volume material, or the preset for a cloud, shows."""

    is_volume = True
    preset = "cloud"

    def __init__(self, ob, reader, materials, known):
        super().__init__(ob, reader)
        material = first_volume(materials)
        self.material = reader.volume_optics(ob, [material], self.preset)
        self.glows = reader.glows(ob, [material], self.material)
        self.grid_name = self._grid_name(known)
        self._tell_even()

    def _grid_name(self, known):
        """The name of the grid that shows where it is, of those `known`, where they can be."""
        named = self.material.density_attribute if self.material else None
        if self.reader.grid or named:
            return self.reader.grid or named
        shining = [name for glow in self.glows for name in glow.grids]
        is_clear = self.material and self.material.is_clear
        names = (shining or ["density"]) if is_clear else ["density", *shining]
        return next((name for name in names if name in known), names[0])

    def _tell_even(self):
        """Add a note on a material that fills its grid, which Cycles does not render."""
        even = self.material and self.material.density_attribute is None
        is_seen = self.glows or (even and not self.material.is_clear)
        if even and is_seen and not self.reader.grid and not self.glowing_grids:
            self.reader.notes.append(
                f"The material of '{self.name}' reads no grid, so Cycles renders nothing of it; "
                f"it was lit as if it filled the grid '{self.grid_name}' evenly."
            )

    @property
    def glowing_grids(self):
        """{str}, the names of the grids that it shines by."""
        return {name for glow in self.glows for name in glow.grids}

    @property
    def limit(self):
        """What counts of the grid's values at most."""
        return self.material.limit if self.material else np.inf

    @property
    def fills(self):
        """Whether the material is homogeneous: all of the grid that is over 0 is density 1."""
        attribute = self.material and self.material.density_attribute
        return self.material is not None and attribute is None and not self.reader.grid

    def _counted(self, _first, values):
        """Values of the grid as the material counts them; of a vector the mean, as in Cycles."""
        numbers = values if values.ndim == 3 else values.mean(axis=0)
        return np.minimum(numbers, self.limit)

    def share(self, density, domain):
        if self.material is None:
            return Share(density, self.reader.preset(self.preset, longest(domain)))
        if self.fills:
            density = (density > 0).astype(np.float32)  # a homogeneous material fills the grid
        return Share(density, self.material.optics)


class VolumeSource(_GridSource):
    """A Volume object, or one whose geometry nodes make a volume: one grid of it."""

    def __init__(self, ob, reader):
        known = volumes.grid_names(ob, reader.depsgraph)
        super().__init__(ob, reader, self._materials(ob, reader), known)
        self.grid = volumes.find_grid(ob, reader.depsgraph, self.grid_name)
        self.matrix = volumes.world_matrix(ob, reader.depsgraph)
        self.is_in_object_space = volumes.is_in_object_space(ob, reader.depsgraph)
        self.fire = {
            name: volumes.find_grid(ob, reader.depsgraph, name)
            for name in self.glowing_grids.intersection(known)
        }

    @staticmethod
    def _materials(ob, reader):
        """[material or None] of its slots; those of the object where nodes give it none."""
        found = volumes.volume_materials(ob, reader.depsgraph)
        if found or ob.type == "VOLUME":
            return found
        slots = [slot.material for slot in ob.material_slots if has_volume(slot.material)]
        if slots and reader.medium == FROM_MATERIAL:
            reader.notes.append(
                f"The nodes of '{ob.name}' give their volume no material, and Cycles renders it "
                f"with a plain one; it was lit with '{slots[0].name}', which the object has. Add "
                "Set Material to the nodes to render that."
            )
        return slots

    @cached_property
    def cells(self):
        """The `SparseCells` of the density."""
        return volumes.cells_of(self.grid.vdb, self.matrix)

    @cached_property
    def matter(self):
        """The `Matter` of the density, with notes of what counts for something else."""
        matter = Matter.of(self.cells, self.fills)
        self.reader.notes.extend(matter.oddities(self.cells, self.name))
        return matter

    @cached_property
    def fires(self):
        """{name: (`SparseCells`, `Matter`)} of the grids that it shines by, noted likewise."""
        found = {}
        for name, grid in self.fire.items():
            cells = volumes.cells_of(grid.vdb, self.matrix)
            found[name] = cells, Matter.of(cells)
            self.reader.notes.extend(found[name][1].oddities(cells, self.name))
        return found

    @cached_property
    def bounds(self):
        whole = self.cells.bounds
        seen = self._seen_bounds(whole)
        if np.ptp(seen, axis=0).max() > WORTHWHILE * np.ptp(whole, axis=0).max():
            return whole
        share = self.matter.share_outside(self.cells, seen)
        self.reader.notes.append(
            f"'{self.name}' has voxels far from the others that are too thin to be seen, with "
            f"{share:.1g} of its density. They are not lit; choose a Domain to light them, too."
        )
        return seen

    def _seen_bounds(self, whole):
        """The part of the box `whole` in which anything can be seen."""
        shines_all_over = any(not self.fires.keys() & set(glow.grids) for glow in self.glows)
        if not len(self.matter.bricks) or shines_all_over:
            return whole
        seen = whole
        # In a smaller box, a preset is denser: the second time it is as dense as it can be.
        for _ in range(2):
            sigma_t = self._sigma_t(np.ptp(seen, axis=0).max())
            if not sigma_t:
                return whole
            seen = self.matter.bounds(self.cells, sigma_t)
        boxes = [seen, *(matter.bounds(cells) for cells, matter in self.fires.values())]
        return np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]

    def _sigma_t(self, longest):
        """1/m at density 1, in a domain whose longest edge has `longest` m."""
        if self.material is None:
            return Share(None, self.reader.preset(self.preset, longest)).sigma_t
        return Share(None, self.material.optics).sigma_t / self._metre

    def shares(self, domain):
        if not len(self.matter.bricks) and not self.glows:
            raise SceneError(
                f"The grid '{self.grid.name}' of '{self.name}' has no values over 0 to light."
            )
        density = averaged(self.cells, domain, self._counted, ())
        if self.material:
            density /= self._metre
        return [self.share(density, domain)]

    def emission(self, domain):
        if not self.glows:
            return None
        cells = {name: cells for name, (cells, _matter) in self.fires.items()}
        return shining(self.glows, cells, self.cells, domain) / self._metre

    @property
    def _metre(self):
        """How many of the lengths that the material's coefficients are per."""
        if not self.is_in_object_space:
            return 1.0
        return np.float32(np.linalg.norm(self.matrix[:3, :3].sum(axis=1)) / np.sqrt(3))


class SmokeSource(_GridSource):
    """The domain of a gas simulation, at the current frame."""

    def __init__(self, ob, reader):
        known = smoke.grid_names(ob, reader.depsgraph)
        super().__init__(ob, reader, smoke.materials(ob, reader.depsgraph), known)
        self.bounds = smoke.world_bounds(ob, reader.depsgraph)
        self.cells = smoke.read_grid(ob, reader.depsgraph, self.grid_name)
        # Nor does the preset know the colour of the smoke.
        self.hue = None if self.material else smoke.hue(ob, reader.depsgraph)
        self.fire = {
            name: smoke.read_grid(ob, reader.depsgraph, name)
            for name in self.glowing_grids.intersection(known)
        }
        if smoke.burns(ob, reader.depsgraph) and not self.glows:
            reader.notes.append(
                f"The fire of '{ob.name}' does not shine; give its material a Blackbody Intensity."
            )

    def shares(self, domain):
        share = self.share(averaged(self.cells, domain, self._counted), domain)
        if self.hue is not None:
            share = Share(share.density, tinted(share.optics, self.hue))
        return [share]

    def emission(self, domain):
        return shining(self.glows, self.fire, self.cells, domain) if self.glows else None


def longest(domain):
    """m, the longest edge of the domain."""
    return domain.voxel_size * max(domain.shape)
