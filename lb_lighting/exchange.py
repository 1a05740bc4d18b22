# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks and results as files, for the way to the solver's process and back.

Pickles, of which both sides are ours. Blender knows an extension's classes under a longer module
name than the worker does, so the package's own name is read as that of the reader.
"""

import pickle


def save(path, thing):
    """Write any object of numbers, arrays and our classes to `path`."""
    with open(path, "wb") as file:
        pickle.dump(thing, file, pickle.HIGHEST_PROTOCOL)


def load(path):
    """What `save` wrote."""
    with open(path, "rb") as file:
        return _Reader(file).load()


class _Reader(pickle.Unpickler):
    def find_class(self, module, name):
        _, ours, rest = module.rpartition("lb_lighting.")
        return super().find_class(f"{__package__}.{rest}" if ours else module, name)
