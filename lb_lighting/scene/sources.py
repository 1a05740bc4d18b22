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

from ..errors import EmptyError, LightingError, SceneError
from ..ours import is_ours
from ..transport.lights import Sun
from ..transport.medium import PRESETS, Optics
from . import smoke, volumes, voxelize
from .attributes import object_attributes
from .emission import shining, volume_glows
from .materials import (
    first_volume,
    grey,
    has_surface,
    has_volume,
    leaf_optics,
    tinted,
    volume_optics,
    volume_shines,
)
from .meshes import world_parts
from .resample import averaged
from .sparse import Matter

FROM_MATERIAL = "MATERIAL"
CUSTOM = "CUSTOM"
COARSEST = 4  # voxels: faces of an occluder with longer edges cannot carry light on their corners
ALIKE = 1e-6  # albedos and mean cosines no further apart than that are the same
SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "EMPTY"}
WORTHWHILE = 0.9  # of a volume's longest edge, over which nothing thin is left out
DARK_TYPES = {"ARMATURE", "CAMERA", "LATTICE", "LIGHT", "LIGHT_PROBE", "SPEAKER"}
NAMED = 8  # objects that one note lists by name


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
    """

    depsgraph: object
    medium: str
    optical_depth: float
    grid: str
    custom: Optics | None = None
    notes: list = field(default_factory=list)

    def __post_init__(self):
        layer = self.depsgraph and self.depsgraph.view_layer
        if layer and layer.material_override:
            self.notes.append(
                f"The view layer '{layer.name}' overrides all materials with "
                f"'{layer.material_override.name}', which shows none of the light. It was baked "
                "for the materials behind that; clear Material Override to see it."
            )

    def __getstate__(self):
        return vars(self) | {"depsgraph": None}  # it stays in Blender

    def volume_optics(self, ob, materials, fallback):
        """The first `VolumeOptics` of `materials`, or None where a preset stands in for them.

        fallback  name of that preset, where none is chosen
        """
        if self.medium != FROM_MATERIAL:
            return None
        attributes = object_attributes(ob, self.depsgraph)
        found = [optics for m in materials if (optics := volume_optics(m, attributes))]
        if not found:
            self.notes.append(
                f"'{ob.name}' has no volume material; the preset '{fallback}' stands in."
            )
            return None
        if any(optics != found[0] for optics in found):
            self.notes.append(f"'{ob.name}' has several volume materials; the first fills it all.")
        return found[0]

    def glows(self, ob, materials, optics):
        """[Glow | BlackBody] that the volumes of `materials` shine with.

        None for those that cannot be read, with a note, or SceneError where nothing else is to be
        seen of their `optics`.
        """
        try:
            attributes = object_attributes(ob, self.depsgraph)
            return [glow for m in materials for glow in volume_glows(m, attributes)]
        except SceneError as error:
            shines = any(map(volume_shines, materials))
            if shines and optics and optics.is_clear:
                raise
            if shines:
                self.notes.append(
                    f"'{ob.name}' shines by itself, which does not light it, and Replace leaves "
                    f"that out. {error}"
                )
            return []

    def mixture(self, shares, shines=False):
        """`mixture` of `shares`, with a note where it is not exact."""
        mixed, present = mixture(shares, shines), _present(shares)
        if present and np.ptp(_per_extinction(present), axis=1).max() > ALIKE:
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
            return [self.leaf(part).reflectance for part in parts]
        except SceneError as error:
            self.notes.append(f"'{ob.name}' throws no light back. {error}")
            return [np.zeros(3)] * len(parts)

    def leaf(self, part):
        """The `Leaf` that the faces of a `Part` are."""
        # Each instance may have attributes of its own.
        one = None if part.instanced else object_attributes(part.object, self.depsgraph)
        return leaf_optics(part.material, one)

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


def open_sources(objects, reader, require=None):
    """The sources among the original `objects`, in their order.

    require  called with each object that is a source; raises a LightingError for one that cannot
             be lit

    Objects that are no source, are hidden or cannot be read are skipped, with a note. Where nothing
    is left, the first that cannot be read is raised, or a SceneError for one of the others.
    """
    if not objects:
        raise SceneError("Nothing is selected; select a volume, a smoke domain or a mesh.")
    hidden = [ob for ob in objects if not ob.visible_get(view_layer=reader.depsgraph.view_layer)]
    shown = [ob for ob in objects if ob not in hidden]
    parts = defaultdict(list)
    for part in world_parts(reader.depsgraph, filter(_is_surface, shown)):
        parts[part.object].append(part)
    sources, neither, failed = [], [], []
    for ob in shown:
        own = parts.get(ob, [])
        if not _is_source(ob, own, reader):
            neither.append(ob)
            continue
        noted = len(reader.notes)
        try:
            if require is not None:
                require(ob)
            sources.append(_open(ob, own, reader))
        except LightingError as error:
            del reader.notes[noted:]
            failed.append((ob, error))
    if not sources:
        _refuse(hidden, neither, failed)
    reader.notes[:0] = [
        *_skipped(neither, "have neither a volume nor faces", "has neither a volume nor faces"),
        *_skipped(hidden, "are hidden", "is hidden"),
        *(f"'{ob.name}' is left out. {error}" for ob, error in failed),
    ]
    return sources


def may_be_lit(ob):
    """Whether an object is of a kind that can have a volume or faces."""
    return ob.type not in DARK_TYPES and (ob.type != "EMPTY" or ob.instance_type != "NONE")


def _refuse(hidden, neither, failed):
    """Raise why no object is a source."""
    if failed:
        raise failed[0][1]
    if neither:
        raise EmptyError(
            f"'{neither[0].name}' has neither a volume nor faces; "
            "select a volume, a smoke domain or a mesh."
        )
    raise EmptyError(f"'{hidden[0].name}' is hidden; show it to light it.")


def _skipped(objects, they, it):
    """[the note that names the skipped `objects`], or none where there are none."""
    if not objects:
        return []
    names = ", ".join(ob.name for ob in objects[:NAMED])
    more = f" and {len(objects) - NAMED} more" if len(objects) > NAMED else ""
    return [f"Skipped, as {f'they {they}' if len(objects) > 1 else f'it {it}'}: {names}{more}."]


def _is_surface(ob):
    return ob.type in SURFACE_TYPES and not smoke.find_domain_settings(ob)


def _is_source(ob, parts, reader):
    """Whether an object has a volume or faces (`parts`)."""
    if ob.type == "VOLUME" or parts or smoke.find_domain_settings(ob) or _is_edited(ob):
        return True
    return volumes.has_volume(ob, reader.depsgraph)


def _is_edited(ob):
    """Whether an object's mesh is in Edit Mode, which hides its faces."""
    return ob.type == "MESH" and ob.data.is_editmode


