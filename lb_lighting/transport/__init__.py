# SPDX-License-Identifier: GPL-3.0-or-later
"""The physics: media, lights and solvers in plain Python, without Blender."""

from ..errors import (
    Cancelled,
    DeviceError,
    LightError,
    LightingError,
    MediumError,
    SettingsError,
)
from .field import Field, Report
from .lights import PointLight, Sky, Sun
from .medium import PRESETS, Domain, Medium, Optics, paper_units
from .solver import Settings, solve

__all__ = [
    "PRESETS",
    "Cancelled",
    "DeviceError",
    "Domain",
    "Field",
    "LightError",
    "LightingError",
    "Medium",
    "MediumError",
    "Optics",
    "PointLight",
    "Report",
    "Settings",
    "SettingsError",
    "Sky",
    "Sun",
    "paper_units",
    "solve",
]
