# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress, cancel and residual of work under way, and the share of it that is at hand."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..errors import Cancelled

Progress = Callable[[str, float], None]
Cancel = Callable[[], bool]
Residual = Callable[[float], None]


@dataclass(frozen=True)
class Monitor:
    """Who hears of the work, and which part of the whole it is.

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
        """The same without progress: of work that the progress of other work stands for."""
        return replace(self, progress=None)

    def check(self) -> None:
        """Raise `Cancelled` where the user has cancelled."""
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


UNHEARD = Monitor()
"""The monitor of work that nobody follows."""