def _open(ob, parts, reader):
    if _is_edited(ob):
        raise SceneError(f"'{ob.name}' is in Edit Mode; leave it to light the mesh.")
    if ob.type == "VOLUME" and is_ours(ob):
        raise SceneError(f"What '{ob.name}' was baked from is gone; select something else.")
    if ob.type == "VOLUME":
        return VolumeSource(ob, reader)
    if smoke.find_domain_settings(ob):
        return SmokeSource(ob, reader)
    if not parts:
        return VolumeSource(ob, reader)
    return _SURFACES[_surface_role(ob, parts)](ob, parts, reader)


def _surface_role(ob, parts):
    """The role that the user gave, or else solid where a volume fills it, and foliage if not."""
    role = ob.lb_lighting.role
    if role != "AUTO":
        return role
    return "SOLID" if any(has_volume(part.material) for part in parts) else "FOLIAGE"


class _Source:
    """name and place of its object, bounds ((lower, upper) in m), what it puts on a lattice.

    uid          the object's number for the session
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


class _GridSource(_Source):
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
            return Share(density, self.reader.preset(self.preset, _longest(domain)))
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


class _SurfaceSource(_Source):
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
            return 1.0, _scaled(self.reader.chosen(), 1.0)
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
            return [Share(fraction, self.reader.preset(self.preset, _longest(domain)))]
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


_SURFACES = {"FOLIAGE": FoliageSource, "SOLID": SolidSource, "OCCLUDER": OccluderSource}


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
