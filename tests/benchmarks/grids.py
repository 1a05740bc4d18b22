# SPDX-License-Identifier: GPL-3.0-or-later
"""The effect of the grid on the physical model: its resolution, and its orientation."""

from functools import partial
from itertools import pairwise
from math import erf

import numpy as np

from lb_lighting.transport import Medium, Sun, solve
from tests.benchmarks.columns import DETERMINISTIC, all_light
from tests.benchmarks.media import COARSE, SUN, corners, of_depth, refined_cases
from tests.benchmarks.references import References

FACTORS = (1, 2, 3, 4, 6, 8)  # 12 to 96 voxels
RESOLVED = (2, 4, 8)  # three factors, each twice the last, from which the order is computed

TURNED = 32  # voxels of the blob's box, which is rotated
TURNS = 50
BLOBS = {"10, g 0": (10, 0), "20, g 0.85": (20, 0.85)}
# Of each Gaussian: weight, centre, width; the box is from -1 to 1.
GAUSSIANS = (
    (1.0, (0.15, 0.0, -0.1), 0.24),
    (1.3, (-0.25, 0.2, 0.1), 0.18),
    (0.8, (0.1, -0.3, 0.25), 0.2),
    (1.1, (0.0, 0.15, -0.4), 0.16),
)
WITHIN = 0.9  # radius of the ball that is compared, which stays in the box

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
    """The same medium with voxels that are smaller by the factor."""
    density = np.kron(medium.density, np.ones((factor,) * 3))
    return Medium(
        density, medium.voxel_size / factor, medium.sigma_s, medium.sigma_a, medium.g, medium.origin
    )


def coarsened(light, factor):
    """Means over the coarse voxels, which are exact in a reference."""
    n = len(light) // factor
    return light.reshape(n, factor, n, factor, n, factor).mean(axis=(1, 3, 5))


def order(rows, light, size):
    """Orders of the error and of the convergence to the model's limit: powers of the voxel's edge.

    The limit of the model has an error of its own, which remains with fine voxels.
    """
    voxels, errors = zip(*[(row["voxels"], row["error"]) for row in rows], strict=True)
    slope, _ = np.polyfit(np.log(voxels), np.log(errors), 1)
    steps = [float(np.linalg.norm(light[a] - light[b]) / size) for a, b in pairwise(RESOLVED)]
    return {
        "order of the error, fitted": -float(slope),
        "order of convergence": float(np.log2(steps[0] / steps[1])),
        "change at last": steps[1],
        "error at last": errors[-1],
    }


# --- Rotation ------------------------------------------------------------------------------------


def rotation_rows():
    """A blob and its sun, compared with both rotated relative to the grid, in a common ball.

    The rotated light is interpolated linearly between voxel centres. The error of the interpolation
    alone is measured on a field that is known exactly: the uncollided light.
    """
    points = np.stack(corners(TURNED), axis=-1)
    points = points[np.linalg.norm(points, axis=-1) < WITHIN]
    rng = np.random.default_rng(4)
    turns = [random_rotation(rng) for _ in range(TURNS)]
    toward = np.divide(SUN.direction, np.linalg.norm(SUN.direction))
    for name, (depth, g) in BLOBS.items():
        medium = of_depth(blob(np.eye(3)), depth, 0.99, g)
        exact_toward = partial(transmittance, sigma_t=medium.sigma_t[0] / 2)  # the box is 1 m
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
    """(3, 3): a uniformly distributed random rotation."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def blob(turn):
    """(n, n, n): the mean density of each voxel, by 2^3 points in it, of the rotated blob."""
    points = np.stack(corners(2 * TURNED), axis=-1) @ turn
    density = sum(
        weight * np.exp(-((points - center) ** 2).sum(axis=-1) / (2 * width**2))
        for weight, center, width in GAUSSIANS
    )
    return coarsened(density, 2)


def transmittance(points, toward, sigma_t):
    """The transmittance of a sun's light to points (..., 3)."""
    depth = 0
    for weight, center, width in GAUSSIANS:
        from_center = points - center
        along = from_center @ toward
        aside = (from_center**2).sum(axis=-1) - along**2
        line = np.sqrt(np.pi / 2) * width * (1 + _erf(along / (np.sqrt(2) * width)))
        depth = depth + weight * np.exp(-aside / (2 * width**2)) * line
    return np.exp(-sigma_t * depth)


def read(values, points):
    """(count,): values (n, n, n) of voxels, interpolated linearly at points of the box."""
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
