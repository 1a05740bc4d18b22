# SPDX-License-Identifier: GPL-3.0-or-later
"""Low-discrepancy sampling of directions, of a domain's faces, of a voxel's face and of the sky."""

from functools import cache
from math import ceil, gcd

import numpy as np

from ...arrays import Array, Floats, Integers, Vector
from ...errors import LightError
from ..medium import Domain

type Cone = tuple[Floats, float]
"""Its axis (3,), of any length, and the versine, 1 - cosine, of its half angle."""

SKY_CELLS = (32, 64)  # rows and columns: the cells by which a sky given as a function is sampled
# For each axis that x is moved to: the old axes of the new x, y and z.
_TURNS = np.array([(0, 1, 2), (2, 0, 1), (1, 2, 0)])
GOLDEN = (np.sqrt(5) - 1) / 2
_PLASTIC = (0.7548776662466927, 0.5698402909980532)  # powers of 1 / the root of x^3 = x + 1


def r_sequence(count: int, dimensions: int, rng: np.random.Generator) -> Floats:
    """(dimensions, count) in [0, 1): low-discrepancy points with one random shift for all.

    The first coordinate ascends, one point in each interval of 1 / count, so that consecutive
    photons start close to each other. The others are the R sequence (M. Roberts, "The Unreasonable
    Effectiveness of Quasirandom Sequences", 2018). The shift makes every mean over the points
    unbiased, and the points of two calls independent.
    Raises LightError for a count below 1.
    """
    if count < 1:
        raise LightError(f"A light sends 1 photon or more; {count} were asked for.")
    root = 2.0  # of x^dimensions = x + 1: the golden ratio for 2
    for _ in range(50):
        root = (1 + root) ** (1 / dimensions)
    number = np.arange(count)
    points = np.outer(root ** -np.arange(dimensions), number)
    points += rng.random((dimensions, 1))
    points[1:] -= np.floor(points[1:])
    points[0] /= count
    return np.minimum(points, np.nextafter(1, 0), out=points)


def intervals(weights: Floats) -> Floats:
    """(n + 1,): the ends of adjoining intervals whose lengths are the weights (n,)."""
    return np.concatenate(([0.0], np.cumsum(weights, dtype=float)))


def sample_discrete(edges: Floats, u: Floats) -> tuple[Integers, Floats]:
    """The interval into which each u (count,) in [0, 1) falls, and the place in it, in [0, 1).

    edges  as of `intervals`; an interval's probability is its length
    If all intervals are empty, it is the last one.
    """
    target = u * edges[-1]
    sampled = np.minimum(np.searchsorted(edges, target, side="right") - 1, len(edges) - 2)
    start, width = edges[sampled], edges[sampled + 1] - edges[sampled]
    place = np.divide(target - start, width, out=np.zeros_like(u), where=width > 0)
    return sampled, np.minimum(place, np.nextafter(1, 0))


def face_areas(domain: Domain) -> Floats:
    """(3,) m^2: the area of the faces across each axis."""
    extent = np.multiply(domain.shape, domain.voxel_size)
    areas: Floats = extent.prod() / extent
    return areas


def entry_points(domain: Domain, directions: Floats, across: Floats, along: Floats) -> Floats:
    """(count, 3) m: points of entry along `directions`, uniform over the domain as seen from there.

    across and along are the (count,) in [0, 1) that choose the place.
    """
    areas = np.abs(directions) * face_areas(domain)
    ends = np.cumsum(areas, axis=1)
    target = across * ends[:, 2]
    axis = (target >= ends[:, 0]).astype(int) + (target >= ends[:, 1])
    sampled = (np.arange(len(axis)), axis)
    across = np.clip(1 - (ends[sampled] - target) / areas[sampled], 0, 1)
    return points_on_faces(domain, axis, directions[sampled] < 0, across, along)


def points_on_faces(
    domain: Domain, axis: Integers, upper: Array, across: Floats, along: Floats
) -> Floats:
    """(count, 3) m: points on the lower or upper face across each `axis`.

    across and along are the (count,) in [0, 1] that choose the place on the face.
    """
    shares = turned_to(np.stack((upper, across, along), axis=1), axis)
    points: Floats = domain.origin + shares * np.multiply(domain.shape, domain.voxel_size)
    return points


def turned_to(vectors: Floats, axis: Integers) -> Floats:
    """Vectors (count, 3) with x moved to `axis` (count,), and y and z to the axes after it."""
    return np.take_along_axis(vectors, _TURNS[axis], axis=1)


def tilted(versine: Floats, turn: Floats) -> Floats:
    """(count, 3) unit vectors with x = 1 - versine, `turn` turns around the x axis.

    Uniform over the sphere if versine is uniform in [0, 2] and turn in [0, 1].
    """
    radius, angle = np.sqrt(versine * (2 - versine)), 2 * np.pi * turn
    return np.stack((1 - versine, radius * np.cos(angle), radius * np.sin(angle)), axis=1)


