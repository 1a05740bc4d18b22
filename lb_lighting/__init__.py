# SPDX-License-Identifier: GPL-3.0-or-later
"""LB Lighting: lights dense media with a lattice-Boltzmann solver.

`lb_lighting.transport` is the physics and needs no Blender; registration imports the rest.
"""

from typing import Any


def _modules() -> tuple[Any, ...]:
    from . import cli
    from .ui import (
        handlers,
        operators,
        panels,
        preferences,
        presets,
        preview,
        properties,
        running,
    )

    return (properties, preferences, running, handlers, operators, presets, panels, preview, cli)


def register() -> None:
    for module in _modules():
        module.register()


def unregister() -> None:
    for module in reversed(_modules()):
        module.unregister()
