# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice in NumPy float64: the oracle of its kernels, and the solver where no OpenCL
runtime exists.

It carries scattered light. f_m is the power that flows along direction m from a voxel to the next
one, over the squared edge of a voxel, W/m^2. In a step it flows in, collides over the length l_m
(voxels) between the two centres, and takes up what a source hands to the voxel. The state is the
light after collision; at open faces, less the share that comes back in the next step.
docs/physics.md derives what stands here.
"""

from dataclasses import dataclass
from itertools import product
from math import prod

import numpy as np

from .lattice import DIRECTIONS

MOVING = DIRECTIONS[1:]
"""(18, 3) int, c_m in voxels a step: six along the axes, then twelve diagonals."""

LENGTHS = np.linalg.norm(MOVING, axis=1)
"""(18,) voxels, l_m."""

OPPOSITE = np.array([np.flatnonzero((-c == MOVING).all(axis=1))[0] for c in MOVING])
"""(18,) int, the direction straight back."""


def _weights():
    weights = np.where(LENGTHS == 1, 0.2 / 6, 0.8 / (12 * np.sqrt(2)))
    return weights / weights.sum()


WEIGHTS = _weights()
"""(18,), w_m, the shares of isotropic light. In free flight it fills a voxel over l_m; w_m l_m has
the moments of the sphere up to the fourth in direction."""

MEAN_LENGTH = float(WEIGHTS @ LENGTHS)
SECOND_MOMENT = float(WEIGHTS @ MOVING[:, 0] ** 2)

_EXTRAPOLATED = 2 / 3  # transport mean free paths outside where the fluence would be zero
_OUTWARD = float(WEIGHTS[MOVING[:, 0] > 0].sum())
_SLOPE = 6 * _EXTRAPOLATED * _OUTWARD / MEAN_LENGTH
REFLECTED = (_SLOPE - 1) / (_SLOPE + 1)
"""The share of light that leaves a scattering medium through an open face and comes back
(negative: more is let out), which sets how far outside the fluence extrapolates to zero."""

_OF_AXES = float((WEIGHTS * LENGTHS)[LENGTHS == 1].sum()) / MEAN_LENGTH
CROWDED = (1.5 - _OF_AXES) / (1 - _OF_AXES) * np.sqrt(2) - 2
"""How many more than one of the voxels beside a diagonal light on it meets: so many that with all
directions it enters 3/2 voxels a voxel's edge, as straight lines of all directions do."""

_EMPTY = 1e-2  # transport depth of a domain full of what a voxel holds, if that counts as nothing


@dataclass(frozen=True)
class Source:
    """What is handed to the lattice of one band in every step.

    power      (nx, ny, nz) W/m^2, over the squared edge of a voxel
    drift      (3, nx, ny, nz) W/m^2, power times its mean direction, and times its mean place from
               the voxel's centre in transport mean free paths: either carries light on that far
    reflected  (nx, ny, nz) W/m^2 or None, what opaque voxels send into each voxel besides what the
               lattice brings them
    """

    power: np.ndarray
    drift: np.ndarray
    reflected: np.ndarray | None = None


def rates(depth, albedo, g):
    """(even, odd, absorbed), each (18, nx, ny, nz): the share of each part that a step changes.

    depth  (nx, ny, nz), optical depth of a voxel's edge
    Even parts relax by the second moment of the phase function, odd ones by the first. Empty
    voxels change nothing: there light streams on.
    """
    first, second, loss = (
        _by_direction(depth * (1 - albedo * factor)) for factor in (g, g * g, 1.0)
    )
    with np.errstate(divide="ignore", over="ignore"):
        odd = 1 / (1 / first + 0.5)
        even = 1 / (1 / second + np.minimum(first / 8, 0.5) + 0.5)
        absorbed = 1 / (1 / loss + 0.5)
    return even, odd, absorbed


def returned(depth, albedo, g):
    """(nx, ny, nz), the share of light leaving a voxel through an open face that comes back.

    `REFLECTED` where the domain would be thick if it were filled with what the voxel holds, and
    none where it is empty: what leaves there has scattered elsewhere.
    """
    with np.errstate(divide="ignore", over="ignore"):
        return REFLECTED / (1 + 1 / (max(depth.shape) * depth * (1 - albedo * g)))


