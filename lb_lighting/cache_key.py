# SPDX-License-Identifier: GPL-3.0-or-later
"""What a result depends on, as a short text: two that are alike were made of the same.

Needs no Blender. Nothing of it depends on where a file lies, on the names of things, or on the
process that asks.
"""

import hashlib
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

# Attributes that a result does not depend on, and `choice`, which the options contain.
_ASIDE = {"name", "instanced", "choice", "uid"}
_AT_ONCE = 1 << 22  # voxels of a grid that are read at once


def essence(*things):
    """A text that tells whether `things` are the same: numbers, texts, arrays, functions, lists and
    objects of these. An object may say by an attribute `essence` what there is to it."""
    found = hashlib.blake2b(digest_size=16)
    _add(found, things)
    return found.hexdigest()


def content_of_file(path):
    """A text that tells whether files hold the same. OSError for one that cannot be read."""
    path = Path(path)
    facts = path.stat()
    return _content_of_file(path, facts.st_size, facts.st_mtime_ns)


@lru_cache(maxsize=64)
def _content_of_file(path, _size, _time):
    with open(path, "rb") as file:
        return hashlib.file_digest(file, hashlib.blake2b).hexdigest()


def content_of_grid(grid):
    """A text that tells whether openvdb grids hold the same in their active voxels' box."""
    found = hashlib.blake2b(digest_size=16)
    if grid.activeVoxelCount():
        lower, upper = map(np.array, grid.evalActiveVoxelBoundingBox())
        shape = upper - lower + 1
        channels = (3,) if isinstance(grid.background, tuple) else ()
        depth = max(1, _AT_ONCE // int(shape[1] * shape[2]))
        _add(found, (lower, upper))
        for start in range(0, shape[0], depth):
            slab = np.empty((min(depth, shape[0] - start), *shape[1:], *channels), np.float32)
            grid.copyToArray(slab, (int(lower[0]) + start, int(lower[1]), int(lower[2])))
            _add(found, slab)
    return found.hexdigest()


def _add(found, thing):
    if isinstance(thing, np.ndarray):
        found.update(f"array {thing.dtype} {thing.shape}".encode())
        found.update(np.ascontiguousarray(thing))
    elif hasattr(thing, "essence"):
        _add(found, thing.essence)
    elif isinstance(thing, (list, tuple)):
        found.update(f"list {len(thing)}".encode())
        for part in thing:
            _add(found, part)
    elif isinstance(thing, dict):
        _add(found, sorted(thing.items(), key=repr))
    elif isinstance(thing, (set, frozenset)):
        _add(found, sorted(thing, key=repr))
    elif isinstance(thing, (float, np.floating)):  # Blender has no more digits
        found.update(f"float {thing:.7g};".encode())
    elif thing is None or isinstance(thing, (str, bytes, int, complex, np.generic)):
        found.update(f"{type(thing).__name__} {thing!r};".encode())
    elif isinstance(thing, type) or not hasattr(thing, "__dict__") or hasattr(thing, "__code__"):
        found.update(getattr(thing, "__qualname__", type(thing).__qualname__).encode())
    else:
        found.update(type(thing).__qualname__.encode())
        _add(found, _parts(thing))


def _parts(thing):
    """{attribute: value} of an object, without what is worked out of the others."""
    kind = type(thing)
    return {
        name: value
        for name, value in vars(thing).items()
        if name not in _ASIDE and not isinstance(getattr(kind, name, None), cached_property)
    }
