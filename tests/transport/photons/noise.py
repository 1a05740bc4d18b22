# SPDX-License-Identifier: GPL-3.0-or-later
"""Media of fractal noise for the tests, and the kernels' noise at any points."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import lb_lighting
from lb_lighting.transport import device
from lb_lighting.transport.photons.perlin import FINEST, STRONG, WEAK, PerlinMedium

OPENCL = [found for found in device.devices() if found.kind != "NumPy"]
on_each_device = pytest.mark.parametrize(
    "found", OPENCL, ids=lambda found: found.platform.split(",")[0]
)

EVALUATE = """
__kernel void evaluate(__global const float *point, __global const float *threshold,
                       __global float *noise, __global float *density, __global int *exceeds,
                       PERLIN_PARAMETERS)
{
    const int i = get_global_id(0);
    const float x = point[3 * i], y = point[3 * i + 1], z = point[3 * i + 2];
    noise[i] = perlin_noise(PERLIN, x, y, z);
    density[i] = perlin_density(PERLIN, x, y, z);
    exceeds[i] = perlin_exceeds(PERLIN, x, y, z, threshold[i]);
}
"""


def perlin(resolution=256, **noise):
    return PerlinMedium(resolution, 1.0, 1.0, 0.0, **noise)


# Between them: every kind of parameter, times between frames and before the first, the largest
# resolution, and one octave alone.
MEDIA = {
    "weak": perlin(256, **WEAK),
    "strong": perlin(4096, **STRONG, seed=1),
    "finest": perlin(FINEST, **STRONG, seed=2**32 - 1, persistence=0.7),
    "moving": perlin(1024, cutoff=0.3, power=1.7, time=3.37, seed=7),
    "past": perlin(FINEST, cutoff=0.45, power=1, time=-2.25, coarsest=1),
    "rough": perlin(96, cutoff=0.48, power=9.5, persistence=1, coarsest=3, seed=5),
    "steep": perlin(512, cutoff=0.62, power=64, seed=3),
    "smooth": perlin(8, **WEAK, coarsest=8, persistence=0),
}


@cache
def evaluator(found):
    import pyopencl as cl

    kernels = Path(lb_lighting.__file__).parent / "kernels"
    needed = ("photons/random.cl", "photons/perlin.cl")
    source = "".join((kernels / name).read_text() for name in needed) + EVALUATE
    program = cl.Program(device.context(found), source).build(device._BUILD_OPTIONS.split())
    return cl.Kernel(program, "evaluate")


def on_device(found, medium, points, thresholds=None):
    """(noise, density, exceeds) at points (n, 3), as the kernels' functions have them."""
    import pyopencl as cl

    context, queue, flags = device.context(found), device.queue(found), cl.mem_flags
    count = len(points)
    thresholds = np.zeros(count) if thresholds is None else thresholds
    inputs = [np.ascontiguousarray(values, np.float32) for values in (points, thresholds)]
    outputs = [np.empty(count, kind) for kind in (np.float32, np.float32, np.int32)]
    copy = flags.READ_ONLY | flags.COPY_HOST_PTR
    buffers = [cl.Buffer(context, copy, hostbuf=values) for values in inputs]
    buffers += [cl.Buffer(context, flags.WRITE_ONLY, values.nbytes) for values in outputs]
    evaluator(found)(queue, (count,), None, *buffers, *medium.device_arguments)
    for values, buffer in zip(outputs, buffers[2:], strict=True):
        cl.enqueue_copy(queue, values, buffer)
    return outputs


def random_points(medium, count, seed=0):
    """(count, 3) float32 in the domain, a third of their coordinates at lattice planes."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3)) * medium.resolution
    planes = np.round(points * rng.choice([1, 1 / 4, 1 / 64], points.shape))
    return np.where(rng.random(points.shape) < 1 / 3, planes, points).astype(np.float32)
