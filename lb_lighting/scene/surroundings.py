# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands about the lit box, or between it and its lights, and is not selected.

It counts for nothing, so it is named. Boxes around objects have to do: that is quick in scenes of
many objects.
"""

from dataclasses import dataclass

import numpy as np

from ..ours import is_ours
from ..transport.lights.distant import Sun
from ..transport.lights.lamps import AreaLight, PointLight, SpotLight
from .lights.light_nodes import or_else
from .lights.receivers import placed_boxes
from .materials import has_volume, volume_shines
from .nodes.shaders import Shader, may_be_positive
from .remarks import listed
from .rendered import rendered_objects

SURFACES = (
    "Not selected, so they neither shade nor light it: {}; select them too, with the role Occluder."
)
VOLUMES = "Not selected, so these volumes neither shade nor light it: {}; select them too."
NEAR = 1.0  # edges of the lit box, to which distance surfaces count as near
SHINING_NEAR = 4.0  # the same of volumes that shine
SMALL = 0.05  # edges of the lit box, below which an object is not told
_CLEAR = {"BSDF_TRANSPARENT", "BSDF_GLASS", "BSDF_REFRACTION", "EMISSION", "HOLDOUT"}
_TO_LIGHTS = np.stack(np.meshgrid(*[(0.0, 0.5, 1.0)] * 3), axis=-1).reshape(-1, 3)


def tell_surroundings(depsgraph, lights, receivers, notes, skipped=()):
    """Add to `notes` what is near the box of `receivers`, or between that and `lights`.

    skipped  names of objects that are meant to be there
    """
    things = _Things.read(depsgraph, receivers)
    distance, size = things.distances(receivers), receivers.size
    close = distance <= NEAR * size
    told = close | things.between(lights, receivers)
    surfaces, volumes = {}, {}
    for n in np.flatnonzero(told | (distance <= SHINING_NEAR * size)):
        owner, look = things.owners[n], things.look(n)
        if owner.name in skipped or is_ours(owner):
            continue
        if (look.volume and told[n]) or look.shines:
            volumes[owner.name] = max(volumes.get(owner.name, 0), things.sizes[n])
        if look.surface and told[n] and not _is_far_around(owner, n, things, receivers):
            surfaces[owner.name] = max(surfaces.get(owner.name, 0), things.sizes[n])
    for sentence, found in ((SURFACES, surfaces), (VOLUMES, volumes)):
        if found:
            notes.append(sentence.format(listed(sorted(found, key=found.get, reverse=True))))


@dataclass(frozen=True)
class _Look:
    """What of an object light meets: an opaque surface, a volume, one that shines."""

    surface: bool = False
    volume: bool = False
    shines: bool = False


@dataclass
class _Things:
    """Objects that renders show and that are not selected, with the instances that they make.

    owners  [bpy.types.Object], original: themselves, or what instances them
    boxes   (n, 2, 3) m, lower and upper corner
    shown   [bpy.types.Object or `_Look`]: what is there
    seen    (surfaces, volumes) which are lit
    """

    owners: list
    boxes: np.ndarray
    shown: list
    seen: tuple

    @classmethod
    def read(cls, depsgraph, receivers):
        rendered = rendered_objects(depsgraph.view_layer.layer_collection)
        for ob in receivers.objects:
            rendered.pop(ob, None)
        things = cls([], [], [], (receivers.has_surfaces, receivers.has_volumes))
        plain = things._add_plain(depsgraph.scene.objects, rendered)
        things.boxes = np.concatenate([plain, things._add_instances(depsgraph, rendered)])
        return things

    def _add_plain(self, objects, rendered):
        count = len(objects)
        corners, matrices = np.empty((count, 8, 3), np.float32), np.empty((count, 4, 4), np.float32)
        objects.foreach_get("bound_box", corners.ravel())
        objects.foreach_get("matrix_world", matrices.ravel())
        everything = list(objects)
        chosen = [n for n, ob in enumerate(everything) if ob in rendered]
        self.owners += [everything[n] for n in chosen]
        self.shown += [everything[n] for n in chosen]
        corners, matrices = corners[chosen], matrices[chosen].transpose(0, 2, 1)
        return placed_boxes(corners.min(axis=1), corners.max(axis=1), matrices)

    def _add_instances(self, depsgraph, rendered):
        looks, lower, upper, matrices = {}, [], [], []
        for instance in depsgraph.object_instances:
            if not instance.is_instance or not instance.show_self:
                continue
            ob, owner = instance.object, instance.parent.original
            if ob.type not in {"MESH", "VOLUME"} or owner not in rendered or ob.hide_render:
                continue
            key = ob.data.as_pointer()
            if key not in looks:
                corners = np.array(ob.bound_box)
                looks[key] = _look(ob, self.seen), corners.min(axis=0), corners.max(axis=0)
            look, low, high = looks[key]
            self.owners.append(owner)
            self.shown.append(look)
            lower.append(low)
            upper.append(high)
            matrices.append([tuple(row) for row in instance.matrix_world])
        return placed_boxes(*(np.reshape(v, (-1, 3)) for v in (lower, upper)), matrices)

    def look(self, n):
        """The `_Look` of one of them."""
        shown = self.shown[n]
        return shown if isinstance(shown, _Look) else _look(shown, self.seen)

    @property
    def sizes(self):
        """(n,) m, the longest edges of their boxes."""
        return np.max(self.boxes[:, 1] - self.boxes[:, 0], axis=1, initial=0)

    def distances(self, receivers):
        """(n,) m, of their boxes from the lit one; infinite for those too small to be told."""
        gap = np.maximum(self.boxes[:, 0] - receivers.upper, receivers.lower - self.boxes[:, 1])
        distance = np.linalg.norm(np.maximum(gap, 0), axis=1)
        return np.where(self.sizes > SMALL * receivers.size, distance, np.inf)

    def between(self, lights, receivers):
        """(n,) bool: does the box lie between the lit one and a light that has a place, or that
        comes from one direction?"""
        found = np.zeros(len(self.boxes), bool)
        starts = receivers.lower + _TO_LIGHTS * (receivers.upper - receivers.lower)
        for light in lights:
            if isinstance(light, Sun):
                rays = np.tile(-np.asarray(light.direction, float), (len(starts), 1))
                rays *= 1e4 * receivers.size / np.linalg.norm(light.direction)
            elif isinstance(light, (PointLight, SpotLight, AreaLight)):
                place = light.center if isinstance(light, AreaLight) else light.position
                rays = np.asarray(place, float) - starts
            else:
                continue
            ends = starts + rays
            low = np.minimum(receivers.lower, ends.min(axis=0))
            high = np.maximum(receivers.upper, ends.max(axis=0))
            near = np.all((self.boxes[:, 0] < high) & (self.boxes[:, 1] > low), axis=1)
            near &= ~found & (self.sizes > SMALL * receivers.size)
            found[near] = _are_crossed(self.boxes[near], starts, rays)
        return found


def _are_crossed(boxes, starts, rays):
    """(n,) bool: does the border of a box (n, 2, 3) lie on one of rays from starts, (k, 3)?"""
    steps = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    first = (boxes[:, None, 0] - starts) / steps
    last = (boxes[:, None, 1] - starts) / steps
    enters = np.minimum(first, last).max(axis=2)
    leaves = np.maximum(first, last).min(axis=2)
    inside = (enters > 0) & (enters < 1) | (leaves > 0) & (leaves < 1)
    return np.any((enters < leaves) & inside, axis=1)


def _is_far_around(owner, n, things, receivers):
    """Whether the box is around all that is near, and so says little, and no vertex is near."""
    reach = NEAR * receivers.size
    lower, upper = receivers.lower - reach, receivers.upper + reach
    around = np.all(things.boxes[n, 0] < lower) and np.all(things.boxes[n, 1] > upper)
    if not around or isinstance(things.shown[n], _Look):
        return False
    points = np.empty((len(owner.data.vertices), 3), np.float32)
    owner.data.vertices.foreach_get("co", points.ravel())
    matrix = np.array(owner.matrix_world)
    points = points @ matrix[:3, :3].T + matrix[:3, 3]
    return not np.any(np.all((points > lower) & (points < upper), axis=1))


def _look(ob, seen):
    """The `_Look` of an object to light that surfaces or volumes send on.

    seen  (surfaces, volumes): which of them are lit
    """
    if ob.type == "VOLUME":
        return _Look(volume=True, shines=_any(volume_shines, _materials(ob)))
    if ob.type != "MESH" or not (ob.data.polygons or ob.modifiers) or ob.is_holdout:
        return _Look()
    bounces = (ob.visible_diffuse and seen[0]) or (ob.visible_volume_scatter and seen[1])
    if not (ob.visible_shadow or bounces):
        return _Look()
    materials = _materials(ob)
    return _Look(
        not materials or _any(_is_opaque, materials),
        _any(has_volume, materials),
        _any(volume_shines, materials),
    )


def _any(is_so, materials):
    return any(or_else(False, is_so, material) for material in materials)


def _materials(ob):
    materials = [slot.material for slot in ob.material_slots] or list(ob.data.materials)
    return [m if m and m.node_tree else None for m in materials]


def _is_opaque(material):
    """Whether a material has a surface that is more than clear, or that only shines."""
    if material is None:
        return True
    closures = Shader(material).reaching("Surface")
    return any(c.node.type not in _CLEAR and not _is_clear(c) for c in closures)


def _is_clear(closure):
    if closure.node.type != "BSDF_PRINCIPLED":
        return False
    return not may_be_positive(closure, "Alpha")
