# SPDX-License-Identifier: GPL-3.0-or-later
"""What every step of a physical solve needs besides the medium and its lights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .device import Device
from .field import Clock
from .monitor import Monitor

if TYPE_CHECKING:
    from .solver import Settings


@dataclass(frozen=True)
class Context:
    """The settings of a solve, the device that runs it, its clock and its monitor."""

    settings: Settings
    device: Device
    clock: Clock
    monitor: Monitor

    @property
    def is_single(self) -> bool:
        """Whether the solve stops at the first collision."""
        return self.settings.scattering == "single"

    def part(self, begin: float, share: float) -> Context:
        """The context of a part of the work, in fractions as of `Monitor.part`."""
        return replace(self, monitor=self.monitor.part(begin, share))

    def uncollided_only(self) -> Context:
        """The context of a silent solve for uncollided light alone."""
        settings = replace(self.settings, scattering="single")
        return replace(self, settings=settings, monitor=self.monitor.silent())
