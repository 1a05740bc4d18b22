# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical model against exact solutions: slabs, a white furnace, a point source."""

from dataclasses import replace

import numpy as np

from lb_lighting.transport import Medium, Sky, solve
from tests.benchmarks.columns import COLUMNS, DETERMINISTIC, all_light, imbalance, relative_noise
from tests.benchmarks.media import CLOUD_DEPTHS, EDGE, cloud, of_depth
from tests.tracing import Beam
from tests.transport.photons.test_photon_oracles import SLABS

THICK = 16  # voxels of a slab
WIDE = 161  # voxels; the light that leaves through the sides is measured
PHOTONS = 400_000  # for a slab's hybrid: R and T of one beam, to .001
SPREADS = [(0, 0.9), (0, 0.5), (0.75, 0.9), (-0.5, 0.8), (0.9, 0.7)]  # g, albedo
# Voxels of the box, and their size relative to the root mean square distance, of which half the box
# is 6. There are two sizes, as the error may depend on the voxels.
BOXES = {41: 0.3, 97: 0.12}


# --- Slabs ---------------------------------------------------------------------------------------


def slab_rows():
    """Reflectance and transmittance of slabs, within 3 % of the exact ones, or .02 if that is more.

    One point in the middle of the slab is lit, and all light that leaves through a face is counted.
    The model is linear and the slab is homogeneous, so this equals the result for light on the
    whole slab. In an infinite slab the light that leaves through the sides, `sides`, would leave
    elsewhere; it is the largest possible error of the two numbers.
    """
    for g, depth, albedo, *exact in SLABS:
        for diffuse in (False, True):
            for column in ("deterministic", "hybrid T=4"):
                settings = replace(COLUMNS[column], photons=PHOTONS)
                found = slab(depth, albedo, g, diffuse, settings)
                expected = exact[2:] if diffuse else exact[:2]
                off = np.abs(found[1:] - expected)
                allowed = np.maximum(0.03 * np.array(expected), 0.02)
                print(f"slab g {g:g}, depth {depth:g}, albedo {albedo:g}, {column}", flush=True)
                yield {
                    "g": g,
                    "depth": depth,
                    "albedo": albedo,
                    "light": "diffuse" if diffuse else "normal",
                    "column": column,
                    "R": float(found[1]),
                    "R exact": expected[0],
                    "T": float(found[2]),
                    "T exact": expected[1],
                    "worst, of what is allowed": float((off / allowed).max()),
                    "sides": float(found[0]),
                }


def slab(depth, albedo, g, diffuse, settings):
    """(sides, R, T): shares of the light that leaves a slab."""
    sigma_t = depth / THICK
    medium = Medium(np.ones((WIDE, WIDE, THICK)), 1.0, sigma_t * albedo, sigma_t * (1 - albedo), g)
    lamp = Beam((WIDE / 2, WIDE / 2, 0), (0, 0, 1), diffuse)
    energy = solve(medium, [lamp], settings).report.energy
    left = energy["left"][0] / energy["entered"][0]
    return np.array([left[:4].sum(), *left[4:]])


# --- White furnace -------------------------------------------------------------------------------


def furnace_rows():
    """A cloud without absorption under a uniform sky: the fluence is 4 pi times its radiance.

    For a sky with a constant radiance the deterministic solve uses this answer and takes no step,
    so it does not test the lattice. A sky by function is first divided into a uniform part and the
    remainder. The lattice is tested with an upper and a lower half, which are not uniform.
    """
    skies = {"number": [Sky(1.0)], "function": [Sky(ones)], "halves": [Sky(upper), Sky(lower)]}
    for depth in CLOUD_DEPTHS:
        for g in (0, 0.85):
            medium = of_depth(cloud(EDGE), depth, 1.0, g)
            for sky, lights in skies.items():
                for column in ("deterministic", "hybrid T=4"):
                    settings = replace(COLUMNS[column], tolerance=1e-3)
                    field = solve(medium, lights, settings)
                    yield {"mean depth": depth, "g": g, "sky": sky, "column": column} | furnace(
                        field, medium
                    )


def ones(towards):
    return np.ones(towards.shape[:-1])


def upper(towards):
    return np.where(towards[..., 2] > 0, 1.0, 0.0)


def lower(towards):
    return 1 - upper(towards)


def furnace(field, medium):
    """The deviation of a field from 4 pi, with the noise of photons if there are any."""
    off = all_light(field) / (4 * np.pi) - 1
    scatters = medium.density > 0
    return {
        "largest error": float(np.abs(off).max()),
        "largest in the cloud": float(np.abs(off[scatters]).max()),
        "rms error": float(np.sqrt((off**2).mean())),
        "mean": float(off.mean()) + 1,
        "noise": relative_noise(field),
        "steps": field.report.steps,
        "balance": imbalance(field),
        "seconds": sum(field.report.seconds.values()),
    }


# --- Light of a point ----------------------------------------------------------------------------


def spread_rows():
    """The mean squared distance between emission and absorption, within 1 %.

    Light is emitted anywhere in the middle voxel and absorbed anywhere in the voxel in which it is
    counted, so h^2 / 2 is added to the squared distance between the centres.
    """
    for g, albedo in SPREADS:
        exact = 2 / ((1 - albedo) * (1 - g * albedo))
        for voxels, share in BOXES.items():
            h = share * float(np.sqrt(exact))
            settings = replace(DETERMINISTIC, tolerance=1e-5)
            field = solve(glowing_point(voxels, h, albedo, g), [], settings)
            light = all_light(field)
            squared = (field.domain.centers() ** 2).sum(axis=-1)
            mean = float((light * squared).sum() / light.sum() - h**2 / 2)
            yield {
                "g": g,
                "albedo": albedo,
                "voxels": voxels,
                "voxel depth": h,
                "mean squared distance": mean,
                "exact": exact,
                "ratio": mean / exact,
                "left": float(field.report.energy["left"].sum()),
            }


def glowing_point(voxels, h, albedo, g):
    """A medium of sigma_t 1/m whose middle voxel, at the origin of space, radiates 1 W."""
    emission = np.zeros((voxels,) * 3)
    emission[(voxels // 2,) * 3] = h**-3
    corner = [-voxels * h / 2] * 3
    return Medium(np.ones((voxels,) * 3), h, albedo, 1 - albedo, g, corner, emission)
