# SPDX-License-Identifier: GPL-3.0-or-later
"""Notes the objects that are not selected, but would shade or light the lit box.

A bake leaves them out, so a note names them. Only their bounding boxes are compared, which is quick
in scenes with many objects.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Booleans, Floats
from ..ours import is_ours
from ..transport.lights.distant import Sun
from ..transport.lights.lamps import AreaLight, PointLight, SpotLight
from .lights.light_nodes import or_else
from .lights.receivers import Receivers, placed_boxes
from .materials import has_volume, volume_shines
from .nodes.shaders import Shader, may_be_positive
from .remarks import listed
from .rendered import rendered_objects

if TYPE_CHECKING:
    import bpy

SURFACES = (
    "Not selected, so they neither shade nor light the selection: {}; select them too, with the "
    "role Occluder."
)
VOLUMES = (
    "Not selected, so these volumes neither shade nor light the selection: {}; select them too."
)
NEAR = 1.0  # edges of the lit box: the distance up to which surfaces count as near
SHINING_NEAR = 4.0  # the same for volumes that shine
SMALL = 0.05  # edges of the lit box: smaller objects are not reported
_CLEAR = {"BSDF_TRANSPARENT", "BSDF_GLASS", "BSDF_REFRACTION", "EMISSION", "HOLDOUT"}
_TO_LIGHTS = np.stack(np.meshgrid(*[(0.0, 0.5, 1.0)] * 3), axis=-1).reshape(-1, 3)


def note_surroundings(
    depsgraph: bpy.types.Depsgraph,
    lights: Sequence[object],
    receivers: Receivers,
    notes: list[str],
    skipped: Collection[str] = (),
) -> None:
    """Add to `notes` the objects near the box of `receivers`, or between it and the `lights`.

    skipped  names of objects that belong there
    """
    surroundings = _Surroundings.read(depsgraph, receivers)
    distance, size = surroundings.distances(receivers), receivers.size
    is_in_the_way = (distance <= NEAR * size) | surroundings.between(lights, receivers)
    # Collect the largest box of each object.
    surfaces: dict[str, float] = {}
    volumes: dict[str, float] = {}
    is_near = is_in_the_way | (distance <= SHINING_NEAR * size)
    for n in map(int, np.flatnonzero(is_near)):
        owner, kind = surroundings.owners[n], surroundings.kind(n)
        if owner.name in skipped or is_ours(owner):
            continue
        box_size = surroundings.sizes[n]
        if (kind.volume and is_in_the_way[n]) or kind.shines:
            volumes[owner.name] = max(volumes.get(owner.name, 0), box_size)
        if kind.surface and is_in_the_way[n] and not surroundings.is_far_around(n, receivers):
            surfaces[owner.name] = max(surfaces.get(owner.name, 0), box_size)
    # Name the largest objects first.
    for sentence, sizes in ((SURFACES, surfaces), (VOLUMES, volumes)):
        if sizes:
            notes.append(
                sentence.format(listed(sorted(sizes, key=sizes.__getitem__, reverse=True)))
            )


@dataclass(frozen=True)
class _Kind:
    """What an object is to light: an opaque surface, a volume, a volume that shines."""

    surface: bool = False
    volume: bool = False
    shines: bool = False


@dataclass
class _Surroundings:
    """The objects in renders that are not selected, and their instances.

    owners  [original object]: the object itself, or the object that instances it
    boxes   (n, 2, 3) m, lower and upper corner
    shown   [object or `_Kind`]: the object at this place
    lit     (surfaces, volumes): whether any of them are lit
    """

    owners: list[Any]
    boxes: Floats
    shown: list[Any]
    lit: tuple[bool, bool]

    @classmethod
    def read(cls, depsgraph: bpy.types.Depsgraph, receivers: Receivers) -> _Surroundings:
        scene, layer = depsgraph.scene, depsgraph.view_layer
        assert scene is not None
        assert layer is not None
        rendered = rendered_objects(layer.layer_collection)
        for ob in receivers.objects:
            rendered.pop(ob, None)
        lit = receivers.has_surfaces, receivers.has_volumes
        surroundings = cls([], np.empty((0, 2, 3)), [], lit)
        objects = surroundings._add_objects(scene.objects, rendered)
        instances = surroundings._add_instances(depsgraph, rendered)
        surroundings.boxes = np.concatenate([objects, instances])
        return surroundings

    def _add_objects(self, objects: Any, rendered: Collection[bpy.types.Object]) -> Floats:
        """Add the `rendered` ones of a scene's objects; (n, 2, 3) m, their boxes."""
        count = len(objects)
        corners, matrices = np.empty((count, 8, 3), np.float32), np.empty((count, 4, 4), np.float32)
        objects.foreach_get("bound_box", corners.ravel())
        objects.foreach_get("matrix_world", matrices.ravel())
        chosen = [(n, ob) for n, ob in enumerate(objects) if ob in rendered]
        self.owners += [ob for _n, ob in chosen]
        self.shown += [ob for _n, ob in chosen]
        numbers = [n for n, _ob in chosen]
        corners, matrices = corners[numbers], matrices[numbers].transpose(0, 2, 1)
        boxes: Floats = placed_boxes(corners.min(axis=1), corners.max(axis=1), matrices)
        return boxes

    def _add_instances(
        self, depsgraph: bpy.types.Depsgraph, rendered: Collection[bpy.types.Object]
    ) -> Floats:
        """Add the instances that `rendered` objects make; (n, 2, 3) m, their boxes."""
        kinds: dict[int, tuple[_Kind, Floats, Floats]] = {}
        lower, upper, matrices = [], [], []
        every: Any = depsgraph.object_instances
        for instance in every:
            if not instance.is_instance or not instance.show_self:
                continue
            ob: Any = instance.object
            owner: Any = instance.parent
            owner = owner.original
            if ob.type not in {"MESH", "VOLUME"} or owner not in rendered or ob.hide_render:
                continue
            key = ob.data.as_pointer()
            if key not in kinds:
                box = np.array(ob.bound_box)
                kinds[key] = _kind(ob, self.lit), box.min(axis=0), box.max(axis=0)
            kind, low, high = kinds[key]
            self.owners.append(owner)
            self.shown.append(kind)
            lower.append(low)
            upper.append(high)
            matrices.append([tuple(row) for row in instance.matrix_world])
        corners = np.reshape(lower, (-1, 3)), np.reshape(upper, (-1, 3))
        boxes: Floats = placed_boxes(*corners, matrices)
        return boxes

    def kind(self, n: int) -> _Kind:
        """The `_Kind` of the object with number `n`."""
        shown = self.shown[n]
        return shown if isinstance(shown, _Kind) else _kind(shown, self.lit)

    @property
    def sizes(self) -> Floats:
        """(n,) m, the longest edges of the boxes."""
        longest: Floats = np.max(self.boxes[:, 1] - self.boxes[:, 0], axis=1, initial=0)
        return longest

    def distances(self, receivers: Receivers) -> Floats:
        """(n,) m, from the boxes to the lit box; infinite for objects too small to report."""
        gap = np.maximum(self.boxes[:, 0] - receivers.upper, receivers.lower - self.boxes[:, 1])
        distance = np.linalg.norm(np.maximum(gap, 0), axis=1)
        return np.where(self.sizes > SMALL * receivers.size, distance, np.inf)

    def between(self, lights: Iterable[object], receivers: Receivers) -> Booleans:
        """(n,) bool: whether each box lies between the lit box and a lamp or a sun."""
        is_between = np.zeros(len(self.boxes), bool)
        starts = receivers.lower + _TO_LIGHTS * (receivers.upper - receivers.lower)
        for light in lights:
            # Draw rays from the lit box to the light.
            if isinstance(light, Sun):
                rays = np.tile(-np.asarray(light.direction, float), (len(starts), 1))
                rays *= 1e4 * receivers.size / np.linalg.norm(light.direction)
            elif isinstance(light, (PointLight, SpotLight, AreaLight)):
                place = light.center if isinstance(light, AreaLight) else light.position
                rays = np.asarray(place, float) - starts
            else:
                continue
            # Compare them with the boxes that they may meet.
            ends = starts + rays
            low = np.minimum(receivers.lower, ends.min(axis=0))
            high = np.maximum(receivers.upper, ends.max(axis=0))
            near = np.all((self.boxes[:, 0] < high) & (self.boxes[:, 1] > low), axis=1)
            near &= ~is_between & (self.sizes > SMALL * receivers.size)
            is_between[near] = _are_crossed(self.boxes[near], starts, rays)
        return is_between

    def is_far_around(self, n: int, receivers: Receivers) -> bool:
        """Whether box `n` encloses all that is near, while none of the object's vertices are
        near: then its faces are far away."""
        margin = NEAR * receivers.size
        lower, upper = receivers.lower - margin, receivers.upper + margin
        encloses = np.all(self.boxes[n, 0] < lower) and np.all(self.boxes[n, 1] > upper)
        if not encloses or isinstance(self.shown[n], _Kind):
            return False
        owner = self.owners[n]
        points = np.empty((len(owner.data.vertices), 3), np.float32)
        owner.data.vertices.foreach_get("co", points.ravel())
        matrix = np.array(owner.matrix_world)
        points = points @ matrix[:3, :3].T + matrix[:3, 3]
        return not np.any(np.all((points > lower) & (points < upper), axis=1))


