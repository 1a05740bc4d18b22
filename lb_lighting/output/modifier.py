# SPDX-License-Identifier: GPL-3.0-or-later
"""Light on surfaces without a change to their meshes: a modifier that reads the baked volume.

The geometry nodes `LB Ambient Grid` sample the grids of a baked Volume object at every evaluation,
at the current place of the plant. So plants that are animated, scattered or instanced get the light
of their place, and the mesh stays as it is. On points they store what `attribute.write_ambient`
writes, `lb_ambient` and `lb_ambient_back`. On an instance they store the light that falls
there on a surface of any direction: `lb_ambient`, the mean of both sides, and `lb_ambient_x`, `_y`
and `_z`, from which `LB Ambient` computes the light on each side. If that is all light, `lb_whole`
is 1 on both.

Foliage gets the modifier if the user chose it; any mesh gets it if its vertices cannot hold its
light.
"""

from collections.abc import Sequence
from typing import Any

import bpy

from ..ours import TAG, is_ours
from ..scene.remarks import listed
from ..scene.sources import Source
from . import attribute
from .grid_groups import BODY, GRID_GROUP, STAND_OFF, WALL_GROUP, WHOLE, grid_group, wall_group


def readers(
    objects: Sequence[bpy.types.Object],
    sources: Sequence[Source],
    depsgraph: bpy.types.Depsgraph,
    chosen: bool,
    notes: list[str],
) -> list[int]:
    """The numbers of those `sources` of the `objects` that the modifier will light.

    These are foliage, if it is `chosen`, and any surface on whose vertices the light would belong
    to other places; the `notes` report these.
    """
    numbers = []
    misplaced: dict[str, list[str]] = {}
    instancers = attribute.instancers(objects, depsgraph)
    sharers = attribute.sharers()
    for number, (ob, source) in enumerate(zip(objects, sources, strict=True)):
        if ob.type != "MESH" or not source.shows_light:
            continue
        if ob in instancers:
            notes.append(
                f"'{instancers[ob].name}' instances '{ob.name}' and shows its light; to light the "
                "instances where they are, make them real and select them."
            )
        reason = attribute.misplaced(ob, depsgraph, sharers)
        if source.lights_instances:
            reason = "geometry nodes make instances, each of which shows the light at its origin"
        is_chosen = chosen and source.is_foliage
        if is_chosen or reason:
            numbers.append(number)
        if reason and not is_chosen:
            misplaced.setdefault(reason, []).append(ob.name)
    notes.extend(
        f"{listed(names)}: {reason}. The modifier {GRID_GROUP} reads their light "
        "from the baked volume."
        for reason, names in misplaced.items()
    )
    return numbers


def add_modifier(
    ob: bpy.types.Object,
    baked: bpy.types.Object,
    all_light: bool = False,
    is_body: bool = False,
    stand_off: float = 0.0,
) -> None:
    """Give the mesh object `ob` the modifier that reads the Volume object `baked`.

    It is added once, as the last modifier; the user's values of its other inputs stay.

    all_light  whether the volume has all light, not scattered light alone
    is_body    whether both sides show the light that leaves the body, see `Vertices`
    stand_off  m, the distance from each side of a wall at which its light is sampled; 0 for a
               surface that is no wall
    """
    modifier: Any = _find(ob)
    if modifier is None:
        modifier = ob.modifiers.new(GRID_GROUP, "NODES")
        modifier.use_pin_to_last = True
    # Updates a group of an older version; both groups have the same inputs.
    modifier.node_group = wall_group() if stand_off else grid_group()
    values: dict[str, object] = {"Volume": baked, WHOLE: all_light, BODY: is_body}
    for name, value in (values | ({STAND_OFF: stand_off} if stand_off else {})).items():
        _input(modifier, name).value = value


def shows_all_light(ob: bpy.types.Object) -> bool:
    """True for an object that `add_modifier` gave all light."""
    modifier = _find(ob)
    return modifier is not None and bool(_input(modifier, WHOLE).value)


def has_modifier(ob: bpy.types.Object) -> bool:
    """True for an object that `add_modifier` lit."""
    return _find(ob) is not None


def remove_modifier(ob: bpy.types.Object) -> None:
    """Remove our modifier from the object `ob`, if it has one."""
    modifier = _find(ob)
    if modifier is not None:
        ob.modifiers.remove(modifier)


def _input(modifier: Any, name: str) -> Any:
    socket = modifier.node_group.interface.items_tree[name]
    return getattr(modifier.properties.inputs, socket.identifier)


def _find(ob: bpy.types.Object) -> Any:
    """Our modifier of the object, or None."""
    modifiers: Any = ob.modifiers
    return next((m for m in modifiers if m.type == "NODES" and _reads_grid(m.node_group)), None)


def _reads_grid(group: Any) -> bool:
    return group is not None and is_ours(group) and group[TAG] in (GRID_GROUP, WALL_GROUP)
