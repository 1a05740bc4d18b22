# SPDX-License-Identifier: GPL-3.0-or-later
"""Mitsuba's picture of a voxel medium under a uniform sky of radiance 1.

    python mitsuba_image.py PROBLEM.npz PICTURE.npz

PROBLEM.npz (lengths in m):
    density     (nx, ny, nz), constant in a voxel
    lower, upper  (3,) corners of the box of voxels
    sigma_t     (bands,) 1/m, extinction at density 1
    albedo, g   (bands,)
    direction   (3,) of the camera's parallel rays, aimed at the centre of the box
    width       of the square that the camera sees, perpendicular to its rays
    pixels      along an edge of the picture
    samples     paths per pixel and band
    seed        int
PICTURE.npz:
    mean, error  (bands, pixels, pixels), radiance and its standard error, by row and column
    origins     (pixels, pixels, 3), origin of the ray through the first corner of each pixel
    right, down  (3,), the edges of a pixel; its rays start uniformly on their parallelogram
"""

import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")  # the others need a GPU or LLVM's library
mi.set_log_level(mi.LogLevel.Error)
from mitsuba import ScalarTransform4f as Transform  # noqa: E402 - only now there is a variant

MANY = 1_000_000  # collisions before Russian roulette


def medium(problem, band, filter_type="nearest"):
    """The medium in Mitsuba, whose grids have x as the fastest axis and fill [0, 1]^3."""
    extinction = problem["density"] * problem["sigma_t"][band]
    grid = np.ascontiguousarray(extinction.transpose(2, 1, 0)[..., None], np.float32)
    size = problem["upper"] - problem["lower"]
    return {
        "type": "heterogeneous",
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(grid),
            "filter_type": filter_type,
            "to_world": Transform().translate(problem["lower"].tolist()).scale(size.tolist()),
        },
        "albedo": {
            "type": "constvolume",
            "value": {"type": "rgb", "value": [float(problem["albedo"][band])] * 3},
        },
        "phase": {"type": "hg", "g": float(problem["g"][band])},
        # Light sampling of a uniform sky is expensive and reduces little noise.
        "sample_emitters": False,
    }


def camera(problem):
    """A camera with parallel rays that start outside the box."""
    lower, upper = problem["lower"], problem["upper"]
    direction = problem["direction"] / np.linalg.norm(problem["direction"])
    middle = (lower + upper) / 2
    start = middle - np.linalg.norm(upper - lower) * direction
    aside = np.eye(3)[np.argmin(np.abs(direction))]
    half, pixels = float(problem["width"]) / 2, int(problem["pixels"])
    view = Transform().look_at(start.tolist(), middle.tolist(), aside.tolist())
    return {
        "type": "orthographic",
        "to_world": view.scale([half, half, 1]),
        "film": {
            "type": "hdrfilm",
            "width": pixels,
            "height": pixels,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        },
        "sampler": {"type": "independent", "sample_count": int(problem["samples"])},
    }


def scene(problem, band):
    middle = (problem["lower"] + problem["upper"]) / 2
    half = (problem["upper"] - problem["lower"]) / 2
    return mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "constant", "radiance": 1.0},
            "box": {
                "type": "cube",
                "to_world": Transform().translate(middle.tolist()).scale(half.tolist()),
                "bsdf": {"type": "null"},
                "interior": medium(problem, band),
            },
            "camera": camera(problem),
            "integrator": {
                "type": "moment",
                "paths": {"type": "volpath", "max_depth": -1, "rr_depth": MANY},
            },
        }
    )


def picture(problem, band):
    """(mean, error) of one band, each (pixels, pixels).

    The integrator returns the mean of the samples and of their squares in XYZ. The light is grey,
    so Y is the radiance.
    """
    loaded = scene(problem, band)
    values = np.array(mi.render(loaded, seed=int(problem["seed"]) + band), float)
    first = values.shape[2] - len(loaded.integrator().aov_names())
    names = loaded.integrator().aov_names()
    mean, square = (values[..., first + names.index(name)] for name in ("paths.Y", "m2_paths.Y"))
    variance = np.maximum(0, square - mean**2)  # 0 up to rounding where no light is absorbed
    return mean, np.sqrt(variance / (int(problem["samples"]) - 1))


def ray_starts(problem):
    """{origins, right, down}: the origins of the rays of each pixel, as reported by Mitsuba."""
    sensor, pixels = mi.load_dict(camera(problem)), int(problem["pixels"])

    def start(row, column):
        ray, _ = sensor.sample_ray(0, 0.5, (column / pixels, row / pixels), (0.5, 0.5))
        return np.array(ray.o, float)

    origins = np.array([[start(i, j) for j in range(pixels)] for i in range(pixels)])
    right, down = start(0, 1) - start(0, 0), start(1, 0) - start(0, 0)
    return {"origins": origins, "right": right, "down": down}


def render(problem):
    pictures = [picture(problem, band) for band in range(len(problem["albedo"]))]
    mean, error = map(np.array, zip(*pictures, strict=True))
    return {"mean": mean, "error": error, **ray_starts(problem)}


if __name__ == "__main__":
    np.savez(sys.argv[2], **render(dict(np.load(sys.argv[1]))))
