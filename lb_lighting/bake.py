# SPDX-License-Identifier: GPL-3.0-or-later
"""The street: a scene goes in, its medium is solved, and the light goes back into the scene.

Operators, the command line and the tests all call `bake` and `clear`. Nothing of the scene is
touched before the whole result is on disk.
"""

from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import bpy
import numpy as np

from . import job
from .errors import OutputError, SceneError, SettingsError, require_known
from .output import attribute, shading, volume
from .scene.lights import scene_lights, unread_lamps
from .scene.sources import (
    FROM_MATERIAL,
    Reader,
    mixture,
    occluders,
    open_sources,
    with_shadows,
)
from .scene.volumes import box_bounds
from .transport.field import Field
from .transport.medium import PRESETS, Domain, Medium, paper_units
from .transport.solver import MODELS, Settings

SMALLEST_VOXEL = 2e-5  # m: OpenVDB takes the transform of much smaller ones for singular


@dataclass(frozen=True)
class Options:
    """What the user chooses; the scene's properties and the command line carry the same names."""

    resolution: int = 64  # voxels along the longest edge, padding included
    padding: int = 2  # empty voxels around the selection
    domain: str = ""  # name of an object whose bounds to light, or "" for the selection's
    medium: str = FROM_MATERIAL  # or the name of a preset
    optical_depth: float = 30.0  # of the domain's longest edge at density 1, for presets
    grid: str = ""  # grid to read from volumes, or "" for the material's
    model: str = "physical"  # or "paper"
    handover: float = 0.0  # transport optical depths that photons are traced for, by "physical"
    mode: str = "REPLACE"  # how a lit volume renders: "REPLACE" or "ADD"
    strength: float = 1.0  # factor on the light in the render
    keep_absorbed: bool = False  # emit absorbed light again, by "paper"
    device: str = ""  # part of a device's label, or "" for the best
    folder: str = ""  # where the .vdb goes, or "" for the .blend's own folder

    def __post_init__(self):
        for value, known, what in (
            (self.medium, (FROM_MATERIAL, *PRESETS), "medium"),
            (self.model, tuple(MODELS), "model"),
            (self.mode, tuple(shading.MODES), "mode"),
        ):
            require_known(value, known, what)
        if self.padding < 1:
            raise SettingsError(f"The padding must be 1 voxel or more; it is {self.padding}.")
        if not (self.optical_depth > 0 and np.isfinite(self.optical_depth)):
            raise SettingsError(f"The optical depth must be positive; it is {self.optical_depth}.")
        if not (self.strength >= 0 and np.isfinite(self.strength)):
            raise SettingsError(f"The strength must not be negative; it is {self.strength}.")
        self.settings()  # refuses the others

    def settings(self):
        """The solver's `Settings`."""
        return Settings(model=self.model, handover=self.handover, keep_absorbed=self.keep_absorbed)

    @classmethod
    def of(cls, scene, **changes):
        """The scene's own, with `changes` where they are not None."""
        values = {f.name: getattr(scene.lb_lighting, f.name) for f in fields(cls)}
        values["domain"] = values["domain"].name if values["domain"] else ""
        return cls(**values | {name: v for name, v in changes.items() if v is not None})


@dataclass
class Problem:
    """A scene as the solver sees it.

    medium    in SI units
    shown     (density (nx, ny, nz), Optics) of what the lit volume renders: the volumes alone,
              where there are any, for surfaces show their light themselves
    lights    transport lights
    sources   what it came from, see scene/sources.py
    notes     sentences that the user should read
    """

    medium: Medium
    shown: tuple
    lights: list
    sources: list
    notes: list = field(default_factory=list)


@dataclass
class Outcome:
    """What a bake made: the field, the file, and what to tell the user."""

    field: Field
    path: Path
    notes: list

    @property
    def summary(self):
        report = self.field.report
        shape = " x ".join(map(str, self.field.fluence.shape[1:]))
        bands = "1 band" if report.runs == 1 else f"{report.runs} bands"
        return (
            f"Lit {shape} voxels, {bands}, {report.steps} steps in "
            f"{sum(report.seconds.values()):.1f} s on {report.device}"
        )


def bake(context, objects, options, progress=None):
    """Light the original `objects` of the scene and write the result into it.

    progress  called as progress(stage, fraction)
    Returns an `Outcome`. Raises a LightingError, and then the scene is as it was.
    """
    objects = sources_of(context.scene, objects)
    _refuse_unwritable(objects, options)
    problem = gather(context, objects, options)
    medium = paper_units(problem.medium) if options.model == "paper" else problem.medium
    device = options.device or None
    result = job.solve(medium, problem.lights, options.settings(), device, progress)
    if not result.report.converged:
        problem.notes.append(
            f"The light had not settled after {result.report.steps} steps and may be too dark; "
            "a lower resolution settles sooner."
        )
    if result.report.device.startswith("NumPy"):
        problem.notes.append(
            "Solved with NumPy; an OpenCL driver for your processor or graphics card is faster."
        )
    return apply(context, problem, result, options)


