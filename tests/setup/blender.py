# SPDX-License-Identifier: GPL-3.0-or-later
"""A real Blender for tests: `$BLENDER`, one on PATH, or Debian's in a separate root folder.

Debian's is installed once (as root, a few minutes, 3 GB) in the user's cache folder. Run as a
script, this module installs it if needed and exits with 3 if that is impossible on this machine.
"""

import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "lb_lighting" / "blender"
DEBIAN = CACHE / "root"
STAMP = CACHE / "ready"
OLDEST = (5, 2)
UNAVAILABLE = 3

SUITE = "sid"
PACKAGES = [
    "blender",
    "imagemagick",
    "libgl1-mesa-dri",
    "pocl-opencl-icd",
    "python3-cattr",
    "python3-openvdb",
    "python3-pyopencl",
    "python3-requests",
    "xauth",
    "xdotool",
    "xvfb",
]

# Mounts are made in a private namespace, so they disappear with the command in any case. Inside,
# the checkout is /lb, read-only except build/.
ENTER = """
set -e
root=$1 checkout=$2; shift 2
for folder in proc sys dev; do mount --bind /$folder $root/$folder; done
mount -t tmpfs tmpfs $root/tmp
mkdir -p $root/lb
mount --bind "$checkout" $root/lb
mount -o remount,bind,ro $root/lb
mount --bind "$checkout/build" $root/lb/build
exec chroot $root sh -c 'cd /lb && exec "$@"' sh "$@"
"""


class UnavailableError(Exception):
    """No real Blender is available; the message is a sentence that says why."""


def inside(root, *command):
    """The command line that runs `command` in the Debian at `root`, in the checkout's folder."""
    enter = ["unshare", "--mount", "sh", "-c", ENTER, "sh", str(root), str(ROOT)]
    # That Debian must not use the paths of this machine's OpenCL drivers.
    return ["env", "-u", "OCL_ICD_VENDORS", "-u", "LD_LIBRARY_PATH", *enter, *command]


def debian_mirror():
    """The first of apt's configured mirrors that has the suite."""
    listing = ["apt-get", "indextargets", "--format", "$(REPO_URI)", "Created-By: Packages"]
    for uri in dict.fromkeys(subprocess.check_output(listing, text=True).split()):
        try:
            urllib.request.urlopen(f"{uri}dists/{SUITE}/Release", timeout=30).close()
        except OSError:
            continue
        return uri
    raise UnavailableError(
        f"None of apt's mirrors has Debian {SUITE}; set BLENDER to a Blender 5.2."
    )


def install_debootstrap():
    if not shutil.which("debootstrap"):
        subprocess.run(["apt-get", "update", "-qq"], check=True)
        subprocess.run(["apt-get", "install", "-y", "-qq", "debootstrap"], check=True)


def build_debian():
    """Install Debian with Blender in `DEBIAN`, from scratch."""
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        raise UnavailableError(
            "Setting up Debian's Blender needs root on a Debian; set BLENDER to a Blender 5.2."
        )
    print(f"Setting up Debian's Blender in {CACHE} (once; a few minutes)", flush=True)
    if DEBIAN.exists():
        shutil.rmtree(DEBIAN)
    install_debootstrap()
    # The output is long, so it goes to a log file.
    with (CACHE / "setup.log").open("w") as log:
        run = {"check": True, "stdout": log, "stderr": log, "stdin": subprocess.DEVNULL}
        subprocess.run(["debootstrap", "--variant=minbase", SUITE, DEBIAN, debian_mirror()], **run)
        # Signatures of the suite expire after a week, and mirrors lag behind.
        apt = ["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qy"]
        apt += ["-o", "Acquire::Check-Valid-Until=false", "-o", "Acquire::Retries=3"]
        subprocess.run(inside(DEBIAN, *apt, "update"), **run)
        install = ["install", "--no-install-recommends", *PACKAGES]
        subprocess.run(inside(DEBIAN, *apt, *install), **run)


def ensure_debian():
    """Install Debian's Blender if it is missing; an interrupted installation restarts."""
    CACHE.mkdir(parents=True, exist_ok=True)
    (ROOT / "build").mkdir(exist_ok=True)
    made_from = hashlib.sha256(" ".join([SUITE, *PACKAGES]).encode()).hexdigest()
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if STAMP.is_file() and STAMP.read_text() == made_from:
            return
        STAMP.unlink(missing_ok=True)
        try:
            build_debian()
        except subprocess.CalledProcessError as error:
            failed = " ".join(map(str, error.cmd))
            log = CACHE / "setup.log"
            raise UnavailableError(
                f"Debian's Blender cannot be set up; see {log}: {failed}"
            ) from error
        STAMP.write_text(made_from)


def version(blender):
    """(major, minor) of a Blender, or None if it does not run."""
    try:
        output = subprocess.run([blender, "--version"], capture_output=True, text=True).stdout
    except OSError:
        return None
    found = re.search(r"Blender (\d+)\.(\d+)", output)
    return tuple(map(int, found.groups())) if found else None


def installed():
    """The user's Blender, or None if there is none that is new enough."""
    if chosen := os.environ.get("BLENDER"):
        if (version(chosen) or (0, 0)) < OLDEST:
            raise UnavailableError(
                f"BLENDER={chosen} is not a Blender 5.2 or newer; correct or unset it."
            )
        return chosen
    on_path = shutil.which("blender")
    return on_path if on_path and (version(on_path) or (0, 0)) >= OLDEST else None


def launcher():
    """A function that turns a command into the command line that runs it in the checkout.

    The word `blender` in the command stands for the Blender that was found. Paths should be
    relative to the checkout.
    """
    if own := installed():
        if not (shutil.which("xvfb-run") and shutil.which("import")):
            raise UnavailableError(
                f"Testing {own} needs a virtual display; install xvfb, xauth and imagemagick."
            )
        return lambda *command: [own if word == "blender" else word for word in command]
    ensure_debian()
    return lambda *command: inside(DEBIAN, *command)


if __name__ == "__main__":
    try:
        launcher()
    except UnavailableError as error:
        print(error, file=sys.stderr)
        sys.exit(UNAVAILABLE)
