# SPDX-License-Identifier: GPL-3.0-or-later
"""The devices that can solve: OpenCL's, and NumPy where there is none.

pyopencl is imported on demand, so that this module also loads where it is not installed.
"""

import logging
import os
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..arrays import Array
from ..errors import DeviceError
from . import caches

WITHOUT_OPENCL = "LB_LIGHTING_WITHOUT_OPENCL"  # environment variable: the reason, in a sentence

troubles: list[str] = []  # sentences about devices that should be there but cannot be used
# The context that drivers are loaded in: they can end a process, or never return.
loading: Callable[[], AbstractContextManager[Any]] = nullcontext

_log = logging.getLogger(__name__)  # quiet by default: nothing here is above INFO

_SOURCES = Path(__file__).parent.parent / "kernels"
_BEST_FIRST = ("GPU", "ACCELERATOR", "CPU")

# Denormals cut the speed to a twentieth on CPUs, and make no visible difference.
_BUILD_OPTIONS = "-cl-std=CL1.2 -cl-denorms-are-zero -cl-mad-enable"


@dataclass(frozen=True)
class Device:
    """A device as the user sees it.

    name, platform  as reported by the driver
    kind            "GPU", "ACCELERATOR", "CPU", or "NumPy"
    memory          bytes that a solve may use in total
    largest_buffer  largest size of one buffer, bytes
    """

    name: str
    platform: str
    kind: str
    memory: int
    largest_buffer: int

    @property
    def is_numpy(self) -> bool:
        """Whether NumPy computes, on the machine's processor."""
        return self.kind == "NumPy"

    @property
    def shares_memory(self) -> bool:
        """Whether arrays of the host use the same memory."""
        return self.kind in ("CPU", "NumPy")

    @property
    def label(self) -> str:
        """The name that the user sees and chooses by."""
        return self.name if self.is_numpy else f"{self.name} [{self.platform}]"

    @property
    def line(self) -> str:
        """The label with kind and memory."""
        return f"{self.label}: {self.kind}, {self.memory / 2**30:.1f} GiB"


def _available_memory() -> int:
    """Bytes of memory that are free now; all of it where the system reports no more than that."""
    try:
        with open("/proc/meminfo") as lines:
            fields = dict(line.split(":") for line in lines)
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError):
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 2**63  # Windows reports neither: too large an allocation fails then


def numpy_device() -> Device:
    """The fallback, which is always available."""
    memory = _available_memory()
    return Device("NumPy (no OpenCL)", "NumPy", "NumPy", memory, memory)


@cache
def _opencl() -> dict[Device, Any]:
    """{Device: pyopencl device}, the fastest kind first; empty without OpenCL."""
    if WITHOUT_OPENCL in os.environ:
        troubles.append(os.environ[WITHOUT_OPENCL])
        return {}
    with loading():
        handles = dict(_load())
    for device in handles:
        _log.info("Found %s", device.line)
    return dict(sorted(handles.items(), key=lambda item: _BEST_FIRST.index(item[0].kind)))


def _load() -> Iterator[tuple[Device, Any]]:
    """Load all drivers; yield (`Device`, pyopencl device) for each that can solve."""
    caches.prepare_drivers()
    # pyopencl's caches raise errors if a file is damaged, and wait for locks of ended processes.
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    try:
        import pyopencl as cl
    except Exception as error:
        if getattr(error, "name", None) != "pyopencl":  # installed, but incomplete
            troubles.append(f"OpenCL cannot be used: pyopencl does not load ({error}).")
        return
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # no driver is installed
        return
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:  # a platform without devices
            continue
        for handle in handles:
            try:
                if handle.available and handle.compiler_available:
                    yield _describe(platform, handle), handle
            except Exception as error:  # each driver fails in its own way
                troubles.append(f"A device of {platform.name} cannot be used ({error}).")


def _describe(platform: Any, handle: Any) -> Device:
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


def devices() -> list[Device]:
    """Every device that can solve, the one chosen by default first, NumPy last."""
    return [*_opencl(), numpy_device()]


def choose(choice: Device | str | None = None) -> Device:
    """The device that `choice` names: None, a `Device`, or part of a label, case ignored.

    None takes the first of `devices()` that opens. A name that starts with NumPy's loads no driver.
    Raises DeviceError, which lists all devices, if none matches.
    """
    if isinstance(choice, Device):
        return choice
    if not choice:
        return next(device for device in devices() if device.is_numpy or _opens(device))
    name, fallback = choice.strip(), numpy_device()
    if name.casefold().startswith("numpy") and _is_called(fallback, name):
        return fallback
    for device in devices():
        if _is_called(device, name):
            return device
    known = "; ".join(device.label for device in devices())
    missing = f"There is no device called '{name}'; choose one of: {known}."
    raise DeviceError(" ".join([*troubles, missing]))


