# SPDX-License-Identifier: GPL-3.0-or-later
"""When a lattice has converged, and when coarser lattices should correct it.

The limit of the iteration is unknown, so its error is estimated from the rate q at which the
changes between checks shrink: all changes still to come add up to q / (1 - q) times the last one.
A correction removes the part that would shrink slowly. The changes after it carry no information
about the error that it leaves; this is estimated in the same way, from successive corrections.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..backend import Lattice
from .multigrid import Level

_CHECK_EVERY = 8  # steps between two checks
_LAYERS, _FEW = 16, 48  # layers that a check reads, for half a step; all, if fewer than _FEW
_RATES = 3  # last rates, of which the slowest is used
_NEVER = 1 - 1e-6  # changes that shrink no faster than this do not shrink
_FAR = 60  # remaining steps beyond which a correction, which costs about 24, is worthwhile
_LEFT = 0.3  # least share of a correction assumed to remain as error; of the first one, 0.5
_USELESS = 0.6  # corrections that shrink no faster than this are not worthwhile


@dataclass
class ConvergenceMonitor:
    """The changes of a lattice's fluence from check to check."""

    lattice: Lattice
    light: Any = 0.0
    changes: list[float] = field(default_factory=list)  # relative, since the last correction

    def change(self) -> float:
        """The relative change of the fluence since the last check."""
        layers = self.lattice.shape[0]
        every = 1 if layers < _FEW else layers // _LAYERS
        before, self.light = self.light, self.lattice.fluence(every)
        norm = float(np.linalg.norm(self.light))
        return float(np.linalg.norm(self.light - before)) / (norm or 1.0)

    def restart(self) -> float:
        """As `change`, after something other than steps has changed the light."""
        self.changes.clear()
        return self.change()

    @property
    def rates(self) -> list[float]:
        """The last rates at which the changes shrink."""
        pairs = zip(self.changes, self.changes[1:], strict=False)
        return [min(change / last if last else 0.0, _NEVER) for last, change in pairs][-_RATES:]

    def remaining(self, tolerance: float) -> tuple[float, float]:
        """(relative change still to come by steps alone, steps until it is within a tolerance)."""
        rate = max(self.rates, default=_NEVER)
        left = min(1.0, self.changes[-1] * rate / (1 - rate))
        if left <= tolerance:
            return left, 0.0
        return left, _CHECK_EVERY * np.log(left / tolerance) / -np.log(rate)


@dataclass
class CorrectionPolicy:
    """Whether corrections are worth their cost, from what earlier ones achieved.

    enabled  whether corrections are still useful
    count    of corrections
    size     relative change by the last one
    left     relative error that remains and that steps do not show
    before   change by the steps before the last correction, until the steps after it are known
    """

    enabled: bool
    count: int = 0
    size: float = 0.0
    left: float = 0.0
    before: float | None = None

    def note(self, size: float, before: float) -> None:
        """Record a correction's size, and the change by the steps before it."""
        self.before = before
        kept = max(size / self.size, _LEFT) if self.count else 0.5
        self.count, self.size = self.count + 1, size
        self.left = size * kept / (1 - kept)
        if kept > _USELESS:
            self.give_up()

    def made_it_worse(self, change: float) -> bool:
        """Whether the first steps after a correction change more than the last ones before it.

        Most of a bad correction is still present after these steps; the larger this part, the more
        slowly it would disappear.
        """
        before, self.before = self.before, None
        return before is not None and change > before

    def give_up(self) -> None:
        """Make no more corrections."""
        self.enabled, self.left, self.before = False, 0.0, None


def converge(
    level: Level, tolerance: float, most_steps: int, report: Callable[[float], None]
) -> tuple[float, int, int]:
    """Step a started `Level` until its light is within a tolerance of its limit.

    report  called with the estimated error at each check
    Returns (estimated relative error, steps, corrections).
    """
    lattice, steps, error = level.lattice, 0, 1.0
    monitor = ConvergenceMonitor(lattice)
    policy = CorrectionPolicy(enabled=not level.is_coarsest)
    while steps < most_steps:
        report(error)

        # Take some steps, and undo the last correction if they show that it did harm.
        lattice.advance(min(_CHECK_EVERY, most_steps - steps))
        steps = min(steps + _CHECK_EVERY, most_steps)
        change = monitor.change()
        if policy.made_it_worse(change):
            level.take_back()
            policy.give_up()
            monitor.restart()
            continue
        monitor.changes.append(change)

        # Estimate the error once there are enough rates: after a correction, fewer suffice.
        rates = len(monitor.rates)
        if rates < (1 if policy.left else _RATES):
            continue
        left, ahead = monitor.remaining(tolerance)
        if rates > 1:
            error = left + policy.left
            if error <= tolerance:
                break

        # Correct if many steps remain; never at the end, as only further steps can check it.
        helps = ahead > _FAR or left <= tolerance < left + policy.left
        if policy.enabled and helps and most_steps - steps > 2 * _CHECK_EVERY:
            steps += level.correct()
            policy.note(monitor.restart(), change)
    return min(error, 1.0), steps, policy.count
