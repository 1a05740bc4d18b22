# SPDX-License-Identifier: GPL-3.0-or-later
"""A few lamps that stand for emissive meshes: flat meshes exactly, others approximately.

Needs no Blender; emitters.py reads the meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Booleans, Floats, Integers
from ...transport.lights.lamps import AreaLight, PointLight
from ..nodes.arithmetic import LUMINANCE

type _Shape = tuple[Floats, Floats, bool]  # edges u and v (3,) m, and whether it is an ellipse

MOST = 16  # lamps for all emitters of a scene
_LEVEL = 0.3  # smallest length of the mean normal for a flat lamp
_EXACTLY_FLAT = 1e-3  # largest deviation from 1 of that length, and depth over width
_FIT = 0.02  # largest relative difference of area from a rectangle or ellipse that is exact
_GOOD = 0.015  # `fault` of a patch up to which it is not divided
_EDGES = 12  # longest edges of a patch to try as sides of a rectangle
_THINNEST = 1e-3  # width over length of a lamp
_PIECES = 6  # along each edge of an area lamp, to compute its light in the box
_PLACES = 40  # in the box, where lamps are compared with patches
_CLOSE = 3  # widths of a patch within which they are not compared
_SLANTED = 0.05  # smallest cosine to count for a face that is turned away from the box's centre


@dataclass(frozen=True)
class Emitter:
    """Triangles of one emissive material.

    name         of the object
    triangles    (n, 3, 3) m, world space
    mirrored     (n,) bool: whether the corners run clockwise as seen from the front
    closed       (n,) bool, see `closed_triangles`
    front, back  (3,) W/(m^2 sr), the radiance of the sides
    """

    name: str
    triangles: Floats
    mirrored: Booleans
    closed: Booleans
    front: Floats
    back: Floats


@dataclass(frozen=True)
class Shining:
    """Lamps that stand for emitters.

    lights   [AreaLight | PointLight]
    names    [str], the emitter of each light
    rough    {name: None} of the emitters that are approximated
    dropped  {name: None} of the emitters that are left out
    share    of all light that is left out
    """

    lights: list[AreaLight | PointLight]
    names: list[str]
    rough: dict[str, None]
    dropped: dict[str, None]
    share: float


@dataclass(frozen=True)
class _Faces:
    """Emissive sides of triangles.

    triangles  (n, 3, 3) m
    normals    (n, 3), unit vectors on the emissive side
    areas      (n,) m^2
    radiance   (n, 3) W/(m^2 sr)
    owners     (n,), the index of the emitter of each
    """

    triangles: Floats
    normals: Floats
    areas: Floats
    radiance: Floats
    owners: Integers

    def __getitem__(self, chosen: Booleans) -> _Faces:
        return _Faces(
            self.triangles[chosen],
            self.normals[chosen],
            self.areas[chosen],
            self.radiance[chosen],
            self.owners[chosen],
        )

    def __len__(self) -> int:
        return len(self.areas)

    @property
    def centers(self) -> Floats:
        return np.mean(self.triangles, axis=1)


def lamps_of(
    emitters: Sequence[Emitter], lower: Floats, upper: Floats, most: int = MOST
) -> Shining:
    """The lamps that light the box from `lower` to `upper`, (3,) m, as `emitters` do.

    most  the largest number of lamps
    """
    faces = _facing(_sides(emitters, lower, upper), lower, upper)
    weights = _weights(faces, lower, upper)
    total = weights.sum()
    if not total > 0:
        return Shining([], [], {}, {}, 0.0)
    # Make one patch for each emitter, the brightest first.
    sums = np.bincount(faces.owners, weights, len(emitters))
    order = [int(k) for k in np.argsort(-sums, kind="stable") if sums[k] > 0]
    patches = [
        _Patch(faces[faces.owners == k], lower, upper, sums[k] / total) for k in order[:most]
    ]
    # Divide the patches with the largest faults.
    while len(patches) < most:
        worst = max(patches, key=lambda patch: patch.fault)
        halves = worst.halves() if worst.fault > _GOOD else []
        if not halves:
            break
        patches.remove(worst)
        patches += halves
    return Shining(
        [patch.light for patch in patches],
        [emitters[patch.owner].name for patch in patches],
        {emitters[patch.owner].name: None for patch in patches if not patch.exact},
        {emitters[k].name: None for k in order[most:]},
        float(sums[order[most:]].sum() / total),
    )


class _Patch:
    """Faces that one lamp stands for.

    share  of all light that the faces emit
    light  the lamp
    exact  whether the lamp has the shape of the faces, and does not only approximate their light
    fault  share of all light by which the lamp differs from the faces in the box
    """

    light: AreaLight | PointLight
    exact: bool
    fault: float

    def __init__(self, faces: _Faces, lower: Floats, upper: Floats, share: float) -> None:
        self.faces, self.lower, self.upper, self.share = faces, lower, upper, share
        self.owner = faces.owners[0]
        area, corners = faces.areas, faces.triangles
        self.area = area.sum()
        self.center = area @ faces.centers / self.area
        normal = area @ faces.normals / self.area
        self.flatness = np.linalg.norm(normal)
        self.normal = normal / max(self.flatness, 1e-12)
        offsets = corners - self.center
        middle = offsets.mean(axis=1)
        # The second moment of a triangle sums its corners, and nine times its centre.
        moments = np.einsum("n,nki,nkj->ij", area, offsets, offsets)
        moments += 9 * np.einsum("n,ni,nj->ij", area, middle, middle)
        self.moments = moments / (12 * self.area)
        self.width = np.sqrt(np.trace(self.moments))
        self._choose()

    def _choose(self) -> None:
        """Set `light`, `exact` and `fault`: take a flat lamp or a point, the one that fits best."""
        shape = self._flat_shape()
        candidates: list[AreaLight | PointLight] = [self._flat_light(shape)] if shape else []
        if self.exact:
            (self.light,), self.fault = candidates, 0.0
            return
        candidates.append(self._point())
        # Compute the light of the faces in the box.
        places = self._places()
        target = _geometry_terms(places, self.faces.centers, self.faces.normals) @ self._intensity
        is_outside = np.any(_gap(self.center, self.lower, self.upper))
        # Compare it with that of each lamp. From outside the box, first match the mean.
        faults = []
        for n, light in enumerate(candidates):
            power = np.broadcast_to(light.power, 3)
            result = np.outer(_geometry_terms(places, *_pieces(light)).mean(axis=1), power)
            result /= 4 * np.pi if isinstance(light, PointLight) else np.pi
            if result.sum() > 0 and is_outside:
                factor = target.sum(axis=0) / np.maximum(result.sum(axis=0), 1e-300)
                factor = np.where(result.sum(axis=0) > 0, factor, 0)
                candidates[n] = replace(light, power=spectrum(power * factor))
                result = result * factor
            faults.append(np.abs(result - target).sum() / max(target.sum(), 1e-300))
        best = int(np.argmin(faults))
        self.light, self.fault = candidates[best], self.share * faults[best]

    @property
    def _intensity(self) -> Floats:
        """(n, 3) W/sr of each face along its normal."""
        return self.faces.areas[:, None] * self.faces.radiance

    def _flat_light(self, shape: _Shape) -> AreaLight:
        """A lamp of that shape, as bright along its normal as the faces."""
        u, v, ellipse = shape
        if np.cross(u, v) @ self.normal < 0:
            u, v = v, u
        ahead = np.einsum("nb,ni->bi", self._intensity, self.faces.normals)
        power = np.pi * np.linalg.norm(ahead, axis=1)
        center, first, second = (tuple(map(float, vector)) for vector in (self.center, u, v))
        return AreaLight(center, first, second, spectrum(power), ellipse)

    def _point(self) -> PointLight:
        """A sphere with the area and the power of the faces."""
        radius = float(np.sqrt(self.area / (4 * np.pi)))
        power = spectrum(np.pi * self._intensity.sum(axis=0))
        return PointLight(tuple(map(float, self.center)), power, radius)

    def _flat_shape(self) -> _Shape | None:
        """The shape of a flat lamp for the patch, or None if it is not flat; sets `exact`."""
        self.exact = False
        if self.flatness < _LEVEL:
            return None
        # Measure the patch along its normal and along its axes.
        depth = np.sqrt(max(self.normal @ self.moments @ self.normal, 0)) / self.width
        in_plane = np.eye(3) - np.outer(self.normal, self.normal)
        squares, axes = np.linalg.eigh(in_plane @ self.moments @ in_plane)
        long, short = np.sqrt(np.maximum(squares[:0:-1], 0))
        short = max(short, _THINNEST * long)
        filled = self.area / (12 * long * short)  # 1 for a rectangle, pi/3 for an ellipse
        # Take an exact shape if there is one, or else an ellipse or a rectangle of that size.
        if 1 - self.flatness < _EXACTLY_FLAT and depth < _EXACTLY_FLAT:
            rectangle = self._rectangle()
            self.exact = rectangle is not None or abs(filled - np.pi / 3) < _FIT
            if rectangle:
                return *rectangle, False
        ellipse = bool(filled > (1 + np.pi / 3) / 2)
        scale = 4 if ellipse else np.sqrt(12)
        return scale * long * axes[:, 2], scale * short * axes[:, 1], ellipse

    def _places(self) -> Floats:
        """(n, 3) m: places in the box; those close to the faces are left out, unless all are."""
        middle, half = (self.lower + self.upper) / 2, (self.upper - self.lower) / 2
        places = middle + half * np.random.default_rng(0).uniform(-1, 1, (_PLACES, 3))
        is_far = np.linalg.norm(places - self.center, axis=1) > _CLOSE * self.width
        return places[is_far] if is_far.any() else places

    def _rectangle(self) -> tuple[Floats, Floats] | None:
        """(u, v) of the rectangle that the faces fill, or None; moves `center` to its centre."""
        corners = self.faces.triangles
        edges = (np.roll(corners, -1, axis=1) - corners).reshape(-1, 3)
        lengths = np.linalg.norm(edges, axis=1)
        rectangles: list[tuple[float, Floats, Floats, Floats, Floats]] = []
        for edge in edges[np.argsort(-lengths)[:_EDGES]]:
            u = edge / np.linalg.norm(edge)
            v = np.cross(self.normal, u)
            places = (corners.reshape(-1, 3) - self.center) @ np.stack([u, v], axis=1)
            size = np.ptp(places, axis=0)
            rectangles.append((float(np.prod(size)), size, u, v, places.min(axis=0) + size / 2))
        area, size, u, v, middle = min(rectangles, key=lambda rectangle: rectangle[0])
        if abs(area / self.area - 1) > _FIT:
            return None
        self.center = self.center + middle[0] * u + middle[1] * v
        return size[0] * u, size[1] * v

    def halves(self) -> list[_Patch]:
        """[_Patch]: the patch divided by position and normal, or itself if it cannot be."""
        # Cut at the mean across the longest axis of positions and normals.
        faces = self.faces
        features = np.hstack([(faces.centers - self.center) / self.width, faces.normals])
        features -= faces.areas @ features / self.area
        covariance = (features * faces.areas[:, None]).T @ features
        upper = features @ np.linalg.eigh(covariance)[1][:, -1] > 0
        if upper.all() or not upper.any():
            self.fault = 0.0
            return [self]
        # Share the light between the halves.
        weights = _weights(faces, self.lower, self.upper)
        share = float(weights[upper].sum()) / max(float(weights.sum()), 1e-300)
        return [
            _Patch(faces[half], self.lower, self.upper, self.share * part)
            for half, part in ((upper, share), (~upper, 1 - share))
        ]


def _geometry_terms(places: Floats, centers: Floats, normals: Floats | None) -> Floats:
    """(p, n) 1/m^2: cosine over squared distance from faces (n, 3) to places (p, 3).

    normals  (n, 3), or None for points, with a cosine of 1
    """
    offsets = places[:, None] - centers
    squares: Floats = np.einsum("pni,pni->pn", offsets, offsets)
    if normals is None:
        return 1 / squares
    ahead: Floats = np.maximum(np.einsum("pni,ni->pn", offsets, normals), 0)
    return ahead / squares**1.5


def _pieces(light: AreaLight | PointLight) -> tuple[Floats, Floats | None]:
    """(centers (n, 3), normals (n, 3) or None for a point) of equal pieces of a lamp."""
    if isinstance(light, PointLight):
        return np.array([light.position]), None
    x, y = (np.indices((_PIECES, _PIECES)).reshape(2, -1) + 0.5) / _PIECES
    if light.ellipse:
        radius, turn = np.sqrt(x) / 2, 2 * np.pi * y
        x, y = radius * np.cos(turn), radius * np.sin(turn)
    else:
        x, y = x - 0.5, y - 0.5
    places = np.outer(x, light.u) + np.outer(y, light.v) + light.center
    normal = np.cross(light.u, light.v)
    return places, np.tile(normal / np.linalg.norm(normal), (len(places), 1))


def spectrum(power: Floats) -> float | tuple[float, ...]:
    """The power (3,) as lights take it, one number if it is grey."""
    return tuple(map(float, power)) if np.ptp(power) > 1e-6 * np.max(power) else float(power[0])


def _sides(emitters: Sequence[Emitter], lower: Floats, upper: Floats) -> _Faces:
    """The emissive sides of all triangles.

    Closed bodies have only their outer sides, or only their inner ones if they surround the box.
    """
    parts = []
    for owner, emitter in enumerate(emitters):
        triangles = emitter.triangles
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
        normals[emitter.mirrored] *= -1
        areas = np.linalg.norm(normals, axis=1)
        closed = emitter.closed
        # Find out whether normals point outwards: the volume of a closed body is positive then.
        volume = np.einsum("ni,ni->", triangles[closed].mean(axis=1), normals[closed])
        around = _is_around(triangles, lower, upper)
        outer = 1 if (volume > 0) != around else -1
        for side, radiance in ((1, emitter.front), (-1, emitter.back)):
            visible = (areas > 0) & (~closed | (side == outer))
            if not np.any(radiance) or not visible.any():
                continue
            count = int(np.count_nonzero(visible))
            parts.append(
                _Faces(
                    triangles[visible],
                    side * normals[visible] / areas[visible, None],
                    areas[visible],
                    np.tile(radiance, (count, 1)),
                    np.full(count, owner),
                )
            )
    if not parts:
        none = np.empty((0, 3))
        return _Faces(np.empty((0, 3, 3)), none, np.empty(0), none, np.empty(0, int))
    return _Faces(
        np.concatenate([faces.triangles for faces in parts]),
        np.concatenate([faces.normals for faces in parts]),
        np.concatenate([faces.areas for faces in parts]),
        np.concatenate([faces.radiance for faces in parts]),
        np.concatenate([faces.owners for faces in parts]),
    )


def _is_around(triangles: Floats, lower: Floats, upper: Floats) -> bool:
    points = triangles.reshape(-1, 3)
    return bool(np.all(points.min(axis=0) < lower) and np.all(points.max(axis=0) > upper))


def _facing(faces: _Faces, lower: Floats, upper: Floats) -> _Faces:
    """Those of `faces` that have a part of the box in front of them."""
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    ahead = np.einsum("ni,ni->n", middle - faces.centers, faces.normals)
    return faces[ahead + np.abs(faces.normals) @ half > 1e-6 * np.max(half)]


def _weights(faces: _Faces, lower: Floats, upper: Floats) -> Floats:
    """(n,): roughly how much each of `faces` lights the box."""
    offsets = (lower + upper) / 2 - faces.centers
    distance = np.linalg.norm(offsets, axis=1)
    nearest = np.linalg.norm(upper - lower) / 2
    cosine = np.einsum("ni,ni->n", offsets, faces.normals) / np.maximum(distance, 1e-12)
    bright = faces.radiance @ LUMINANCE * faces.areas
    weights: Floats = bright * np.maximum(cosine, _SLANTED) / np.maximum(distance, nearest) ** 2
    return weights


def _gap(place: Floats, lower: Floats, upper: Floats) -> Floats:
    """(3,) m, the distance along each axis from the box to a place; 0 inside."""
    return np.asarray(np.maximum(np.maximum(lower - place, place - upper), 0))
