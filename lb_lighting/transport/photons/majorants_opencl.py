# SPDX-License-Identifier: GPL-3.0-or-later
"""The least linear majorants on an OpenCL device: kernels/photons/majorants.cl."""

import numpy as np
import pyopencl as cl

from ...arrays import Floats
from .. import device as devices
from ..device import Device
from .majorants import Problem
from .majorants_numpy import EXCHANGES, SMALLEST_PIVOT, TOLERANCE

_LANES = 16  # super-voxels that lie side by side in the kernel's memory


def least_corners(problem: Problem, device: Device) -> Floats:
    """Corner values (mx, my, mz, 8) of the least majorants of a `majorants.Problem`."""
    context, queue = devices.context(device), devices.queue(device)
    program = devices.program(device, "photons/majorants.cl", defines())
    count = int(np.prod(problem.cells))
    groups = -(-count // _LANES)
    corners = np.empty((*problem.cells, 8), np.float32)
    flags = cl.mem_flags
    values = cl.Buffer(context, flags.READ_ONLY | flags.USE_HOST_PTR, hostbuf=problem.values)
    scratch = cl.Buffer(
        context, flags.READ_WRITE, 4 * _LANES * groups * int(np.prod(problem.nodes))
    )
    result = cl.Buffer(context, flags.WRITE_ONLY, corners.nbytes)
    make_int3 = cl.cltypes.make_int3  # type: ignore[attr-defined]  # made when it is imported
    triples = [make_int3(*t) for t in (problem.fine, problem.cells, problem.nodes)]
    fit = cl.Kernel(program, "fit")
    options = np.int32(problem.size), np.int32(problem.blocky)
    fit(queue, (groups * _LANES,), (_LANES,), values, *triples, *options, scratch, result)
    cl.enqueue_copy(queue, corners, result)
    return corners


def defines() -> tuple[str, ...]:
    return (
        f"LANES={_LANES}",
        f"EXCHANGES={EXCHANGES}",
        f"TOLERANCE={TOLERANCE}f",
        f"SMALLEST_PIVOT={SMALLEST_PIVOT}f",
    )