def _are_crossed(boxes: Floats, starts: Floats, rays: Floats) -> Booleans:
    """(n,) bool: whether any of the rays from starts, (k, 3), crosses the surface of each box.

    boxes  (n, 2, 3)
    """
    steps = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    first = (boxes[:, None, 0] - starts) / steps
    last = (boxes[:, None, 1] - starts) / steps
    enters = np.minimum(first, last).max(axis=2)
    leaves = np.maximum(first, last).min(axis=2)
    inside = (enters > 0) & (enters < 1) | (leaves > 0) & (leaves < 1)
    are_crossed: Booleans = np.any((enters < leaves) & inside, axis=1)
    return are_crossed


def _kind(ob: Any, lit: tuple[bool, bool]) -> _Kind:
    """The `_Kind` of an object to light from lit surfaces or volumes.

    lit  (surfaces, volumes): whether any of them are lit
    """
    if ob.type == "VOLUME":
        return _Kind(volume=True, shines=_any(volume_shines, _materials(ob)))
    if ob.type != "MESH" or not (ob.data.polygons or ob.modifiers) or ob.is_holdout:
        return _Kind()
    bounces = (ob.visible_diffuse and lit[0]) or (ob.visible_volume_scatter and lit[1])
    if not (ob.visible_shadow or bounces):
        return _Kind()
    materials = _materials(ob)
    return _Kind(
        not materials or _any(_is_opaque, materials),
        _any(has_volume, materials),
        _any(volume_shines, materials),
    )


def _any(
    is_so: Callable[[bpy.types.Material | None], bool],
    materials: Iterable[bpy.types.Material | None],
) -> bool:
    return any(or_else(False, is_so, material) for material in materials)


def _materials(ob: Any) -> list[bpy.types.Material | None]:
    materials = [slot.material for slot in ob.material_slots] or list(ob.data.materials)
    return [m if m and m.node_tree else None for m in materials]


def _is_opaque(material: bpy.types.Material | None) -> bool:
    """Whether a material has a surface that is not clear and does not only emit light."""
    if material is None:
        return True
    closures = Shader(material).reaching("Surface")
    return any(c.node.type not in _CLEAR and not _is_clear(c) for c in closures)


def _is_clear(closure: Any) -> bool:
    if closure.node.type != "BSDF_PRINCIPLED":
        return False
    return not may_be_positive(closure, "Alpha")
