# SPDX-License-Identifier: GPL-3.0-or-later
"""Where built programs are kept: for the drivers that keep their own, and by us for the others.

A cache only saves time. Where its folder takes no files, or a file in it is damaged, programs are
built anew, and nothing else happens.
"""

import contextlib
import hashlib
import os
import shutil
import tempfile
from pathlib import Path

NO_CACHE = "LB_LIGHTING_NO_CACHE"  # in the environment: nothing that was kept before is used
_DIGEST = hashlib.sha256().digest_size
_ROOM = 2**25  # bytes that drivers may well write
_temporary: list[tempfile.TemporaryDirectory[str]] = []  # folders, as long as the process


def prepare_drivers() -> None:
    """Give drivers a temporary folder in place of one that takes no files.

    Some drivers (PoCL) are not there at all, or end the process, where they cannot keep what they
    build.
    """
    home = _home()
    pocl = Path(os.environ.get("POCL_CACHE_DIR") or home / "pocl" / "kcache")
    if NO_CACHE in os.environ or not (_takes_files(home) and _takes_files(pocl)):
        folder = tempfile.TemporaryDirectory(prefix="lb_lighting_", ignore_cleanup_errors=True)
        _temporary.append(folder)
        pocl = Path(folder.name, "pocl")
        os.environ.update(XDG_CACHE_HOME=folder.name, POCL_CACHE_DIR=str(pocl))


def key(*parts: str) -> str:
    """The name under which a program is kept that `parts`, texts, determine."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def find(name: str) -> bytes | None:
    """The bytes that `keep` kept under a name, or None where there are none that are whole."""
    if NO_CACHE in os.environ:
        return None
    try:
        content = _path(name).read_bytes()
    except OSError:
        return None
    digest, binary = content[:_DIGEST], content[_DIGEST:]
    return binary if hashlib.sha256(binary).digest() == digest else None


def keep(name: str, binary: bytes) -> None:
    """Keep bytes under a name, if that is possible."""
    path = _path(name)
    if not path.is_absolute():  # of a user without a home
        return
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        number, half = tempfile.mkstemp(dir=path.parent)
        try:
            with open(number, "wb") as file:
                file.write(hashlib.sha256(binary).digest() + binary)
            os.replace(half, path)  # so that other processes find all of it or nothing
        except OSError:
            os.unlink(half)


def _path(name: str) -> Path:
    return _home() / "lb_lighting" / "programs" / name


def _home() -> Path:
    """The folder of the user's caches; a relative path where the user has no home."""
    chosen = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")  # as on Windows
    return Path(chosen or os.path.expanduser("~/.cache"))


def _takes_files(folder: Path) -> bool:
    """Whether files can be written in a folder, or in the one where it would be made."""
    if not folder.is_absolute():  # of a user without a home
        return False
    try:
        there = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(b"as a driver would")
        return shutil.disk_usage(there).free > _ROOM
    except OSError:
        return False
