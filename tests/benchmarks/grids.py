# SPDX-License-Identifier: GPL-3.0-or-later
"""What the grid does to the physical model: its resolution, and how it is turned to the scene."""

from functools import partial
from itertools import pairwise
from math import erf

import numpy as np

from lb_lighting.transport import Medium, Sun, solve
from tests.benchmarks.columns import DETERMINISTIC, all_light
from tests.benchmarks.media import COARSE, SUN, corners, of_depth, refined_cases
from tests.benchmarks.references import References

FACTORS = (1, 2, 3, 4, 6, 8)  # 12 to 96 voxels
RESOLVED = (2, 4, 8)  # the three of them, each twice the last, that tell an order

TURNED = 32  # voxels of the blob's box, which is turned
TURNS = 50
BLOBS = {"10, g 0": (10, 0), "20, g 0.85": (20, 0.85)}
# Of each Gaussian: weight, centre, width; the box is from -1 to 1.
GAUSSIANS = (
    (1.0, (0.15, 0.0, -0.1), 0.24),
    (1.3, (-0.25, 0.2, 0.1), 0.18),
    (0.8, (0.1, -0.3, 0.25), 0.2),
    (1.1, (0.0, 0.15, -0.4), 0.16),
)
WITHIN = 0.9  # what is compared: a ball that stays in the box

_erf = np.vectorize(erf)


# --- Resolution ----------------------------------------------------------------------------------


def refinement():
    """Tables of the errors of media on finer voxels, and of the orders of accuracy."""
    references = References()
    rows, orders = [], []
    for case in refined_cases():
        reference = references[case]
        size = np.linalg.norm(reference.light)
        light = {}
        for factor in FACTORS:
            field = solve(refined(case.medium, factor), case.lights, DETERMINISTIC)
            light[factor] = coarsened(all_light(field), factor)
            raw = np.linalg.norm(light[factor] - reference.light) / size
            rows.append(
                {
                    "case": case.name,
                    "voxels": COARSE * factor,
                    "error": float(np.sqrt(max(0, raw**2 - reference.error**2))),
                    "steps": field.report.steps,
                    "seconds": sum(field.report.seconds.values()),
                }
            )
        orders.append({"case": case.name} | order(rows[-len(FACTORS) :], light, size))
    yield "refinement", rows
    yield "orders", orders


def refined(medium, factor):
    """The same medium, on voxels so many times smaller."""
    density = np.kron(medium.density, np.ones((factor,) * 3))
    return Medium(
        density, medium.voxel_size / factor, medium.sigma_s, medium.sigma_a, medium.g, medium.origin
    )


def coarsened(light, factor):
    """Means over the coarse voxels, which a reference has exactly."""
    n = len(light) // factor
    return light.reshape(n, factor, n, factor, n, factor).mean(axis=(1, 3, 5))


def order(rows, light, size):
    """How fast the error falls, and how fast the light settles: powers of the voxel's edge.

    The light settles to the model's own limit, which errs by as much as is left at last.
    """
    voxels, errors = zip(*[(row["voxels"], row["error"]) for row in rows], strict=True)
    slope, _ = np.polyfit(np.log(voxels), np.log(errors), 1)
    steps = [float(np.linalg.norm(light[a] - light[b]) / size) for a, b in pairwise(RESOLVED)]
    return {
        "order of the error, fitted": -float(slope),
        "order of settling": float(np.log2(steps[0] / steps[1])),
        "change at last": steps[1],
        "error at last": errors[-1],
    }


# --- Rotation ------------------------------------------------------------------------------------


def rotation_rows():
    """A blob against itself turned, with its sun, against the grid; in the ball that both show.

    The turned light is read between voxels' centres, linearly. What that alone costs is measured
    by a field that is exact wherever it is read: the unscattered light.
    """
    points = np.stack(corners(TURNED), axis=-1)
    points = points[np.linalg.norm(points, axis=-1) < WITHIN]
    rng = np.random.default_rng(4)
    turns = [random_rotation(rng) for _ in range(TURNS)]
    toward = np.divide(SUN.direction, np.linalg.norm(SUN.direction))
    for name, (depth, g) in BLOBS.items():
        medium = of_depth(blob(np.eye(3)), depth, 0.99, g)
        exact_toward = partial(unscattered, sigma_t=medium.sigma_t[0] / 2)  # the box is 1 m
        upright = read(all_light(solve(medium, [SUN], DETERMINISTIC)), points)
        exact = exact_toward(points, toward)
        differences, costs = [], []
        for turn in turns:
            turned = replace_density(medium, blob(turn))
            light = all_light(solve(turned, [Sun(turn @ toward, 1.0)], DETERMINISTIC))
            differences.append(relative(read(light, points @ turn.T), upright))
            at_centers = exact_toward(np.stack(corners(TURNED), axis=-1) @ turn, toward)
            costs.append(relative(read(at_centers, points @ turn.T), exact))
        yield {
            "blob": name,
            "mean difference": float(np.mean(differences)),
            "largest difference": float(np.max(differences)),
            "of it by reading, mean": float(np.mean(costs)),
            "of it by reading, largest": float(np.max(costs)),
            "mean without": float(np.sqrt(np.mean(np.square(differences) - np.square(costs)))),
        }


def replace_density(medium, density):
    return Medium(density, medium.voxel_size, medium.sigma_s, medium.sigma_a, medium.g)


def random_rotation(rng):
    """(3, 3): of all rotations, each as likely."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def blob(turn):
    """(n, n, n): the mean density of each voxel, by 2^3 of its points, of the blob turned."""
    points = np.stack(corners(2 * TURNED), axis=-1) @ turn
    density = sum(
        weight * np.exp(-((points - center) ** 2).sum(axis=-1) / (2 * width**2))
        for weight, center, width in GAUSSIANS
    )
    return coarsened(density, 2)


def unscattered(points, toward, sigma_t):
    """The share of a sun's light that reaches points (..., 3) unscattered."""
    depth = 0
    for weight, center, width in GAUSSIANS:
        from_center = points - center
        along = from_center @ toward
        aside = (from_center**2).sum(axis=-1) - along**2
        line = np.sqrt(np.pi / 2) * width * (1 + _erf(along / (np.sqrt(2) * width)))
        depth = depth + weight * np.exp(-aside / (2 * width**2)) * line
    return np.exp(-sigma_t * depth)


def read(values, points):
    """(count,) of voxels' values (n, n, n), linearly between centres, at points of the box."""
    place = (points + 1) / 2 * len(values) - 0.5
    low = np.clip(place.astype(int), 0, len(values) - 2)
    share = place - low
    total = 0
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, share, 1 - share).prod(axis=-1)
        total = total + weight * values[tuple((low + corner).T)]
    return total


def relative(light, truth):
    return float(np.linalg.norm(light - truth) / np.linalg.norm(truth))
