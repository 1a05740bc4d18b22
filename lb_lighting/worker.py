# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's own process: no Blender in it, and no OpenCL in Blender's.

    python -m lb_lighting.worker FOLDER

The folder holds a `Task`, which is ready once GO comes on stdin. The result of its `run` is saved
beside it. The process sends messages on stdout, one JSON object per line:

- what the task sends, such as {"stage", "fraction"}
- {"drivers": LOADING or LOADED} before and after OpenCL's drivers are loaded
- {"worked": s of processor time} from time to time, as a sign of life
- {"error": class, "text": sentence} if the task cannot be done
- {"defect": summary} of an unexpected error, whose traceback goes to stderr

Drivers may print to stdout: the messages go to a copy of it, and all other output to stderr. The
process ends when stdin does, because Blender has then ended.

Quiet by default; the environment variable LB_LIGHTING_LOG names the level to log at on stderr.
"""

import errno
import faulthandler
import json
import logging
import os
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from . import exchange
from .errors import DeviceError, LightingError, OutputError
from .tasks import Send, Task
from .transport import device

TASK, RESULT = "task", "result"
GO = b"\n"
LOADING, LOADED = "loading", "loaded"
LOG_LEVEL = "LB_LIGHTING_LOG"  # environment variable
BEAT = 1.0  # s between two signs of life
LONGEST_LOAD = 120.0  # s: graphics drivers take some 10 s on an idle machine
_FULL = {getattr(errno, name, None) for name in ("ENOSPC", "EDQUOT", "EFBIG")}
_logger = logging.getLogger("lb_lighting.worker")


def main(folder_name: str) -> int:
    """Do the task in a folder; the exit code."""
    # Keep stdout for messages.
    folder = Path(folder_name)
    messages, lock = os.fdopen(os.dup(1), "w", buffering=1), threading.Lock()
    os.dup2(2, 1)
    _start_log()

    def send(**message: Any) -> None:
        with lock:  # threads send too
            messages.write(json.dumps(message) + "\n")

    if not os.read(0, len(GO)):
        return 1
    try:
        _run(folder, send)
    except Exception as error:
        refusal = _refusal(error, folder)
        if refusal is not None:
            _logger.info("Refused: %s", refusal)
            send(error=type(refusal).__name__, text=str(refusal))
        else:
            traceback.print_exc()
            send(defect=_summary(error))
        return 1
    return 0


def _start_log() -> None:
    level = os.environ.get(LOG_LEVEL, "").upper()
    logging.basicConfig(
        level=logging.getLevelNamesMapping().get(level, logging.WARNING),
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )


def _run(folder: Path, send: Send) -> None:
    """Load the task, run it, and save its result."""
    tempfile.tempdir = str(folder)  # so that nothing is left elsewhere
    device.loading = lambda: _loading(send)
    task: Task = exchange.load(folder / TASK)
    threading.Thread(target=_leave_with_parent, args=(task,), daemon=True).start()
    threading.Thread(target=_beat, args=(send,), daemon=True).start()
    start, name = time.perf_counter(), type(task).__name__
    _logger.info("%s begins", name)
    result = task.run(send, folder)
    exchange.save(folder / RESULT, result)
    _logger.info("%s ends after %.2f s", name, time.perf_counter() - start)


def _refusal(error: Exception, folder: Path) -> LightingError | None:
    """The error for the user, or None for a defect."""
    if isinstance(error, LightingError):
        return error
    if isinstance(error, MemoryError):
        return DeviceError(
            "There is not enough memory; close other programs or lower the resolution."
        )
    if isinstance(error, OSError) and _is_full(error, folder):
        return OutputError(
            f"The result does not fit into the temporary folder {folder} ({error.strerror}); free "
            "some space there."
        )
    if type(error).__module__.startswith("pyopencl"):
        return DeviceError(
            f"The device failed ({error}); choose another device or a lower resolution."
        )
    return None


def _beat(send: Send) -> None:
    """Send the processor time from time to time."""
    while True:
        time.sleep(BEAT)
        send(worked=time.process_time())


@contextmanager
def _loading(send: Send) -> Iterator[None]:
    """Announce that drivers are loaded. End the process if that takes too long: a driver may block
    all threads of Python, and the process would not notice that Blender has ended."""
    faulthandler.dump_traceback_later(2 * LONGEST_LOAD, exit=True)
    send(drivers=LOADING)
    start = time.perf_counter()
    yield
    _logger.info("Loaded OpenCL's drivers in %.2f s", time.perf_counter() - start)
    send(drivers=LOADED)
    faulthandler.cancel_dump_traceback_later()


def _is_full(error: OSError, folder: Path) -> bool:
    """Whether an error means that the disk of the folder is full, or the folder not writable."""
    return error.errno in _FULL or str(error.filename).startswith(str(folder))


def _summary(error: Exception) -> str:
    """What a defect is, and where."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(traceback.format_exception_only(error)[-1].split())
    return f"{what} ({where.name}, line {where.lineno} of {Path(where.filename).name})"


def remove_scraps(task: Task) -> None:
    """Delete the files that an unfinished `task` may have left outside of its folder."""
    for path in getattr(task, "scraps", ()):
        Path(path).unlink(missing_ok=True)


def _leave_with_parent(task: Task) -> None:
    while os.read(0, 1):  # not sys.stdin, whose lock would be held when Python ends
        pass
    remove_scraps(task)
    os._exit(1)


if __name__ == "__main__":
    code = main(*sys.argv[1:])
    sys.stderr.flush()
    os._exit(code)  # drivers and OpenVDB sometimes crash when Python shuts down
