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
from .errors import OutputError, SceneError, SettingsError
from .output import attribute, shading, volume
from .scene.lights import scene_lights
from .scene.materials import leaf_optics
from .scene.sources import FROM_MATERIAL, Reader, mixture, open_sources
from .transport.field import Field
from .transport.medium import PRESETS, Domain, Medium, paper_units
from .transport.solver import Settings


@dataclass(frozen=True)
class Options:
    """What the user chooses; the scene's properties and the command line carry the same names."""

    resolution: int = 64  # voxels along the longest edge, padding included
    padding: int = 2  # empty voxels around the selection
    domain: str = ""  # name of an object whose bounds to light, or "" for the selection's
    medium: str = FROM_MATERIAL  # or the name of a preset
    optical_depth: float = 30.0  # of the domain's longest edge at density 1, for presets
    grid: str = ""  # grid to read from volumes, or "" for the material's
    mode: str = "REPLACE"  # how a lit volume renders: "REPLACE" or "ADD"
    strength: float = 1.0  # factor on the light in the render
    keep_absorbed: bool = False  # emit absorbed light again
    device: str = ""  # part of a device's label, or "" for the best
    folder: str = ""  # where the .vdb goes, or "" for the .blend's own folder

    def __post_init__(self):
        for value, known, what in (
            (self.medium, (FROM_MATERIAL, *PRESETS), "medium"),
            (self.mode, tuple(shading.MODES), "mode"),
        ):
            if value not in known:
                raise SettingsError(
                    f"There is no {what} called '{value}'; choose one of: {', '.join(known)}."
                )
        if self.padding < 1:
            raise SettingsError(f"The padding must be 1 voxel or more; it is {self.padding}.")
        if not self.optical_depth > 0:
            raise SettingsError(f"The optical depth must be positive; it is {self.optical_depth}.")

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
    settings = Settings(keep_absorbed=options.keep_absorbed)
    medium = paper_units(problem.medium)
    result = job.solve(medium, problem.lights, settings, options.device or None, progress)
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
        job.require_memory(domain.shape, options.device)
        shares = {source: source.shares(domain) for source in sources}
        occlusions = [o for source in sources if (o := source.occlusion(domain)) is not None]
        lights = scene_lights(context.scene, depsgraph)
    density, optics = mixture([share for own in shares.values() for share in own])
    volumes = [share for source, own in shares.items() for share in own if source.is_volume]
    medium = Medium(
        density,
        domain.voxel_size,
        *(np.broadcast_to(v, _bands(optics, lights)) for v in (optics.sigma_s, optics.sigma_a)),
        optics.g,
        domain.origin,
        occlusion=np.max(occlusions, axis=0) if occlusions else None,
    )
    shown = mixture(volumes) if volumes else (density, optics)
    return Problem(medium, shown, lights, sources, reader.notes)


def apply(context, problem, result, options):
    """Write the result to disk, then into the scene."""
    surfaces = [source.ob for source in problem.sources if not source.is_volume]
    meshes = [ob for ob in surfaces if ob.type == "MESH"]
    light = result.mean_radiance()
    name = problem.sources[0].ob.name
    path = volume.fresh_path(_folder(options), name)
    volume.write_vdb(path, result.domain, problem.shown[0], light, _stamp(result, options))

    _show_volume(context, problem, path, name, options)
    depsgraph = context.evaluated_depsgraph_get()
    attribute.write_ambient(meshes, depsgraph, result.domain, light)
    for ob in meshes:
        shading.light_surface(ob, _albedo, options.strength)
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
    Returns the number of objects that were changed or removed.
    """
    scene = context.scene
    baked = volume.baked_volumes(scene)
    _show_sources(context, baked)
    count = 0
    for ob in scene.objects:
        if ob.type == "MESH" and attribute.AMBIENT_ATTRIBUTE in ob.data.attributes:
            attribute.remove_ambient(ob)
            shading.unlight_surface(ob)
            count += 1
    for ob in baked:
        volume.remove_baked(ob, delete_files)
        count += 1
    shading.restore_scene(scene)
    shading.remove_unused()
    return count


def _show_sources(context, baked):
    """Give back what bakes hid, and selected where the baked volume was."""
    selected = any(ob.select_get() for ob in baked)
    for ob in context.scene.objects:
        was_hidden = ob.hide_viewport
        shading.show_source(ob)
        shown = was_hidden and not ob.hide_viewport
        if selected and shown and ob.name in context.view_layer.objects:
            ob.select_set(True)


def sources_of(scene, objects):
    """`objects` with each baked volume replaced by the object whose light it shows."""
    found = [volume.source_of(scene, ob) or ob for ob in objects]
    return list(dict.fromkeys(found))


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
        ob = context.scene.objects.get(options.domain)
        if ob is None:
            raise SettingsError(
                f"There is no object '{options.domain}' to light the bounds of; choose another."
            )
        matrix = np.array(ob.matrix_world)
        corners = np.array(ob.bound_box) @ matrix[:3, :3].T + matrix[:3, 3]
    else:
        corners = np.concatenate([source.bounds for source in sources])
    return Domain.around(
        corners.min(axis=0), corners.max(axis=0), options.resolution, options.padding
    )


def _bands(optics, lights):
    """3 where a coefficient or a light has a colour, else 1."""
    values = [optics.sigma_s, optics.sigma_a, optics.g]
    values += [vars(light).get("irradiance", vars(light).get("radiance")) for light in lights]
    return max(np.size(value) for value in values)


def _albedo(material):
    """(3,), what a surface reflects and transmits; a plain grey where its nodes do not tell."""
    try:
        leaf = leaf_optics(material)
    except SceneError:
        leaf = leaf_optics(None)
    return np.add(leaf.reflectance, leaf.transmittance)


def _folder(options):
    if not options.folder:
        return volume.default_folder()
    return Path(bpy.path.abspath(options.folder)).absolute()


def _stamp(result, options):
    """The settings that made the file, flat, for its metadata."""
    report = asdict(result.report)
    report["seconds"] = sum(report["seconds"].values())
    return {**asdict(options), **report}


def _show_volume(context, problem, path, name, options):
    """A Volume object for the file; it renders only where it stands for volumes."""
    ob = volume.show_volume(context, name, path)
    volumes = any(source.is_volume for source in problem.sources)
    _density, optics = problem.shown
    shading.shade_volume(ob, options.mode, optics.sigma_s, optics.sigma_a, options.strength)
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
