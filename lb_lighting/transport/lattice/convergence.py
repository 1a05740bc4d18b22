# SPDX-License-Identifier: GPL-3.0-or-later
"""When the lattice has converged, and when coarser lattices should correct it.

The converged light is unknown, so the error is estimated from how fast changes shrink: by a factor
q from one check to the next, so that all later changes together are q / (1 - q) of the last one.
Corrections by coarser lattices remove the part of the error that shrinks slowly. The changes after
them do not show what is left of that part, so it is estimated likewise, from the sizes of
successive corrections.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Floats
from ..backend import Lattice
from .multigrid import Level

_STEPS_PER_CHECK = 8
# Layers that a check compares, and the number of layers up to which it compares all: a check takes
# half the time of a step.
_LAYERS, _FEW = 16, 48
_RATES = 3  # latest rates that are kept: the slowest counts
_NO_DECAY = 1 - 1e-6  # changes that shrink no faster than this do not shrink
_FAR = 60  # remaining steps above which a correction, which takes the time of 24, pays off
_REMAINDER = 0.3  # smallest share of a correction assumed to be still missing
_FIRST_REMAINDER = 0.5  # the same of the first one
_USELESS = 0.6  # corrections that shrink no faster than this do not pay off


@dataclass
class ConvergenceMonitor:
    """Measures how fast the light of a lattice converges."""

    lattice: Lattice
    light: Floats | float = 0.0
    changes: list[float] = field(default_factory=list)  # relative, since the last correction

    def change(self) -> float:
        """The relative change of the fluence since the last check."""
        layers = self.lattice.shape[0]
        every = 1 if layers < _FEW else layers // _LAYERS
        before, self.light = self.light, self.lattice.fluence(every)
        norm = float(np.linalg.norm(self.light))
        return float(np.linalg.norm(self.light - before)) / (norm or 1.0)

    def restart(self) -> float:
        """The relative change since the last check, when it was not made by steps alone."""
        self.changes.clear()
        return self.change()

    @property
    def rates(self) -> list[float]:
        """The latest ratios of a change to the one before it."""
        pairs = zip(self.changes, self.changes[1:], strict=False)
        ratios = [min(change / last if last else 0.0, _NO_DECAY) for last, change in pairs]
        return ratios[-_RATES:]

    def remaining(self, tolerance: float) -> tuple[float, float]:
        """(relative change that further steps alone would make, steps until it is within a
        tolerance)."""
        rate = max(self.rates, default=_NO_DECAY)
        error = min(1.0, self.changes[-1] * rate / (1 - rate))
        if error <= tolerance:
            return error, 0.0
        return error, _STEPS_PER_CHECK * np.log(error / tolerance) / -np.log(rate)


@dataclass
class CorrectionPolicy:
    """Decides whether corrections pay off.

    enabled  whether to correct again
    count    corrections so far
    size     relative change by the last one
    error    relative error that is left of what corrections remove, and that steps do not show
    before   change by the steps before the last correction, until the steps after it are checked
    """

    enabled: bool
    count: int = 0
    size: float = 0.0
    error: float = 0.0
    before: float | None = None

    def record(self, size: float, before: float) -> None:
        """Record a correction of this relative size, and the change by the steps before it."""
        self.before = before
        ratio = max(size / self.size, _REMAINDER) if self.count else _FIRST_REMAINDER
        self.count, self.size = self.count + 1, size
        self.error = size * ratio / (1 - ratio)
        if ratio > _USELESS:
            self.disable()

    def has_worsened(self, change: float) -> bool:
        """Whether the first steps after a correction change more than the last ones before it.

        Most of a wrong correction is still there at that time, the more so the longer it would
        take to decay.
        """
        before, self.before = self.before, None
        return before is not None and change > before

    def disable(self) -> None:
        """Correct no more."""
        self.enabled, self.error, self.before = False, 0.0, None


def converge(
    level: Level, tolerance: float, most_steps: int, report: Callable[[float], None]
) -> tuple[float, int, int]:
    """Step the lattice of a started `Level` until its light is within a relative tolerance (L2).

    report  called with the estimated relative error at each check
    Returns (estimated relative error, steps, corrections).
    """
    lattice, steps, error = level.lattice, 0, 1.0
    monitor, policy = ConvergenceMonitor(lattice), CorrectionPolicy(enabled=not level.is_coarsest)
    while steps < most_steps:
        # Step, and undo a correction that turns out wrong.
        report(error)
        lattice.advance(min(_STEPS_PER_CHECK, most_steps - steps))
        steps = min(steps + _STEPS_PER_CHECK, most_steps)
        change = monitor.change()
        if policy.has_worsened(change):
            level.take_back()
            policy.disable()
            monitor.restart()
            continue

        # Estimate the error. After a correction the rate shows sooner.
        monitor.changes.append(change)
        rates = len(monitor.rates)
        if rates < (1 if policy.error else _RATES):
            continue
        remaining, remaining_steps = monitor.remaining(tolerance)
        if rates > 1:
            error = remaining + policy.error
            if error <= tolerance:
                break

        # Correct where it pays off, but never last: the steps after it show whether it was right.
        pays_off = remaining_steps > _FAR or remaining <= tolerance < remaining + policy.error
        if policy.enabled and pays_off and most_steps - steps > 2 * _STEPS_PER_CHECK:
            steps += level.correct()
            policy.record(monitor.restart(), change)
    return min(error, 1.0), steps, policy.count
