# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice in NumPy float64: the twin of kernels/lattice.

It carries scattered light. f_m is the power that flows along direction m from a voxel to its
neighbour, divided by the squared edge of a voxel, W/m^2. In a step the light that has arrived
collides over the length l_m (voxels) between two centres, receives the source, and streams on. The
state is the light that has arrived. docs/theory/physics.md derives the equations; `Cells` describes
the layout.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import Array, Floats, Integers
from ..medium import repeated
from .boundary import reflection
from .layout import (
    LENGTHS,
    MEAN_LENGTH,
    MOVING,
    OPPOSITE,
    SECOND_MOMENT,
    THROUGH,
    WEIGHTS,
    Cells,
    parts,
)

_OF_AXES = float((WEIGHTS * LENGTHS)[LENGTHS == 1].sum()) / MEAN_LENGTH
DIAGONAL_BLOCKING = (1.5 - _OF_AXES) / (1 - _OF_AXES) * np.sqrt(2) - 2
"""Light on a diagonal meets this many voxels beside it, plus 1. With this value, light of all
directions enters 3/2 voxels for each voxel's edge, as straight lines of all directions do."""


@dataclass(frozen=True)
class Source:
    """The source of one band, added in every step.

    power      (nx, ny, nz) W/m^2, divided by the squared edge of a voxel
    drift      (3, nx, ny, nz) W/m^2: power times its mean direction, plus power times its mean
               place from the voxel's centre in transport mean free paths; both carry light
               equally far
    reflected  (nx, ny, nz) W/m^2 or None: uncollided light that opaque voxels reflect into each
    """

    power: Floats
    drift: Floats
    reflected: Floats | None = None


def rates(depth: Floats, albedo: float, g: float) -> tuple[Floats, Floats, Floats]:
    """(even, odd, absorbed), each (18, ...): the relaxation rates of a step.

    depth  (...), optical depth of a voxel's edge
    Even parts relax by the second moment of the phase function, odd parts by the first. All rates
    of empty voxels are 0: light streams on.
    """
    first, second, loss = (
        _by_direction(depth * (1 - albedo * factor)) for factor in (g, g * g, 1.0)
    )
    with np.errstate(divide="ignore", over="ignore"):
        odd = 1 / (1 / first + 0.5)
        even = 1 / (1 / second + np.minimum(first / 8, 0.5) + 0.5)
        absorbed = 1 / (1 / loss + 0.5)
    return even, odd, absorbed


def _by_direction(depth: Floats | float) -> Floats:
    """(18, ...): the optical depth between two centres, by direction."""
    return np.multiply.outer(LENGTHS, depth)


