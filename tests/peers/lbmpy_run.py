# SPDX-License-Identifier: GPL-3.0-or-later
"""lbmpy's steps of a D3Q19 lattice: FP32, all 19 directions, one fluid, only cells, OpenMP.

    python lbmpy_run.py EDGE THREADS

Generates and compiles the candidates for EDGE^3 cells (a minute or two), and prints the list of
their names in one line. For every line "INDEX STEPS" on its standard input, with an even number of
steps, it then runs the steps of that candidate and prints the seconds.
"""

import json
import sys
from dataclasses import replace
from itertools import product
from time import perf_counter

import numpy as np
import pystencils as ps
from lbmpy import LBMConfig, LBMOptimisation, LBStencil, Method, Stencil, create_lb_update_rule
from lbmpy.advanced_streaming.utility import get_timesteps, is_inplace

PATTERNS = ("esotwist", "esopull", "aa", "pull")
METHODS = (Method.SRT, Method.TRT)
LANES = 8  # of AVX2, by intrinsics; 0 leaves vectorization to the compiler
ALIGNMENT = 64  # bytes, of the first cell


def lattice(edge):
    """(edge + 2,)^3 cells of 19 floats, directions outermost, x innermost, at rest."""
    rows = edge + 2
    room = np.zeros(19 * rows**3 + ALIGNMENT, np.float32)
    start = (-room.ctypes.data // 4 - 1) % (ALIGNMENT // 4)
    cells = room[start : start + 19 * rows**3].reshape(19, rows, rows, rows).T
    cells[...] = 0.01
    return cells


def configuration(threads, lanes):
    """The configuration with which pystencils generates C++."""
    config = ps.CreateKernelConfig(
        target=ps.Target.X86_AVX, default_dtype="float32", ghost_layers=1
    )
    config.cpu.openmp.enable, config.cpu.openmp.num_threads = True, threads
    if lanes:
        vectors = config.cpu.vectorize
        vectors.enable, vectors.lanes = True, lanes
        vectors.assume_inner_stride_one = True
    return config


class Candidate:
    """One of lbmpy's steps: two alternating kernels in place, or two lattices."""

    def __init__(self, edge, threads, pattern, method, lanes):
        self.name = f"{pattern}, {method.name}, {'AVX2' if lanes else 'compiler'}"
        stencil = LBStencil(Stencil.D3Q19)
        self.lattices = [lattice(edge) for _ in range(1 if is_inplace(pattern) else 2)]
        fields = [
            ps.Field.create_from_numpy_array(name, cells, index_dimensions=1)
            for name, cells in zip(("src", "dst"), self.lattices, strict=False)
        ]
        names = ("symbolic_field", "symbolic_temporary_field")
        optimisation = LBMOptimisation(**dict(zip(names, fields, strict=False)))
        rates = {Method.SRT: [1.5], Method.TRT: [1.5, 1.2]}[method]
        lbm = LBMConfig(
            stencil=stencil, method=method, relaxation_rates=rates, streaming_pattern=pattern
        )
        config = configuration(threads, lanes)
        self.kernels = []
        for timestep in get_timesteps(pattern):
            rule = create_lb_update_rule(
                lbm_config=replace(lbm, timestep=timestep), lbm_optimisation=optimisation
            )
            self.kernels.append(ps.create_kernel(rule, config).compile())

    def seconds(self, steps):
        """Seconds of the given steps."""
        there = dict(zip(("src", "dst"), self.lattices, strict=False))
        back = dict(zip(("src", "dst"), self.lattices[::-1], strict=False))
        begin = perf_counter()
        for _ in range(steps // 2):
            self.kernels[0](**there)
            self.kernels[-1](**back)
        return perf_counter() - begin


def main(edge, threads):
    choices = list(product(PATTERNS, METHODS, (LANES, 0)))
    candidates = [Candidate(edge, threads, *choice) for choice in choices]
    print(json.dumps([candidate.name for candidate in candidates]), flush=True)
    for line in sys.stdin:
        index, steps = map(int, line.split())
        print(candidates[index].seconds(steps), flush=True)
        if not all(np.isfinite(cells).all() for cells in candidates[index].lattices):
            sys.exit("This step of lbmpy's diverged.")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
