# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the built zip into a real Blender with a fresh user folder, and test it there."""

import shutil
import subprocess
import sys
from pathlib import Path

from tests.setup import blender, package

BUILD = blender.ROOT / "build"
WORK = BUILD / "blender"
SCREENS = BUILD / "screens"
WORKER = SCREENS / "worker.pid"  # of the solver that was at work when Blender was quit
REQUIREMENTS = Path(blender.__file__).with_name("requirements.txt")

# Run by a shell that stands in the checkout, wherever that is mounted.
FRESH = 'BLENDER_USER_RESOURCES=$PWD/build/blender/user LIBGL_ALWAYS_SOFTWARE=1 exec "$@"'
DISPLAY = ["xvfb-run", "-a", "-s", "-screen 0 1600x1200x24 +extension GLX"]


def install_pytest():
    """pytest is pure Python: it goes into a folder that the Python of any Blender can read."""
    pinned = next(line for line in REQUIREMENTS.read_text().split() if line.startswith("pytest=="))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--target", WORK / "python"]
    subprocess.run([*pip, pinned], check=True)


def main():
    """Every step in turn; the first that fails ends the run with its exit code."""
    launch = blender.launcher()
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    SCREENS.mkdir(exist_ok=True)
    WORKER.unlink(missing_ok=True)
    install_pytest()

    def run(*command):
        print("+", *command, flush=True)
        in_checkout = launch("sh", "-c", FRESH, "sh", *command)
        subprocess.run(in_checkout, cwd=blender.ROOT, check=True, stdin=subprocess.DEVNULL)

    archive = package.archive().relative_to(blender.ROOT)
    run("blender", "--command", "extension", "install-file", "-r", "user_default", "--enable",
        str(archive))  # fmt: skip
    # The display is for EEVEE, which has to show volumes where Cycles is built without NanoVDB.
    run(*DISPLAY, "blender", "--background", "--gpu-backend", "opengl",
        "--python-exit-code", "1", "--python", "tests/blender/run.py")  # fmt: skip
    run(*DISPLAY, "blender", "--gpu-backend", "opengl",
        "--python-exit-code", "1", "--python", "tests/blender/window.py")  # fmt: skip
    worker = Path("/proc", WORKER.read_text())
    if worker.exists() and b"lb_lighting.worker" in (worker / "cmdline").read_bytes():
        sys.exit("Blender was quit in the middle of a bake, and the solver's process lives on.")


if __name__ == "__main__":
    try:
        main()
    except blender.UnavailableError as error:
        print(error, file=sys.stderr)
        sys.exit(blender.UNAVAILABLE)
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)
