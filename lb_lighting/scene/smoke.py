# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoke and fire of Blender's fluid simulation."""

import numpy as np

from ..errors import EmptyError, SceneError
from .grids.resample import Cells, box_bounds
from .volumes import world_matrix

SCALAR_GRIDS = ("density", "flame", "temperature")


def find_domain_settings(ob):
    """FluidDomainSettings of the object, or None where it is not a fluid domain."""
    for modifier in ob.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            return modifier.domain_settings
    return None


def read_grid(ob, depsgraph, name):
    """The `Cells` of a grid of the simulation at the current frame.

    ob    the original object that is the fluid domain
    name  one of SCALAR_GRIDS; its values stay in the simulation's own units

    Raises SceneError for an object that is no gas domain, that is not simulated yet, or that does
    not simulate the grid.
    """
    evaluated, settings = _simulated(ob, depsgraph)
    known = grid_names(ob, depsgraph)
    if name not in known:
        raise EmptyError(f"'{ob.name}' has no grid '{name}'; choose one of: {', '.join(known)}.")
    values = _cells(getattr(settings, f"{name}_grid"), 1, settings.domain_resolution)[..., 0]
    # With an adaptive domain the evaluated box is the part that is being simulated.
    box = np.array(evaluated.bound_box)
    # Grids of the noise are finer, so each brings its own number of cells.
    cell = np.ptp(box, axis=0) / values.shape
    to_object = np.diag([*cell, 1.0])
    to_object[:3, 3] = box.min(axis=0) + cell / 2
    return Cells(values, world_matrix(ob, depsgraph) @ to_object)


def grid_names(ob, depsgraph):
    """Those of SCALAR_GRIDS that are simulated."""
    _evaluated, settings = _simulated(ob, depsgraph)
    return [name for name in SCALAR_GRIDS if len(getattr(settings, f"{name}_grid"))]


def materials(ob, depsgraph):
    """[original material] of the slots of a domain; what has none shows no smoke."""
    slots = ob.evaluated_get(depsgraph).material_slots
    return [slot.material.original for slot in slots if slot.material]


def burns(ob, depsgraph):
    """Whether the simulation has a flame at the current frame."""
    _evaluated, settings = _simulated(ob, depsgraph)
    flame = _cells(settings.flame_grid, 1, settings.domain_resolution)
    return flame is not None and bool(flame.any())


def hue(ob, depsgraph):
    """(3,): the mean colour of the smoke, its largest component 1; black smoke has none.

    Only the hue is the user's: the simulation lets a colour fade in, so that white smoke too has
    less than 1 (.65 after 6 frames, .57 after 30).
    """
    _evaluated, settings = _simulated(ob, depsgraph)
    # The grid holds colour times density, so the sum is weighed by that.
    colors = _cells(settings.color_grid, 4, settings.domain_resolution)
    if colors is None:
        return np.ones(3)
    total = colors[..., :3].sum(axis=(0, 1, 2), dtype=float)
    return np.divide(total, total.max(), out=np.zeros(3), where=total.max() > 0)


def world_bounds(ob, depsgraph):
    """(lower, upper), each (3,) m: the box around the simulated domain in world space."""
    evaluated, _settings = _simulated(ob, depsgraph)
    box = np.array(evaluated.bound_box)
    return box_bounds(box.min(axis=0), box.max(axis=0), world_matrix(ob, depsgraph))


def _simulated(ob, depsgraph):
    """(evaluated object, its domain settings); only the evaluated ones have grids."""
    evaluated = ob.evaluated_get(depsgraph)
    settings = find_domain_settings(evaluated)
    if settings is None or settings.domain_type != "GAS":
        raise SceneError(f"'{ob.name}' is not a gas domain; choose the domain of a smoke.")
    # A cache that is not baked yet has the grids of the first frame, without any smoke.
    density = _cells(settings.density_grid, 1, settings.domain_resolution)
    if density is None or not density.any():
        raise EmptyError(
            f"There is no smoke in '{ob.name}' at this frame; bake it, or go to a later frame."
        )
    return evaluated, settings


def _cells(grid, channels, resolution):
    """A flat simulation grid, x fastest, as (mx, my, mz, channels); None where it is empty."""
    if not len(grid):
        return None
    values = np.empty(len(grid), np.float32)
    grid.foreach_get(values)
    fineness = round((len(grid) / channels / np.prod(resolution)) ** (1 / 3))
    nx, ny, nz = np.multiply(resolution, fineness)
    return values.reshape(nz, ny, nx, channels).transpose(2, 1, 0, 3)
