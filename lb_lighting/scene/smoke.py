# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoke and fire of Blender's fluid simulation, onto the lattice."""

import numpy as np

from ..errors import SceneError
from .volumes import resample_array


def find_domain_settings(ob):
    """FluidDomainSettings of the object, or None where it is not a fluid domain."""
    for modifier in ob.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            return modifier.domain_settings
    return None


def smoke_grids(ob, depsgraph, domain):
    """{name: values on the lattice of `domain`} of the simulation at the current frame.

    ob  the original object that is the fluid domain

    "density", "flame" and "temperature" are (nx, ny, nz) and "color" is (3, nx, ny, nz), all
    float32 and in the simulation's own units; all but the density only where they are simulated.
    Raises SceneError for an object that is no gas domain, or that is not simulated yet.
    """
    evaluated, settings = _simulated(ob, depsgraph)
    resolution = tuple(settings.domain_resolution)
    # With an adaptive domain the evaluated box is the part that is being simulated.
    box = np.array(evaluated.bound_box)
    corner, size = box.min(axis=0), np.ptp(box, axis=0)

    def on_lattice(values):
        """Grids of the noise are finer, so each brings its own number of cells."""
        cell = size / values.shape
        to_object = np.diag([*cell, 1.0])
        to_object[:3, 3] = corner + cell / 2
        return resample_array(values, np.array(evaluated.matrix_world) @ to_object, domain)

    grids = {}
    for name in ("density", "flame", "temperature"):
        cells = _cells(getattr(settings, f"{name}_grid"), 1, resolution)
        if cells is not None:
            grids[name] = on_lattice(cells[..., 0])
    colors = _cells(settings.color_grid, 4, resolution)
    if colors is not None:
        grids["color"] = _plain_color(*(on_lattice(colors[..., i]) for i in range(4)))
    return grids


def world_bounds(ob, depsgraph):
    """(lower, upper), each (3,) m: the box around the simulated domain in world space."""
    evaluated, _settings = _simulated(ob, depsgraph)
    matrix = np.array(evaluated.matrix_world)
    corners = np.array(evaluated.bound_box) @ matrix[:3, :3].T + matrix[:3, 3]
    return corners.min(axis=0), corners.max(axis=0)


def _simulated(ob, depsgraph):
    """(evaluated object, its domain settings); only the evaluated ones have grids."""
    evaluated = ob.evaluated_get(depsgraph)
    settings = find_domain_settings(evaluated)
    if settings is None or settings.domain_type != "GAS":
        raise SceneError(f"'{ob.name}' is not a gas domain; choose the domain of a smoke.")
    # A cache that is not baked yet has the grids of the first frame, without any smoke.
    density = _cells(settings.density_grid, 1, settings.domain_resolution)
    if density is None or not density.any():
        raise SceneError(
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


def _plain_color(red, green, blue, density):
    """(3, nx, ny, nz): colour divided by density, as Cycles reads it; 0 where no smoke is."""
    color = np.stack([red, green, blue])
    return np.divide(color, density, out=np.zeros_like(color), where=density > 0)
