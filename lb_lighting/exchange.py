# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks and results as files, on the way to the solver's process and back.

The files are pickles, which only this package writes and reads. Blender knows an extension's
classes by a longer module name than the worker does, so `load` replaces the name of the package.
"""

import pickle
from pathlib import Path
from typing import Any


def save(path: str | Path, thing: Any) -> None:
    """Write any object of numbers, arrays and this package's classes to `path`."""
    with open(path, "wb") as file:
        pickle.dump(thing, file, pickle.HIGHEST_PROTOCOL)


def load(path: str | Path) -> Any:
    """What `save` wrote."""
    with open(path, "rb") as file:
        return _Reader(file).load()


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        _, ours, rest = module.rpartition("lb_lighting.")
        return super().find_class(f"{__package__}.{rest}" if ours else module, name)
