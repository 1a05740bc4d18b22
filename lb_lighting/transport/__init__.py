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
from .field import (
    CollisionSource,
    Field,
    PhotonReport,
    Report,
)
from .lights.base import DistantLight, Light, LocalLight
from .lights.distant import Sky, Sun
from .lights.lamps import AreaLight, PointLight, SpotLight
from .medium import (
    PRESETS,
    Domain,
    Medium,
    Optics,
    paper_units,
)
from .photons.free_path import SAMPLERS, FreePathSampler, sample_free_paths
from .photons.perlin import PerlinMedium
from .photons.trace import trace
from .planning.planner import Plan, plan
from .preview.pictures import Picture, View, pictures
from .preview.survey import (
    Statistics,
    advice,
    histogram_picture,
    statistics,
)
from .solver import Settings, solve

__all__ = [
    "PRESETS",
    "SAMPLERS",
    "AreaLight",
    "Cancelled",
    "CollisionSource",
    "DeviceError",
    "DistantLight",
    "Domain",
    "Field",
    "FreePathSampler",
    "Light",
    "LightError",
    "LightingError",
    "LocalLight",
    "Medium",
    "MediumError",
    "Optics",
    "PerlinMedium",
    "PhotonReport",
    "Picture",
    "Plan",
    "PointLight",
    "Report",
    "Settings",
    "SettingsError",
    "Sky",
    "SolverError",
    "SpotLight",
    "Statistics",
    "Sun",
    "View",
    "advice",
    "histogram_picture",
    "paper_units",
    "pictures",
    "plan",
    "sample_free_paths",
    "solve",
    "statistics",
    "trace",
]