def gather(context, objects, options):
    """The `Problem` that the scene poses at the current frame."""
    with _unhidden(context, objects):
        depsgraph = context.evaluated_depsgraph_get()
        reader = Reader(depsgraph, options.medium, options.optical_depth, options.grid)
        sources = open_sources(objects, reader)
        domain = _domain(context, sources, options)
        job.require_memory(domain.shape, options.device, options.model)
        _refuse_tiny(domain)
        shares = {source: source.shares(domain) for source in sources}
        occlusions = [o for source in sources if (o := source.occlusion(domain)) is not None]
        reader.notes.extend(unread_lamps(depsgraph))
        lights = scene_lights(context.scene, depsgraph)
    everything = [share for own in shares.values() for share in own]
    density, optics = reader.mixture(everything)
    occlusion, albedo = occluders(occlusions) if occlusions else (None, np.zeros(1))
    bands = _bands(optics, lights, albedo)
    volumes = [share for source, own in shares.items() for share in own if source.is_volume]
    medium = Medium(
        density,
        domain.voxel_size,
        *(np.broadcast_to(v, bands) for v in (optics.sigma_s, optics.sigma_a)),
        optics.g,
        domain.origin,
        occlusion=occlusion,
        occlusion_albedo=np.broadcast_to(albedo, (bands, *albedo.shape[1:])),
    )
    shown = mixture(volumes) if volumes else (density, optics)
    return Problem(medium, shown, with_shadows(lights, everything), sources, reader.notes)


def apply(context, problem, result, options):
    """Write the result to disk, then into the scene."""
    surfaces = [source.ob for source in problem.sources if source.shows_light]
    meshes = [ob for ob in surfaces if ob.type == "MESH"]
    light, others, beams = volume.volume_light(result, problem.lights, options.mode)
    name = problem.sources[0].ob.name
    path = volume.fresh_path(_folder(options), name)
    stamp = _stamp(context.scene, problem, result, options)
    volume.write_vdb(path, result.domain, problem.shown[0], light, stamp, others)

    _show_volume(context, problem, beams, path, options)
    depsgraph = context.evaluated_depsgraph_get()
    bodies = [source.ob for source in problem.sources if source.is_body]
    # The paper's opaque voxels are not dark, they only send on less of their light.
    occlusion = None if options.model == "paper" else problem.medium.occlusion
    walls = [source.ob for source in problem.sources if source.is_wall]
    attribute.write_ambient(meshes, depsgraph, result, bodies, walls, occlusion)
    for ob in meshes:
        shading.light_surface(ob, options.strength)
    unlit = [
        f"'{ob.name}' has no mesh of its own to show light on; make its instances real, or "
        "convert it to a mesh."
        for ob in surfaces
        if ob not in meshes
    ]
    return Outcome(result, path, problem.notes + unlit)


def clear(context, delete_files=False):
    """Take everything that bakes made out of the scene, and give back what they changed.

    delete_files  delete the .vdb files of the baked volumes too
    Returns the number of objects that had light. Raises OutputError for a file that cannot be
    deleted; the scene is cleared all the same.
    """
    scene = context.scene
    baked = volume.baked_volumes(scene)
    paths = [volume.baked_path(ob) for ob in baked]
    sources = [s for ob in baked for s in volume.sources_of(scene, ob)]
    sources += volume.lost_sources(scene)
    surfaces = [ob for ob in scene.objects if attribute.has_ambient(ob)]
    count = len({*sources, *surfaces} or baked)
    _release(context, sources, baked)
    for ob in surfaces:
        attribute.remove_ambient(ob)
    shading.unwire_unused()
    for ob in baked:
        volume.remove_baked(ob)
    shading.restore_scene(scene)
    shading.remove_unused()
    if delete_files:
        for path in paths:
            volume.delete_baked_file(path)
    return count


def _release(context, sources, baked):
    """Show `sources` as they were before the bake, selected where their light was."""
    selected = any(ob.select_get() for ob in baked)
    for ob in sources:
        was_hidden = ob.hide_viewport
        shading.show_source(ob)
        volume.forget(ob)
        if selected and was_hidden and not ob.hide_viewport and _in_view(context, ob):
            ob.select_set(True)


