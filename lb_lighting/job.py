# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs tasks in a process of its own, so that no driver can take Blender down with it.

Tasks are written down, and results read, by threads: that takes long for large scenes, and Blender
is free meanwhile.
"""

import contextlib
import importlib.util
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from . import errors, exchange
from .tasks.devices import Devices
from .transport.caches import NO_CACHE
from .transport.device import WITHOUT_OPENCL
from .worker import (
    GO,
    LOADED,
    LOADING,
    LONGEST_LOAD,
    RESULT,
    TASK,
    remove_scraps,
)

PATIENCE = 600.0  # s of silence and idleness, after which the worker is taken to hang
_IDLE = 0.1  # s of processors' time in which it does nothing that counts
_PACKAGE = Path(__file__).parent
_END = None  # what the worker's last message is followed by
# By which somebody else ended it, and not a driver.
_ASKED = {
    -getattr(signal, n) for n in ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP") if hasattr(signal, n)
}
# What this session's workers do without, after a driver ended one: {name in the environment: value}
_learned = {}


class Job:
    """A task under way in a process of its own.

    Where OpenCL's drivers end that process, the task begins again in another: first without what
    drivers kept on disk, which may be damaged, then without OpenCL.

    said  {name: value}: the latest that it told of each name, such as its stage
    log   path of what the process printed, which is kept where the process failed
    """

    def __init__(self, task):
        """Start `task`, see worker.py; it must not be changed from now on. Raises OutputError
        where there is no temporary folder, and SolverError where no process starts."""
        self.task = task
        self.said = {}
        self._result = None
        try:
            self.folder = tempfile.TemporaryDirectory(
                prefix="lb_lighting_", ignore_cleanup_errors=True
            )
            number, self.log = tempfile.mkstemp(prefix="lb_lighting_", suffix=".log")
        except OSError as error:
            raise errors.OutputError(
                f"No temporary folder can be made ({error.strerror}); free some space, or set "
                "TMPDIR to a folder that takes files."
            ) from error
        self._chatter = os.fdopen(number, "r+b")
        self._written = self._failed = False
        self._start()

    def _start(self):
        """Start a process for the task."""
        self._begun = self._heard = time.monotonic()
        self._worked, self._without = 0.0, dict(_learned)
        try:
            self._process = subprocess.Popen(
                # Without the folder that Blender was started in, where anything may lie, and
                # without the user's own packages, which Blender does not use either.
                [sys.executable, "-P", "-s", "-m", f"{_PACKAGE.name}.worker", self.folder.name],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._chatter,
                env=_environment() | self._without,
                text=True,
            )
        except OSError as error:
            self._discard()
            raise errors.SolverError(
                f"The solver's process does not start: {sys.executable} cannot be run "
                f"({error.strerror}); install Blender anew."
            ) from error
        self._inbox = queue.SimpleQueue()
        self._feeder = threading.Thread(target=self._feed, daemon=True)
        self._feeder.start()
        arguments = self._process, self._inbox
        threading.Thread(target=self._listen, args=arguments, daemon=True).start()

    def update(self, wait=0.0):
        """Take in what the worker said, waiting up to `wait` s for it; whether it is done.

        Raises what the worker raised, OutputError where the task cannot be written down, or
        SolverError if the worker died or has been silent for too long; then it is ended, and its
        files are gone.
        """
        try:
            return self._hear(wait)
        except BaseException:
            self.cancel()
            raise

    def result(self):
        """What the task returned, once `update` says that it is done."""
        return self._result

    def wait(self, progress=None):
        """Wait for the end; what the task returned. Raises as `update` does.

        progress  called as progress(stage, fraction)
        """
        wait(self, progress)
        return self.result()

    def must_wait(self, _context):
        """Why the result cannot be taken at the moment, or None."""
        return None

    @property
    def status(self):
        """(what it is doing, fraction from 0 to 1)."""
        return self.said.get("stage", "Starting"), self.said.get("fraction", 0.0)

    def cancel(self):
        """End the process at once, and delete what it left."""
        self._end()
        self._discard()

    def _discard(self):
        """Delete all files but the result's."""
        remove_scraps(self.task)
        self.folder.cleanup()
        self._close_log()

    @property
    def seconds_left(self):
        """An estimate from the way so far, or None where it is too early to tell."""
        fraction = self.said.get("fraction", 0)
        spent = time.monotonic() - self._begun
        return spent * (1 - fraction) / fraction if fraction > 0.05 else None

    def _path(self, name):
        return Path(self.folder.name, name)

    def _feed(self):
        """Write the task down, and let the worker have it."""
        try:
            if not self._written:
                exchange.save(self._path(TASK), self.task)
                self._written = True
        except OSError as error:
            self._inbox.put(
                errors.OutputError(
                    f"The temporary folder {self.folder.name} cannot take the scene "
                    f"({error.strerror}); free some space there."
                )
            )
        except Exception as error:  # a defect, for whoever waits
            self._inbox.put(error)
        else:
            with contextlib.suppress(OSError):  # it died before
                os.write(self._process.stdin.fileno(), GO)

    def _listen(self, process, inbox):
        """Hear the worker out, and read its result."""
        try:
            with contextlib.suppress(ValueError):  # it died in the middle of a word
                for line in process.stdout:
                    inbox.put(json.loads(line))
            if process.wait() == 0 and self._path(RESULT).exists():
                self._result = exchange.load(self._path(RESULT))
        except Exception as error:  # a defect, or the job was cancelled, and nobody waits
            inbox.put(error)
        inbox.put(_END)

    def _hear(self, wait):
        """What `update` does, but for what is left where it raises."""
        while True:
            try:
                message = self._inbox.get(timeout=wait) if wait else self._inbox.get_nowait()
            except queue.Empty:
                return self._wait_on()
            if message is _END:
                return self._finished()
            self._take(message)
            wait = 0.0

    def _take(self, message):
        if isinstance(message, Exception):
            raise message
        if "worked" in message:
            self._take_work(message["worked"])
            return
        self._heard = time.monotonic()
        if "error" in message:
            raise getattr(errors, message["error"])(message["text"])
        self.said |= message

    def _take_work(self, seconds):
        """Hear that the worker has worked: on a busy machine it may be long at one thing."""
        if seconds > self._worked + _IDLE:
            self._heard, self._worked = time.monotonic(), seconds

    def _wait_on(self):
        """False, as the worker is not done; what is to be done where it was silent for too long."""
        drivers, silence = self.said.get("drivers"), time.monotonic() - self._heard
        if drivers == LOADING and silence > LONGEST_LOAD:
            return self._begin_again(f"were not loaded within {LONGEST_LOAD:.0f} s")
        if silence <= PATIENCE:
            return False
        if drivers == LOADED:
            return self._begin_again(f"did nothing for {PATIENCE:.0f} s")
        raise errors.SolverError(
            f"The solver has said nothing for {PATIENCE:.0f} s and was ended; nothing was "
            "changed. Choose another device or a lower resolution."
        )

    def _finished(self):
        self._inbox.put(_END)  # for whoever asks again
        code, drivers = self._process.wait(), self.said.get("drivers")
        if code == 0 and self._path(RESULT).exists():
            self._end()
            self._close_log()
            return True
        # A worker that comes to an end of its own says something.
        at_work = drivers == LOADED and "defect" not in self.said and code not in _ASKED
        if at_work and NO_CACHE not in self._without:
            return self._begin_again()
        if at_work or drivers == LOADING:
            return self._begin_again(f"ended the solver's process ({_signal_or_code(code)})")
        self._failed = True
        raise errors.SolverError(self._obituary(code))

    def _begin_again(self, fault=None):
        """Begin again without the drivers, which are at fault, or without what they kept on disk,
        which may be; False, for it is not done."""
        self._end()
        if fault is None:
            _learned[NO_CACHE] = "1"
        else:
            self._failed = True
            log = f" All that they said is in {self.log}." if self._words() else ""
            _learned[WITHOUT_OPENCL] = (
                f"The OpenCL drivers of this machine {fault}; update or remove them, then press "
                f"Find Devices in the add-on's preferences.{log}"
            )
        self.said = {}
        self._start()
        return False

    def _obituary(self, code):
        """What is to be said of a worker that died."""
        lines, defect = self._words(), self.said.get("defect")
        advice = (
            "This is a defect of LB Lighting; please report it"
            if defect
            else "Choose another device or a lower resolution"
        )
        log = f" All that it said is in {self.log}." if lines else ""
        words = f" Its last words: {defect or lines[-1]}" if lines else ""
        cause = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
        return f"The solver's process {cause}; nothing was changed. {advice}.{log}{words}"

    def _words(self):
        """What the process printed, its lines."""
        self._chatter.seek(0)
        return self._chatter.read().decode(errors="replace").strip().splitlines()

    def _end(self):
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        self._feeder.join()
        self._process.stdin.close()

    def _close_log(self):
        """Close the log; delete it unless something failed, and it tells of that."""
        if self._chatter.closed:
            return
        empty = self._chatter.seek(0, os.SEEK_END) == 0
        self._chatter.close()
        if empty or not self._failed:
            Path(self.log).unlink(missing_ok=True)


