# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of the selected objects are sources, and what each of them is to the light."""

from collections import defaultdict

from ..errors import EmptyError, LightingError, SceneError
from ..ours import is_ours
from . import smoke, volumes
from .materials import has_volume
from .meshes import world_parts
from .remarks import listed
from .sources import SmokeSource, VolumeSource
from .surface_sources import FoliageSource, OccluderSource, SolidSource

SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "EMPTY"}
NAMED = 8  # objects that one note lists by name

_SURFACES = {"FOLIAGE": FoliageSource, "SOLID": SolidSource, "OCCLUDER": OccluderSource}


def open_sources(objects, reader, require=None):
    """The sources among the original `objects`, in their order.

    require  called with each object that is a source; raises a LightingError for one that cannot
             be lit

    Objects that are no source, are hidden or cannot be read are skipped, with a note. Where nothing
    is left, the first that cannot be read is raised, or a SceneError for one of the others.
    """
    if not objects:
        raise SceneError("Nothing is selected; select a volume, a smoke domain or a mesh.")
    hidden = [ob for ob in objects if not ob.visible_get(view_layer=reader.depsgraph.view_layer)]
    shown = [ob for ob in objects if ob not in hidden]
    parts = defaultdict(list)
    for part in world_parts(reader.depsgraph, filter(_is_surface, shown)):
        parts[part.object].append(part)
    sources, neither, failed = [], [], []
    for ob in shown:
        own = parts.get(ob, [])
        if not _is_source(ob, own, reader):
            neither.append(ob)
            continue
        noted = len(reader.notes)
        try:
            if require is not None:
                require(ob)
            sources.append(_open(ob, own, reader))
        except LightingError as error:
            del reader.notes[noted:]
            failed.append((ob, error))
    if not sources:
        _refuse(hidden, neither, failed)
    reader.notes[:0] = [
        *_skipped(neither, "have neither a volume nor faces", "has neither a volume nor faces"),
        *_skipped(hidden, "are hidden", "is hidden"),
        *(f"'{ob.name}' is left out. {error}" for ob, error in failed),
    ]
    return sources


def _refuse(hidden, neither, failed):
    """Raise why no object is a source."""
    if failed:
        raise failed[0][1]
    if neither:
        raise EmptyError(
            f"'{neither[0].name}' has neither a volume nor faces; "
            "select a volume, a smoke domain or a mesh."
        )
    raise EmptyError(f"'{hidden[0].name}' is hidden; show it to light it.")


def _skipped(objects, they, it):
    """[the note that names the skipped `objects`], or none where there are none."""
    if not objects:
        return []
    names = listed([ob.name for ob in objects], NAMED)
    return [f"Skipped, as {f'they {they}' if len(objects) > 1 else f'it {it}'}: {names}."]


def _is_surface(ob):
    return ob.type in SURFACE_TYPES and not smoke.find_domain_settings(ob)


def _is_source(ob, parts, reader):
    """Whether an object has a volume or faces (`parts`)."""
    if ob.type == "VOLUME" or parts or smoke.find_domain_settings(ob) or _is_edited(ob):
        return True
    return volumes.has_volume(ob, reader.depsgraph)


def _is_edited(ob):
    """Whether an object's mesh is in Edit Mode, which hides its faces."""
    return ob.type == "MESH" and ob.data.is_editmode


def _open(ob, parts, reader):
    if _is_edited(ob):
        raise SceneError(f"'{ob.name}' is in Edit Mode; leave it to light the mesh.")
    if ob.type == "VOLUME" and is_ours(ob):
        raise SceneError(f"What '{ob.name}' was baked from is gone; select something else.")
    if ob.type == "VOLUME":
        return VolumeSource(ob, reader)
    if smoke.find_domain_settings(ob):
        return SmokeSource(ob, reader)
    if not parts:
        return VolumeSource(ob, reader)
    return _SURFACES[_surface_role(ob, parts)](ob, parts, reader)


def _surface_role(ob, parts):
    """The role that the user gave, or else solid where a volume fills it, and foliage if not."""
    role = ob.lb_lighting.role
    if role != "AUTO":
        return role
    return "SOLID" if any(has_volume(part.material) for part in parts) else "FOLIAGE"
