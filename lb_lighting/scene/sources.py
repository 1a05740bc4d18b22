# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources: the objects to light, as values. Volumes and smoke domains; see also `surface_sources`.

`read_sources` makes them in Blender, of the arrays that Blender keeps in memory. They cross to the
solver's process, which does the rest: bounds, densities, emission. Needs no Blender.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..arrays import Array, Floats, Integers
from ..errors import SceneError
from ..transport.medium import Domain
from . import volumes
from .emission import BlackBody, Glow, shining
from .grids.resample import Box, Cells, averaged
from .grids.sparse import Matter, SparseCells
from .materials import VolumeOptics, tinted
from .medium_choice import MediumChoice
from .mixture import Share, max_extinction

WORTHWHILE = 0.9  # of a volume's longest edge: a box with more than that is not reduced

type Emission = Glow | BlackBody


@dataclass(eq=False, kw_only=True)
class Source:
    """An object to light.

    name    of the object
    uid     the object's number for the session
    place   (4, 4), object space to world space
    choice  the medium that the user chose for all sources, with the notes for the user
    """

    name: str
    uid: int
    place: Floats
    choice: MediumChoice

    shows_light = False  # whether its surface shows the light
    lights_instances = False  # whether a modifier of the object can light all its instances
    is_foliage = False  # whether it consists of surfaces with space between them
    is_body = False  # whether its surface shows the light that leaves it, not the light it receives
    is_wall = False  # whether it is opaque

    if TYPE_CHECKING:  # a field of some sources, computed by others

        @property
        def bounds(self) -> Box:
            """(lower, upper), each (3,) m."""

    @property
    def is_volume(self) -> bool:
        """Whether the baked volume shows its light."""
        return False

    @property
    def shines(self) -> bool:
        """Whether it emits light."""
        return False

    def shares(self, domain: Domain) -> list[Share]:
        """[Share] on the lattice of `domain`."""
        return []

    def occlusion(self, domain: Domain) -> tuple[Floats, Floats] | None:
        """((nx, ny, nz), (3,)) or None: the share of the light entering a voxel that it stops, and
        the share of the stopped light that it reflects."""
        return None

    def emission(self, domain: Domain) -> Floats | None:
        """(3, nx, ny, nz) W/(m^3 sr) that it emits, or None."""
        return None


@dataclass(eq=False, kw_only=True)
class GridSource(Source):
    """A density grid, shown by a volume material or by the preset for clouds.

    material   its `VolumeOptics`, or None for a preset
    glows      the emission of the material
    grid_name  of the density grid
    """

    material: VolumeOptics | None
    glows: Sequence[Emission]
    grid_name: str

    preset: ClassVar[str] = "cloud"

    @property
    def is_volume(self) -> bool:
        return True

    @property
    def shines(self) -> bool:
        return bool(self.glows)

    @property
    def fills(self) -> bool:
        """Whether the material is homogeneous: the density is 1 wherever the grid is over 0."""
        if self.material is None:
            return False
        return self.material.density_attribute is None and not self.choice.grid

    def _clamped(self, _first: Integers, values: Array) -> Array:
        """The `values` of the grid, at most the material's limit; for vectors the mean, like
        Cycles."""
        scalars = values if values.ndim == 3 else values.mean(axis=0)
        return np.minimum(scalars, self.material.limit if self.material else np.inf)

    def _share(self, density: Floats, domain: Domain) -> Share:
        if self.material is None:
            optics = self.choice.scaled_optics(self.preset, longest(domain))
            return Share(density, optics, name=self.name)
        if self.fills:
            density = (density > 0).astype(np.float32)
        return Share(density, self.material.optics, name=self.name)


