# SPDX-License-Identifier: GPL-3.0-or-later
"""MCX-CL on a voxel medium, on the OpenCL device that its loader finds first.

    python mcx_run.py PROBLEM.npz RESULT.npz

PROBLEM.npz (lengths in voxels, nothing reflects or refracts):
    levels    (nx, ny, nz) uint8, 0 to 254: the row of the coefficients of each voxel
    sigma_s, sigma_a  (255,)
    g         mean cosine of the Henyey-Greenstein phase function
    source    "planar", over the face z = 0, or "pencil", into its middle; both along +z
    photons   per run
    seeds     (runs,)
    threads   (runs, 2), in total and per block; 0 leaves both to MCX
RESULT.npz:
    fluence   (nx, ny, nz), mean of the runs, for one photon of energy 1: path length weighted by
              the remaining energy, over volume
    absorbed  (runs,) share of the energy
    kernel    (runs,) s of the kernel alone, as reported by MCX
    seconds   (runs,) s of the whole call, including the build of MCX's program
"""

import sys
from time import perf_counter

import numpy as np
import pmcxcl

FOREVER = 1e-6  # s: light travels 300000 voxels of 1 mm


def settings(problem):
    """The settings that all runs share."""
    nx, ny = problem["levels"].shape[:2]
    coefficients = np.zeros((256, 4), np.float32)  # row 0 is outside, where a path ends
    coefficients[1:, 0], coefficients[1:, 1] = problem["sigma_a"], problem["sigma_s"]
    coefficients[1:, 2], coefficients[:, 3] = problem["g"], 1
    planar = str(problem["source"]) == "planar"
    return {
        "vol": problem["levels"] + np.uint8(1),
        "prop": coefficients,
        "nphoton": int(problem["photons"]),
        "srctype": str(problem["source"]),
        "srcpos": [0, 0, 0] if planar else [nx / 2, ny / 2, 0],
        "srcdir": [0, 0, 1],
        "srcparam1": [nx, 0, 0, 0],
        "srcparam2": [0, ny, 0, 0],
        "issrcfrom0": 1,
        "isreflect": 0,
        "issavedet": 0,
        "outputtype": "fluence",
        "unitinmm": 1,
        "tstart": 0,
        "tend": FOREVER,
        "tstep": FOREVER,
        # MCX chooses float atomics for this device, which need OpenCL C 2.
        "compileropt": "-cl-std=CL3.0",
    }


def layout(threads):
    """MCX's settings for (threads in total, threads per block)."""
    total, block = map(int, threads)
    return {"autopilot": 0, "nthread": total, "nblocksize": block} if total else {"autopilot": 1}


def run(problem):
    common = settings(problem)
    fluence, absorbed, kernel, seconds = 0, [], [], []
    for seed, threads in zip(problem["seeds"], problem["threads"], strict=True):
        start = perf_counter()
        result = pmcxcl.run(**common, seed=int(seed), **layout(threads))
        seconds.append(perf_counter() - start)
        kernel.append(result["stat"]["runtime"] / 1000)
        absorbed.append(result["stat"]["energyabs"] / result["stat"]["energytot"])
        fluence += result["flux"][..., 0].astype(float) / len(problem["seeds"])
    return {"fluence": fluence, "absorbed": absorbed, "kernel": kernel, "seconds": seconds}


if __name__ == "__main__":
    np.savez(sys.argv[2], **run(dict(np.load(sys.argv[1]))))
