# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's own process: no Blender in it, and no OpenCL in Blender's.

    python -m lb_lighting.worker solve PROBLEM.npz FIELD.npz
    python -m lb_lighting.worker plan NX NY NZ MODEL DEVICE
    python -m lb_lighting.worker devices

It answers on stdout, one JSON object a line: {"stage", "fraction"} while it works,
{"devices": [line, ...]} or {"field": path} when done, nothing for a plan that fits,
{"error": kind, "text": sentence} where it cannot. A driver that prints to stdout does no harm:
the messages go to a copy of it, and the rest to stderr.
"""

import json
import os
import sys

from . import exchange
from .errors import DeviceError, LightingError
from .transport import device
from .transport.solver import Settings, require_memory, solve


def main(arguments):
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def say(**message):
        print(json.dumps(message), file=answers)

    try:
        if arguments == ["devices"]:
            say(devices=[found.line for found in device.devices()])
        elif arguments[0] == "plan":
            *shape, model, wanted = arguments[1:]
            require_memory(tuple(map(int, shape)), Settings(model=model), wanted)
        else:
            _, problem, result = arguments
            _solve(problem, result, say)
    except LightingError as error:
        say(error=type(error).__name__, text=str(error))
        return 1
    except MemoryError:
        say(
            error=DeviceError.__name__,
            text="There is not enough memory; close other programs or lower the resolution.",
        )
        return 1
    return 0


def _solve(problem, result, say):
    medium, lights, settings, wanted = exchange.load_problem(problem)
    field = solve(
        medium,
        lights,
        settings,
        wanted,
        progress=lambda stage, fraction: say(stage=stage, fraction=fraction),
    )
    exchange.save_field(result, field)
    say(field=result)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
