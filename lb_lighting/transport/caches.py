# SPDX-License-Identifier: GPL-3.0-or-later
"""The caches of built programs: the drivers', and one of ours for drivers without a cache.

A cache only saves time. If its folder is not writable or a file in it is damaged, programs are
built again.
"""

import contextlib
import hashlib
import os
import shutil
import tempfile
from pathlib import Path

NO_CACHE = "LB_LIGHTING_NO_CACHE"  # environment variable: cached programs are not used
_DIGEST = hashlib.sha256().digest_size
_ROOM = 2**25  # bytes that drivers may need
_temporary: list[tempfile.TemporaryDirectory[str]] = []  # folders that exist as long as the process


def prepare_drivers() -> None:
    """Give drivers a temporary folder if they cannot write to their cache.

    Some drivers (PoCL) do not load, or end the process, without a writable cache.
    """
    home = _home()
    pocl = Path(os.environ.get("POCL_CACHE_DIR") or home / "pocl" / "kcache")
    if NO_CACHE in os.environ or not (_is_writable(home) and _is_writable(pocl)):
        folder = tempfile.TemporaryDirectory(prefix="lb_lighting_", ignore_cleanup_errors=True)
        _temporary.append(folder)
        pocl = Path(folder.name, "pocl")
        os.environ.update(XDG_CACHE_HOME=folder.name, POCL_CACHE_DIR=str(pocl))


def key(*parts: str) -> str:
    """The cache name of a program that is determined by the texts `parts`."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def find(name: str) -> bytes | None:
    """The bytes that `keep` stored under a name; None if they are missing or damaged."""
    if NO_CACHE in os.environ:
        return None
    try:
        content = _path(name).read_bytes()
    except OSError:
        return None
    digest, binary = content[:_DIGEST], content[_DIGEST:]
    return binary if hashlib.sha256(binary).digest() == digest else None


def keep(name: str, binary: bytes) -> None:
    """Store bytes under a name, if that is possible."""
    path = _path(name)
    if not path.is_absolute():  # the user has no home
        return
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        number, half = tempfile.mkstemp(dir=path.parent)
        try:
            with open(number, "wb") as file:
                file.write(hashlib.sha256(binary).digest() + binary)
            os.replace(half, path)  # other processes see the whole file or none
        except OSError:
            os.unlink(half)


def _path(name: str) -> Path:
    return _home() / "lb_lighting" / "programs" / name


def _home() -> Path:
    """The folder of the user's caches; a relative path if the user has no home."""
    chosen = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")  # as on Windows
    return Path(chosen or os.path.expanduser("~/.cache"))


def _is_writable(folder: Path) -> bool:
    """Whether a folder, or the parent in which it would be created, takes files."""
    if not folder.is_absolute():  # the user has no home
        return False
    try:
        existing = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
        with tempfile.TemporaryFile(dir=existing) as file:
            file.write(b"as a driver would")
        return shutil.disk_usage(existing).free > _ROOM
    except OSError:
        return False
