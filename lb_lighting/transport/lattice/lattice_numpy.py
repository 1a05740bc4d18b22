# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical lattice in NumPy float64: the oracle of its kernels, and the solver where no OpenCL
runtime exists.

It carries scattered light. f_m is the power that flows along direction m from a voxel to the next
one, over the squared edge of a voxel, W/m^2. In a step what has arrived collides over the length
l_m (voxels) between two centres, takes up what a source hands to the voxel, and flows on. The state
is the light that has arrived. docs/theory/physics.md derives what stands here; `Cells` says where
it lies.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, Floats, Integers
from ..medium import repeated
from .boundary import boundary_reflection
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
"""The number of voxels beside a diagonal, above one, that block light on it: with this number
light of all directions enters 3/2 voxels per voxel edge, as straight lines of all directions do."""


@dataclass(frozen=True)
class Source:
    """The source of the lattice of one band, the same in every step.

    power      (nx, ny, nz) W/m^2, over the squared edge of a voxel
    drift      (3, nx, ny, nz) W/m^2, power times its mean direction, and times its mean place from
               the voxel's centre in transport mean free paths: either carries light on that far
    reflected  (nx, ny, nz) W/m^2 or None, what opaque voxels send into each voxel besides what the
               lattice brings them
    """

    power: Floats
    drift: Floats
    reflected: Floats | None = None


