# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs that solve the same problems, in a separate environment: `build/peers`.

It is made on the first call. The scripts that use them are in tests/peers/. They read a problem
from one .npz file and write the result to another.
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
    """A hash of the inputs of the environment and of its path."""
    return hashlib.sha256(REQUIREMENTS.read_bytes() + str(VENV).encode()).hexdigest()


def ready():
    """Whether the environment is complete and made from exactly these requirements."""
    return STAMP.is_file() and STAMP.read_text() == fingerprint() and PYTHON.exists()


def build():
    """Make the environment from scratch; remains of an interrupted build are deleted."""
    shutil.rmtree(VENV, ignore_errors=True)
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    for command in ([find_python(), "-m", "venv", VENV], [*pip, "--requirement", REQUIREMENTS]):
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode != 0:
            raise SetupError(f"The peers of {REQUIREMENTS.name} cannot be installed: {done.stdout}")
    STAMP.write_text(fingerprint())


def python():
    """The path of the peers' Python; raises SetupError if it cannot be made."""
    VENV.parent.mkdir(exist_ok=True)
    with (VENV.parent / "peers.lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        if not ready():
            build()
    return PYTHON


def run(script, **problem):
    """Solve a problem with a script of tests/peers/; problem and result are {name: array}."""
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder, "problem.npz"), Path(folder, "result.npz")
        np.savez(given, **problem)
        command = [python(), SCRIPTS / f"{script}.py", given, found]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{script} failed with {done.returncode}:\n{done.stdout}")
        with np.load(found) as result:
            return dict(result)
