# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding the devices that can solve."""

from ..transport import device


class Devices:
    """List the devices that can solve, the default first."""

    def run(self, _tell, _folder):
        """([str], a line for each; [sentence] about those that cannot be used)."""
        return [found.line for found in device.devices()], device.troubles
