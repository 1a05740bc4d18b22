# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks that behave in ways that a process of its own has to be proof against."""

import os
import time
from dataclasses import dataclass

from lb_lighting.errors import DeviceError
from lb_lighting.transport import device
from lb_lighting.transport.solver import solve


@dataclass
class Solve:
    """Solve a medium, tell how far it is, return the field."""

    medium: object
    lights: list
    settings: object
    device: str | None = None

    def run(self, tell, _folder):
        def progress(stage, fraction):
            tell(stage=stage, fraction=fraction)

        return solve(self.medium, self.lights, self.settings, self.device, progress)


@dataclass
class Idle:
    """Tell where it is, and work for a minute."""

    scraps: tuple = ()

    def run(self, tell, _folder):
        tell(stage="idle", fraction=0.5)
        time.sleep(60)


class Toil:
    """Work without a word, for some seconds of a processor's time."""

    def run(self, _tell, _folder):
        while time.process_time() < 2:
            sum(range(10_000))


@dataclass
class Fail:
    """Raise `error`."""

    error: Exception

    def run(self, _tell, _folder):
        raise self.error


class ReadAndFail:
    """Fail as nobody expects, while a grid is held: OpenVDB tells of that when Python ends."""

    def run(self, _tell, _folder):
        import openvdb

        self.grid = openvdb.FloatGrid()
        raise ZeroDivisionError("division by zero")


class Chatter:
    """Print as drivers do, and return a number."""

    def run(self, tell, _folder):
        print("chatter")
        os.write(1, b"chatter of a driver")
        tell(stage="talk", fraction=1.0)
        return 42


def refused():
    """An error as the worker may raise it."""
    return DeviceError("The device is asleep; wake it.")


@dataclass
class Die:
    """Run `code` on the first OpenCL device, as its driver might; return the device's label."""

    code: str

    def run(self, _tell, _folder):
        chosen = device.choose()
        if chosen.kind != "NumPy":
            exec(self.code)
        return chosen.label
