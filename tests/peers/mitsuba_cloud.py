# SPDX-License-Identifier: GPL-3.0-or-later
"""Mitsuba's pictures of a grey voxel medium in a sun, by `volpath` with all scatterings.

    python mitsuba_cloud.py PROBLEM.npz PICTURES.npz

PROBLEM.npz (lengths in m):
    density       (nx, ny, nz), linear between voxel centres, and 0 beyond the outermost
    lower, upper  (3,) corners of the box of voxels
    sigma_t       1/m, extinction at density 1
    albedo, g
    direction     (3,) in which the sun's light travels
    irradiance    W/m^2
    eye           (3,), position of the camera, which looks at the origin, with z up
    angle         field of view, degrees
    pixels        along an edge of the picture
    samples       paths per pixel
    seeds         (pictures,)
PICTURES.npz:
    pictures      (pictures, pixels, pixels), radiance, row 0 at the bottom
"""

import sys

import mitsuba as mi
import numpy as np
from mitsuba_image import MANY, Transform, medium


def padded(problem):
    """The grid with a layer of zeros: Mitsuba continues grids beyond their outermost values."""
    lower, upper = problem["lower"], problem["upper"]
    voxel = (upper - lower) / problem["density"].shape
    return problem | {
        "density": np.pad(problem["density"], 1),
        "lower": lower - voxel,
        "upper": upper + voxel,
        "sigma_t": problem["sigma_t"][None],
        "albedo": problem["albedo"][None],
        "g": problem["g"][None],
    }


def scene(problem):
    middle = (problem["lower"] + problem["upper"]) / 2
    half = (problem["upper"] - problem["lower"]) / 2
    inside = medium(problem, 0, filter_type="trilinear") | {"sample_emitters": True}
    pixels = int(problem["pixels"])
    return mi.load_dict(
        {
            "type": "scene",
            "sun": {
                "type": "directional",
                "direction": problem["direction"].tolist(),
                "irradiance": float(problem["irradiance"]),
            },
            "box": {
                "type": "cube",
                "to_world": Transform().translate(middle.tolist()).scale(half.tolist()),
                "bsdf": {"type": "null"},
                "interior": inside,
            },
            "camera": {
                "type": "perspective",
                "to_world": Transform().look_at(problem["eye"].tolist(), [0, 0, 0], [0, 0, 1]),
                "fov": float(problem["angle"]),
                "film": {
                    "type": "hdrfilm",
                    "width": pixels,
                    "height": pixels,
                    "rfilter": {"type": "box"},
                    "component_format": "float32",
                },
                "sampler": {"type": "independent", "sample_count": int(problem["samples"])},
            },
            "integrator": {"type": "volpath", "max_depth": -1, "rr_depth": MANY},
        }
    )


def render(problem):
    loaded = scene(padded(problem))
    pictures = [
        np.array(mi.render(loaded, seed=int(seed)))[::-1, :, :3] for seed in problem["seeds"]
    ]
    return {"pictures": np.mean(pictures, axis=-1)}


if __name__ == "__main__":
    np.savez(sys.argv[2], **render(dict(np.load(sys.argv[1]))))