def open_faces(depth, albedo, g, occlusion=None):
    """(nx, ny, nz) uint8, the bits of the faces -x, +x, -y, +y, -z, +z of a voxel that are open.

    That is where the medium ends in a plane, as it does at the domain's faces: the nine voxels
    beyond are empty, and what leaves in any of the five directions through it meets nothing more.
    """
    clear = np.zeros(depth.shape) == (0 if occlusion is None else occlusion)
    empty = clear & (max(depth.shape) * depth * (1 - albedo * g) <= _EMPTY)
    free = np.array([_is_free(empty, clear, c) for c in MOVING])
    faces = np.zeros(depth.shape, np.uint8)
    for axis, side in product(range(3), (0, 1)):
        nine, outward = empty, np.zeros(3, int)
        for across in {0, 1, 2} - {axis}:
            step = np.eye(3, dtype=int)[across]
            nine = nine & _at(nine, step, True) & _at(nine, -step, True)
        outward[axis] = 2 * side - 1
        ends = _at(nine, outward, True) & free[MOVING @ outward > 0].all(axis=0)
        faces |= ends.astype(np.uint8) << (2 * axis + side)
    return faces


def through(c):
    """The bits of the faces that light along c leaves a voxel by."""
    return sum(1 << (2 * axis + (c[axis] > 0)) for axis in np.flatnonzero(c))


def _is_free(empty, clear, c):
    """(nx, ny, nz), whether what leaves each voxel along c meets nothing more.

    empty  whether voxels hold nothing
    clear  whether they hold nothing opaque, which is met beside the way, too
    """
    free, reach = _at(empty, c, True), 1
    for part in _parts(c):
        free &= _at(clear, part, True)
    while reach < max(empty.shape):
        free &= _at(free, reach * c, True)
        reach *= 2
    return free


def _parts(c):
    """The steps along axes of which c is the sum."""
    return [c * unit for unit in np.eye(3, dtype=int) if c @ unit]


def _at(values, step, outside):
    """(nx, ny, nz), the values of the voxels that lie a step from each."""
    found = np.full_like(values, outside)
    if np.all(np.abs(step) < values.shape):
        here, there = _overlap(-step, values.shape)
        found[here] = values[there]
    return found


def _by_direction(depth):
    """(18, nx, ny, nz): what lies between two centres."""
    return LENGTHS[:, None, None, None] * depth