class NumpyLattice:
    """The lattice of one band; `lattice_opencl.OpenclLattice` takes the same calls.

    depth             (nx, ny, nz), optical depth of a voxel's edge
    albedo, g         of the band
    occlusion         (nx, ny, nz) or None: the share of arriving light that a voxel stops
    occlusion_albedo  (nx, ny, nz) or a number: the share of that which it reflects
    edge              voxels, the longest edge of the domain; None if the lattice covers all of it
    """

    def __init__(
        self,
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Any = 0.0,
        edge: float | None = None,
    ) -> None:
        self.shape, self.cells = depth.shape, Cells(depth.shape)
        self.steps = self.cells.steps
        depth = np.asarray(depth, float)
        self.outside, self.within = reflection(depth, albedo, g, occlusion, self.cells, edge)
        self.inside = self.cells.is_inside()
        self.occluders = None
        if occlusion is not None:
            self.occluders = _Occluders(self.cells, occlusion, occlusion_albedo)
        depth = self.cells.flat(depth)
        self.even, self.odd, self.absorbed = rates(depth, albedo, g)
        self.transport_depth = depth * (1 - albedo * g)
        # Divided by the depth of a voxel, to be finite in empty ones.
        self.drifted = _by_direction(1.0)[:, None] / (1 + _by_direction(self.transport_depth) / 2)
        self.lingered = _by_direction(1.0)[:, None] / (1 + _by_direction(depth * (1 - albedo)) / 2)
        # The weights of isotropic light: the rate of collisions, or the length in empty voxels.
        pull = np.where(self.even[0] > 0, self.even, LENGTHS[:, None])
        self.pull = pull / (WEIGHTS @ pull)

    @staticmethod
    def buffers(shape: Sequence[int], occluded: bool) -> dict[str, int]:
        """{name: bytes} of a lattice of this shape and all coarser ones, float64."""
        directions = 18 * 8 * Cells(shape).count
        plan = {"light": directions, "light that flows on": directions, "rates": 6 * directions}
        plan |= {"source": 3 * directions, "work": 3 * directions}
        if occluded:
            plan["occluders"] = 4 * directions
        plan["coarser lattices"] = sum(plan.values()) // 7  # an eighth, an eighth of that, ...
        return plan

    def start(self, source: Source) -> None:
        """Start from darkness, with a `Source`."""
        power = self.cells.flat(source.power)
        self.emitted = np.multiply.outer(WEIGHTS * LENGTHS / MEAN_LENGTH, power)
        self.drift = self._drift(self.cells.flat(source.drift))
        self.given = self.emitted * (1 - self.absorbed / 2) + self.drift
        self._start_dark(source.reflected)

    def start_as_coarser(self) -> None:
        """Start from darkness, with the source that finer lattices `restrict`."""
        self.given = np.zeros((18, self.cells.count))
        self._start_dark(None)

    def _start_dark(self, reflected: Floats | None) -> None:
        if self.occluders is not None:
            self.occluders.start(reflected)
        self.light: Floats = np.zeros((18, self.cells.count))

    def _drift(self, drift: Floats) -> Floats:
        """(18, count) of (3, count)."""
        return WEIGHTS[:, None] / SECOND_MOMENT * self.drifted * (MOVING @ drift)

    def advance(self, steps: int) -> None:
        """Take a number of steps."""
        for _ in range(steps):
            self.light = self._streamed(self._collided(self.light))

    def _collided(self, f: Floats) -> Floats:
        """(18, count): the light after collisions and reflection, from light that has arrived."""
        even, odd = (f + f[OPPOSITE]) / 2, (f - f[OPPOSITE]) / 2
        isotropic = self._isotropic(f)
        even -= self.even * (even - isotropic) + self.absorbed * isotropic
        out = even + odd * (1 - self.odd) + self.given
        out = np.where(self.inside, out, self.outside * f[OPPOSITE])
        for face, (at, share) in self.within.items():
            for m in THROUGH[face]:
                back = share * out[m, at]
                out[m, at] -= back
                out[OPPOSITE[m], at] += back
        return out

    def _streamed(self, out: Floats) -> Floats:
        """(18, count): the light that arrives, from light after collisions."""
        arrived = np.array([np.roll(f, step) for f, step in zip(out, self.steps, strict=True)])
        return arrived if self.occluders is None else self.occluders.met(arrived)

    def restrict(self, coarser: "NumpyLattice", factor: float) -> None:
        """Add a factor times the light that streamed last to a coarser lattice's source.

        The odd part carries light by 1 / s + 1 / 2 voxels, where s is a voxel's transport depth,
        before it relaxes; the restriction preserves this distance.
        """
        sent = [np.roll(f, -step) for f, step in zip(self.light, self.steps, strict=True)]
        out = self.cells.inside(np.array(sent))
        even, odd = (out + out[OPPOSITE]) / 2, (out - out[OPPOSITE]) / 2
        power = out.sum(axis=0)
        place = np.array([power * (n % 2 - 0.5) for n in np.indices(self.shape)]) / 2
        even, odd, place = map(sum_of_eight, (even, odd * self._flow(), place))
        cells = coarser.cells
        drift = coarser._drift(cells.flat(place / 4) * coarser.transport_depth)
        given = (even + odd / coarser._flow()) / 4 + cells.inside(drift)
        cells.inside(coarser.given)[...] += factor * given

    def prolongate(self, coarser: "NumpyLattice", factor: float) -> None:
        """Add a factor times the light of a coarser lattice, interpolated."""
        light = coarser.cells.inside(coarser.light)
        even, odd = (light + light[OPPOSITE]) / 2, (light - light[OPPOSITE]) / 2
        even, odd = (interpolate(part, self.shape) for part in (even, odd))
        # Scale by the flow of the coarse voxel around each: its neighbours may be far thinner.
        part = tuple(map(slice, self.shape))  # there is nothing beyond an odd edge
        odd *= self._flow() / repeated(coarser._flow(), 2)[:, *part]
        self.cells.inside(self.light)[...] += factor * (even + odd)

    def _flow(self) -> Floats:
        """(18, nx, ny, nz): the odd part, relative to that of the light that crosses a voxel."""
        return 1 + _by_direction(self.cells.inside(self.transport_depth)) / 2

    def _isotropic(self, f: Floats) -> Floats:
        """(18, count): the isotropic light that collisions relax to."""
        return np.multiply.outer(WEIGHTS, np.sum(self.pull * f, axis=0))

    def fluence(self, every: int = 1) -> Floats:
        """(nx, ny, nz) W/m^2, of every n-th layer along x. Times the absorption depth, it is the
        power that the steps absorb."""
        passing = self._isotropic(self.light) + self.emitted / 2
        return self.cells.inside(np.sum(passing * self.lingered, axis=0))[::every]

    def flux(self) -> Floats:
        """(3, nx, ny, nz) W/m^2."""
        passing = self.light * (1 - self.odd / 2) + self.drift / 2
        return self.cells.inside(MOVING.T.astype(float) @ passing)

    def leaving(self) -> Iterator[Floats]:
        """Yield for each direction (nx, ny, nz) W/m^2: the light that streamed in the last step, by
        the voxel that it left. Light that leaves the domain excludes the reflected part."""
        for light, step in zip(self.light, self.steps, strict=True):
            yield self.cells.inside(np.roll((1 - self.outside) * light, -step))

    def lost(self) -> tuple[Floats, float]:
        """(left (6,), stopped): the light of a step that leaves through the faces -x, +x, -y, +y,
        -z, +z, and the light that occluders absorb; sums over voxels of W/m^2."""
        left = np.zeros(6)
        for c, gone in zip(MOVING, self.leaving(), strict=True):
            for axis in np.flatnonzero(c):  # a diagonal leaves through the first of its two faces
                border = (slice(None),) * axis + (-1 if c[axis] > 0 else 0,)
                left[2 * axis + (c[axis] > 0)] += gone[border].sum()
                gone[border] = 0
        return left, 0.0 if self.occluders is None else self.occluders.stopped


