# SPDX-License-Identifier: GPL-3.0-or-later
"""The choices of a scene and of its objects, kept in the .blend; see `bake.Options`."""

import functools

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .. import job
from ..errors import LightingError

MEDIA = [
    ("MATERIAL", "From Material", "Read scattering, absorption and g from each object's material"),
    ("CUSTOM", "Custom", "The coefficients below, which the presets of the panel's header fill in"),
    ("cloud", "Cloud", "Water droplets: hardly any absorption, scattering strongly forward"),
    ("plant", "Plant", "Leaves: green light passes and is scattered, red and blue are absorbed"),
    ("pmma", "PMMA", "Translucent acrylic plastic"),
]
MODELS = [
    (
        "physical",
        "Physical",
        "In the scene's units: the light of lamps and sky is exact up to its first collision, "
        "and the lattice carries what is scattered",
    ),
    (
        "paper",
        "Paper",
        "The lattice of Geist and Westall as printed: for comparison; its level is not nature's",
    ),
]
QUALITIES = [
    ("preview", "Preview", "An error of 20 % at most: to place lamps, within a second or so"),
    ("draft", "Draft", "An error of 10 % at most: the lattice alone, free of noise"),
    ("final", "Final", "An error of 5 % at most: with photons where the lattice needs them"),
    ("reference", "Reference", "An error of 2 % at most: slow, to compare with"),
    ("CUSTOM", "Custom", "The settings below, which Customize fills in with what was planned"),
]
SCATTERINGS = [
    ("multiple", "Multiple", "All scattered light"),
    ("single", "Single", "No lattice: light scatters once, in the shader; for thin media"),
]
MODES = [
    (
        "REPLACE",
        "Replace",
        "The lit volume takes the place of its source, which is hidden: fast, and without noise",
    ),
    (
        "ADD",
        "Add",
        "The source stays and Cycles scatters light in it once; the light of many scatterings "
        "is laid over it, for the camera alone",
    ),
]
FOLIAGE = [
    ("ATTRIBUTE", "Attribute", "Light is written on the vertices of the mesh: works everywhere"),
    (
        "MODIFIER",
        "Modifier",
        "A geometry nodes modifier reads the baked volume: meshes stay as they are, and plants "
        "that move or are instanced are lit where they are",
    ),
]
ROLES = [
    ("AUTO", "Automatic", "Solid where the material has a volume, foliage where it has none"),
    ("FOLIAGE", "Foliage", "Leaves and twigs: surfaces that are lit as a cloud of leaves"),
    ("SOLID", "Solid", "A closed body of a translucent material"),
    ("OCCLUDER", "Occluder", "Wood, ground or walls: stops all light, and throws back its colour"),
]


@functools.cache
def _device_labels():
    return [line.rsplit(": ", 1)[0] for line in job.device_lines()]


def _search_devices(_properties, _context, text):
    try:
        return [label for label in _device_labels() if text.casefold() in label.casefold()]
    except LightingError:  # a driver that dies must not take the text field with it
        return []


