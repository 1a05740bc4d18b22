# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of Debian packages, downloaded on the first call to `build/assets`; no root needed."""

import fcntl
import subprocess
import sys
from pathlib import Path

ASSETS = Path(__file__).resolve().parents[2] / "build" / "assets"


def apt(state, *command):
    """Run apt-get with lists and cache in `state`, so that it needs no root; the exit code."""
    private = ["-o", f"Dir::State={state}", "-o", f"Dir::Cache={state}/cache"]
    status = ["-o", "Dir::State::status=/var/lib/dpkg/status", "-o", "APT::Sandbox::User=root"]
    return subprocess.call(["apt-get", "-qq", *private, *status, *command], cwd=state)


def fetch(name):
    """Download the files of a package into `ASSETS / name`."""
    state = ASSETS / "apt"
    (state / "lists" / "partial").mkdir(parents=True, exist_ok=True)
    (state / "cache" / "archives" / "partial").mkdir(parents=True, exist_ok=True)
    # One of the machine's sources may be down; only the download has to work.
    apt(state, "update")
    if apt(state, "download", name) != 0:
        sys.exit(f"The Debian package {name} cannot be fetched; check apt's sources.")
    partial = ASSETS / f"{name}.partial"
    subprocess.run(["dpkg", "-x", next(state.glob(f"{name}_*.deb")), partial], check=True)
    partial.rename(ASSETS / name)


def package(name):
    """The folder with the files of a Debian package, downloaded if missing."""
    ASSETS.mkdir(parents=True, exist_ok=True)
    with (ASSETS / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (ASSETS / name).exists():
            fetch(name)
    return ASSETS / name
