# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache keys: short texts of what a result was computed from. Equal inputs have equal keys.

Needs no Blender. A key does not depend on where a file lies, on the names of objects, or on the
process that computes it. Files of earlier bakes carry their keys, so a change to how a key is
computed makes a sequence bake all its frames again.
"""

import hashlib
from collections.abc import Iterable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

# Attributes that a result does not depend on, and `choice`, which the options contain.
_IGNORED = {"name", "instanced", "choice", "uid"}


@runtime_checkable
class HasCacheKey(Protocol):
    """An object that names what a result depends on, instead of all its attributes."""

    @property
    def cache_key(self) -> object:
        """A value that `cache_key` takes: numbers, texts, arrays, and collections of these."""


def cache_key(*values: object) -> str:
    """The key of `values`: numbers, texts, arrays, functions, and lists, dictionaries, sets and
    objects of these. An object counts by its `cache_key` if it has one, else by its attributes."""
    digest = _new_hash()
    _add(digest, values)
    return digest.hexdigest()


def content_of_file(path: Path | str) -> str:
    """The key of what a file contains. Raises OSError for a file that cannot be read."""
    path = Path(path)
    status = path.stat()
    return _content_of_file(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=64)
def _content_of_file(path: Path, _size: int, _time: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, hashlib.blake2b).hexdigest()


def content_of_blocks(blocks: Iterable[object]) -> str:
    """The key of `blocks` in their order, for contents that are too large for the memory."""
    digest = _new_hash()
    for block in blocks:
        _add(digest, block)
    return digest.hexdigest()


def _new_hash() -> hashlib.blake2b:
    return hashlib.blake2b(digest_size=16)


def _add(digest: hashlib.blake2b, value: object) -> None:
    """Feed `value` to the hash, with its kind and size, so that values cannot run together."""
    if isinstance(value, np.ndarray):
        digest.update(f"array {value.dtype} {value.shape}".encode())
        digest.update(np.ascontiguousarray(value))
    elif isinstance(value, (float, np.floating)):  # Blender stores no more digits
        digest.update(f"float {value:.7g};".encode())
    elif value is None or isinstance(value, (str, bytes, int, complex, np.generic)):
        digest.update(f"{type(value).__name__} {value!r};".encode())
    elif isinstance(value, HasCacheKey):
        _add(digest, value.cache_key)
    elif isinstance(value, (list, tuple)):
        _add_all(digest, value)
    elif isinstance(value, dict):
        _add(digest, sorted(value.items(), key=repr))
    elif isinstance(value, (set, frozenset)):
        _add(digest, sorted(value, key=repr))
    elif isinstance(value, type) or not hasattr(value, "__dict__") or hasattr(value, "__code__"):
        digest.update(getattr(value, "__qualname__", type(value).__qualname__).encode())
    else:
        digest.update(type(value).__qualname__.encode())
        _add(digest, _attributes(value))


def _add_all(digest: hashlib.blake2b, values: list[Any] | tuple[Any, ...]) -> None:
    digest.update(f"list {len(values)}".encode())
    for value in values:
        _add(digest, value)


def _attributes(value: object) -> dict[str, object]:
    """{name: value} of an object's attributes, without those computed from others."""
    kind = type(value)
    return {
        name: attribute
        for name, attribute in vars(value).items()
        if name not in _IGNORED and not isinstance(getattr(kind, name, None), cached_property)
    }
