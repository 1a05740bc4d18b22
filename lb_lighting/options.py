# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a bake.

Each option states its name, default, range, unit and description once, as a field of `Options`. The
scene's properties (ui/properties.py), the arguments of the command line (cli.py) and the reference
in the manual (tests/setup/reference.py) are made from these fields.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .errors import SettingsError, require_known
from .scene.medium_choice import CUSTOM, FROM_MATERIAL
from .transport.medium import optics_by_band
from .transport.solver import Settings

if TYPE_CHECKING:
    import bpy

SHOWN = {"strength", "device", "folder"}  # options that change how a result is shown or made
FORMAT = 3  # raised where grids come to mean something else, so that old frames are not kept


class Choice(NamedTuple):
    """One of the values of an option that is chosen from a list."""

    identifier: str
    label: str
    description: str


@dataclass(frozen=True)
class Option:
    """What the panel, the command line and the manual need to know of an option.

    default       its value, which also gives its type
    lowest        of its range, None for no limit; `highest` likewise
    usual         (from, to) of the slider in the panel, None where that is no use
    digits        after the decimal point, in the panel; None for Blender's own number
    unit          of the value, "" for none
    choices       its values, for an option that is chosen from a list
    """

    label: str
    description: str
    default: Any
    lowest: float | None = None
    highest: float | None = None
    usual: tuple[float | None, float | None] = (None, None)
    digits: int | None = None
    unit: str = ""
    choices: tuple[Choice, ...] = ()
    name: str = ""

    @property
    def identifiers(self) -> tuple[str, ...]:
        return tuple(choice.identifier for choice in self.choices)

    @property
    def flag(self) -> str:
        """The argument of the command line."""
        return f"--{self.name.replace('_', '-')}"


def _option(label: str, description: str, default: Any, **details: Any) -> Any:
    """The field of `Options` that an option is."""
    option = Option(label, description, default, **details)
    return field(default=default, metadata={"option": option})


MEDIA = (
    Choice(
        FROM_MATERIAL,
        "From Material",
        "Read scattering, absorption and anisotropy from the material of each object",
    ),
    Choice(
        CUSTOM,
        "Custom",
        "Use the coefficients below. The presets in the panel header fill them in",
    ),
    Choice("cloud", "Cloud", "Water droplets: almost no absorption, strong forward scattering"),
    Choice("plant", "Plant", "Leaves: they transmit and scatter green, and absorb red and blue"),
    Choice("pmma", "PMMA", "Translucent acrylic plastic"),
)
MODELS = (
    Choice(
        "physical",
        "Physical",
        "Work in the scene's units. Direct light of lamps and sky is exact up to its first "
        "collision, and the lattice carries the scattered light",
    ),
    Choice(
        "paper",
        "Paper",
        "Use the lattice as Geist and Westall published it, for comparison. Its brightness is not "
        "physical",
    ),
)
QUALITIES = (
    Choice("preview", "Preview", "Error of at most 20%: the fastest, for placing lamps"),
    Choice("draft", "Draft", "Error of at most 10%: usually the lattice alone, free of noise"),
    Choice("final", "Final", "Error of at most 5%: adds photons where the lattice needs them"),
    Choice("reference", "Reference", "Error of at most 2%: slow, for comparison"),
    Choice(
        CUSTOM,
        "Custom",
        "Use the settings in the panel Solver. Customize copies the planned settings there",
    ),
)
SCATTERINGS = (
    Choice("multiple", "Multiple", "Compute light of all orders of scattering"),
    Choice(
        "single",
        "Single",
        "Skip the lattice: light scatters once, in the shader. For thin media",
    ),
)
MODES = (
    Choice(
        "REPLACE",
        "Replace",
        "Hide the source and render the lit volume in its place: fast and free of noise",
    ),
    Choice(
        "ADD",
        "Add",
        "Keep the source. Cycles renders single scattering in it, and multiple scattering is "
        "added on top, visible to the camera only",
    ),
)
FOLIAGE = (
    Choice("ATTRIBUTE", "Attribute", "Write the light on the vertices of the mesh: works anywhere"),
    Choice(
        "MODIFIER",
        "Modifier",
        "Read the light from the baked volume with a geometry nodes modifier. Meshes stay "
        "unchanged, and plants that move or are instanced get the light of their position",
    ),
)
ROLES = (
    Choice(
        "AUTO", "Automatic", "Solid if the material has a volume shader, foliage if it has none"
    ),
    Choice("FOLIAGE", "Foliage", "Leaves and twigs: surfaces that are lit as a cloud of leaves"),
    Choice("SOLID", "Solid", "A closed body of a translucent material"),
    Choice(
        "OCCLUDER",
        "Occluder",
        "Wood, ground or walls: blocks all light and reflects its own colour",
    ),
)


