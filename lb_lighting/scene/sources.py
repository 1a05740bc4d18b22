# SPDX-License-Identifier: GPL-3.0-or-later
"""What a selected object is to the light: a volume, smoke, foliage, a solid or an occluder.

Sources are made in Blender, and take from it what they need as arrays, which is quick. All else
(`bounds`, `shares`, `occlusion`) needs no Blender, and is done in the solver's process.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..errors import EmptyError, SceneError
from ..transport.lights import Sun
from ..transport.medium import PRESETS, Optics
from . import smoke, volumes, voxelize
from .emission import shining, volume_glows
from .materials import (
    grey,
    has_surface,
    has_volume,
    leaf_optics,
    tinted,
    volume_optics,
    volume_shines,
)
from .meshes import world_parts

FROM_MATERIAL = "MATERIAL"
CUSTOM = "CUSTOM"
COARSEST = 4  # voxels: faces of an occluder with longer edges cannot carry light on their corners
ALIKE = 1e-6  # albedos and mean cosines no further apart than that are the same
SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "EMPTY"}


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


@dataclass
class Reader:
    """How sources are read: the choices of the user, and what to tell about them.

    medium         FROM_MATERIAL, CUSTOM, or the name of one of PRESETS for everything
    optical_depth  of a straight line as long as the domain through density 1, for presets in
                   volumes and solids; foliage has its own, from its leaves; 0 for the
                   coefficients of CUSTOM as they are
    grid           name of the grid to read, or "" for the one that the material names
    custom         the `Optics` of CUSTOM, 1/m
    instances_lit  those that geometry nodes make of foliage show light
    """

    depsgraph: object
    medium: str
    optical_depth: float
    grid: str
    custom: Optics | None = None
    instances_lit: bool = False
    notes: list = field(default_factory=list)

    def __getstate__(self):
        return vars(self) | {"depsgraph": None}  # it stays in Blender

    def volume_optics(self, ob, materials, fallback):
        """The first `VolumeOptics` of `materials`, or None where a preset stands in for them.

        fallback  name of that preset, where none is chosen
        """
        if self.medium != FROM_MATERIAL:
            return None
        found = [optics for m in materials if m and (optics := volume_optics(m))]
        if not found:
            self.notes.append(
                f"'{ob.name}' has no volume material; the preset '{fallback}' stands in."
            )
            return None
        if any(optics != found[0] for optics in found):
            self.notes.append(f"'{ob.name}' has several volume materials; the first fills it all.")
        return found[0]

    def glows(self, ob, materials):
        """[Glow | BlackBody] that the volumes of `materials` shine with.

        None for those that cannot be read, with a note.
        """
        try:
            return [glow for material in materials for glow in volume_glows(material)]
        except SceneError as error:
            if any(map(volume_shines, materials)):
                self.notes.append(
                    f"'{ob.name}' shines by itself, which does not light it, and Replace leaves "
                    f"that out. {error}"
                )
            return []

    def mixture(self, shares):
        """`mixture` of `shares`, with a note where it is not exact."""
        mixed = mixture(shares)
        if np.ptp(_per_extinction(_present(shares)), axis=1).max() > ALIKE:
            self.notes.append(
                "The materials differ in colour or in how they scatter; the light takes their "
                "mean, weighed by how dense each is."
            )
        return mixed

    def occluder_colors(self, ob, parts):
        """[(3,)], the share of light that each of the parts of `ob` throws back.

        0 for materials that cannot be read, with a note: they stop light all the same.
        """
        try:
            return [leaf_optics(part.material).reflectance for part in parts]
        except SceneError as error:
            self.notes.append(f"'{ob.name}' throws no light back. {error}")
            return [np.zeros(3)] * len(parts)

    def chosen(self, fallback=None):
        """The `Optics` of the chosen preset, or of the one called `fallback`."""
        if self.medium == CUSTOM:
            return self.custom
        return PRESETS[fallback if self.medium == FROM_MATERIAL else self.medium]

    def preset(self, fallback, length):
        """The chosen preset (or `fallback`), scaled to `optical_depth` over `length` metres."""
        if self.optical_depth == 0:
            return self.chosen(fallback)
        return _scaled(self.chosen(fallback), self.optical_depth / length)


def open_sources(objects, reader):
    """The sources that the original `objects` are; SceneError names one that is none."""
    if not objects:
        raise SceneError("Nothing is selected; select a volume, a smoke domain or a mesh.")
    for ob in objects:
        if not ob.visible_get(view_layer=reader.depsgraph.view_layer):
            raise EmptyError(f"'{ob.name}' is hidden; show it to light it.")
    surfaces = [ob for ob in objects if _is_surface(ob)]
    parts = defaultdict(list)
    for part in world_parts(reader.depsgraph, surfaces):
        parts[part.object].append(part)
    return [_open(ob, parts.get(ob, []), reader) for ob in objects]


def _is_surface(ob):
    return ob.type in SURFACE_TYPES and not smoke.find_domain_settings(ob)


def _open(ob, parts, reader):
    if ob.type == "VOLUME":
        return VolumeSource(ob, reader)
    if smoke.find_domain_settings(ob):
        return SmokeSource(ob, reader)
    if not parts and volumes.has_volume(ob, reader.depsgraph):
        return VolumeSource(ob, reader)
    if not parts:
        raise EmptyError(
            f"'{ob.name}' has neither a volume nor faces; "
            "select a volume, a smoke domain or a mesh."
        )
    return _SURFACES[_surface_role(ob, parts)](ob, parts, reader)


def _surface_role(ob, parts):
    """The role that the user gave, or else solid where a volume fills it, and foliage if not."""
    role = ob.lb_lighting.role
    if role != "AUTO":
        return role
    return "SOLID" if any(has_volume(part.material) for part in parts) else "FOLIAGE"


class _Source:
    """name and place of its object, bounds ((lower, upper) in m), what it puts on a lattice.

    place        (4, 4), the object's space to world space
    is_volume    whether a lit volume in its place shows its light
    shows_light  whether its surface shows its light
    is_foliage   whether it is surfaces that light passes between
    is_body      whether that light is what comes out of it, not what falls on it
    is_wall      whether it stops all light
    glows        [Glow | BlackBody], see scene/emission.py
    """

    is_volume = False
    shows_light = False
    is_foliage = False
    is_body = False
    is_wall = False
    glows = ()

    def __init__(self, ob, reader):
        self.name, self.reader = ob.name, reader
        self.place = np.array(ob.evaluated_get(reader.depsgraph).matrix_world)

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


class _GridSource(_Source):
    """A density grid that a volume material, or the preset for a cloud, shows."""

    is_volume = True
    preset = "cloud"

    def __init__(self, ob, reader, material):
        super().__init__(ob, reader)
        self.material = reader.volume_optics(ob, [material], self.preset)
        self.glows = reader.glows(ob, [material])

    @property
    def glowing_grids(self):
        """{str}, the names of the grids that it shines by."""
        return {name for glow in self.glows for name in glow.grids}

    @property
    def grid_name(self):
        named = self.material.density_attribute if self.material else None
        return self.reader.grid or named or "density"

    def share(self, density, domain):
        if self.material is None:
            return Share(density, self.reader.preset(self.preset, _longest(domain)))
        if self.material.density_attribute is None and not self.reader.grid:
            density = (density > 0).astype(np.float32)  # a homogeneous material fills the grid
        return Share(density, self.material.optics)


class VolumeSource(_GridSource):
    """A Volume object, or one whose geometry nodes make a volume: one grid of it."""

    def __init__(self, ob, reader):
        super().__init__(ob, reader, volumes.volume_material(ob, reader.depsgraph))
        self.grid = volumes.find_grid(ob, reader.depsgraph, self.grid_name)
        self.matrix = volumes.world_matrix(ob, reader.depsgraph)
        self.is_in_object_space = volumes.is_in_object_space(ob, reader.depsgraph)
        known = self.glowing_grids and volumes.grid_names(ob, reader.depsgraph)
        self.fire = {
            name: volumes.find_grid(ob, reader.depsgraph, name)
            for name in self.glowing_grids.intersection(known)
        }

    @property
    def bounds(self):
        return volumes.world_bounds(self.grid.vdb, self.matrix)

    def shares(self, domain):
        density = volumes.resample(self.grid.vdb, self.matrix, domain)
        if self.material:
            density /= self._metre
        return [self.share(density, domain)]

    def emission(self, domain):
        if not self.glows:
            return None
        cells = {
            name: volumes.near_cells(grid.vdb, self.matrix, domain)
            for name, grid in self.fire.items()
        }
        inside = volumes.near_cells(self.grid.vdb, self.matrix, domain)
        return shining(self.glows, cells, inside, domain) / self._metre

    @property
    def _metre(self):
        """How many of the lengths that the material's coefficients are per."""
        if not self.is_in_object_space:
            return 1.0
        return np.float32(np.linalg.norm(self.matrix[:3, :3].sum(axis=1)) / np.sqrt(3))