def _in_view(context, ob):
    return ob.name in context.view_layer.objects


def sources_of(scene, objects):
    """`objects` with each baked volume replaced by the objects whose light it shows."""
    baked = volume.baked_volumes(scene)
    found = {}  # keeps the order
    for ob in objects:
        sources = volume.sources_of(scene, ob) if ob in baked else [ob]
        if not sources:
            raise SceneError(f"What '{ob.name}' was baked from is gone; select something else.")
        found.update(dict.fromkeys(sources))
    return list(found)


def _refuse_unwritable(objects, options):
    """Raise OutputError, before any work, for what could not take its light afterwards."""
    for ob in objects:
        if not ob.is_editable:
            raise OutputError(f"'{ob.name}' is linked from another file; make it local.")
    meshes = [ob for ob in objects if ob.type == "MESH"]
    attribute.refuse_unwritable(meshes)
    shading.refuse_unwritable(meshes)
    volume.require_writable(_folder(options))


@contextmanager
def _unhidden(context, objects):
    """Objects that a bake hid are evaluated only while they are shown."""
    hidden = [ob for ob in objects if ob.hide_viewport]
    for ob in hidden:
        ob.hide_viewport = False
    try:
        yield
    finally:
        for ob in hidden:
            ob.hide_viewport = True
        context.view_layer.update()


def _domain(context, sources, options):
    if options.domain:
        lower, upper = _box(context, options.domain)
    else:
        corners = np.concatenate([source.bounds for source in sources])
        lower, upper = corners.min(axis=0), corners.max(axis=0)
    return Domain.around(lower, upper, options.resolution, options.padding)


def _refuse_tiny(domain):
    if domain.voxel_size < SMALLEST_VOXEL:
        raise SceneError(
            f"Voxels of {domain.voxel_size:.1g} m are too small for a volume file; "
            "scale the scene up."
        )


def _box(context, name):
    """(lower, upper), each (3,) m: the bounds of the object `name` in world space."""
    ob = context.scene.objects.get(name)
    if ob is None:
        raise SettingsError(f"There is no object '{name}' to light the bounds of; choose another.")
    corners = np.array(ob.bound_box)
    lower, upper = box_bounds(corners.min(axis=0), corners.max(axis=0), np.array(ob.matrix_world))
    if not np.ptp([lower, upper], axis=0).any():
        raise SettingsError(f"The domain '{name}' has no size of its own; choose a mesh.")
    return lower, upper


def _bands(optics, lights, albedo):
    """3 where a coefficient, a light or an occluder has a colour, else 1."""
    values = [optics.sigma_s, optics.sigma_a, optics.g]
    values += [light.spectrum for light in lights]
    return max(len(albedo), *(np.size(value) for value in values))


def _folder(options):
    if not options.folder:
        return volume.default_folder()
    return Path(bpy.path.abspath(options.folder)).absolute()


def _stamp(scene, problem, result, options):
    """What the file was made of and how, flat, for its metadata."""
    facts = asdict(result.report).items()
    report = {name: value for name, value in facts if np.isscalar(value)}  # metadata holds no more
    report["seconds"] = sum(result.report.seconds.values())
    coefficients = {
        name: " ".join(f"{value:g}" for value in getattr(problem.medium, name))
        for name in ("sigma_s", "sigma_a", "g")
    }
    return {
        **asdict(options),
        **report,
        **coefficients,
        "sources": ", ".join(source.ob.name for source in problem.sources),
        "frame": scene.frame_current,
    }


def _show_volume(context, problem, beams, path, options):
    """A Volume object for the file; it renders only where it stands for volumes."""
    sources = [source.ob for source in problem.sources]
    ob = volume.show_volume(context, sources, path)
    # An older bake may have had more sources than this one; they have no light now.
    gone = [s for s in volume.sources_of(context.scene, ob) if s not in sources]
    _release(context, gone + volume.lost_sources(context.scene), [])
    volumes = any(source.is_volume for source in problem.sources)
    _density, optics = problem.shown
    coefficients = optics.sigma_s, optics.sigma_a, optics.g
    shading.shade_volume(ob, options.mode, *coefficients, beams, options.strength)
    ob.hide_render = not volumes
    ob.hide_viewport = not volumes
    for source in problem.sources:
        if source.is_volume and options.mode == "REPLACE":
            # Blender deselects what is hidden; the next bake is to find it all the same.
            ob.select_set(ob.select_get() or source.ob.select_get())
            shading.hide_source(source.ob)
        else:
            shading.show_source(source.ob)
    if volumes:
        shading.prepare_scene(context.scene)
