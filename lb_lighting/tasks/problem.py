# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the problem for the solver from what was read from a scene: fills its voxels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import LightingError, SceneError
from ..scene.mixture import mixture, occluders, with_shadows
from ..transport.lights.base import Light, bands_of
from ..transport.medium import Domain, Medium, Optics
from ..transport.solver import Settings, require_memory

if TYPE_CHECKING:
    from ..arrays import Floats
    from ..options import Options
    from ..scene.medium_choice import MediumChoice
    from ..scene.sources import Source

COARSEST = 2  # voxels along its longest edge that a source should have
SMALLEST_VOXEL = 2e-5  # m: OpenVDB rejects the transform of much smaller voxels as singular
SPHERE = np.float32(4 * np.pi)  # sr


@dataclass
class Problem:
    """A scene as the solver sees it.

    medium  in SI units
    shown   (density (nx, ny, nz), Optics) that the lit volume renders: that of the volumes alone if
            there are any, because surfaces show their light themselves
    lights  transport lights
    """

    medium: Medium
    shown: tuple[Floats, Optics]
    lights: Sequence[Light]


@dataclass
class SceneTask:
    """What was read from a scene; it makes the `Problem` for the solver.

    options   `Options`
    sources   see scene/sources.py
    medium_choice  the medium that the user chose, with the notes for the user
    lights    transport lights
    box       (lower, upper), each (3,) m, to light, or None for the bounds of the sources
    left_out  sources that turn out to be unreadable
    is_frame  whether it is one of a sequence
    """

    options: Options
    sources: list[Source]
    medium_choice: MediumChoice
    lights: Sequence[Light]
    box: tuple[Floats, Floats] | None
    left_out: list[Source]
    is_frame: bool

    def problem(self) -> Problem:
        """The `Problem`, with all voxels filled."""
        domain = self._domain()
        # Read the sources.
        shares = self._of_each(lambda source: source.shares(domain))
        everything = [share for of_source in shares.values() for share in of_source]
        occlusion, albedo = self._occlusion(domain)
        emission = self._emission(domain)
        glows = emission is not None
        density, optics = self.medium_choice.mixture(everything, glows)
        # Compose the medium.
        bands = _bands(optics, self.lights, albedo, emission)
        medium = Medium(
            density,
            domain.voxel_size,
            np.broadcast_to(optics.sigma_s, bands),
            np.broadcast_to(optics.sigma_a, bands),
            optics.g,
            domain.origin,
            emission=None if emission is None else SPHERE * emission[:bands],
            occlusion=occlusion,
            occlusion_albedo=np.broadcast_to(albedo, (bands, *albedo.shape[1:])),
        )
        # Find what the lit volume renders.
        volumes = [share for source, own in shares.items() for share in own if source.is_volume]
        shown = density, optics
        if volumes and (glows or any(np.any(share.density) for share in volumes)):
            shown = mixture(volumes, glows)
        elif volumes or self.is_frame:  # there are none here, but other frames may have some
            shown = np.zeros_like(density), optics
        return Problem(medium, shown, with_shadows(self.lights, everything))

    def _occlusion(self, domain: Domain) -> tuple[Floats | None, Floats]:
        """(share of a voxel that stops light (nx, ny, nz) or None, albedo of what does)."""
        of_sources = self._of_each(lambda source: source.occlusion(domain)).values()
        occlusions = [occlusion for occlusion in of_sources if occlusion is not None]
        return occluders(occlusions) if occlusions else (None, np.zeros(1))

    def _emission(self, domain: Domain) -> Floats | None:
        """(3, nx, ny, nz) W/(m^3 sr) that the sources emit, or None."""
        of_sources = self._of_each(lambda source: source.emission(domain)).values()
        emissions = [emission for emission in of_sources if emission is not None]
        if emissions and self.options.model == "paper":
            self.medium_choice.notes.append(
                "The paper model leaves out the light of fire; choose Physical to bake it."
            )
            return None
        return np.sum(emissions, axis=0) if np.any(emissions) else None

    def _domain(self) -> Domain:
        """The `Domain` to light. Raises SceneError or SettingsError for one that cannot be."""
        bounds = {} if self.box else self._of_each(lambda source: source.bounds)
        corners = np.concatenate([self.box] if self.box else list(bounds.values()))
        padding, resolution = self.options.padding, self.options.resolution
        domain = Domain.around(corners.min(axis=0), corners.max(axis=0), resolution, padding)
        # A plan picks settings that fit into memory; uncollided light alone needs the least.
        least = Settings(scattering="single")
        settings = least if self.options.is_planned else self.options.settings()
        require_memory(domain.shape, settings, self.options.device)
        if domain.voxel_size < SMALLEST_VOXEL:
            raise SceneError(
                f"Voxels of {domain.voxel_size:.1g} m are too small for a volume file; "
                "scale the scene up."
            )
        for source, (lower, upper) in bounds.items():
            width = (upper - lower).max() / domain.voxel_size
            if width < COARSEST and len(bounds) > 1:
                self.medium_choice.notes.append(
                    f"'{source.name}' is only {width:.1g} voxels wide beside the other objects; "
                    "bake it separately to see its shape."
                )
        return domain

    def _of_each(self, read: Callable[[Source], Any]) -> dict[Source, Any]:
        """{source: read(source)}. Sources that cannot be read are left out, with a note.

        Raises the LightingError of the first one if none can be read.
        """
        values: dict[Source, Any] = {}
        failures: list[tuple[Source, LightingError]] = []
        for source in self.sources:
            if source in self.left_out:
                continue
            try:
                values[source] = read(source)
            except LightingError as error:
                failures.append((source, error))
        if failures and not values:
            raise failures[0][1]
        for source, failure in failures:
            self.left_out.append(source)
            self.medium_choice.notes.append(f"'{source.name}' is left out. {failure}")
        return values


def _bands(optics: Optics, lights: Sequence[Light], albedo: Floats, emission: Floats | None) -> int:
    """3 if a coefficient, a light, an occluder or the emission has a colour, else 1."""
    if emission is not None and np.ptp(emission, axis=0).any():
        return 3
    values = [optics.sigma_s, optics.sigma_a, optics.g]
    return max(len(albedo), *map(np.size, values), *map(bands_of, lights))
