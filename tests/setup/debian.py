# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of Debian packages, fetched on the first call and kept in `build/assets`; no root."""

import fcntl
import subprocess
import sys
from pathlib import Path

ASSETS = Path(__file__).resolve().parents[2] / "build" / "assets"


def apt(state, *command):
    """Run apt-get with its lists and cache in `state`, so that no root is needed; its exit code."""
    private = ["-o", f"Dir::State={state}", "-o", f"Dir::Cache={state}/cache"]
    status = ["-o", "Dir::State::status=/var/lib/dpkg/status", "-o", "APT::Sandbox::User=root"]
    return subprocess.call(["apt-get", "-qq", *private, *status, *command], cwd=state)


def fetch(name):
    """The files of a package that is not there yet, into `ASSETS / name`."""
    state = ASSETS / "apt"
    (state / "lists" / "partial").mkdir(parents=True, exist_ok=True)
    (state / "cache" / "archives" / "partial").mkdir(parents=True, exist_ok=True)
    # One of the machine's sources may be down; what counts is whether the download works.
    apt(state, "update")
    if apt(state, "download", name) != 0:
        sys.exit(f"The Debian package {name} cannot be fetched; check apt's sources.")
    partial = ASSETS / f"{name}.partial"
    subprocess.run(["dpkg", "-x", next(state.glob(f"{name}_*.deb")), partial], check=True)
    partial.rename(ASSETS / name)


def package(name):
    """The folder with the files of a Debian package."""
    ASSETS.mkdir(parents=True, exist_ok=True)
    with (ASSETS / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (ASSETS / name).exists():
            fetch(name)
    return ASSETS / name
