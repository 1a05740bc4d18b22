# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs tasks in a separate process, so that no driver can crash Blender.

Threads write tasks and read results: that takes long for large scenes, and leaves Blender free.
"""

import contextlib
import importlib.util
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from . import errors, exchange
from .tasks import Task
from .tasks.devices import Devices
from .transport.caches import NO_CACHE
from .transport.device import WITHOUT_OPENCL
from .worker import (
    GO,
    LOADED,
    LOADING,
    LOG_LEVEL,
    LONGEST_LOAD,
    RESULT,
    TASK,
    remove_scraps,
)

PATIENCE = 600.0  # s of silence and idleness, after which the worker is taken to hang
_IDLE = 0.1  # s of processor time that still counts as idle
_PACKAGE = Path(__file__).parent
_END = None  # follows the worker's last message
# Exit codes of a worker that was ended on purpose, not by a driver.
_ASKED = {
    -getattr(signal, n) for n in ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP") if hasattr(signal, n)
}
# What this session's workers do without, after a driver ended one: {environment variable: value}
_learned: dict[str, str] = {}

_logger = logging.getLogger(__name__)

type Message = dict[str, Any]


class Waitable(Protocol):
    """What `wait` needs of work under way."""

    @property
    def status(self) -> tuple[str, float]: ...

    def update(self, wait: float = 0.0) -> bool: ...

    def cancel(self) -> None: ...


class Job:
    """A task under way in a separate process.

    If OpenCL drivers end that process, the task begins again in another one: first without the
    files that drivers keep on disk, which may be damaged, then without OpenCL.

    said  {name: value}: the latest value that the process sent for each name, such as its stage
    log   path of the file with the process's output, which is kept if the process failed
    """

    def __init__(self, task: Task) -> None:
        """Start `task`, see worker.py; do not change it from now on. Raises OutputError if there
        is no temporary folder, and SolverError if no process starts."""
        self.task = task
        self.said: Message = {}
        self._result: Any = None
        try:
            self.folder = tempfile.TemporaryDirectory(
                prefix="lb_lighting_", ignore_cleanup_errors=True
            )
            number, self.log = tempfile.mkstemp(prefix="lb_lighting_", suffix=".log")
        except OSError as error:
            raise errors.OutputError(
                f"A temporary folder cannot be created ({error.strerror}); free some space, or set "
                "TMPDIR to a folder that is writable."
            ) from error
        self._output = os.fdopen(number, "r+b")
        self._is_written = self._has_failed = False
        self._start()

    def _start(self) -> None:
        """Start a process for the task."""
        self._begun = self._heard = time.monotonic()
        self._worked, self._without = 0.0, dict(_learned)
        try:
            self._process = subprocess.Popen(
                # Leave out the folder that Blender was started in, which may hold any file, and
                # the user's own packages, which Blender does not use either.
                [sys.executable, "-P", "-s", "-m", f"{_PACKAGE.name}.worker", self.folder.name],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._output,
                env=_environment() | self._without,
                text=True,
            )
        except OSError as error:
            self._discard()
            raise errors.SolverError(
                f"The solver's process does not start: {sys.executable} cannot be run "
                f"({error.strerror}); reinstall Blender."
            ) from error
        _logger.info("Started process %d for %s", self._process.pid, type(self.task).__name__)
        self._inbox: queue.SimpleQueue[Message | Exception | None] = queue.SimpleQueue()
        self._feeder = threading.Thread(target=self._feed, daemon=True)
        self._feeder.start()
        arguments = self._process, self._inbox
        threading.Thread(target=self._listen, args=arguments, daemon=True).start()

    def update(self, wait: float = 0.0) -> bool:
        """Read the worker's messages, waiting up to `wait` s for one; whether it is done.

        Raises what the worker raised, OutputError if the task cannot be written, or SolverError if
        the worker died or was silent for too long. Then the process is ended and its files are
        deleted.
        """
        try:
            return self._read_messages(wait)
        except BaseException:
            self.cancel()
            raise

    def result(self) -> Any:
        """What the task returned, once `update` says that it is done."""
        return self._result

    def wait(self, progress: Callable[[str, float], None] | None = None) -> Any:
        """Wait for the end; what the task returned. Raises as `update` does.

        progress  called as progress(stage, fraction)
        """
        wait(self, progress)
        return self.result()

    def must_wait(self, _context: Any) -> str | None:
        """Why the result cannot be used at the moment, or None."""
        return None

    @property
    def status(self) -> tuple[str, float]:
        """(what it is doing, fraction from 0 to 1)."""
        return self.said.get("stage", "Starting"), self.said.get("fraction", 0.0)

    def cancel(self) -> None:
        """End the process at once, and delete what it left."""
        self._end()
        self._discard()

    def _discard(self) -> None:
        """Delete all files but the result's."""
        remove_scraps(self.task)
        self.folder.cleanup()
        self._close_log()

    @property
    def seconds_left(self) -> float | None:
        """An estimate from the progress so far, or None if it is too early for one."""
        fraction: float = self.said.get("fraction", 0)
        spent = time.monotonic() - self._begun
        return spent * (1 - fraction) / fraction if fraction > 0.05 else None

    def _path(self, name: str) -> Path:
        return Path(self.folder.name, name)

    def _feed(self) -> None:
        """Write the task, and let the worker read it."""
        try:
            if not self._is_written:
                exchange.save(self._path(TASK), self.task)
                self._is_written = True
        except OSError as error:
            self._inbox.put(
                errors.OutputError(
                    f"The scene does not fit into the temporary folder {self.folder.name} "
                    f"({error.strerror}); free some space there."
                )
            )
        except Exception as error:  # a defect, which `update` raises
            self._inbox.put(error)
        else:
            assert self._process.stdin is not None
            with contextlib.suppress(OSError):  # the worker has died already
                os.write(self._process.stdin.fileno(), GO)

    def _listen(
        self,
        process: subprocess.Popen[str],
        inbox: queue.SimpleQueue[Message | Exception | None],
    ) -> None:
        """Receive the worker's messages, and then its result."""
        assert process.stdout is not None
        try:
            with contextlib.suppress(ValueError):  # it died in the middle of a message
                for line in process.stdout:
                    inbox.put(json.loads(line))
            if process.wait() == 0 and self._path(RESULT).exists():
                self._result = exchange.load(self._path(RESULT))
        except Exception as error:  # a defect; or the job was cancelled, and its folder is gone
            inbox.put(error)
        inbox.put(_END)

    def _read_messages(self, wait: float) -> bool:
        """As `update`, without the clean-up."""
        while True:
            try:
                message = self._inbox.get(timeout=wait) if wait else self._inbox.get_nowait()
            except queue.Empty:
                return self._keep_waiting()
            if message is _END:
                return self._is_finished()
            self._take(message)
            wait = 0.0

    def _take(self, message: Message | Exception) -> None:
        if isinstance(message, Exception):
            raise message
        if "worked" in message:
            self._take_work(message["worked"])
            return
        self._heard = time.monotonic()
        if "error" in message:
            raise getattr(errors, message["error"])(message["text"])
        self.said |= message

    def _take_work(self, seconds: float) -> None:
        """Count work as a sign of life: on a busy machine a single step may take long."""
        if seconds > self._worked + _IDLE:
            self._heard, self._worked = time.monotonic(), seconds

    def _keep_waiting(self) -> bool:
        """False, as the worker is not done. If it was silent for too long, begin again or raise."""
        drivers, silence = self.said.get("drivers"), time.monotonic() - self._heard
        if drivers == LOADING and silence > LONGEST_LOAD:
            return self._begin_again(f"were not loaded within {LONGEST_LOAD:.0f} s")
        if silence <= PATIENCE:
            return False
        if drivers == LOADED:
            return self._begin_again(f"did not respond for {PATIENCE:.0f} s")
        raise errors.SolverError(
            f"The solver has not responded for {PATIENCE:.0f} s and was ended; nothing was "
            "changed. Choose another device or a lower resolution."
        )

    def _is_finished(self) -> bool:
        """Whether the process, which has ended, left a result. If not, begin again or raise."""
        self._inbox.put(_END)  # for the next call
        code, drivers = self._process.wait(), self.said.get("drivers")
        if code == 0 and self._path(RESULT).exists():
            self._end()
            self._close_log()
            return True
        # A worker that fails without a driver's fault says so.
        is_crash = drivers == LOADED and "defect" not in self.said and code not in _ASKED
        if is_crash and NO_CACHE not in self._without:
            return self._begin_again()
        if is_crash or drivers == LOADING:
            return self._begin_again(f"ended the solver's process ({_signal_or_code(code)})")
        self._has_failed = True
        raise errors.SolverError(self._exit_message(code))

    def _begin_again(self, fault: str | None = None) -> bool:
        """Begin again without the drivers, if they are at `fault`, or else without the files that
        they keep on disk. False, as it is not done."""
        self._end()
        _logger.warning(
            "Starting again: the OpenCL drivers %s", fault or "crashed; their caches are off"
        )
        if fault is None:
            _learned[NO_CACHE] = "1"
        else:
            self._has_failed = True
            log = f" Their output is in {self.log}." if self._output_lines() else ""
            _learned[WITHOUT_OPENCL] = (
                f"The OpenCL drivers of this machine {fault}; update or remove them, then press "
                f"Find Devices in the add-on's preferences.{log}"
            )
        self.said = {}
        self._start()
        return False

    def _exit_message(self, code: int) -> str:
        """The sentences for a worker that died."""
        lines, defect = self._output_lines(), self.said.get("defect")
        advice = (
            "This is a bug in LB Lighting; please report it"
            if defect
            else "Choose another device or a lower resolution"
        )
        log = f" Its output is in {self.log}." if lines else ""
        words = f" Its last line: {defect or lines[-1]}" if lines else ""
        cause = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
        return f"The solver's process {cause}; nothing was changed. {advice}.{log}{words}"

    def _output_lines(self) -> list[str]:
        """The lines that the process printed."""
        self._output.seek(0)
        return self._output.read().decode(errors="replace").strip().splitlines()

    def _end(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        self._feeder.join()
        self._process.stdin.close()

    def _close_log(self) -> None:
        """Close the log; delete it unless it is needed to understand a failure."""
        if self._output.closed:
            return
        is_empty = self._output.seek(0, os.SEEK_END) == 0
        self._output.close()
        if is_empty or not (self._has_failed or os.environ.get(LOG_LEVEL)):
            Path(self.log).unlink(missing_ok=True)
        else:
            _logger.info("The log of the solver's process is %s", self.log)


def wait(work: Waitable, progress: Callable[[str, float], None] | None = None) -> None:
    """Wait until `work` is done; see `Job.wait`."""
    shown, is_done = None, False
    try:
        while not is_done:
            is_done = work.update(wait=0.5)
            if progress is not None and work.status != shown:
                shown = work.status
                progress(*shown)
    except BaseException:  # also if the caller stops waiting: leave no orphan
        work.cancel()
        raise


def find_devices() -> tuple[list[str], list[str]]:
    """(lines, one for each device that can solve, the default first; sentences on those that cannot
    be used), with all drivers loaded afresh."""
    _learned.clear()
    lines, troubles = Job(Devices()).wait()
    return lines, troubles


def device_lines() -> list[str]:
    """The devices that can solve, a line each, the default first."""
    return find_devices()[0]


def _environment() -> dict[str, str]:
    """The worker's: it finds the package, and the libraries where Blender has them."""
    folders = [str(_PACKAGE.parent)]
    for name in ("pyopencl", "numpy", "openvdb"):
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.origin is not None:
            package = Path(spec.origin).parent
            folders.append(str(package.parent if spec.submodule_search_locations else package))
    # Variables that the user has set for another Python could keep this one from starting. Blender
    # ignores them too.
    inherited = {name: v for name, v in os.environ.items() if not name.startswith("PYTHON")}
    return {
        **inherited,
        "PYTHONPATH": os.pathsep.join(folders),
        # NumPy's own threads would take processors from the device, and have little to do.
        "OPENBLAS_NUM_THREADS": "1",
        # An installed extension must not write to its own folder.
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _signal_or_code(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"code {code}"
