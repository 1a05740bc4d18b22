# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs that solve the same problems, in an environment of their own: `build/peers`.

It is made on the first call. The scripts that use them are in tests/peers/; they take a problem
as one .npz file and leave the result as another.
"""

import fcntl
import hashlib
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from tests.setup.environment import ROOT, SetupError, find_python

VENV = ROOT / "build" / "peers"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "ready"
REQUIREMENTS = Path(__file__).with_name("peers.txt")
SCRIPTS = ROOT / "tests" / "peers"


def fingerprint():
    """Changes with whatever the environment was made from, its place included."""
    return hashlib.sha256(REQUIREMENTS.read_bytes() + str(VENV).encode()).hexdigest()


def ready():
    """Whether the environment was finished from exactly these requirements."""
    return STAMP.is_file() and STAMP.read_text() == fingerprint() and PYTHON.exists()


def build():
    """The environment from nothing; what an interrupted build left behind is thrown away."""
    shutil.rmtree(VENV, ignore_errors=True)
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    for command in ([find_python(), "-m", "venv", VENV], [*pip, "--requirement", REQUIREMENTS]):
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode != 0:
            raise SetupError(f"The peers of {REQUIREMENTS.name} cannot be installed: {done.stdout}")
    STAMP.write_text(fingerprint())


def python():
    """The path of the peers' Python; SetupError says why there is none."""
    VENV.parent.mkdir(exist_ok=True)
    with (VENV.parent / "peers.lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        if not ready():
            build()
    return PYTHON


def run(script, **problem):
    """Let a script of tests/peers/ solve a problem; both it and the result are {name: array}."""
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder, "problem.npz"), Path(folder, "result.npz")
        np.savez(given, **problem)
        command = [python(), SCRIPTS / f"{script}.py", given, found]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{script} failed with {done.returncode}:\n{done.stdout}")
        with np.load(found) as result:
            return dict(result)
