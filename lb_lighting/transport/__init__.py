# SPDX-License-Identifier: GPL-3.0-or-later
"""The physics: media, lights and solvers in plain Python, without Blender."""

from ..errors import (
    Cancelled,
    DeviceError,
    LightError,
    LightingError,
    MediumError,
    SettingsError,
    SolverError,
)
from .field import Field, Handed, PhotonReport, Report
from .free_path import SAMPLERS, FreePathSampler, sample_free_paths
from .lights import PointLight, Sky, Sun
from .medium import PRESETS, Domain, Medium, Optics, paper_units
from .perlin import PerlinMedium
from .photons import trace
from .solver import Settings, solve

__all__ = [
    "PRESETS",
    "SAMPLERS",
    "Cancelled",
    "DeviceError",
    "Domain",
    "Field",
    "FreePathSampler",
    "Handed",
    "LightError",
    "LightingError",
    "Medium",
    "MediumError",
    "Optics",
    "PerlinMedium",
    "PhotonReport",
    "PointLight",
    "Report",
    "Settings",
    "SettingsError",
    "Sky",
    "SolverError",
    "Sun",
    "paper_units",
    "sample_free_paths",
    "solve",
    "trace",
]
