# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress, cancellation and residual of a piece of work, and its place in the whole."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..errors import Cancelled

Progress = Callable[[str, float], None]
Cancel = Callable[[], bool]
Residual = Callable[[float], None]


@dataclass(frozen=True)
class Monitor:
    """The callbacks that follow a piece of work, and its place in the whole.

    progress  called as progress(stage, fraction) with the fraction of the whole, 0 to 1
    cancel    called without arguments; `check` raises `Cancelled` once it returns true
    residual  called with the estimated relative error of an iteration
    begin     fraction of the whole at which this part begins
    share     fraction of the whole that this part is
    """

    progress: Progress | None = None
    cancel: Cancel | None = None
    residual: Residual | None = None
    begin: float = 0.0
    share: float = 1.0

    def part(self, begin: float, share: float) -> "Monitor":
        """The monitor of a part that begins at the fraction `begin` of this one."""
        return replace(self, begin=self.begin + self.share * begin, share=self.share * share)

    def silent(self) -> "Monitor":
        """The same monitor without progress."""
        return replace(self, progress=None)

    def check(self) -> None:
        """Raise `Cancelled` if the user has cancelled."""
        if self.cancel is not None and self.cancel():
            raise Cancelled("Cancelled; nothing was changed.")

    def report(self, stage: str, fraction: float) -> None:
        """Report the fraction of this part that is done."""
        if self.progress is not None:
            self.progress(stage, self.begin + self.share * fraction)

    def report_residual(self, error: float) -> None:
        """Report the estimated relative error of an iteration."""
        if self.residual is not None:
            self.residual(error)


NO_MONITOR = Monitor()
"""A monitor without callbacks."""
