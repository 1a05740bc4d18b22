# SPDX-License-Identifier: GPL-3.0-or-later
"""The tasks of the solver's process.

A task is sent there as a pickle, and the result of its `run` comes back the same way; see
`worker.py`. Tasks need no Blender.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

type Send = Callable[..., None]  # sends a message, {name: value}, to Blender's process


class Task(Protocol):
    """A task. If it has an attribute `scraps`, [path] of files it may leave outside of its folder,
    those files are deleted if it does not end well."""

    def run(self, send: Send, folder: Path, /) -> Any:
        """Do the work in the temporary `folder`; the result."""
