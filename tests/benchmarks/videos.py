# SPDX-License-Identifier: GPL-3.0-or-later
"""The talk's two videos: seconds per frame to light a cloud of 4096^3 effective voxels.

In the first video the cloud is constant, with 5 million photons per frame; in the second it
changes, with 50 million. Frames with two smaller numbers of photons are timed here. The time of a
frame is a constant plus a part proportional to the photons, which is scaled to the talk's numbers.
The field has 128^3 voxels; there are 128^3 super-voxels as in the talk, or the automatic number.
"""

import sys
from time import perf_counter

import numpy as np

from lb_lighting.transport import Sun, device
from lb_lighting.transport.photons.perlin import PerlinMedium
from lb_lighting.transport.photons.trace import trace
from tests.benchmarks.freepath import markdown
from tests.benchmarks.freepath_noise import CONTRASTS
from tests.benchmarks.table import publish

RESOLUTION, CELLS = 4096, 128
DEPTH, ALBEDO, G = 10.0, 0.99, 0.85  # the first is the mean from face to face
SUN = Sun((0.3, 0.2, -0.93), 1.0)
# Name: (time step between frames, the talk's photons per frame, the talk's seconds)
VIDEOS = {"static": (0.0, 5_000_000, 1.0), "changing": (0.25, 50_000_000, 9.0)}
PHOTONS = (25_000, 100_000)
FRAMES = 3


def mean_density():
    shape = CONTRASTS["middle"]
    return PerlinMedium(RESOLUTION, 1.0, 0, 1, **shape).voxels(64).density.mean(dtype=float)


def frame(number, speed, sigma_t, supervoxel, photons):
    """(seconds, `Field`) of one frame; everything except the programs is rebuilt."""
    start = perf_counter()
    sigma_s, sigma_a = sigma_t * ALBEDO, sigma_t * (1 - ALBEDO)
    medium = PerlinMedium(
        RESOLUTION, 1.0, sigma_s, sigma_a, G, time=number * speed, **CONTRASTS["middle"]
    )
    field = trace(
        *(medium, [SUN], photons),
        seed=number,
        supervoxel=supervoxel,
        tallied=CELLS,
        flux=False,  # a picture needs only the fluence
    )
    return perf_counter() - start, field


def row(name, sigma_t, supervoxel):
    speed, wanted, talk = VIDEOS[name]
    frame(0, speed, sigma_t, supervoxel, 1000)  # builds the programs
    built = device.program.cache_info().misses
    medians = []
    for photons in PHOTONS:
        timed = [frame(n + 1, speed, sigma_t, supervoxel, photons) for n in range(FRAMES)]
        medians.append(float(np.median([seconds for seconds, _ in timed])))
    reports = [field.report for _, field in timed]
    each = (medians[1] - medians[0]) / (PHOTONS[1] - PHOTONS[0])
    fixed = medians[0] - each * PHOTONS[0]
    return {
        "video": name,
        "super-voxels": f"{RESOLUTION // supervoxel}³" if supervoxel else "automatic",
        "photons/s": 1 / each,
        "collisions/photon": float(
            sum(r.collisions[0] for r in reports) / sum(r.photons for r in reports)
        ),
        "same for all frames, s": fixed,
        "of it to prepare, s": float(np.median([r.seconds["prepare"] for r in reports])),
        "million photons a frame": wanted // 1_000_000,
        "s a frame": fixed + each * wanted,
        "talk, s a frame": talk,
        "programs built": device.program.cache_info().misses - built,
        "photons timed": PHOTONS[1],
    }


def main():
    found = device.choose()
    sigma_t = DEPTH / mean_density()
    sizes = (RESOLUTION // CELLS, None)
    rows = [row(name, sigma_t, size) for name in VIDEOS for size in sizes]
    publish("videos", found.label, rows)
    print(f"\n{markdown(rows)}")
    if any(row["programs built"] for row in rows):
        sys.exit("A new density rebuilt a program.")


if __name__ == "__main__":
    main()
