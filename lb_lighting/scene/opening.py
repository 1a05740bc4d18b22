# SPDX-License-Identifier: GPL-3.0-or-later
"""Selects the sources among the selected objects, and reads each as its kind of source."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

from ..errors import EmptyError, LightingError, SceneError
from ..ours import is_ours
from . import read_volumes, smoke
from .materials import has_volume
from .read_meshes import Part, world_parts
from .read_sources import read_smoke, read_volume
from .read_surfaces import read_foliage, read_occluder, read_solid
from .reader import Reader
from .remarks import listed
from .sources import Source

if TYPE_CHECKING:
    import bpy

SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "EMPTY"}
NAMED = 8  # objects that a note lists by name

_SURFACES: dict[str, Callable[[Any, Sequence[Part], Reader], Source]] = {
    "FOLIAGE": read_foliage,
    "SOLID": read_solid,
    "OCCLUDER": read_occluder,
}


def open_sources(
    objects: Sequence[bpy.types.Object],
    reader: Reader,
    require: Callable[[bpy.types.Object], None] | None = None,
) -> list[Source]:
    """The sources among the original `objects`, in their order.

    require  called with each object that is a source; raises a LightingError for an object that
             cannot be lit

    Objects that are hidden, are no source or cannot be read are skipped, with a note. If no source
    is left, the error of the first that cannot be read is raised, or else a SceneError.
    """
    if not objects:
        raise SceneError("Nothing is selected; select a volume, a smoke domain or a mesh.")
    # Read the faces of all visible objects.
    hidden = [ob for ob in objects if not ob.visible_get(view_layer=reader.depsgraph.view_layer)]
    visible = [ob for ob in objects if ob not in hidden]
    parts: dict[bpy.types.Object, list[Part]] = defaultdict(list)
    for part in world_parts(reader.depsgraph, filter(_is_surface, visible)):
        parts[part.object].append(part)
    # Read each source.
    sources: list[Source] = []
    no_sources: list[bpy.types.Object] = []
    failed: list[tuple[bpy.types.Object, LightingError]] = []
    for ob in visible:
        if not _is_source(ob, parts.get(ob, []), reader):
            no_sources.append(ob)
            continue
        note_count = len(reader.notes)
        try:
            if require is not None:
                require(ob)
            sources.append(_read_source(ob, parts.get(ob, []), reader))
        except LightingError as error:
            del reader.notes[note_count:]
            failed.append((ob, error))
    # Report the skipped objects.
    if not sources:
        _refuse(hidden, no_sources, failed)
    reader.notes[:0] = [
        *_skipped(no_sources, "have neither a volume nor faces", "has neither a volume nor faces"),
        *_skipped(hidden, "are hidden", "is hidden"),
        *(f"'{ob.name}' is left out. {error}" for ob, error in failed),
    ]
    return sources


def _refuse(
    hidden: Sequence[bpy.types.Object],
    no_sources: Sequence[bpy.types.Object],
    failed: Sequence[tuple[bpy.types.Object, LightingError]],
) -> NoReturn:
    """Raise why no object is a source."""
    if failed:
        raise failed[0][1]
    if no_sources:
        raise EmptyError(
            f"'{no_sources[0].name}' has neither a volume nor faces; "
            "select a volume, a smoke domain or a mesh."
        )
    raise EmptyError(f"'{hidden[0].name}' is hidden; show it to light it.")


def _skipped(objects: Sequence[bpy.types.Object], they: str, it: str) -> list[str]:
    """[the note that names the skipped `objects`], or [] if there are none."""
    if not objects:
        return []
    names = listed([ob.name for ob in objects], NAMED)
    return [f"Skipped, as {f'they {they}' if len(objects) > 1 else f'it {it}'}: {names}."]


def _is_surface(ob: bpy.types.Object) -> bool:
    return ob.type in SURFACE_TYPES and not smoke.find_domain_settings(ob)


def _is_source(ob: bpy.types.Object, parts: Sequence[Part], reader: Reader) -> bool:
    """Whether an object has a volume or faces (`parts`)."""
    if ob.type == "VOLUME" or parts or smoke.find_domain_settings(ob) or _is_in_edit_mode(ob):
        return True
    return read_volumes.has_volume(ob, reader.depsgraph)


def _is_in_edit_mode(ob: Any) -> bool:
    """Whether an object is a mesh in Edit Mode, which hides its faces."""
    return ob.type == "MESH" and bool(ob.data.is_editmode)


def _read_source(ob: bpy.types.Object, parts: Sequence[Part], reader: Reader) -> Source:
    if _is_in_edit_mode(ob):
        raise SceneError(f"'{ob.name}' is in Edit Mode; leave Edit Mode to light it.")
    if ob.type == "VOLUME" and is_ours(ob):
        raise SceneError(
            f"The objects that '{ob.name}' was baked from were deleted; select others."
        )
    if ob.type == "VOLUME":
        return read_volume(ob, reader)
    if smoke.find_domain_settings(ob):
        return read_smoke(ob, reader)
    if not parts:
        return read_volume(ob, reader)
    return _SURFACES[_surface_role(ob, parts)](ob, parts, reader)


def _surface_role(ob: Any, parts: Sequence[Part]) -> str:
    """The role that the user chose, or by default solid with a volume material, else foliage."""
    role: str = ob.lb_lighting.role
    if role != "AUTO":
        return role
    return "SOLID" if any(has_volume(part.material) for part in parts) else "FOLIAGE"
