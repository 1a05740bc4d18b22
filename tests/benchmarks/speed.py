# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed of the steps and solves of the physical lattice on every runtime, in one run.

    python -m tests.benchmarks.speed [steps corrections sweeps solves empty growth problems]

steps   million voxels per second of the paper's kernels, of ours, and of ours without collision
        (the roof), and the speed of a plain copy, GB/s
sweeps  seconds of a sun's sweep through a cloud, alone and with the work of NumPy, and of ten steps
corrections  the cost of a correction by coarser lattices, of a check of convergence, and of
        undoing a correction, in steps
solves  seconds of whole solves of a cloud by stage, from 32 to 192 voxels along an edge
empty   processor seconds of whole solves of a cloud that fills its domain, and of smaller clouds
        with empty space around them; other processes are not included
growth  like solves, for white cubes, 32 mean free paths deep
problems  the two problems of the paper, solved to 1 %, compared with the 2N steps of its final
        kernel, scaled from a few steps
"""

import sys
from itertools import product
from math import prod
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import pyopencl as cl

from lb_lighting.transport import Settings, Sky, Sun, device, solve
from lb_lighting.transport.backend import backend_of
from lb_lighting.transport.box import Box
from lb_lighting.transport.lattice.convergence import ConvergenceMonitor
from lb_lighting.transport.lattice.lattice_numpy import Source
from lb_lighting.transport.lattice.lattice_opencl import OpenclLattice, _state_size, _stride
from lb_lighting.transport.lattice.layout import GROUP, Cells
from lb_lighting.transport.lattice.multigrid import Level
from lb_lighting.transport.lights.sampling import rank_1
from lb_lighting.transport.paper.collision import collision_matrix
from lb_lighting.transport.paper.model import boundary_inflow
from lb_lighting.transport.paper.paper_opencl import PaperLattice
from lb_lighting.transport.solver import KERNELS
from lb_lighting.transport.uncollided.casting import cast
from lb_lighting.transport.uncollided.sweep import Beam, Turn, Voxels
from lb_lighting.transport.uncollided.sweep_opencl import OpenclSweep
from tests.benchmarks.kernels import cloud
from tests.benchmarks.media import cloud as puffs
from tests.benchmarks.media import of_depth
from tests.benchmarks.table import publish

EDGES = (64, 128, 160)
SOLVED = (32, 64, 96, 128, 192)
# Voxels along the edge of a cloud, and empty ones around it; the third fills a tenth of its domain.
EMPTY = ((128, 0), (60, 17), (60, 34), (96, 8), (96, 16))
STEPS, RUNS = {"paper": 4, "ours": 20}, 4
SOLVES = 2  # the cheaper one counts
SUN = Sun((0.3, 0.2, -0.93), 1.0)
LIGHTS = {"sun": SUN, "even sky": Sky(1.0)}


def steps():
    for found in device.devices():
        if found.kind == "NumPy":
            continue
        for edge in EDGES:
            shape = (edge,) * 3
            speeds = {kernel: paper_speed(found, shape, kernel) for kernel in KERNELS}
            speeds["ours"] = our_speed(found, shape)
            speeds["roof"] = roof(found, shape)
            yield {
                "platform": found.platform.split(",")[0],
                "voxels": edge,
                **speeds,
                "ours / final": speeds["ours"] / speeds["final"],
                "ours / roof": speeds["ours"] / speeds["roof"],
                "copy, GB/s": copied(found, shape),
                "bytes a voxel": sum(OpenclLattice.buffers(shape, False).values()) / prod(shape),
            }


def fastest(run):
    """Seconds of the fastest of several runs, after an untimed one."""
    run()
    seconds = []
    for _ in range(RUNS):
        start = perf_counter()
        run()
        seconds.append(perf_counter() - start)
    return min(seconds)


def paper_speed(found, shape, kernel):
    medium = cloud(shape)
    lattice = PaperLattice(medium, False, found, kernel)
    omega = collision_matrix(medium.sigma_s[0], medium.sigma_a[0], medium.g[0])
    lattice.start(boundary_inflow([SUN], 1)[0], omega)
    count = STEPS["paper"]
    return prod(shape) * count / fastest(lambda: lattice.advance(count)) / 1e6


def stepped(lattice, count):
    """Take steps and wait for them."""
    lattice.advance(count)
    lattice.queue.finish()


def our_level(found, shape):
    """A started `Level` of a random medium."""
    rng = np.random.default_rng(0)
    level = Level(backend_of(found).lattice, rng.uniform(0.1, 2, shape), 0.95, 0.5)
    level.lattice.start(Source(rng.random(shape), np.zeros((3, *shape))))
    return level


def our_speed(found, shape):
    lattice, count = our_level(found, shape).lattice, STEPS["ours"]
    return prod(shape) * count / fastest(lambda: stepped(lattice, count)) / 1e6


def roof(found, shape):
    queue, kernels, buffers = _roof(found, 1, 4 * _state_size(Cells(shape)))
    cells, count = Cells(shape), STEPS["ours"]
    grid = [np.uint64(n) for n in (cells.plane, cells.row, _stride(cells), cells.first)]

    def run():
        for step in range(count):
            kernel = kernels["step_there" if step % 2 else "step_here"]
            kernel(queue, (cells.count,), (GROUP,), *grid, *buffers)
        queue.finish()

    return prod(shape) * count / fastest(run) / 1e6


def copied(found, shape):
    """GB/s, read and written, of a copy of the size of the light of a lattice."""
    floats = 18 * Cells(shape).count
    queue, kernels, buffers = _roof(found, 2, 4 * floats)

    def run():
        kernels["copy"](queue, (floats,), (GROUP,), *buffers)
        queue.finish()

    return 2 * 4 * floats / fastest(run) / 1e9


def _roof(found, buffers, size):
    """(queue, {name: kernel} of roof.cl, filled buffers of `size` bytes)."""
    context, queue = device.context(found), device.queue(found)
    roof_cl = str(Path(__file__).with_name("roof.cl"))
    program = device.program(found, ("lattice/layout.cl", roof_cl), (f"GROUP={GROUP}",))
    made = [cl.Buffer(context, cl.mem_flags.READ_WRITE, size) for _ in range(buffers)]
    for buffer in made:
        cl.enqueue_fill_buffer(queue, buffer, np.float32(0), 0, size)
    return queue, {kernel.function_name: kernel for kernel in program.all_kernels()}, made


def sweeps():
    for found in device.devices():
        if found.kind == "NumPy":
            continue
        for edge in EDGES:
            medium = of_depth(puffs(edge), 20, 0.99, 0.85)
            turn = Turn(2, medium.shape, Box.all(medium.shape))
            depth = turn.turned(medium.depth(medium.sigma_t[0]))
            sweep = OpenclSweep(turn, Voxels(depth, None, None, None), False, found)
            beam = Beam(np.divide(SUN.direction, np.linalg.norm(SUN.direction)), 1, turn, rank_1(9))
            yield {
                "platform": found.platform.split(",")[0],
                "voxels": edge,
                "sweep": fastest(lambda s=sweep, b=beam: (s.run([b]), s.read())),
                "whole": fastest(lambda m=medium, d=found: cast(m, SUN, 0, m.sigma_t[0], d, 3)),
                "ten steps": 10 * edge**3 / our_speed(found, medium.shape) / 1e6,
            }


def corrections():
    for found in device.devices():
        if found.kind == "NumPy":
            continue
        for edge in EDGES:
            took = correction(found, edge)
            rest = {what: seconds / took["step"] for what, seconds in took.items()}
            del rest["step"]
            named = {"platform": found.platform.split(",")[0], "voxels": edge}
            yield {**named, "step, ms": 1000 * took["step"], **rest}


def correction(found, edge):
    """{action: seconds}."""
    level = our_level(found, (edge,) * 3)
    lattice = level.lattice
    look, count = ConvergenceMonitor(lattice), STEPS["ours"]
    level.correct()
    return {
        "step": fastest(lambda: stepped(lattice, count)) / count,
        "correction": fastest(lambda: (level.correct(), lattice.queue.finish())),
        "take back": fastest(lambda: (level.take_back(), lattice.queue.finish())),
        "look": fastest(look.change),
    }


def solves():
    found = device.choose()
    for edge in SOLVED:
        medium = of_depth(puffs(edge), 20, 0.99, 0.85)
        report = solve(medium, [SUN], Settings(), found).report
        yield {
            "voxels": edge,
            "steps": report.steps,
            "corrections": report.corrections,
            **report.seconds,
            "ns a voxel and step": 1e9 * report.seconds["solve"] / edge**3 / report.steps,
        }


def empty():
    for found, (light, of_light) in product(device.devices(), LIGHTS.items()):
        if found.kind == "NumPy":
            continue
        full = before = None
        for edge, margin in EMPTY:
            medium = surrounded(of_depth(puffs(edge), 20, 0.99, 0.85), margin)
            seconds, report = processor_seconds(medium, of_light, found)
            full = full or seconds
            doubled = before is not None and before[:2] == (edge, margin / 2)
            yield {
                "platform": found.platform.split(",")[0],
                "light": light,
                "cloud": edge,
                "domain": edge + 2 * margin,
                "filled": (edge / (edge + 2 * margin)) ** 3,
                "steps": report.steps,
                "corrections": report.corrections,
                "uncollided, s": report.seconds["direct"],
                "processor s": seconds,
                "to the full one": seconds / full,
                "to half the margin": seconds / before[2] if doubled else "",
            }
            before = (edge, margin, seconds)


def surrounded(medium, margin):
    """The same medium with empty voxels around it."""
    return medium.altered(density=np.pad(medium.density, margin))


def processor_seconds(medium, light, found):
    """Processor seconds of all threads, and the report of a solve."""
    taken = []
    for _ in range(SOLVES):
        start = process_time()
        report = solve(medium, [light], Settings(), found).report
        taken.append(process_time() - start)
    return min(taken), report


def growth():
    found = device.choose()
    for edge in SOLVED:
        medium = of_depth(np.ones((edge,) * 3), 32, 1.0, 0.0)
        report = solve(medium, [SUN], Settings(), found).report
        yield {
            "voxels": edge,
            "steps": report.steps,
            "corrections": report.corrections,
            **report.seconds,
            "us a voxel": 1e6 * sum(report.seconds.values()) / edge**3,
        }


def problems():
    for found in device.devices():
        if found.kind == "NumPy":
            continue
        for shape in ((128, 128, 128), (256, 128, 128)):
            medium = cloud(shape)
            report = solve(medium, [SUN], Settings(divide=1), found).report
            seconds = sum(report.seconds.values())
            theirs = 2 * max(shape) * prod(shape) / paper_speed(found, shape, "final") / 1e6
            yield {
                "platform": found.platform.split(",")[0],
                "voxels": " x ".join(map(str, shape)),
                "steps": report.steps,
                "corrections": report.corrections,
                "uncollided, s": report.seconds["direct"],
                "lattice, s": report.seconds["solve"],
                "all, s": seconds,
                "2N steps of the paper's, s": theirs,
                "ratio": theirs / seconds,
            }


PARTS = {
    "steps": steps,
    "corrections": corrections,
    "sweeps": sweeps,
    "solves": solves,
    "empty": empty,
    "growth": growth,
    "problems": problems,
}


def main(parts):
    for part in parts or PARTS:
        publish(f"speed-{part}", device.choose().label, list(PARTS[part]()))


if __name__ == "__main__":
    main(sys.argv[1:])