def rates(depth: Floats, albedo: float, g: float) -> tuple[Floats, Floats, Floats]:
    """(even, odd, absorbed), each (18, ...): the share of each part that a step changes.

    depth  (...), optical depth of a voxel's edge
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


def _by_direction(depth: Floats | float) -> Floats:
    """(18, ...): what lies between two centres."""
    return np.multiply.outer(LENGTHS, depth)


class NumpyLattice:
    """The lattice of one band, used just as `lattice_opencl.OpenclLattice`.

    depth             (nx, ny, nz), optical depth of a voxel's edge
    albedo, g         of the band
    occlusion         (nx, ny, nz) or None, the share of arriving light that a voxel stops
    occlusion_albedo  (nx, ny, nz) or a number, the share of that which goes back
    edge              voxels, the longest of a domain of which this is a part; None if it is all
    """

    def __init__(
        self,
        depth: Floats,
        albedo: float,
        g: float,
        occlusion: Floats | None = None,
        occlusion_albedo: Floats | float = 0.0,
        edge: float | None = None,
    ) -> None:
        self.shape, self.cells = depth.shape, Cells(depth.shape)
        self.steps = self.cells.steps
        depth = np.asarray(depth, float)
        self.outside, self.within = boundary_reflection(
            depth, albedo, g, occlusion, self.cells, edge
        )
        self.inside = self.cells.is_inside()
        self.occluders = None
        if occlusion is not None:
            self.occluders = _Occluders(self.cells, occlusion, occlusion_albedo)
        depth = self.cells.flat(depth)
        self.even, self.odd, self.absorbed = rates(depth, albedo, g)
        self.transport_depth = depth * (1 - albedo * g)
        # Over the depth of a voxel, which leaves a number in empty ones.
        self.drifted = _by_direction(1.0)[:, None] / (1 + _by_direction(self.transport_depth) / 2)
        self.lingered = _by_direction(1.0)[:, None] / (1 + _by_direction(depth * (1 - albedo)) / 2)
        # The weights of isotropic light: what collides, or in empty voxels the length of flight.
        pull = np.where(self.even[0] > 0, self.even, LENGTHS[:, None])
        self.pull = pull / (WEIGHTS @ pull)

    @staticmethod
    def buffers(shape: Sequence[int], occluded: bool) -> dict[str, int]:
        """{what: bytes} for a lattice of this shape and all coarser ones, float64."""
        directions = 18 * 8 * Cells(shape).count
        plan = {"light": directions, "light that flows on": directions, "rates": 6 * directions}
        plan |= {"source": 3 * directions, "work": 3 * directions}
        if occluded:
            plan["occluders"] = 4 * directions
        plan["coarser lattices"] = sum(plan.values()) // 7  # an eighth, an eighth of that, ...
        return plan

    def start(self, source: Source) -> None:
        """Remove all light, and set the `Source`."""
        power = self.cells.flat(source.power)
        self.emitted = np.multiply.outer(WEIGHTS * LENGTHS / MEAN_LENGTH, power)
        self.drift = self._drift(self.cells.flat(source.drift))
        self.given = self.emitted * (1 - self.absorbed / 2) + self.drift
        self._start_dark(source.reflected)

    def start_as_coarser(self) -> None:
        """Remove all light, and wait for the residual that a finer lattice will `restrict`."""
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
        """(18, count): what flows on of what has arrived."""
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
        """(18, count): what arrives of what flows on."""
        arrived = np.array([np.roll(f, step) for f, step in zip(out, self.steps, strict=True)])
        return arrived if self.occluders is None else self.occluders.met(arrived)

    def restrict(self, coarser: "NumpyLattice", factor: float) -> None:
        """Add a factor times the light that flowed last to the source of a lattice of half the
        resolution.

        The odd part carries light on by (1 / s + 1 / 2) voxels' lengths, s the transport depth of
        one, before it is forgotten: by as far on both.
        """
        flowed = [np.roll(f, -step) for f, step in zip(self.light, self.steps, strict=True)]
        out = self.cells.inside(np.array(flowed))
        even, odd = (out + out[OPPOSITE]) / 2, (out - out[OPPOSITE]) / 2
        power = out.sum(axis=0)
        place = np.array([power * (n % 2 - 0.5) for n in np.indices(self.shape)]) / 2
        even, odd, place = map(sum_of_eight, (even, odd * self._flow(), place))
        cells = coarser.cells
        drift = coarser._drift(cells.flat(place / 4) * coarser.transport_depth)
        given = (even + odd / coarser._flow()) / 4 + cells.inside(drift)
        cells.inside(coarser.given)[...] += factor * given

    def prolongate(self, coarser: "NumpyLattice", factor: float) -> None:
        """Add a factor times the light of a lattice of half the resolution."""
        light = coarser.cells.inside(coarser.light)
        even, odd = (light + light[OPPOSITE]) / 2, (light - light[OPPOSITE]) / 2
        even, odd = (interpolate(part, self.shape) for part in (even, odd))
        # By the flow of the voxel that each lies in: next to it there may be far thinner ones.
        within = tuple(map(slice, self.shape))  # beyond an odd edge there is nothing
        odd *= self._flow() / repeated(coarser._flow(), 2)[:, *within]
        self.cells.inside(self.light)[...] += factor * (even + odd)

    def _flow(self) -> Floats:
        """(18, nx, ny, nz), the odd part over that of the light that flows through a voxel."""
        return 1 + _by_direction(self.cells.inside(self.transport_depth)) / 2

    def _isotropic(self, f: Floats) -> Floats:
        """(18, count): the light spread evenly that collisions lead to."""
        return np.multiply.outer(WEIGHTS, np.sum(self.pull * f, axis=0))

    def fluence(self, every: int = 1) -> Floats:
        """(nx, ny, nz) W/m^2, of every n-th layer along x; absorption times it is what the
        steps absorb."""
        passing = self._isotropic(self.light) + self.emitted / 2
        return self.cells.inside(np.sum(passing * self.lingered, axis=0))[::every]

    def flux(self) -> Floats:
        """(3, nx, ny, nz) W/m^2."""
        passing = self.light * (1 - self.odd / 2) + self.drift / 2
        return self.cells.inside(MOVING.T.astype(float) @ passing)

    def leaving(self) -> Iterator[Floats]:
        """Yields for each direction (nx, ny, nz) W/m^2: what flowed on by the last step, by the
        voxel that it left; less of what leaves all of these where some of it comes back."""
        for light, step in zip(self.light, self.steps, strict=True):
            yield self.cells.inside(np.roll((1 - self.outside) * light, -step))

    def lost(self) -> tuple[Floats, float]:
        """(left (6,), stopped): the light of a step that leaves through the faces -x, +x, -y, +y,
        -z, +z, and that occluders absorb; sums over voxels of W/m^2."""
        left = np.zeros(6)
        for c, gone in zip(MOVING, self.leaving(), strict=True):
            for axis in np.flatnonzero(c):  # a diagonal leaves through the first face of the two
                border = (slice(None),) * axis + (-1 if c[axis] > 0 else 0,)
                left[2 * axis + (c[axis] > 0)] += gone[border].sum()
                gone[border] = 0
        return left, 0.0 if self.occluders is None else self.occluders.stopped


def sum_of_eight(values: Floats) -> Floats:
    """(..., nx/2, ny/2, nz/2, rounded up) of (..., nx, ny, nz)."""
    for axis in (-3, -2, -1):
        values = np.add.reduceat(values, range(0, values.shape[axis], 2), axis)
    return values


def interpolate(values: Floats, shape: Sequence[int]) -> Floats:
    """Values at the centres of voxels, between those of voxels of twice the size."""
    for axis, n in zip((-3, -2, -1), shape, strict=True):
        here = np.arange(n)
        near = here // 2
        far = np.clip(near + here % 2 * 2 - 1, 0, values.shape[axis] - 1)
        values = 0.75 * values.take(near, axis) + 0.25 * values.take(far, axis)
    return values


class _Occluders:
    """Opaque voxels, and what they do to light on its way from cell to cell.

    Of all of these, (18, count), row m is of light that arrives at a cell along m; nothing is
    stopped on the way out of the domain, nor of what comes back from there.

    passed    the share that arrives
    back      the share that goes back to where it came from
    stopped   the sum of what they have absorbed of the last step, W/m^2
    """

    def __init__(self, cells: Cells, occlusion: Floats, albedo: Floats | float) -> None:
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
        # What goes back of light that left a cell along m, at that cell.
        self.sent_back = np.array(
            [np.roll(back, -step) for back, step in zip(self.back, self.steps, strict=True)]
        )
        self.spread = WEIGHTS @ self.sent_back
        self.stopped = 0.0

    def _beside(self, opaque: Floats, reflecting: Floats, c: Integers) -> Array:
        """(count,) each: the shares that the two voxels beside a diagonal on its way to each cell
        stop, and send back; none along axes."""
        if np.abs(c).sum() == 1:
            return np.zeros((2, self.cells.count))
        steps = parts(c) @ (self.cells.plane, self.cells.row, 1)
        means = [
            sum(np.roll(values, step) / 2 for step in steps) for values in (opaque, reflecting)
        ]
        return np.multiply(means, 1 + DIAGONAL_BLOCKING * (1 - means[0]))

    def start(self, reflected: Floats | None) -> None:
        """reflected is that of a `Source`."""
        none = np.zeros(self.cells.shape)
        self.reflected = self.cells.flat(none if reflected is None else reflected)

    def met(self, arriving: Floats) -> Floats:
        """(18, count): what arrives where all of this would without them.

        What they send back to a cell goes off evenly in all directions away from them: sent
        straight back, light would go to and fro for ever between white walls.
        """
        self.stopped = float(np.sum((1 - self.passed - self.back) * arriving))
        sent = [np.roll(f, -step) for f, step in zip(arriving, self.steps, strict=True)]
        returning = self.reflected + np.sum(self.sent_back * sent, axis=0)
        density = np.divide(
            returning, self.spread, out=np.zeros(self.cells.count), where=self.spread > 0
        )
        return self.passed * arriving + WEIGHTS[:, None] * self.sent_back[OPPOSITE] * density
