# SPDX-License-Identifier: GPL-3.0-or-later
"""The errors, each with a sentence that says what is wrong and what the user can do.

Every error that a user can meet derives from `LightingError`. Operators and the command line print
its text and stop. Any other exception is a defect and shows its traceback.
"""

from collections.abc import Collection
from numbers import Integral
from typing import Any


class LightingError(Exception):
    """The base of every error whose text is meant for the user."""


class MediumError(LightingError):
    """A medium that cannot be solved: NaN, negative density, |g| >= 1, an empty grid."""


class LightError(LightingError):
    """No light, or a light that the chosen model does not support."""


class SettingsError(LightingError):
    """A setting that is unknown or out of its range."""


class DeviceError(LightingError):
    """No such device, a kernel that does not build, or too little memory."""


class SceneError(LightingError):
    """The scene lacks something: no selection, no faces, no such grid or file."""


class EmptyError(SceneError):
    """There is nothing to light at this frame, though there may be at another."""


class OutputError(LightingError):
    """A result that cannot be written: a read-only folder, a full disk."""


class SolverError(LightingError):
    """The solver's process ended without a result."""


class Cancelled(LightingError):  # noqa: N818 - the public name
    """The user stopped the work; nothing was changed."""


def require_known(value: str, known: Collection[str], what: str) -> None:
    """Refuse a value that is not one of the `known`, with a SettingsError that lists them."""
    if value not in known:
        raise SettingsError(
            f"There is no {what} called '{value}'; choose one of: {', '.join(known)}."
        )


def require_whole(
    value: Any,
    what: str,
    lowest: int,
    highest: int,
    error: type[LightingError] = SettingsError,
) -> None:
    """Refuse a number that is not whole, or out of range, with an `error`."""
    is_whole = isinstance(value, Integral)
    if not is_whole or not lowest <= value <= highest:
        raise error(f"The {what} must be a whole number from {lowest} to {highest}; it is {value}.")
