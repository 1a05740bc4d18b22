# SPDX-License-Identifier: GPL-3.0-or-later
"""The devices that can solve: OpenCL's, and NumPy where there is none.

pyopencl is imported on demand, so that this module also loads where it is not installed.
"""

import os
import warnings
from dataclasses import dataclass
from functools import cache
from math import ceil
from pathlib import Path

import numpy as np

from ..errors import DeviceError

_SOURCES = Path(__file__).parent.parent / "kernels"
_BEST_FIRST = ("GPU", "ACCELERATOR", "CPU")

# Denormals cut the speed to a twentieth on CPUs, and no picture sees them.
_BUILD_OPTIONS = "-cl-std=CL1.2 -cl-denorms-are-zero -cl-mad-enable"


@dataclass(frozen=True)
class Device:
    """A device as the user sees it.

    name, platform  as the driver says
    kind            "GPU", "ACCELERATOR", "CPU", or "NumPy"
    memory          bytes that a solve may use in all
    largest_buffer  bytes that one buffer may have
    """

    name: str
    platform: str
    kind: str
    memory: int
    largest_buffer: int

    @property
    def shares_memory(self):
        """Whether the arrays of the host take from the same memory."""
        return self.kind in ("CPU", "NumPy")

    @property
    def label(self):
        return self.name if self.kind == "NumPy" else f"{self.name} [{self.platform}]"

    @property
    def line(self):
        return f"{self.label}: {self.kind}, {self.memory / 2**30:.1f} GiB"


def _available_memory():
    """Bytes of the machine's memory that are free now, or its best guess where none is told."""
    try:
        with open("/proc/meminfo") as lines:
            fields = dict(line.split(":") for line in lines)
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError):
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 2**63  # not told (Windows): the allocation itself will have to fail


def numpy_device():
    """The fallback that is always there."""
    memory = _available_memory()
    return Device("NumPy (no OpenCL)", "NumPy", "NumPy", memory, memory)


@cache
def _opencl():
    """{Device: pyopencl device}, the fastest kind first; empty where there is no OpenCL."""
    try:
        import pyopencl as cl

        platforms = cl.get_platforms()
    except Exception:
        # No pyopencl, no loader, or no platform: each driver fails in its own way, and all of
        # them mean that there is nothing to run on.
        return {}
    found = {}
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:  # a platform without devices
            continue
        for handle in handles:
            found[_describe(platform, handle)] = handle
    return dict(sorted(found.items(), key=lambda item: _BEST_FIRST.index(item[0].kind)))


def _describe(platform, handle):
    import pyopencl as cl

    kinds = {cl.device_type.GPU: "GPU", cl.device_type.CPU: "CPU"}
    kind = next((name for bit, name in kinds.items() if handle.type & bit), "ACCELERATOR")
    memory = handle.global_mem_size
    if kind == "CPU":
        memory = min(memory, _available_memory())
    return Device(
        handle.name.strip(),
        f"{platform.name.strip()}, {platform.version.split('  ')[0].strip()}",
        kind,
        memory,
        handle.max_mem_alloc_size,
    )


def devices():
    """Every device that can solve, the one chosen by default first, NumPy last."""
    return [*_opencl(), numpy_device()]


def choose(wanted=None):
    """The device that `wanted` names: None, a `Device`, or part of a label, case ignored.

    None takes the first of `devices()`. A name that fits none is a DeviceError that lists them.
    """
    if isinstance(wanted, Device):
        return wanted
    for device in devices():
        if not wanted or wanted.casefold() in device.label.casefold():
            return device
    known = "; ".join(device.label for device in devices())
    raise DeviceError(f"There is no device called '{wanted}'; choose one of: {known}.")


def require_memory(device, shape, plan):
    """Refuse a lattice that does not fit, before anything is allocated.

    plan  function of a shape that returns ({what: bytes} of buffers on the device, bytes of
          arrays on the host); the second counts where the device shares the host's memory
    Returns the bytes to be had; DeviceError says the largest resolution that fits.
    """
    if _fits(device, *plan(shape)):
        return _total(device, *plan(shape))
    low, high = 0, max(shape)
    while high - low > 1:  # the largest edge that fits lies in [low, high)
        resolution = (low + high) // 2
        scaled = [max(1, ceil(n * resolution / max(shape))) for n in shape]
        low, high = (resolution, high) if _fits(device, *plan(scaled)) else (low, resolution)
    raise DeviceError(
        f"{' x '.join(map(str, shape))} voxels need {_total(device, *plan(shape)) / 2**30:.1f} "
        f"GiB, and {device.label} can take {device.memory / 2**30:.1f} GiB "
        f"({device.largest_buffer / 2**30:.1f} GiB in one piece); "
        f"the largest resolution that fits is {low}."
    )


def _total(device, buffers, arrays):
    return sum(buffers.values()) + (arrays if device.shares_memory else 0)


def _fits(device, buffers, arrays):
    return (
        max(buffers.values()) <= device.largest_buffer
        and _total(device, buffers, arrays) <= device.memory
    )


@cache
def context(device):
    """The context of an OpenCL device, one a process."""
    import pyopencl as cl

    handles = _opencl()
    if device not in handles:
        raise DeviceError(f"The device {device.label} is gone; choose another.")
    return cl.Context([handles[device]])


@cache
def queue(device):
    """The command queue of an OpenCL device, one a process."""
    import pyopencl as cl

    return cl.CommandQueue(context(device))


@cache
def program(device, sources, defines):
    """A built program, kept for the process; pyopencl keeps the binary for later ones.

    sources  name of a file in kernels/, or names of files to be built as one
    defines  tuple of "NAME" or "NAME=value"
    """
    import pyopencl as cl

    names = (sources,) if isinstance(sources, str) else sources
    text = "\n".join((_SOURCES / name).read_text() for name in names)
    options = [*_BUILD_OPTIONS.split(), *(f"-D{define}" for define in defines)]
    try:
        with warnings.catch_warnings():
            # Drivers chat about how well they optimized; errors come as exceptions.
            warnings.simplefilter("ignore", cl.CompilerWarning)
            return cl.Program(context(device), text).build(options)
    except cl.RuntimeError as error:
        raise DeviceError(
            f"{device.label} cannot build {', '.join(names)}; update its driver or choose another "
            f"device. The driver said: {error}"
        ) from error


def upload(queue, values, kind=np.float32):
    """A buffer that holds values, as numbers of a kind, for kernels to read."""
    import pyopencl as cl

    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(queue.context, flags, hostbuf=np.ascontiguousarray(values, kind))


def zeros(queue, size):
    """A buffer of `size` bytes, all zero."""
    import pyopencl as cl

    buffer = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size)
    cl.enqueue_fill_buffer(queue, buffer, np.uint32(0), 0, size)
    return buffer
