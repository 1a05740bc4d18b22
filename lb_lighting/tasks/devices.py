# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding the devices that can solve."""

from pathlib import Path

from ..transport import device
from . import Send


class Devices:
    """List the devices that can solve, the default first."""

    def run(self, _send: Send, _folder: Path) -> tuple[list[str], list[str]]:
        """(lines, one for each device; sentences on those that cannot be used)."""
        return [found.line for found in device.devices()], device.troubles