@dataclass(eq=False, kw_only=True)
class VolumeSource(GridSource):
    """A Volume object, or an object whose geometry nodes make a volume.

    grid    the density
    matrix  (4, 4), the volume's space to world space
    is_in_object_space  whether coefficients are per unit of the object's space, not per metre
    fire    {name: `Grid`} of the grids that the emission depends on
    """

    grid: volumes.Grid
    matrix: Floats
    is_in_object_space: bool
    fire: Mapping[str, volumes.Grid]

    @cached_property
    def cells(self) -> SparseCells:
        """The density in the world."""
        return volumes.cells_of(self.grid.vdb, self.matrix)

    @cached_property
    def matter(self) -> Matter:
        """Where the density is, with notes about values that are changed."""
        matter = Matter.of(self.cells, self.fills)
        self.choice.notes.extend(matter.oddities(self.cells, self.name))
        return matter

    @cached_property
    def fires(self) -> dict[str, tuple[SparseCells, Matter]]:
        """The grids that the emission depends on, with notes about values that are changed."""
        fires = {}
        for name, grid in self.fire.items():
            cells = volumes.cells_of(grid.vdb, self.matrix)
            fires[name] = cells, Matter.of(cells)
            self.choice.notes.extend(fires[name][1].oddities(cells, self.name))
        return fires

    @cached_property
    def bounds(self) -> Box:
        whole = self.cells.bounds
        visible = self._visible_bounds(whole)
        if np.ptp(visible, axis=0).max() > WORTHWHILE * np.ptp(whole, axis=0).max():
            return whole
        share = self.matter.share_outside(self.cells, visible)
        self.choice.notes.append(
            f"'{self.name}' has voxels far from the others that are too thin to be seen, with "
            f"{share:.1g} of its density. They are not lit; choose a Domain to light them, too."
        )
        return visible

    def _visible_bounds(self, whole: Box) -> Box:
        """The part of the box `whole` in which there is anything to see."""
        glows_everywhere = any(not self.fires.keys() & set(glow.grids) for glow in self.glows)
        if not len(self.matter.bricks) or glows_everywhere:
            return whole
        visible = whole
        # A preset is denser in a smaller box, so the second box is for its largest density.
        for _ in range(2):
            sigma_t = self._sigma_t(float(np.ptp(visible, axis=0).max()))
            if not sigma_t:
                return whole
            visible = self.matter.bounds(self.cells, sigma_t)
        boxes = [visible, *(matter.bounds(cells) for cells, matter in self.fires.values())]
        return np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]

    def _sigma_t(self, length: float) -> float:
        """1/m at density 1, in a domain whose longest edge has this `length` in m."""
        if self.material is None:
            return max_extinction(self.choice.scaled_optics(self.preset, length))
        return float(max_extinction(self.material.optics) / self._metre)

    def shares(self, domain: Domain) -> list[Share]:
        if not len(self.matter.bricks) and not self.glows:
            raise SceneError(
                f"The grid '{self.grid.name}' of '{self.name}' has no values above 0; "
                "choose another."
            )
        density = averaged(self.cells, domain, self._clamped, ())
        if self.material:
            density /= self._metre
        return [self._share(density, domain)]

    def emission(self, domain: Domain) -> Floats | None:
        if not self.glows:
            return None
        cells = {name: cells for name, (cells, _matter) in self.fires.items()}
        radiance: Floats = shining(self.glows, cells, self.cells, domain)
        return radiance / self._metre

    @property
    def _metre(self) -> float | np.float32:
        """The length in m that the material's coefficients are per."""
        if not self.is_in_object_space:
            return 1.0
        return np.float32(np.linalg.norm(self.matrix[:3, :3].sum(axis=1)) / np.sqrt(3))


@dataclass(eq=False, kw_only=True)
class SmokeSource(GridSource):
    """The domain of a gas simulation, at the current frame.

    cells  the density
    hue    (3,), the colour of smoke that a preset stands for, or None with a material
    fire   {name: `Cells`} of the grids that the emission depends on
    """

    bounds: Box
    cells: Cells
    hue: Floats | None
    fire: Mapping[str, Cells]

    def shares(self, domain: Domain) -> list[Share]:
        share = self._share(averaged(self.cells, domain, self._clamped), domain)
        if self.hue is not None:
            share = Share(share.density, tinted(share.optics, self.hue), name=self.name)
        return [share]

    def emission(self, domain: Domain) -> Floats | None:
        return shining(self.glows, self.fire, self.cells, domain) if self.glows else None


def longest(domain: Domain) -> float:
    """m, the longest edge of the domain."""
    return float(domain.voxel_size * max(domain.shape))
