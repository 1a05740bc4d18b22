# SPDX-License-Identifier: GPL-3.0-or-later
"""Points spread evenly: over directions, the faces of a domain, a voxel's face, and the sky."""

from functools import cache
from math import ceil, gcd

import numpy as np

from ...errors import LightError

SKY_CELLS = (32, 64)  # in height and around: where a sky given as a function is bright
# By the axis that x is moved to: where the new x, y and z come from.
_TURNS = np.array([(0, 1, 2), (2, 0, 1), (1, 2, 0)])
GOLDEN = (np.sqrt(5) - 1) / 2
_PLASTIC = (0.7548776662466927, 0.5698402909980532)  # powers of 1 / the root of x^3 = x + 1


def strata(count, dimensions, rng):
    """(dimensions, count) in [0, 1): points spread evenly, shifted as a whole at random.

    The first coordinate ascends, one point in each interval of 1 / count, so that photons which
    follow each other start close to each other. The others are the R sequence (M. Roberts, "The
    Unreasonable Effectiveness of Quasirandom Sequences", 2018). The shift makes every mean over
    the points unbiased, and the points of two calls independent.
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


def intervals(weights):
    """(n + 1,) where the intervals begin and end that weights (n,) have when laid side by side."""
    return np.concatenate(([0.0], np.cumsum(weights, dtype=float)))


def pick(edges, u):
    """The interval that each u (count,) in [0, 1) falls to, and where in it, in [0, 1).

    Where all are empty it is the last.
    """
    target = u * edges[-1]
    picked = np.minimum(np.searchsorted(edges, target, side="right") - 1, len(edges) - 2)
    start, width = edges[picked], edges[picked + 1] - edges[picked]
    rest = np.divide(target - start, width, out=np.zeros_like(u), where=width > 0)
    return picked, np.minimum(rest, np.nextafter(1, 0))


def face_areas(domain):
    """(3,) m^2: the area of the faces across each axis."""
    extent = np.multiply(domain.shape, domain.voxel_size)
    return extent.prod() / extent


def entry_points(domain, directions, across, along):
    """(count, 3) m: where rays of `directions` enter the domain, uniform over what it shows them.

    across and along are the (count,) in [0, 1) that choose the place.
    """
    areas = np.abs(directions) * face_areas(domain)
    ends = np.cumsum(areas, axis=1)
    target = across * ends[:, 2]
    axis = (target >= ends[:, 0]).astype(int) + (target >= ends[:, 1])
    picked = (np.arange(len(axis)), axis)
    across = np.clip(1 - (ends[picked] - target) / areas[picked], 0, 1)
    return points_on_faces(domain, axis, directions[picked] < 0, across, along)


def points_on_faces(domain, axis, upper, across, along):
    """(count, 3) m: points on the lower or upper face across each `axis`, by two shares of it."""
    shares = turned_to(np.stack((upper, across, along), axis=1), axis)
    return domain.origin + shares * np.multiply(domain.shape, domain.voxel_size)


def turned_to(vectors, axis):
    """Vectors (count, 3) with x moved to `axis` (count,), and y and z to those that follow it."""
    return np.take_along_axis(vectors, _TURNS[axis], axis=1)


def tilted(drop, turn):
    """(count, 3) unit vectors with x = 1 - drop, `turn` turns around the x axis.

    Uniform over the sphere where drop is uniform in [0, 2], and turn in [0, 1].
    """
    radius, angle = np.sqrt(drop * (2 - drop)), 2 * np.pi * turn
    return np.stack((1 - drop, radius * np.cos(angle), radius * np.sin(angle)), axis=1)


def frame_of(axis):
    """(3, 3): orthogonal unit rows, the first along `axis`, whatever its length."""
    if not axis.any():
        return np.eye(3)
    first = axis / np.linalg.norm(axis)
    second = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    second /= np.linalg.norm(second)
    return np.stack((first, second, np.cross(first, second)))


def even_directions(numbers, count, spread=2.0, turn=0.0):
    """(n, 3) unit vectors: those `numbers` (n,) of `count` that are spread evenly over the cone
    around the x axis whose half angle's cosine is 1 - spread, `turn` turns around it. Fibonacci's
    lattice.
    """
    return tilted(spread * (numbers + 0.5) / count, (numbers * GOLDEN + turn) % 1)


def sight(position, domain, reach=0.0):
    """((3,) m its axis, 1 - the cosine of its half angle): the cone in which the domain is seen
    from all places up to `reach` m around the position."""
    lower, upper = np.array((domain.origin, domain.upper))
    axis = (lower + upper) / 2 - position
    distance, radius = np.linalg.norm(axis), np.linalg.norm(upper - lower) / 2 + reach
    if distance <= radius:
        return axis, 2.0
    sine_squared = (radius / distance) ** 2
    return axis, sine_squared / (1 + np.sqrt(1 - sine_squared))  # keeps its digits far away


def rays_to(domain, position, spread, per_edge):
    """How many rays, evenly over a cone of `sight`, are per_edge^2 through the face of a voxel
    in the corner of the domain that is farthest from the position."""
    ends = np.array((domain.origin, domain.upper)) - position
    farthest = np.linalg.norm(np.abs(ends).max(axis=0))
    return ceil(2 * np.pi * spread * (per_edge * farthest / domain.voxel_size) ** 2)


def shift_of(beam):
    """(2, 1), by how much the lattice of a beam of some number is shifted."""
    return beam * np.array(_PLASTIC)[:, None]


def rank_1(least):
    """(2, n): a lattice of `least` points or a few more, spread evenly over the unit square.

    Coordinates, and their sums and differences, are different for all points, so that neither
    edges nor diagonals of voxels run along its rows; that takes an n without the factors 2 and 3.
    """
    count = next(n for n in range(least, least + 6) if gcd(n, 6) == 1)
    fit = (n for n in range(1, count + 1) if gcd((n - 1) * n * (n + 1), count) == 1 or count == 1)
    factor = min(fit, key=lambda n: abs(n - count * GOLDEN))
    number = np.arange(count)
    return (np.stack((number, number * factor % count)) + 0.5) / count


def in_cells(cell, height, around):
    """(count, 3) unit vectors in cells of the sky, all of the same solid angle."""
    rows, columns = SKY_CELLS
    row, column = np.divmod(cell, columns)
    return tilted(2 * (row + height) / rows, (column + around) / columns)


def cells_of(towards):
    """(...): the numbers of the cells of the sky that unit vectors (..., 3) point to.

    There are SKY_CELLS, in rows from +x to -x, all of the same solid angle; in a row they go from
    y to z and on.
    """
    rows, columns = SKY_CELLS
    x, y, z = np.moveaxis(towards, -1, 0)
    row = np.clip((1 - x) / 2 * rows, 0, rows - 1).astype(int)
    around = np.arctan2(z, y) / (2 * np.pi) % 1
    return row * columns + np.minimum(around * columns, columns - 1).astype(int)


@cache
def cell_centers():
    return in_cells(np.arange(SKY_CELLS[0] * SKY_CELLS[1]), 0.5, 0.5)


@cache
def cell_quarters():
    """(4 n, 3): the centres of the quarters of the n cells, cell by cell. What shines in a part
    of a cell hardly ever is missed by all four."""
    cell = np.arange(SKY_CELLS[0] * SKY_CELLS[1])[:, None]
    height, around = np.array([(x, y) for x in (0.25, 0.75) for y in (0.25, 0.75)]).T
    return in_cells(*(v.ravel() for v in np.broadcast_arrays(cell, height, around)))