def frame_of(axis: Floats) -> Floats:
    """(3, 3): orthogonal unit rows, the first along `axis`, a vector of any length."""
    if not axis.any():
        return np.eye(3)
    first = axis / np.linalg.norm(axis)
    second = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    second /= np.linalg.norm(second)
    return np.stack((first, second, np.cross(first, second)))


def even_directions(
    numbers: Integers, count: int, versine: float = 2.0, turn: float = 0.0
) -> Floats:
    """(n, 3) unit vectors: the points `numbers` (n,) of a Fibonacci lattice of `count` points.

    The lattice covers the cone around the x axis whose half angle has this versine, 1 - cosine;
    it is rotated by `turn` turns.
    """
    return tilted(versine * (numbers + 0.5) / count, (numbers * GOLDEN + turn) % 1)


def bounding_cone(position: Vector, domain: Domain, reach: float = 0.0) -> Cone:
    """The `Cone`, its axis in m, that holds the domain as seen from the position.

    It holds the domain's bounding sphere as seen from all places within `reach` m of the position.
    """
    lower, upper = np.array((domain.origin, domain.upper))
    axis = (lower + upper) / 2 - position
    distance, radius = np.linalg.norm(axis), np.linalg.norm(upper - lower) / 2 + reach
    if distance <= radius:
        return axis, 2.0
    sine_squared = (radius / distance) ** 2
    # 1 - cos, without the cancellation of small angles.
    return axis, float(sine_squared / (1 + np.sqrt(1 - sine_squared)))


def rays_to(domain: Domain, position: Vector, versine: float, per_edge: int) -> int:
    """The number of evenly distributed rays in a cone of which per_edge^2 cross a voxel's face in
    the corner of the domain that is farthest from the position.

    versine  of the cone's half angle
    """
    ends = np.array((domain.origin, domain.upper)) - position
    farthest = np.linalg.norm(np.abs(ends).max(axis=0))
    count: int = ceil(2 * np.pi * versine * (per_edge * farthest / domain.voxel_size) ** 2)
    return count


def shift_of(beam: int) -> Floats:
    """(2, 1): the shift of the lattice of points of beam number `beam`."""
    return beam * np.array(_PLASTIC)[:, None]


def rank_1(least: int) -> Floats:
    """(2, n): a rank-1 lattice of `least` points or a few more on the unit square.

    All points have different coordinates, and different sums and differences of these, so neither
    edges nor diagonals of voxels run along its rows. For this, n must not have the factors 2 and 3.
    """
    count = next(n for n in range(least, least + 6) if gcd(n, 6) == 1)
    factors = (
        n for n in range(1, count + 1) if gcd((n - 1) * n * (n + 1), count) == 1 or count == 1
    )
    factor = min(factors, key=lambda n: float(abs(n - count * GOLDEN)))
    number = np.arange(count)
    return (np.stack((number, number * factor % count)) + 0.5) / count


def in_cells(cell: Integers, height: Floats | float, around: Floats | float) -> Floats:
    """(count, 3) unit vectors in cells of the sky, all of the same solid angle.

    height, around  (count,) in [0, 1], the place in the cell
    """
    rows, columns = SKY_CELLS
    row, column = np.divmod(cell, columns)
    return tilted(2 * (row + height) / rows, (column + around) / columns)


def cells_of(towards: Floats) -> Integers:
    """(...): the numbers of the sky's cells that unit vectors (..., 3) point to.

    The cells form the grid SKY_CELLS, in rows from +x to -x, and in a row from y to z and on. All
    have the same solid angle.
    """
    rows, columns = SKY_CELLS
    x, y, z = np.moveaxis(towards, -1, 0)
    row = np.clip((1 - x) / 2 * rows, 0, rows - 1).astype(int)
    around = np.arctan2(z, y) / (2 * np.pi) % 1
    cells: Integers = row * columns + np.minimum(around * columns, columns - 1).astype(int)
    return cells


@cache
def cell_centers() -> Floats:
    """(n, 3) unit vectors: the centres of the n cells."""
    return in_cells(np.arange(SKY_CELLS[0] * SKY_CELLS[1]), 0.5, 0.5)


@cache
def cell_quarters() -> Floats:
    """(4 n, 3) unit vectors: the centres of the quarters of the n cells, cell by cell. All four
    rarely miss a source that covers part of a cell."""
    cell = np.arange(SKY_CELLS[0] * SKY_CELLS[1])[:, None]
    height, around = np.array([(x, y) for x in (0.25, 0.75) for y in (0.25, 0.75)]).T
    cells, heights, arounds = (v.ravel() for v in np.broadcast_arrays(cell, height, around))
    return in_cells(cells, heights, arounds)
