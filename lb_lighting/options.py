# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user chooses; the scene's properties and the command line carry the same names."""

from dataclasses import asdict, dataclass, fields

import numpy as np

from .errors import SettingsError, require_known
from .scene.medium_choice import CUSTOM, FROM_MATERIAL
from .transport.medium import PRESETS, optics_by_band
from .transport.planning.planner import TARGETS
from .transport.solver import MODELS, Settings

QUALITIES = (*TARGETS, CUSTOM)
MODES = ("REPLACE", "ADD")
SHOWN = {"strength", "device", "folder"}
FORMAT = 3  # raised where grids come to mean something else, so that old frames are not kept
FOLIAGE = ("ATTRIBUTE", "MODIFIER")  # how it gets its light


@dataclass(frozen=True)
class Options:
    """The choices for a bake. Raises SettingsError for what is unknown or out of its range."""

    resolution: int = 64  # voxels along the longest edge, padding included
    padding: int = 2  # empty voxels around the selection
    domain: str = ""  # name of an object whose bounds to light, or "" for the selection's
    medium: str = FROM_MATERIAL  # or the name of a preset, or "CUSTOM": the next three
    sigma_s: tuple = (1.0, 1.0, 1.0)  # 1/m at density 1, by band
    sigma_a: tuple = (0.0, 0.0, 0.0)  # 1/m at density 1, by band
    g: tuple = (0.0, 0.0, 0.0)  # mean cosine of the scattering angle, by band
    optical_depth: float = 30.0  # of the domain's longest edge at density 1, for presets
    grid: str = ""  # grid to read from volumes, or "" for the material's
    model: str = "physical"  # or "paper"
    # An error target, see transport/planning/planner.py; or "CUSTOM": the next six count.
    quality: str = "draft"
    scattering: str = "multiple"  # or "single"
    rays: float = 1.0  # of unscattered light along a voxel's edge, over the usual number
    merge: int = 1  # voxels along each edge that scattered light is found in as one
    handover: float = 0.0  # transport optical depths that photons are traced for
    photons: int = 0  # to trace, or 0 for as many as the voxels take
    tolerance: float = 2**-7  # relative error that the lattice's steps leave; as float32 has it
    # Directions of forward scattering media: transport/ordinates/source_iteration.py.
    gather: bool = True
    mode: str = "REPLACE"  # how a lit volume renders: "REPLACE" or "ADD"
    foliage: str = "ATTRIBUTE"  # how it gets its light: "ATTRIBUTE", or "MODIFIER" that reads it
    sky: bool = False  # bake its own light into surfaces, too, where nothing else shines
    strength: float = 1.0  # factor on the light in the render
    keep_absorbed: bool = False  # emit absorbed light again, by "paper"
    device: str = ""  # part of a device's label, or "" for the best
    folder: str = ""  # where the .vdb goes, or "" for the .blend's own folder

    def __post_init__(self):
        for value, known, what in (
            (self.medium, (FROM_MATERIAL, CUSTOM, *PRESETS), "medium"),
            (self.model, tuple(MODELS), "model"),
            (self.quality, QUALITIES, "quality"),
            (self.mode, MODES, "mode"),
            (self.foliage, FOLIAGE, "light of foliage"),
        ):
            require_known(value, known, what)
        if self.padding < 1:
            raise SettingsError(f"The padding must be 1 voxel or more; it is {self.padding}.")
        self._refuse_bad_medium()
        if not (self.strength >= 0 and np.isfinite(self.strength)):
            raise SettingsError(f"The strength must not be negative; it is {self.strength}.")
        self.settings()  # refuses the others

    def _refuse_bad_medium(self):
        optics_by_band(self.sigma_s, self.sigma_a, self.g)  # refuses what is not physical
        if self.medium == CUSTOM and not (any(self.sigma_s) or any(self.sigma_a)):
            raise SettingsError("The custom medium is void; give it scattering or absorption.")
        # As they are, without a scale, only the coefficients of a custom medium are meant.
        enough = self.optical_depth > 0 or (self.optical_depth == 0 and self.medium == CUSTOM)
        if not (enough and np.isfinite(self.optical_depth)):
            raise SettingsError(f"The optical depth must be positive; it is {self.optical_depth}.")

    def settings(self):
        """The solver's `Settings`, where they are not to be planned."""
        return Settings(model=self.model, keep_absorbed=self.keep_absorbed, **self.by_hand)

    @property
    def by_hand(self):
        """{name: value} of the `Settings` that a plan chooses, as they are for CUSTOM."""
        names = ("scattering", "rays", "merge", "handover", "tolerance")
        return {name: getattr(self, name) for name in names} | {"photons": self.photons or None}

    @property
    def is_planned(self):
        return self.model == "physical" and self.quality != CUSTOM

    @property
    def cache_key(self):
        """All that a result depends on, as text: not how it is shown, or where it is made."""
        values = {name: value for name, value in asdict(self).items() if name not in SHOWN}
        return repr(values | {"format": FORMAT})

    @classmethod
    def of(cls, scene, **changes):
        """The scene's own, with `changes` where they are not None."""
        values = {f.name: getattr(scene.lb_lighting, f.name) for f in fields(cls)}
        values |= {f.name: tuple(values[f.name]) for f in fields(cls) if f.type is tuple}
        values["domain"] = values["domain"].name if values["domain"] else ""
        return cls(**values | {name: v for name, v in changes.items() if v is not None})
