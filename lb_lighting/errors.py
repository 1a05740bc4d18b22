# SPDX-License-Identifier: GPL-3.0-or-later
"""What can go wrong, each said in one sentence that tells the user what to do.

Every error that a user can meet derives from `LightingError`: operators and the
command line print its text and stop; anything else is a defect and is left to
show its traceback.
"""

from numbers import Integral


class LightingError(Exception):
    """The base of every error whose text is meant for the user."""


class MediumError(LightingError):
    """A medium that no solver can take: NaN, negative density, |g| >= 1, an empty grid."""


class LightError(LightingError):
    """No light, or a light that the chosen model cannot carry."""


class SettingsError(LightingError):
    """A setting that is unknown or out of its range."""


class DeviceError(LightingError):
    """No such device, a kernel that does not build, or too little memory."""


class SceneError(LightingError):
    """The scene lacks what was asked of it: no selection, no faces, no such grid or file."""


class EmptyError(SceneError):
    """There is nothing to light at this frame, though there may be at another."""


class OutputError(LightingError):
    """A result that cannot be written: a read-only folder, a full disk."""


class SolverError(LightingError):
    """The solver's process ended without a result."""


class Cancelled(LightingError):  # noqa: N818 - the public name
    """The user stopped the work; nothing was changed."""


def require_known(value, known, what):
    """Refuse a choice that is not among the `known` ones, with a SettingsError that lists them."""
    if value not in known:
        raise SettingsError(
            f"There is no {what} called '{value}'; choose one of: {', '.join(known)}."
        )


def require_whole(value, what, lowest, highest, error=SettingsError):
    """Refuse a number that is not whole, or out of its range, with an `error`."""
    if not isinstance(value, Integral) or not lowest <= value <= highest:
        raise error(f"The {what} must be a whole number from {lowest} to {highest}; it is {value}.")
