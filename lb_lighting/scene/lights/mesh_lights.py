# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that shine, as a few lamps: flat ones exactly, others about as they light the box.

Needs no Blender; emitters.py reads them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Booleans, Floats, Integers
from ...transport.lights.lamps import AreaLight, PointLight
from ..nodes.arithmetic import LUMINANCE

type _Shape = tuple[Floats, Floats, bool]  # two edges of a flat lamp, and if it is an ellipse

MOST = 16  # lamps for all of them together
_LEVEL = 0.3  # length of the mean normal, from which on a flat lamp may stand for a patch
_ALIKE = 1e-3  # of the same, and of depth over width: exactly flat
_FIT = 0.02  # share of its area by which a patch may differ from a rectangle that counts as exact
_GOOD = 0.015  # `fault` of a patch, below which it stays whole
_EDGES = 12  # edges of a patch along which a rectangle is looked for
_THINNEST = 1e-3  # width over length of a lamp
_PIECES = 6  # along the edges of a lamp, for its light in the middle of the box
_PLACES = 40  # in the box, where lamps are held to what they stand for
_CLOSE = 3  # widths of a patch, within which a lamp need not be like it
_SLANTED = 0.05  # what a face that turns from the middle of the box counts at least


@dataclass(frozen=True)
class Emitter:
    """Triangles of one material that shines.

    name       of the object
    triangles  (n, 3, 3) m, world space
    mirrored   (n,) bool: is the front the side from which the corners go clockwise?
    closed     (n,) bool, see `closed_triangles`
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
    names    [str] of the emitter of each
    rough    {name: None} of the emitters that they stand for only about
    dropped  {name: None} of those that are left out
    share    of the light, which is that of those
    """

    lights: list[AreaLight | PointLight]
    names: list[str]
    rough: dict[str, None]
    dropped: dict[str, None]
    share: float