class NumpyLattice:
    """The lattice of one band, used just as `physical_opencl.OpenCLLattice`.

    depth             (nx, ny, nz), optical depth of a voxel's edge
    albedo, g         of the band
    occlusion         (nx, ny, nz) or None, the share of arriving light that a voxel stops
    occlusion_albedo  (nx, ny, nz) or a number, the share of that which goes back
    """

    def __init__(self, depth, albedo, g, occlusion=None, occlusion_albedo=0.0):
        self.shape = depth.shape
        depth = np.asarray(depth, float)
        self.even, self.odd, self.absorbed = rates(depth, albedo, g)
        share, opened = returned(depth, albedo, g), open_faces(depth, albedo, g, occlusion)
        self.returned = np.stack([np.where(opened & through(c), share, 0) for c in MOVING])
        # Over the depth of a voxel, which leaves a number in empty ones.
        self.drifted = _by_direction(1.0) / (1 + _by_direction(depth * (1 - albedo * g)) / 2)
        self.lingered = _by_direction(1.0) / (1 + _by_direction(depth * (1 - albedo)) / 2)
        # The weights of isotropic light: what collides, or in empty voxels the length of flight.
        pull = np.where(self.even[0] > 0, self.even, _by_direction(1.0))
        self.pull = pull / np.tensordot(WEIGHTS, pull, axes=1)
        self.occlusion = None if occlusion is None else np.asarray(occlusion, float)
        self.reflecting = None if occlusion is None else self.occlusion * occlusion_albedo

    @staticmethod
    def buffers(shape, occluded):
        """{what: bytes} for a lattice of this shape, float64."""
        voxels = 8 * prod(shape)
        plan = {"light": 18 * voxels, "light that flows in": 18 * voxels, "rates": 6 * 18 * voxels}
        plan |= {"source": 2 * 18 * voxels, "work": 3 * 18 * voxels}
        if occluded:
            plan["occlusion"] = 2 * voxels
        return plan

    def start(self, source):
        """Dark, with a `Source`."""
        weight = WEIGHTS[:, None, None, None]
        self.emitted = weight * LENGTHS[:, None, None, None] / MEAN_LENGTH * source.power
        along = np.tensordot(MOVING, source.drift, axes=1)
        self.drift = weight / SECOND_MOMENT * self.drifted * along
        self.reflected = 0.0 if source.reflected is None else source.reflected
        self.light = np.zeros((18, *self.shape))

    def advance(self, steps):
        """Take so many steps."""
        for _ in range(steps):
            self.light = (1 - self.returned) * self._collided(self._streamed())

    def _streamed(self):
        """(18, nx, ny, nz): what flows into each voxel."""
        f = (self.returned / (1 - self.returned) * self.light)[OPPOSITE]
        for m, c in enumerate(MOVING):
            here, upstream = _overlap(c, self.shape)
            arriving = self.light[m][upstream]
            if self.occlusion is not None:
                arriving = arriving * self._past(c)[here] * (1 - self.occlusion[here])
            f[m][here] += arriving
        return f if self.occlusion is None else f + self._reflected()

    def _reflected(self):
        """(18, nx, ny, nz): what opaque voxels around each voxel send back into it.

        All of it together goes off evenly in all directions away from them: sent straight back,
        light would go to and fro for ever between white walls.
        """
        away = np.zeros_like(self.light)  # share of isotropic light that goes back from there
        for m, c in enumerate(MOVING):
            here, upstream = _overlap(c, self.shape)
            beside = self._beside(self.reflecting, c)[here]
            away[m][here] = beside + self._past(c)[here] * self.reflecting[upstream]
        reflected = self.reflected + np.sum(away[OPPOSITE] * self.light, axis=0)
        away *= WEIGHTS[:, None, None, None]
        total = away.sum(axis=0)
        return away * np.divide(reflected, total, out=np.zeros(self.shape), where=total > 0)

    def _beside(self, share, c):
        """(nx, ny, nz), what is stopped of light to each voxel by the two that a diagonal c leads
        between, of which that share counts; 0 along axes."""
        if np.abs(c).sum() == 1:
            return np.zeros(self.shape)
        occlusion, share = (_mean_beside(values, c) for values in (self.occlusion, share))
        return share * (1 + CROWDED * (1 - occlusion))

    def _past(self, c):
        return 1 - self._beside(self.occlusion, c)

    def _collided(self, f):
        even, odd = (f + f[OPPOSITE]) / 2, (f - f[OPPOSITE]) / 2
        isotropic = self._isotropic(f)
        even -= self.even * (even - isotropic) + self.absorbed * isotropic
        even += self.emitted * (1 - self.absorbed / 2)
        return even + odd * (1 - self.odd) + self.drift

    def _isotropic(self, f):
        """(18, nx, ny, nz): the light spread evenly that collisions lead to."""
        return WEIGHTS[:, None, None, None] * np.sum(self.pull * f, axis=0)

    def fluence(self):
        """(nx, ny, nz) W/m^2; absorption times it is what the steps absorb."""
        passing = self._isotropic(self._streamed()) + self.emitted / 2
        return np.sum(passing * self.lingered, axis=0)

    def flux(self):
        """(3, nx, ny, nz) W/m^2."""
        passing = self._streamed() * (1 - self.odd / 2) + self.drift / 2
        return np.tensordot(MOVING.T.astype(float), passing, axes=1)

    def lost(self):
        """(left (6,), stopped): the light of a step that leaves through the faces -x, +x, -y, +y,
        -z, +z, and that occluders absorb; sums over voxels of W/m^2."""
        left, stopped = np.zeros(6), 0.0
        for m, c in enumerate(MOVING):
            outside = np.ones(self.shape, bool)
            here, upstream = _overlap(c, self.shape)  # light goes from `upstream` to `here`
            outside[upstream] = False
            for axis in np.flatnonzero(c):  # a diagonal leaves through the first face of the two
                face = np.zeros(self.shape, bool)
                face[(slice(None),) * axis + (-1 if c[axis] > 0 else 0,)] = True
                left[2 * axis + (c[axis] > 0)] += self.light[m][face & outside].sum()
                outside &= ~face
            if self.occlusion is not None:
                kept = self.occlusion - self.reflecting
                kept = self._beside(kept, c)[here] + self._past(c)[here] * kept[here]
                stopped += np.sum(kept * self.light[m][upstream])
        return left, stopped


def _mean_beside(values, c):
    return sum(_at(values, -part, 0) / 2 for part in _parts(c))


def _overlap(c, shape):
    """(here, upstream): the slices of the voxels that light along c reaches from another voxel,
    and of those that it comes from."""
    sizes = list(zip(c, shape, strict=True))
    here = tuple(slice(max(d, 0), n + min(d, 0)) for d, n in sizes)
    return here, tuple(slice(max(-d, 0), n - max(d, 0)) for d, n in sizes)
