# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory of a solve, known before anything is allocated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import ceil

from ..errors import DeviceError
from .device import Device

FLOAT, DOUBLE = 4, 8  # bytes of a number


@dataclass(frozen=True)
class Footprint:
    """The memory of a solve, by what it holds.

    device  {what: bytes} of buffers on the device
    host    {what: bytes} of arrays in the host's memory
    """

    device: dict[str, int]
    host: dict[str, int] = field(default_factory=dict)

    @property
    def on_device(self) -> int:
        """Bytes of all buffers."""
        return sum(self.device.values())

    @property
    def on_host(self) -> int:
        """Bytes of all arrays."""
        return sum(self.host.values())

    @property
    def total(self) -> int:
        """Bytes of both."""
        return self.on_device + self.on_host

    def on(self, device: Device) -> int:
        """Bytes that count against a device's memory: the host's, too, if they share one."""
        return self.total if device.shares_memory else self.on_device

    def fits(self, device: Device) -> bool:
        """Whether it fits into the memory of a device."""
        largest = max(self.device.values())
        return largest <= device.largest_buffer and self.on(device) <= device.memory

    def or_larger(self, other: "Footprint") -> "Footprint":
        """The larger memory on the device and on the host, of two pieces of work that do not run at
        the same time."""
        device = max(self.device, other.device, key=lambda buffers: sum(buffers.values()))
        return Footprint(
            device, max(self.host, other.host, key=lambda arrays: sum(arrays.values()))
        )


def require_memory(
    device: Device, shape: Sequence[int], footprint: Callable[[Sequence[int]], Footprint]
) -> int:
    """Refuse a grid that does not fit, before anything is allocated.

    footprint  returns the `Footprint` of a shape
    Returns the bytes that the shape needs. Raises DeviceError with the largest resolution
    that fits.
    """
    needed = footprint(shape)
    if needed.fits(device):
        return needed.on(device)
    low, high = 0, max(shape)
    while high - low > 1:  # the largest edge that fits lies in [low, high)
        resolution = (low + high) // 2
        scaled = [max(1, ceil(n * resolution / max(shape))) for n in shape]
        low, high = (resolution, high) if footprint(scaled).fits(device) else (low, resolution)
    raise DeviceError(
        f"{' x '.join(map(str, shape))} voxels need {needed.on(device) / 2**30:.1f} "
        f"GiB, and {device.label} can use {device.memory / 2**30:.1f} GiB "
        f"({device.largest_buffer / 2**30:.1f} GiB in one piece); "
        f"the largest resolution that fits is {low}."
    )