def properties_of(owner: Any) -> Any:
    """The properties that ui/properties.py adds to a scene or an object."""
    return owner.lb_lighting


@dataclass(frozen=True)
class Options:
    """The options of a bake. Raises SettingsError for a value that is unknown or out of range."""

    resolution: int = _option(
        "Resolution",
        "Number of voxels along the longest edge, padding included. Doubling it takes 16 times "
        "as long",
        64,
        lowest=0,
        usual=(16, 256),
        unit="voxels",
    )
    padding: int = _option(
        "Padding",
        "Width of the empty border around the lit objects, through which light enters",
        2,
        lowest=1,
        usual=(None, 16),
        unit="voxels",
    )
    domain: str = _option(
        "Domain",
        "Object whose bounding box is lit. If empty, the bounding box of the selection is lit",
        "",
    )
    medium: str = _option(
        "Medium", "The medium that scatters the light", FROM_MATERIAL, choices=MEDIA
    )
    sigma_s: tuple[float, ...] = _option(
        "Scattering",
        "Scattering coefficient for red, green and blue at density 1, for a custom medium",
        (1.0, 1.0, 1.0),
        lowest=0,
        digits=3,
        unit="1/m",
    )
    sigma_a: tuple[float, ...] = _option(
        "Absorption",
        "Absorption coefficient for red, green and blue at density 1, for a custom medium",
        (0.0, 0.0, 0.0),
        lowest=0,
        digits=3,
        unit="1/m",
    )
    g: tuple[float, ...] = _option(
        "Anisotropy",
        "Mean cosine of the scattering angle for red, green and blue, for a custom medium. "
        "Positive values scatter forward, negative values scatter back",
        (0.0, 0.0, 0.0),
        lowest=-0.99,
        highest=0.99,
    )
    optical_depth: float = _option(
        "Optical Depth",
        "Density of a preset or custom medium: the mean number of collisions along a straight line "
        "as long as the domain, at density 1. With 0, custom coefficients are used unscaled. "
        "Foliage takes its density from its leaves",
        30.0,
        lowest=0,
        usual=(None, 200),
    )
    grid: str = _option(
        "Grid",
        "Density grid of volumes and smoke. If empty, the grid that the material names is used",
        "",
    )
    model: str = _option("Model", "How the light is computed", "physical", choices=MODELS)
    quality: str = _option(
        "Quality",
        "Error target: how wrong the light may be on average, where a picture shows it. "
        "LB Lighting picks the cheapest settings that meet it",
        "draft",
        choices=QUALITIES,
    )
    scattering: str = _option(
        "Scattering",
        "Which scattered light is computed, for Custom quality",
        "multiple",
        choices=SCATTERINGS,
    )
    rays: float = _option(
        "Rays",
        "Factor on the usual number of direct light rays along a voxel edge, for Custom quality. "
        "Doubling it makes the light of skies more even and takes four times as long",
        1.0,
        lowest=0.25,
        highest=16,
        usual=(None, 4),
    )
    merge: int = _option(
        "Merge Voxels",
        "Compute scattered light in voxels that are this many times as large, for Custom quality. "
        "Direct light keeps the full resolution",
        1,
        lowest=1,
        highest=64,
        usual=(None, 8),
    )
    handover: float = _option(
        "Trace Photons",
        "How far light is traced as photons before the lattice takes over, for Custom quality. 0 "
        "is fast and free of noise, 4 is more accurate, 1000 leaves almost nothing to the lattice",
        0.0,
        lowest=0,
        usual=(None, 8),
        unit="transport optical depths",
    )
    photons: int = _option(
        "Photons",
        "Number of photons, for Custom quality. Four times as many photons halve the noise. 0 "
        "traces 64 photons per voxel",
        0,
        lowest=0,
    )
    tolerance: float = _option(
        "Tolerance",
        "Relative error of the lattice's light at which it stops, for Custom quality",
        2**-7,  # exact in the float32 of Blender's properties
        lowest=1e-5,
        highest=0.5,
        digits=4,
    )
    gather: bool = _option(
        "Directional Scattering",
        "Compute scattered light along many directions where lamps shine on volumes that scatter "
        "forward. Renders are then right from all sides, and a bake takes a few times as long",
        True,
    )
    mode: str = _option("Volumes", "How a lit volume is rendered", "REPLACE", choices=MODES)
    foliage: str = _option("Foliage", "How foliage gets its light", "ATTRIBUTE", choices=FOLIAGE)
    sky: bool = _option(
        "Bake Sky",
        "Where the world is the only light, bake its direct light into surfaces too. Renders need "
        "a quarter of the samples and hardly flicker. Only lit objects shadow the baked sky, and "
        "no shadow is finer than a voxel",
        False,
    )
    strength: float = _option(
        "Strength", "Factor on the brightness of the light in the render", 1.0, lowest=0
    )
    keep_absorbed: bool = _option(
        "Keep Absorbed Light",
        "Emit absorbed light again instead of losing it: brighter and less colourful. For the "
        "paper model only",
        False,
    )
    device: str = _option(
        "Device",
        "Part of the name of the device that computes the light. If empty, the fastest "
        "kind of device is used",
        "",
    )
    folder: str = _option(
        "Folder",
        "Folder for the .vdb files. If empty, they go beside the .blend file. Files that were "
        "baked before the first save move there when you save",
        "",
    )

    def __post_init__(self) -> None:
        for option in OPTIONS:
            if option.choices:
                require_known(getattr(self, option.name), option.identifiers, option.name)
        if self.padding < 1:
            raise SettingsError(f"The padding must be 1 voxel or more; it is {self.padding}.")
        self._refuse_bad_medium()
        if not (self.strength >= 0 and np.isfinite(self.strength)):
            raise SettingsError(f"The strength must not be negative; it is {self.strength}.")
        self.settings()  # refuses bad values of the others

    def _refuse_bad_medium(self) -> None:
        optics_by_band(self.sigma_s, self.sigma_a, self.g)  # refuses unphysical values
        if self.medium == CUSTOM and not (any(self.sigma_s) or any(self.sigma_a)):
            raise SettingsError("The custom medium is empty; set Scattering or Absorption.")
        # Only the coefficients of a custom medium make sense unscaled.
        is_valid = self.optical_depth > 0 or (self.optical_depth == 0 and self.medium == CUSTOM)
        if not (is_valid and np.isfinite(self.optical_depth)):
            raise SettingsError(f"The optical depth must be positive; it is {self.optical_depth}.")

    def settings(self) -> Settings:
        """The solver's `Settings`, if they are not to be planned."""
        return Settings(model=self.model, keep_absorbed=self.keep_absorbed, **self.by_hand)

    @property
    def by_hand(self) -> dict[str, Any]:
        """{name: value} of the `Settings` that a plan chooses, and that Custom quality fixes."""
        names = ("scattering", "rays", "merge", "handover", "tolerance")
        return {name: getattr(self, name) for name in names} | {"photons": self.photons or None}

    @property
    def is_planned(self) -> bool:
        return self.model == "physical" and self.quality != CUSTOM

    @property
    def cache_key(self) -> str:
        """The options that a result depends on, as text."""
        values = {name: value for name, value in asdict(self).items() if name not in SHOWN}
        return repr(values | {"format": FORMAT})

    @classmethod
    def of(cls, scene: bpy.types.Scene, **changes: Any) -> Options:
        """The options of a scene, with those `changes` that are not None."""
        properties = properties_of(scene)
        values = {option.name: getattr(properties, option.name) for option in OPTIONS}
        for option in OPTIONS:
            if isinstance(option.default, tuple):
                values[option.name] = tuple(values[option.name])
        values["domain"] = values["domain"].name if values["domain"] else ""
        return cls(**values | {name: v for name, v in changes.items() if v is not None})


OPTIONS: tuple[Option, ...] = tuple(
    replace(option.metadata["option"], name=option.name) for option in fields(Options)
)
# Options that are no part of `Options`: of how frames are baked, and of an object.
OVERWRITE = Option(
    "Overwrite Frames",
    "Bake frames again that are already baked, into a new folder",
    False,
    name="overwrite",
)
ROLE = Option("Role", "How light interacts with this object", "AUTO", choices=ROLES, name="role")
