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
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from . import errors, exchange
from .tasks.devices import Devices
from .worker import GO, RESULT, TASK, remove_scraps

PATIENCE = 600.0  # s of silence, after which the worker is taken to hang
_PACKAGE = Path(__file__).parent
_END = None  # what the worker's last message is followed by


class Job:
    """A task under way in a process of its own.

    said  {name: value}: the latest that it told of each name, such as its stage
    """

    def __init__(self, task):
        """Start `task`, see worker.py; it must not be changed from now on."""
        self.task = task
        self.said = {}
        self._result = None
        self.folder = tempfile.TemporaryDirectory(prefix="lb_lighting_", ignore_cleanup_errors=True)
        self._chatter = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the process
        self._started = self._heard = time.monotonic()
        self._process = subprocess.Popen(
            # Without the folder that Blender was started in, where anything may lie.
            [sys.executable, "-P", "-m", f"{_PACKAGE.name}.worker", self.folder.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._chatter,
            env=_environment(),
            text=True,
        )
        self._inbox = queue.SimpleQueue()
        self._feeder = threading.Thread(target=self._feed, daemon=True)
        self._feeder.start()
        threading.Thread(target=self._listen, daemon=True).start()

    def update(self, wait=0.0):
        """Take in what the worker said, waiting up to `wait` s for it; whether it is done.

        Raises what the worker raised, OutputError where the task cannot be written down, or
        SolverError if the worker died or has been silent for too long; then it is ended, and its
        files are gone.
        """
        try:
            while True:
                message = self._inbox.get(timeout=wait) if wait else self._inbox.get_nowait()
                wait = 0.0
                if message is _END:
                    return self._finished()
                self._take(message)
        except queue.Empty:
            if time.monotonic() - self._heard < PATIENCE:
                return False
            self.cancel()
            raise errors.SolverError(
                f"The solver has said nothing for {PATIENCE:.0f} s and was ended; nothing was "
                "changed. Choose another device or a lower resolution."
            ) from None
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
        remove_scraps(self.task)
        self.folder.cleanup()

    @property
    def seconds_left(self):
        """An estimate from the way so far, or None where it is too early to tell."""
        fraction = self.said.get("fraction", 0)
        spent = time.monotonic() - self._started
        return spent * (1 - fraction) / fraction if fraction > 0.05 else None

    def _path(self, name):
        return Path(self.folder.name, name)

    def _feed(self):
        """Write the task down, and let the worker have it."""
        try:
            exchange.save(self._path(TASK), self.task)
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

    def _listen(self):
        """Hear the worker out, and read its result."""
        try:
            with contextlib.suppress(ValueError):  # it died in the middle of a word
                for line in self._process.stdout:
                    self._inbox.put(json.loads(line))
            if self._process.wait() == 0:
                self._result = exchange.load(self._path(RESULT))
        except Exception as error:  # a defect, or the job was cancelled, and nobody waits
            self._inbox.put(error)
        self._inbox.put(_END)

    def _take(self, message):
        self._heard = time.monotonic()
        if isinstance(message, Exception):
            raise message
        if "error" in message:
            raise getattr(errors, message["error"])(message["text"])
        self.said |= message

    def _finished(self):
        self._inbox.put(_END)  # for whoever asks again
        if self._process.wait() != 0:
            self._chatter.seek(0)
            raise errors.SolverError(_obituary(self._process.returncode, self._chatter.read()))
        self._end()
        return True

    def _end(self):
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        self._feeder.join()
        self._process.stdin.close()
        self._chatter.close()


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


def device_lines():
    """The devices that can solve, a line each, the default first."""
    return Job(Devices()).wait()


def _environment():
    """The worker's: it finds the package, and the libraries where Blender has them."""
    folders = [str(_PACKAGE.parent)]
    for name in ("pyopencl", "numpy", "openvdb"):
        spec = importlib.util.find_spec(name)
        if spec is not None:
            package = Path(spec.origin).parent
            folders.append(str(package.parent if spec.submodule_search_locations else package))
    # An installed extension's folder is not ours to write to.
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(folders),
        # NumPy's own threads take processors from the device, and there is little for them to do.
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _obituary(code, chatter):
    cause = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
    last = chatter.decode(errors="replace").strip().splitlines()[-1:]
    said = f" Its last words: {last[0]}" if last else ""
    return (
        f"The solver's process {cause}; nothing was changed. "
        f"Choose another device or a lower resolution.{said}"
    )
