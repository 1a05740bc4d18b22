# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the solver in a process of its own, so that no driver can take Blender down with it."""

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from . import errors, exchange

_PACKAGE = Path(__file__).parent


def solve(medium, lights, settings, device=None, progress=None):
    """`transport.solve` in a process of its own, waited for.

    device    None, or part of a device's label
    progress  called as progress(stage, fraction)
    Returns a Field. Raises what the solver raised, or SolverError if its process died.
    """
    with tempfile.TemporaryDirectory(prefix="lb_lighting_") as folder:
        problem, result = Path(folder, "problem.npz"), Path(folder, "field.npz")
        try:
            exchange.save_problem(problem, medium, lights, settings, device)
        except OSError as error:
            raise errors.OutputError(
                f"The temporary folder {folder} cannot take the scene ({error.strerror}); "
                "free some space there."
            ) from error
        for message in _messages("solve", str(problem), str(result)):
            if progress is not None and "stage" in message:
                progress(message["stage"], message["fraction"])
        return exchange.load_field(result)


def require_memory(shape, device=None, model="physical"):
    """Refuse, with a DeviceError, a domain of `shape` voxels that the device cannot hold."""
    for _ in _messages("plan", *map(str, shape), model, device or ""):
        pass


def device_lines():
    """The devices that can solve, a line each, the default first."""
    return next(m["devices"] for m in _messages("devices") if "devices" in m)


def _messages(*arguments):
    """Start the worker and yield what it says; raise its error, or SolverError if it dies."""
    with tempfile.TemporaryFile() as chatter:
        process = subprocess.Popen(
            [sys.executable, "-m", f"{_PACKAGE.name}.worker", *arguments],
            stdout=subprocess.PIPE,
            stderr=chatter,
            stdin=subprocess.DEVNULL,
            env=_environment(),
            text=True,
        )
        try:
            for line in process.stdout:
                message = json.loads(line)
                if "error" in message:
                    raise getattr(errors, message["error"])(message["text"])
                yield message
            if process.wait() != 0:
                chatter.seek(0)
                raise errors.SolverError(_obituary(process.returncode, chatter.read()))
        finally:  # also where the caller stops listening: no orphan is left
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            process.wait()
            process.stdout.close()


def _environment():
    """The worker's: it finds the package, and pyopencl where an extension's wheels put it."""
    folders = [str(_PACKAGE.parent)]
    for name in ("pyopencl", "numpy"):
        spec = importlib.util.find_spec(name)
        if spec is not None:
            folders.append(str(Path(spec.origin).parent.parent))
    # An installed extension's folder is not ours to write to.
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(folders),
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
