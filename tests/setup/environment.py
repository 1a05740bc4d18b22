# SPDX-License-Identifier: GPL-3.0-or-later
"""Make `.venv`, the environment of demos, tests and benchmarks, unless it is ready.

Runs on the system's `python3` (3.11 or newer) with only the standard library.
"""

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
from glob import glob
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "ready"
OPENCL_VENDORS = VENV / "opencl"
REQUIREMENTS = Path(__file__).with_name("requirements.txt")

USABLE = "import sys, venv, ensurepip; sys.exit(sys.version_info[:2] != (3, 13))"


class SetupError(Exception):
    """The machine lacks something; the message is a sentence that says what to install."""


def pythons():
    """Every place where a Python 3.13 may be, in order of preference."""
    if on_path := shutil.which("python3.13"):
        yield on_path
    pyenv = os.environ.get("PYENV_ROOT", os.path.expanduser("~/.pyenv"))
    yield from sorted(glob(f"{pyenv}/versions/3.13*/bin/python3.13"), reverse=True)
    if uv := shutil.which("uv"):
        found = subprocess.run([uv, "python", "find", "3.13"], capture_output=True, text=True)
        if found.returncode == 0:
            yield found.stdout.strip()
    data = os.environ.get("XDG_DATA_HOME", os.path.expanduser("~/.local/share"))
    yield from sorted(glob(f"{data}/uv/python/cpython-3.13*/bin/python3.13"), reverse=True)


def usable(python):
    """Whether it runs at all (a pyenv shim may not), is 3.13 and can make environments."""
    try:
        return subprocess.run([python, "-c", USABLE], capture_output=True).returncode == 0
    except OSError:
        return False


def find_python():
    """A Python 3.13 that works, or SetupError."""
    for python in pythons():
        if usable(python):
            return python
    raise SetupError(
        "No usable Python 3.13 on PATH, in pyenv or in uv; install one with its venv module, "
        "for example with `pyenv install 3.13` or `uv python install 3.13`."
    )


def fingerprint():
    """A hash of the inputs of the environment and of its path."""
    made_from = Path(__file__).read_bytes() + REQUIREMENTS.read_bytes() + str(VENV).encode()
    return hashlib.sha256(made_from).hexdigest()


def ready():
    """Whether `.venv` is complete, made from exactly these requirements, and still has a Python."""
    return STAMP.is_file() and STAMP.read_text() == fingerprint() and PYTHON.exists()


def register_intel_opencl():
    """Write an .icd file with the right path: Intel's names a folder of the build machine."""
    OPENCL_VENDORS.mkdir()
    library = VENV / "lib" / "libintelocl.so"
    (OPENCL_VENDORS / "intel.icd").write_text(f"{library}\n")


def build():
    """Make the environment from scratch; remains of an interrupted build are deleted."""
    python = find_python()
    print(f"Setting up .venv with {python} (once; a minute or two)", flush=True)
    shutil.rmtree(VENV, ignore_errors=True)
    subprocess.run([python, "-m", "venv", VENV], check=True)
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--requirement", REQUIREMENTS], check=True)
    register_intel_opencl()
    STAMP.write_text(fingerprint())


def main():
    """Build the environment unless it is ready, one process at a time."""
    lock = ROOT / "build" / "environment.lock"
    lock.parent.mkdir(exist_ok=True)
    with lock.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        if not ready():
            build()


if __name__ == "__main__":
    try:
        main()
    except SetupError as error:
        sys.exit(str(error))
    except subprocess.CalledProcessError as error:
        sys.exit(f"Setting up .venv failed: `{' '.join(map(str, error.cmd))}`; see above.")