def wait(job, progress=None):
    """Wait until `job` is done; see `Job.wait`."""
    told, done = None, False
    try:
        while not done:
            done = job.update(wait=0.5)
            if progress is not None and job.status != told:
                told = job.status
                progress(*told)
    except BaseException:  # also where the caller stops listening: no orphan is left
        job.cancel()
        raise


def find_devices():
    """([str], a line for each device that can solve, the default first; [sentence] about those that
    cannot be used), with all drivers loaded anew."""
    _learned.clear()
    return Job(Devices()).wait()


def device_lines():
    """The devices that can solve, a line each, the default first."""
    return find_devices()[0]


def _environment():
    """The worker's: it finds the package, and the libraries where Blender has them."""
    folders = [str(_PACKAGE.parent)]
    for name in ("pyopencl", "numpy", "openvdb"):
        spec = importlib.util.find_spec(name)
        if spec is not None:
            package = Path(spec.origin).parent
            folders.append(str(package.parent if spec.submodule_search_locations else package))
    # What the user has set for another Python would keep this one from starting; Blender does not
    # heed it either.
    inherited = {name: v for name, v in os.environ.items() if not name.startswith("PYTHON")}
    return {
        **inherited,
        "PYTHONPATH": os.pathsep.join(folders),
        # NumPy's own threads take processors from the device, and there is little for them to do.
        "OPENBLAS_NUM_THREADS": "1",
        # An installed extension's folder is not ours to write to.
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _signal_or_code(code):
    return f"signal {-code}" if code < 0 else f"code {code}"