class SmokeSource(_GridSource):
    """The domain of a gas simulation, at the current frame."""

    def __init__(self, ob, reader):
        super().__init__(ob, reader, ob.active_material)
        self.bounds = smoke.world_bounds(ob, reader.depsgraph)
        self.cells = smoke.read_grid(ob, reader.depsgraph, self.grid_name)
        # Nor does the preset know the colour of the smoke.
        self.hue = None if self.material else smoke.hue(ob, reader.depsgraph)
        known = smoke.grid_names(ob, reader.depsgraph)
        self.fire = {
            name: smoke.read_grid(ob, reader.depsgraph, name)
            for name in self.glowing_grids.intersection(known)
        }
        if smoke.burns(ob, reader.depsgraph) and not self.glows:
            reader.notes.append(
                f"The fire of '{ob.name}' does not shine; give its material a Blackbody Intensity."
            )

    def shares(self, domain):
        share = self.share(self.cells.on(domain), domain)
        if self.hue is not None:
            share = Share(share.density, tinted(share.optics, self.hue))
        return [share]

    def emission(self, domain):
        return shining(self.glows, self.fire, self.cells, domain) if self.glows else None


class _SurfaceSource(_Source):
    def __init__(self, ob, parts, reader):
        super().__init__(ob, reader)
        self.faces = [part.faces for part in parts]
        # A modifier of the object sees the instances that modifiers make, and no others.
        duplicates = ob.instance_type != "NONE" or len(ob.particle_systems)
        lit = self.is_foliage and reader.instances_lit and not duplicates
        instanced = any(part.instanced for part in parts)
        if self.shows_light and ob.type == "MESH" and instanced and not lit:
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
        self.leaves = [self._leaf(part.material) for part in parts]
        self.instanced = [part.material and part.material.name for part in parts if part.instanced]

    def _leaf(self, material):
        """(share of the faces that is not a hole, Optics at 1/m of extinction)."""
        if self.reader.medium != FROM_MATERIAL:
            return 1.0, _scaled(self.reader.chosen(), 1.0)
        leaf = leaf_optics(material)
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

    def __init__(self, ob, parts, reader):
        materials = [part.material for part in parts]
        self.shows_light = any(map(has_surface, materials))
        super().__init__(ob, parts, reader)
        self.material = reader.volume_optics(ob, materials, self.preset)
        self.glows = reader.glows(ob, materials)

    @property
    def is_volume(self):
        return not self.shows_light

    def shares(self, domain):
        fraction = voxelize.solid_fraction(self.triangles, domain)
        if self.material is None:
            return [Share(fraction, self.reader.preset(self.preset, _longest(domain)))]
        return [Share(fraction, self.material.optics)]

    def emission(self, domain):
        if not self.glows:
            return None
        radiance = sum(glow.radiance({}) for glow in self.glows if not glow.grids)
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
        return voxelize.opaque_share(triangles, closed, domain), color


_SURFACES = {"FOLIAGE": FoliageSource, "SOLID": SolidSource, "OCCLUDER": OccluderSource}


def mixture(shares):
    """(density (nx, ny, nz), Optics): the shares as one material, which the lattice needs.

    Shares of the same optics keep them, and their densities are summed. Otherwise the density is
    the extinction coefficient, 1/m, of each share's densest band, summed, and the optics are the
    shares' per such extinction, averaged by how much of it there is of each: so every share keeps
    its own extinction, and only albedo and g are means. EmptyError for no density.
    """
    shares = _present(shares)
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


def _scaled(optics, largest):
    """`optics` times a factor that makes the largest sigma_t of its bands `largest`, 1/m."""
    sigma_s, sigma_a = np.atleast_1d(optics.sigma_s), np.atleast_1d(optics.sigma_a)
    factor = largest / (sigma_s + sigma_a).max()
    return Optics(tuple(sigma_s * factor), tuple(sigma_a * factor), optics.g)


def _longest(domain):
    """m, the longest edge of the domain."""
    return domain.voxel_size * max(domain.shape)