@dataclass(frozen=True)
class _Faces:
    """Sides of triangles that shine: triangles (n, 3, 3), normals (n, 3), areas (n,), radiance
    (n, 3), owners (n,) the number of the emitter."""

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
    """The `Shining` that lights the box from `lower` to `upper`, (3,) m, as `emitters` do.

    most  lamps at most
    """
    faces = _facing(_sides(emitters, lower, upper), lower, upper)
    weights = _weights(faces, lower, upper)
    total = weights.sum()
    if not total > 0:
        return Shining([], [], {}, {}, 0.0)
    # One patch for each emitter, the brightest first; then those that fit worst are divided.
    sums = np.bincount(faces.owners, weights, len(emitters))
    order = [int(k) for k in np.argsort(-sums, kind="stable") if sums[k] > 0]
    patches = [
        _Patch(faces[faces.owners == k], lower, upper, sums[k] / total) for k in order[:most]
    ]
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
    """Faces that one lamp stands for; `share` is that of all light which they send.

    light  the lamp
    exact  whether it is what the faces are, not only about as bright at some places in the box
    fault  share of all light by which it is wrong at these
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
        away = corners - self.center
        middle = away.mean(axis=1)
        # The second moments of a triangle: those of its corners and, nine times, of its middle.
        moments = np.einsum("n,nki,nkj->ij", area, away, away)
        moments += 9 * np.einsum("n,ni,nj->ij", area, middle, middle)
        self.moments = moments / (12 * self.area)
        self.width = np.sqrt(np.trace(self.moments))
        self._choose()

    def _choose(self) -> None:
        shape = self._flat_shape()
        candidates: list[AreaLight | PointLight] = [self._flat_light(shape)] if shape else []
        if self.exact:
            (self.light,), self.fault = candidates, 0.0
            return
        candidates.append(self._point())
        places = self._places()
        wanted = _falling(places, self.faces.centers, self.faces.normals) @ self._sent
        outside = np.any(_gap(self.center, self.lower, self.upper))
        faults = []
        for n, light in enumerate(candidates):
            power = np.broadcast_to(light.power, 3)
            given = np.outer(_falling(places, *_pieces(light)).mean(axis=1), power)
            given /= 4 * np.pi if isinstance(light, PointLight) else np.pi
            if given.sum() > 0 and outside:
                factor = wanted.sum(axis=0) / np.maximum(given.sum(axis=0), 1e-300)
                factor = np.where(given.sum(axis=0) > 0, factor, 0)
                candidates[n] = replace(light, power=spectrum(power * factor))
                given = given * factor
            faults.append(np.abs(given - wanted).sum() / max(wanted.sum(), 1e-300))
        best = int(np.argmin(faults))
        self.light, self.fault = candidates[best], self.share * faults[best]

    @property
    def _sent(self) -> Floats:
        """(n, 3) W/sr straight ahead of each face."""
        return self.faces.areas[:, None] * self.faces.radiance

    def _flat_light(self, shape: _Shape) -> AreaLight:
        u, v, ellipse = shape
        if np.cross(u, v) @ self.normal < 0:
            u, v = v, u
        ahead = np.einsum("nb,ni->bi", self._sent, self.faces.normals)
        power = np.pi * np.linalg.norm(ahead, axis=1)
        center, first, second = (tuple(map(float, vector)) for vector in (self.center, u, v))
        return AreaLight(center, first, second, spectrum(power), ellipse)

    def _point(self) -> PointLight:
        radius = float(np.sqrt(self.area / (4 * np.pi)))
        power = spectrum(np.pi * self._sent.sum(axis=0))
        return PointLight(tuple(map(float, self.center)), power, radius)

    def _flat_shape(self) -> _Shape | None:
        """(u, v, whether it is an ellipse) of a flat lamp like it, or None; sets `exact`."""
        self.exact = False
        if self.flatness < _LEVEL:
            return None
        depth = np.sqrt(max(self.normal @ self.moments @ self.normal, 0)) / self.width
        across = np.eye(3) - np.outer(self.normal, self.normal)
        squares, axes = np.linalg.eigh(across @ self.moments @ across)
        long, short = np.sqrt(np.maximum(squares[:0:-1], 0))
        short = max(short, _THINNEST * long)
        filled = self.area / (12 * long * short)  # 1 for a rectangle, pi/3 for an ellipse
        if 1 - self.flatness < _ALIKE and depth < _ALIKE:
            rectangle = self._rectangle()
            self.exact = rectangle is not None or abs(filled - np.pi / 3) < _FIT
            if rectangle:
                return *rectangle, False
        ellipse = bool(filled > (1 + np.pi / 3) / 2)
        scale = 4 if ellipse else np.sqrt(12)
        return scale * long * axes[:, 2], scale * short * axes[:, 1], ellipse

    def _places(self) -> Floats:
        """(n, 3) m: places in the box, those that are not right at the faces if there are any."""
        middle, half = (self.lower + self.upper) / 2, (self.upper - self.lower) / 2
        places = middle + half * np.random.default_rng(0).uniform(-1, 1, (_PLACES, 3))
        off = np.linalg.norm(places - self.center, axis=1) > _CLOSE * self.width
        return places[off] if off.any() else places

    def _rectangle(self) -> tuple[Floats, Floats] | None:
        """(u, v) of the rectangle that the faces fill, or None."""
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
        """[_Patch] that it is divided into by place and by normal; itself, if that is not to be."""
        faces = self.faces
        features = np.hstack([(faces.centers - self.center) / self.width, faces.normals])
        features -= faces.areas @ features / self.area
        spread = (features * faces.areas[:, None]).T @ features
        upper = features @ np.linalg.eigh(spread)[1][:, -1] > 0
        if upper.all() or not upper.any():
            self.fault = 0.0
            return [self]
        weights = _weights(faces, self.lower, self.upper)
        share = float(weights[upper].sum()) / max(float(weights.sum()), 1e-300)
        return [
            _Patch(faces[half], self.lower, self.upper, self.share * part)
            for half, part in ((upper, share), (~upper, 1 - share))
        ]


def _falling(places: Floats, centers: Floats, normals: Floats | None) -> Floats:
    """(p, n) 1/m^2: the cosine over the squared distance to places (p, 3), of faces (n, 3)."""
    away = places[:, None] - centers
    squares: Floats = np.einsum("pni,pni->pn", away, away)
    if normals is None:
        return 1 / squares
    ahead: Floats = np.maximum(np.einsum("pni,ni->pn", away, normals), 0)
    return ahead / squares**1.5


def _pieces(light: AreaLight | PointLight) -> tuple[Floats, Floats | None]:
    """(centers (n, 3), normals (n, 3) or None) of pieces that a lamp is made of, equal ones."""
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
    """Power (3,) as lights take it: a number where it is grey."""
    return tuple(map(float, power)) if np.ptp(power) > 1e-6 * np.max(power) else float(power[0])


def _sides(emitters: Sequence[Emitter], lower: Floats, upper: Floats) -> _Faces:
    """The `_Faces` of all sides that shine and can be seen; of closed bodies, the outer ones, or
    the inner ones of those around the box."""
    found = []
    for owner, emitter in enumerate(emitters):
        triangles = emitter.triangles
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
        normals[emitter.mirrored] *= -1
        areas = np.linalg.norm(normals, axis=1)
        closed = emitter.closed
        volume = np.einsum("ni,ni->", triangles[closed].mean(axis=1), normals[closed])
        around = _is_around(triangles, lower, upper)
        outer = 1 if (volume > 0) != around else -1
        for side, radiance in ((1, emitter.front), (-1, emitter.back)):
            seen = (areas > 0) & (~closed | (side == outer))
            if not np.any(radiance) or not seen.any():
                continue
            count = int(np.count_nonzero(seen))
            found.append(
                _Faces(
                    triangles[seen],
                    side * normals[seen] / areas[seen, None],
                    areas[seen],
                    np.tile(radiance, (count, 1)),
                    np.full(count, owner),
                )
            )
    if not found:
        none = np.empty((0, 3))
        return _Faces(np.empty((0, 3, 3)), none, np.empty(0), none, np.empty(0, int))
    return _Faces(
        np.concatenate([faces.triangles for faces in found]),
        np.concatenate([faces.normals for faces in found]),
        np.concatenate([faces.areas for faces in found]),
        np.concatenate([faces.radiance for faces in found]),
        np.concatenate([faces.owners for faces in found]),
    )


def _is_around(triangles: Floats, lower: Floats, upper: Floats) -> bool:
    points = triangles.reshape(-1, 3)
    return bool(np.all(points.min(axis=0) < lower) and np.all(points.max(axis=0) > upper))


def _facing(faces: _Faces, lower: Floats, upper: Floats) -> _Faces:
    """Those of `faces` that have some of the box in front of them."""
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    ahead = np.einsum("ni,ni->n", middle - faces.centers, faces.normals)
    return faces[ahead + np.abs(faces.normals) @ half > 1e-6 * np.max(half)]


def _weights(faces: _Faces, lower: Floats, upper: Floats) -> Floats:
    """(n,): about how much each of `faces` lights the box."""
    away = (lower + upper) / 2 - faces.centers
    distance = np.linalg.norm(away, axis=1)
    nearest = np.linalg.norm(upper - lower) / 2
    cosine = np.einsum("ni,ni->n", away, faces.normals) / np.maximum(distance, 1e-12)
    bright = faces.radiance @ LUMINANCE * faces.areas
    weights: Floats = bright * np.maximum(cosine, _SLANTED) / np.maximum(distance, nearest) ** 2
    return weights


def _gap(place: Floats, lower: Floats, upper: Floats) -> Floats:
    """(3,) m, from the box to a place outside of it; 0 inside."""
    return np.asarray(np.maximum(np.maximum(lower - place, place - upper), 0))