def _is_called(device: Device, name: str) -> bool:
    return name.casefold() in device.label.casefold()


def _opens(device: Device) -> bool:
    """Whether an OpenCL device can be used; if not, `troubles` says so."""
    try:
        context(device)
    except DeviceError as error:
        if str(error) not in troubles:
            troubles.append(str(error))
        return False
    return True


@cache
def context(device: Device) -> Any:
    """The context of an OpenCL device, one per process. Raises DeviceError if it does not open."""
    import pyopencl as cl

    handles = _opencl()
    if device not in handles:
        raise DeviceError(f"The device {device.label} is gone; choose another.")
    try:
        return cl.Context([handles[device]])
    except Exception as error:  # each driver fails in its own way
        raise DeviceError(
            f"The device {device.label} does not open ({error}); close other programs that use it, "
            "or choose another device."
        ) from error


@cache
def queue(device: Device) -> Any:
    """The command queue of an OpenCL device, one per process."""
    import pyopencl as cl

    return cl.CommandQueue(context(device))


@cache
def program(device: Device, sources: str | tuple[str, ...], defines: tuple[str, ...]) -> Any:
    """A built program, cached for this process and on disk for later ones.

    sources  name of a file in kernels/, or names of files that are built as one
    defines  tuple of "NAME" or "NAME=value"
    """
    import pyopencl as cl

    names = (sources,) if isinstance(sources, str) else sources
    text = "\n".join((_SOURCES / name).read_text() for name in names)
    options = [*_BUILD_OPTIONS.split(), *(f"-D{define}" for define in defines)]
    try:
        with warnings.catch_warnings():
            # Drivers report how well they optimized as warnings; errors are exceptions.
            warnings.simplefilter("ignore", cl.CompilerWarning)
            start = perf_counter()
            cached = _cached(device, text, options)
            built = cached or _built(device, text, options)
            origin = "loaded from the cache" if cached else "built"
            _log.info("%s: %s in %.2f s", ", ".join(names), origin, perf_counter() - start)
            return built
    except cl.Error as error:
        raise DeviceError(
            f"{device.label} cannot build {', '.join(names)}; update its driver or choose another "
            f"device. The driver said: {error}"
        ) from error


def _cached(device: Device, text: str, options: Sequence[str]) -> Any:
    """The program from the cache, or None."""
    import pyopencl as cl

    binary = caches.find(_key(device, text, options))
    if binary is None:
        return None
    return _usable(cl.Program(context(device), context(device).devices, [binary]), options)


def _built(device: Device, text: str, options: Sequence[str]) -> Any:
    """The program, built from its text. Raises pyopencl.Error if that fails."""
    import pyopencl as cl
    from pyopencl.characterize import has_src_build_cache

    built = _usable(cl.Program(context(device), text), options)
    if built is None:
        # The driver's cache of this text may be damaged; a different text is built again.
        renamed = f"{text}\n__constant int unlike_{uuid.uuid4().hex} = 0;\n"
        return cl.Program(context(device), renamed).build(options)
    if not has_src_build_cache(context(device).devices[0]):
        binary = built.get_info(cl.program_info.BINARIES)[0]
        caches.keep(_key(device, text, options), binary)
    return built


def _usable(program: Any, options: Sequence[str]) -> Any:
    """The program, built; None if it does not build or has no kernels."""
    import pyopencl as cl

    try:
        program.build(options)
        return program if program.all_kernels() else None
    except cl.Error:
        return None


def _key(device: Device, text: str, options: Sequence[str]) -> str:
    handle = context(device).devices[0]
    return caches.key(device.label, handle.version, handle.driver_version, *options, text)


def upload(queue: Any, values: Array, kind: Any = np.float32) -> Any:
    """A read-only buffer of values, converted to a number type.

    OpenCL has no empty buffers: without values, the buffer holds one number that nothing reads.
    """
    import pyopencl as cl

    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    array = np.ascontiguousarray(values if np.size(values) else 0, kind)
    return cl.Buffer(queue.context, flags, hostbuf=array)


def zeros(queue: Any, size: int) -> Any:
    """A buffer of `size` bytes, all zero."""
    import pyopencl as cl

    buffer = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size)
    cl.enqueue_fill_buffer(queue, buffer, np.uint32(0), 0, size)
    return buffer
