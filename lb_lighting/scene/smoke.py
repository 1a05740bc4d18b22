# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads smoke and fire of Blender's fluid simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Floats
from ..errors import EmptyError, SceneError
from .grids.resample import Box, Cells, box_bounds
from .read_volumes import world_matrix

if TYPE_CHECKING:
    import bpy

SCALAR_GRIDS = ("density", "flame", "temperature")


def find_domain_settings(ob: Any) -> bpy.types.FluidDomainSettings | None:
    """The settings of the fluid domain that the object is, or None for any other object."""
    for modifier in ob.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            settings: bpy.types.FluidDomainSettings = modifier.domain_settings
            return settings
    return None


def read_grid(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, name: str) -> Cells:
    """The `Cells` of a grid of the simulation at the current frame.

    ob    the original object that is the fluid domain
    name  one of SCALAR_GRIDS; the values are in the units of the simulation

    Raises SceneError for an object that is not a gas domain or is not simulated yet, or for a grid
    that it does not simulate.
    """
    evaluated, settings = _simulated(ob, depsgraph)
    known = grid_names(ob, depsgraph)
    if name not in known:
        raise EmptyError(f"'{ob.name}' has no grid '{name}'; choose one of: {', '.join(known)}.")
    grid = _cells(getattr(settings, f"{name}_grid"), 1, settings.domain_resolution)
    assert grid is not None
    values = grid[..., 0]
    # In an adaptive domain, the evaluated box is the part that is simulated.
    box = np.array(evaluated.bound_box)
    # Grids with noise are finer, so the cell size depends on the grid.
    cell = np.ptp(box, axis=0) / values.shape
    to_object = np.diag([*cell, 1.0])
    to_object[:3, 3] = box.min(axis=0) + cell / 2
    return Cells(values, world_matrix(ob, depsgraph) @ to_object)


def grid_names(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[str]:
    """Those of SCALAR_GRIDS that are simulated."""
    _evaluated, settings = _simulated(ob, depsgraph)
    return [name for name in SCALAR_GRIDS if len(getattr(settings, f"{name}_grid"))]


def materials(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[bpy.types.Material]:
    """The original materials of a domain; empty slots show no smoke."""
    slots: Any = ob.evaluated_get(depsgraph).material_slots
    return [slot.material.original for slot in slots if slot.material]


def burns(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether the simulation has a flame at the current frame."""
    _evaluated, settings = _simulated(ob, depsgraph)
    flame = _cells(settings.flame_grid, 1, settings.domain_resolution)
    return flame is not None and bool(flame.any())


def hue(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Floats:
    """(3,): the mean colour of the smoke, scaled to a largest component of 1; 0 for black smoke.

    The brightness is not the user's: the simulation darkens colours, so even white smoke has
    less than 1 (0.65 after 6 frames, 0.57 after 30).
    """
    _evaluated, settings = _simulated(ob, depsgraph)
    # The grid holds colour times density, so the sum is weighted by density.
    colors = _cells(settings.color_grid, 4, settings.domain_resolution)
    if colors is None:
        return np.ones(3)
    total = colors[..., :3].sum(axis=(0, 1, 2), dtype=float)
    color: Floats = np.divide(total, total.max(), out=np.zeros(3), where=total.max() > 0)
    return color


def world_bounds(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Box:
    """(lower, upper), each (3,) m: the box around the simulated domain in world space."""
    evaluated, _settings = _simulated(ob, depsgraph)
    box = np.array(evaluated.bound_box)
    return box_bounds(box.min(axis=0), box.max(axis=0), world_matrix(ob, depsgraph))


def _simulated(
    ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> tuple[bpy.types.Object, Any]:
    """(evaluated object, its domain settings); the original settings have no grids."""
    evaluated = ob.evaluated_get(depsgraph)
    settings = find_domain_settings(evaluated)
    if settings is None or settings.domain_type != "GAS":
        raise SceneError(
            f"'{ob.name}' is not a gas domain; choose the domain of a smoke simulation."
        )
    # A cache that is not baked yet has the grids of the first frame, without smoke.
    density = _cells(settings.density_grid, 1, settings.domain_resolution)
    if density is None or not density.any():
        raise EmptyError(
            f"There is no smoke in '{ob.name}' at this frame; bake the simulation, or go to a "
            "later frame."
        )
    return evaluated, settings


def _cells(grid: Any, channels: int, resolution: Any) -> Floats | None:
    """A flat simulation grid, x fastest, as (mx, my, mz, channels); None if it is empty."""
    if not len(grid):
        return None
    values = np.empty(len(grid), np.float32)
    grid.foreach_get(values)
    fineness = round((len(grid) / channels / np.prod(resolution)) ** (1 / 3))
    nx, ny, nz = np.multiply(resolution, fineness)
    return values.reshape(nz, ny, nx, channels).transpose(2, 1, 0, 3)