class SceneProperties(bpy.types.PropertyGroup):
    resolution: IntProperty(
        name="Resolution",
        description="Voxels along the longest edge. Twice as many take 16 times as long",
        default=64,
        min=0,
        soft_min=16,
        soft_max=256,
    )
    padding: IntProperty(
        name="Padding",
        description="Empty voxels around what is lit, through which light enters",
        default=2,
        min=1,
        soft_max=16,
    )
    domain: PointerProperty(
        name="Domain",
        description="Light the bounds of this object instead of those of the selection",
        type=bpy.types.Object,
    )
    medium: EnumProperty(name="Medium", description="What the light scatters in", items=MEDIA)
    sigma_s: FloatVectorProperty(
        name="Scattering",
        description="How much red, green and blue light is scattered at density 1, in 1/m",
        default=(1, 1, 1),
        min=0,
        precision=3,
    )
    sigma_a: FloatVectorProperty(
        name="Absorption",
        description="How much red, green and blue light is absorbed at density 1, in 1/m",
        default=(0, 0, 0),
        min=0,
        precision=3,
    )
    g: FloatVectorProperty(
        name="Anisotropy",
        description="Mean cosine of the angle that red, green and blue light is scattered by: "
        "forward above 0, back below",
        default=(0, 0, 0),
        min=-0.99,
        max=0.99,
    )
    optical_depth: FloatProperty(
        name="Optical Depth",
        description="How dense a preset is: the mean number of collisions on a straight line as "
        "long as the domain, through density 1; 0 takes custom coefficients as they are. "
        "Foliage has its own, from its leaves",
        default=30,
        min=0,
        soft_max=200,
    )
    grid: StringProperty(
        name="Grid",
        description="Grid to read from volumes and smoke; empty for the one the material names",
    )
    model: EnumProperty(name="Model", description="How light is computed", items=MODELS)
    quality: EnumProperty(
        name="Quality",
        description="How wrong the light may be, on average over voxels; how that is reached is "
        "planned for each scene",
        items=QUALITIES,
        default="draft",
    )
    scattering: EnumProperty(
        name="Scattering", description="What scattered light is found", items=SCATTERINGS
    )
    rays: FloatProperty(
        name="Rays",
        description="Rays of unscattered light along a voxel's edge, over the usual number: skies "
        "of twice as many take four times as long, and are more even",
        default=1,
        min=0.25,
        max=16,
        soft_max=4,
    )
    merge: IntProperty(
        name="Merge Voxels",
        description="Find scattered light in voxels so many times as large; unscattered light "
        "keeps its own",
        default=1,
        min=1,
        max=64,
        soft_max=8,
    )
    photons: IntProperty(
        name="Photons",
        description="How many are traced: four times as many leave half the noise. 0 for 64 a "
        "voxel",
        default=0,
        min=0,
    )
    tolerance: FloatProperty(
        name="Tolerance",
        description="The error that the lattice's steps may leave, of its light",
        default=2**-7,
        min=1e-5,
        max=0.5,
        precision=4,
    )
    handover: FloatProperty(
        name="Trace Photons",
        description="How far light is traced as photons before the lattice takes it over, in "
        "transport optical depths: 0 is fast and free of noise, 4 is more exact, 1000 leaves "
        "next to nothing to the lattice",
        default=0,
        min=0,
        soft_max=8,
    )
    gather: BoolProperty(
        name="Gather Directions",
        description="Where volumes scatter forwards and lamps shine on them, follow what they "
        "scatter along rays of many directions at last: pictures are right from all sides. It "
        "takes a few times as long as the rest",
        default=True,
    )
    mode: EnumProperty(name="Volumes", description="How a lit volume is rendered", items=MODES)
    foliage: EnumProperty(name="Foliage", description="How foliage gets its light", items=FOLIAGE)
    sky: BoolProperty(
        name="Bake Sky",
        description="Where the world alone shines, take its own light into what surfaces show: "
        "pictures need a quarter of the samples and hardly flicker. Only what is lit casts a "
        "shadow in it, and none that is finer than a voxel",
    )
    strength: FloatProperty(
        name="Strength", description="Factor on the light in the render", default=1, min=0
    )
    keep_absorbed: BoolProperty(
        name="Keep Absorbed Light",
        description="Emit absorbed light again instead of losing it: brighter, and less coloured. "
        "For the paper's model alone",
    )
    device: StringProperty(
        name="Device",
        description="What solves: empty for the fastest kind, or part of a device's name",
        search=_search_devices,
        search_options={"SUGGESTION"},
    )
    overwrite: BoolProperty(
        name="Overwrite Frames",
        description="Animation bakes the frames anew that are baked already, in another folder",
    )
    folder: StringProperty(
        name="Folder",
        description="Where the .vdb is written; empty for the folder of the .blend. What is baked "
        "before the first save moves there with it",
        subtype="DIR_PATH",
        options={"ANIMATABLE", "PATH_SUPPORTS_BLEND_RELATIVE"},
    )


class ObjectProperties(bpy.types.PropertyGroup):
    role: EnumProperty(name="Role", description="What this object is to the light", items=ROLES)


def register():
    for group, owner in ((SceneProperties, bpy.types.Scene), (ObjectProperties, bpy.types.Object)):
        bpy.utils.register_class(group)
        owner.lb_lighting = PointerProperty(type=group)


def unregister():
    for group, owner in ((SceneProperties, bpy.types.Scene), (ObjectProperties, bpy.types.Object)):
        del owner.lb_lighting
        bpy.utils.unregister_class(group)
