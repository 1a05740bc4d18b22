# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's own process: no Blender in it, and no OpenCL in Blender's.

    python -m lb_lighting.worker FOLDER

The folder holds a task, any object with a method `run(tell, folder)`, once GO comes on stdin; what
that returns is kept beside it. It talks on stdout, one JSON object a line: what the task tells,
such as {"stage", "fraction"}; {"drivers": LOADING or LOADED} around all that loads OpenCL's; from
time to time {"worked": s of processors' time}, for what is silent may be at work; and, where it
cannot, {"error": kind, "text": sentence}, or {"defect": what it died of}, whose traceback
is on stderr. A driver that prints to stdout does no harm: the messages go to a copy of it, and the
rest to stderr. It ends when stdin does, for then whoever waits for it is gone.
"""

import errno
import faulthandler
import json
import os
import sys
import tempfile
import threading
import time
import traceback
from contextlib import contextmanager
from pathlib import Path

from . import exchange
from .errors import DeviceError, LightingError, OutputError
from .transport import device

TASK, RESULT = "task", "result"
GO = b"\n"
LOADING, LOADED = "loading", "loaded"
BEAT = 1.0  # s between two messages of how much it has worked
LONGEST_LOAD = 120.0  # s: graphics drivers take some 10 on a machine that has nothing else to do
_FULL = {getattr(errno, name, None) for name in ("ENOSPC", "EDQUOT", "EFBIG")}


def main(folder):
    folder = Path(folder)
    answers, speaking = os.fdopen(os.dup(1), "w", buffering=1), threading.Lock()
    os.dup2(2, 1)

    def tell(**message):
        with speaking:  # threads do
            answers.write(json.dumps(message) + "\n")

    def refuse(error, text):
        tell(error=error.__name__, text=text)
        return 1

    if not os.read(0, len(GO)):
        return 1
    try:
        tempfile.tempdir = str(folder)  # where nothing is left
        device.loading = lambda: _loading(tell)
        task = exchange.load(folder / TASK)
        threading.Thread(target=_leave_with_parent, args=(task,), daemon=True).start()
        threading.Thread(target=_beat, args=(tell,), daemon=True).start()
        result = task.run(tell, folder)
        exchange.save(folder / RESULT, result)
    except LightingError as error:
        return refuse(type(error), str(error))
    except MemoryError:
        sentence = "There is not enough memory; close other programs or lower the resolution."
        return refuse(DeviceError, sentence)
    except Exception as error:
        if _is_full(error, folder):
            sentence = f"The temporary folder {folder} cannot take the result ({error.strerror}); "
            return refuse(OutputError, sentence + "free some space there.")
        if type(error).__module__.startswith("pyopencl"):
            sentence = f"The device failed ({error}); choose another device or a lower resolution."
            return refuse(DeviceError, sentence)
        traceback.print_exc()
        tell(defect=_summary(error))
        return 1
    return 0


def _beat(tell):
    """Tell from time to time how much was worked."""
    while True:
        time.sleep(BEAT)
        tell(worked=time.process_time())


@contextmanager
def _loading(tell):
    """Tell that drivers are loaded; end the process where that takes forever, though whoever waits
    is gone and the driver holds all threads of Python."""
    faulthandler.dump_traceback_later(2 * LONGEST_LOAD, exit=True)
    tell(drivers=LOADING)
    yield
    tell(drivers=LOADED)
    faulthandler.cancel_dump_traceback_later()


def _is_full(error, folder):
    """Whether an error tells that no more can be written."""
    if not isinstance(error, OSError):
        return False
    return error.errno in _FULL or str(error.filename).startswith(str(folder))


def _summary(error):
    """What a defect is, and where."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(traceback.format_exception_only(error)[-1].split())
    return f"{what} ({where.name}, line {where.lineno} of {Path(where.filename).name})"


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