def sum_of_eight(values: Array) -> Array:
    """(..., nx/2, ny/2, nz/2), rounded up: the sums of eight voxels each."""
    for axis in (-3, -2, -1):
        values = np.add.reduceat(values, range(0, values.shape[axis], 2), axis)
    return values


def interpolate(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Values at the centres of voxels, interpolated between voxels of twice the edge."""
    for axis, n in zip((-3, -2, -1), shape, strict=True):
        here = np.arange(n)
        near = here // 2
        far = np.clip(near + here % 2 * 2 - 1, 0, values.shape[axis] - 1)
        values = 0.75 * values.take(near, axis) + 0.25 * values.take(far, axis)
    return values


class _Occluders:
    """Opaque voxels, which stop and reflect light on its way from cell to cell.

    Row m of the arrays (18, count) is for light that arrives at a cell along m. Light on its way
    out of the domain is not stopped, and neither is light that the domain's faces reflect.

    passed    the share that arrives
    back      the share that is reflected
    stopped   W/m^2 that they absorbed in the last step, summed over voxels
    """

    def __init__(self, cells: Cells, occlusion: Floats, albedo: Any) -> None:
        self.cells, self.steps = cells, cells.steps
        occlusion = np.asarray(occlusion, float)
        inside, opaque = cells.is_inside(), cells.flat(occlusion)
        reflecting = cells.flat(occlusion * albedo)
        self.passed, self.back = np.ones((18, cells.count)), np.zeros((18, cells.count))
        for m, (c, step) in enumerate(zip(MOVING, self.steps, strict=True)):
            between = inside & np.roll(inside, step)
            stopped, beside = self._beside(opaque, reflecting, c)
            self.passed[m] = np.where(between, (1 - stopped) * (1 - opaque), 1)
            self.back[m] = np.where(between, beside + (1 - stopped) * reflecting, 0)
        # The reflected share of light that left a cell along m, at that cell.
        self.sent_back = np.array(
            [np.roll(back, -step) for back, step in zip(self.back, self.steps, strict=True)]
        )
        self.returning = WEIGHTS @ self.sent_back
        self.stopped = 0.0

    def _beside(self, opaque: Floats, reflecting: Floats, c: Integers) -> Floats:
        """(2, count): the shares that the two voxels beside a diagonal towards each cell stop and
        reflect; 0 along axes."""
        if np.abs(c).sum() == 1:
            return np.zeros((2, self.cells.count))
        steps = parts(c) @ (self.cells.plane, self.cells.row, 1)
        means: list[Any] = [
            sum(np.roll(values, step) / 2 for step in steps) for values in (opaque, reflecting)
        ]
        return np.multiply(means, 1 + DIAGONAL_BLOCKING * (1 - means[0]))

    def start(self, reflected: Floats | None) -> None:
        """Start with the reflected light of a `Source`."""
        dark = np.zeros(self.cells.shape)
        self.reflected = self.cells.flat(dark if reflected is None else reflected)

    def met(self, arriving: Floats) -> Floats:
        """(18, count): the light that arrives, from the light that would arrive without occluders.

        Light that occluders reflect into a cell leaves it evenly in all directions away from them.
        Reflected straight back, it would oscillate forever between white walls.
        """
        self.stopped = float(np.sum((1 - self.passed - self.back) * arriving))
        sent = [np.roll(f, -step) for f, step in zip(arriving, self.steps, strict=True)]
        returning = self.reflected + np.sum(self.sent_back * sent, axis=0)
        density = np.divide(
            returning, self.returning, out=np.zeros(self.cells.count), where=self.returning > 0
        )
        return self.passed * arriving + WEIGHTS[:, None] * self.sent_back[OPPOSITE] * density
