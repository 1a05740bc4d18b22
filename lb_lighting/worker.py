# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's own process: no Blender in it, and no OpenCL in Blender's.

    python -m lb_lighting.worker FOLDER

The folder holds a task, any object with a method `run(tell, folder)`, once GO comes on stdin; what
that returns is kept beside it. It talks on stdout, one JSON object a line: what the task tells,
such as {"stage", "fraction"}, and {"error": kind, "text": sentence} where it cannot. A driver that
prints to stdout does no harm: the messages go to a copy of it, and the rest to stderr. It ends when
stdin does, for then whoever waits for it is gone.
"""

import json
import os
import sys
import threading
from pathlib import Path

from . import exchange
from .errors import DeviceError, LightingError, OutputError

TASK, RESULT = "task", "result"
GO = b"\n"


def main(folder):
    folder = Path(folder)
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def tell(**message):
        print(json.dumps(message), file=answers)

    def refuse(error, text):
        tell(error=error.__name__, text=text)
        return 1

    if not os.read(0, len(GO)):
        return 1
    task = exchange.load(folder / TASK)
    threading.Thread(target=_leave_with_parent, args=(task,), daemon=True).start()
    try:
        result = task.run(tell, folder)
        exchange.save(folder / RESULT, result)
    except LightingError as error:
        return refuse(type(error), str(error))
    except MemoryError:
        sentence = "There is not enough memory; close other programs or lower the resolution."
        return refuse(DeviceError, sentence)
    except OSError as error:
        sentence = f"The temporary folder {folder} cannot take the result ({error.strerror}); "
        return refuse(OutputError, sentence + "free some space there.")
    return 0


def remove_scraps(task):
    """Delete the files that an unfinished `task` may have left outside of its folder."""
    for path in getattr(task, "scraps", ()):
        Path(path).unlink(missing_ok=True)


def _leave_with_parent(task):
    while os.read(0, 1):  # not by sys.stdin, whose lock would be held when Python ends
        pass
    remove_scraps(task)
    os._exit(1)


if __name__ == "__main__":
    code = main(*sys.argv[1:])
    sys.stderr.flush()
    os._exit(code)  # drivers and OpenVDB at times crash when Python takes them down
