# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a lattice is stepped, and when coarser ones are asked for help.

Nobody knows the light that a lattice tends to, so the error is estimated from how fast changes
shrink: by a factor q from one look to the next, so that all that are still to come add up to
q / (1 - q) of the last. Corrections take away what would shrink slowly, and leave changes that tell
nothing of it; what they leave is estimated in the same way, from one correction to the next.
"""

from dataclasses import dataclass, field

import numpy as np

_LOOK_EVERY = 8  # steps between two looks
_LAYERS, _FEW = 16, 48  # that are looked at, but all where there are few: a look costs half a step
_RATES = 3  # rates of shrinking that are kept: the slowest counts
_NEVER = 1 - 1e-6  # changes that shrink no faster than this do not shrink
_FAR = 60  # steps still to come from which on a correction, which costs some 24, is worth it
_LEFT = 0.3  # of what a correction took away, at least: taken to be left; of the first one, twice
_USELESS = 0.6  # corrections that shrink no faster than this are not worth it


@dataclass
class _Look:
    """What the looks at a lattice tell."""

    lattice: object
    light: object = 0.0
    changes: list = field(default_factory=list)  # relative ones, since the last correction

    def change(self):
        """The relative change of the fluence since the last look."""
        layers = self.lattice.shape[0]
        every = 1 if layers < _FEW else layers // _LAYERS
        before, self.light = self.light, self.lattice.fluence(every)
        norm = float(np.linalg.norm(self.light))
        return float(np.linalg.norm(self.light - before)) / (norm or 1.0)

    def start_again(self):
        """The same, of light that something else than steps has changed."""
        self.changes.clear()
        return self.change()

    @property
    def rates(self):
        pairs = zip(self.changes, self.changes[1:], strict=False)
        return [min(change / last if last else 0.0, _NEVER) for last, change in pairs][-_RATES:]

    def still_to_come(self, tolerance):
        """(relative change still to come by steps alone, steps until it is within a tolerance)."""
        rate = max(self.rates, default=_NEVER)
        left = min(1.0, self.changes[-1] * rate / (1 - rate))
        if left <= tolerance:
            return left, 0.0
        return left, _LOOK_EVERY * np.log(left / tolerance) / -np.log(rate)


@dataclass
class _Help:
    """What corrections are worth."""

    wanted: bool
    count: int = 0
    size: float = 0.0  # the relative change by the last one
    left: float = 0.0  # relative error that is left where steps no longer see it
    before: float | None = None  # the change by the steps before it, until those after it are seen

    def note(self, size, before):
        """A correction of this size, and the change by the steps before it."""
        self.before = before
        kept = max(size / self.size, _LEFT) if self.count else 0.5
        self.count, self.size = self.count + 1, size
        self.left = size * kept / (1 - kept)
        if kept > _USELESS:
            self.give_up()

    def made_it_worse(self, change):
        """Whether the first steps after a correction change more than the last ones before it.

        What it added still is there, for the most part: the more surely, the longer it would take
        to go away.
        """
        before, self.before = self.before, None
        return before is not None and change > before

    def give_up(self):
        self.wanted, self.left, self.before = False, 0.0, None


def settle(level, tolerance, most_steps, tell):
    """Step a started `Level` until its light is within a tolerance of what it tends to.

    tell  is called with the estimated error at each look
    Returns (estimated relative error, steps, corrections).
    """
    lattice, steps, error = level.lattice, 0, 1.0
    look, help_ = _Look(lattice), _Help(wanted=not level.is_coarsest)
    while steps < most_steps:
        tell(error)
        lattice.advance(min(_LOOK_EVERY, most_steps - steps))
        steps = min(steps + _LOOK_EVERY, most_steps)
        change = look.change()
        if help_.made_it_worse(change):
            level.take_back()
            help_.give_up()
            look.start_again()
            continue
        look.changes.append(change)
        # What a correction leaves shrinks fast, and tells sooner how fast.
        rates = len(look.rates)
        if rates < (1 if help_.left else _RATES):
            continue
        left, ahead = look.still_to_come(tolerance)
        if rates > 1:
            error = left + help_.left
            if error <= tolerance:
                break
        # Never as the last thing done: whether it was right shows in the steps after it.
        helps = ahead > _FAR or left <= tolerance < left + help_.left
        if help_.wanted and helps and most_steps - steps > 2 * _LOOK_EVERY:
            steps += level.correct()
            help_.note(look.start_again(), change)
    return min(error, 1.0), steps, help_.count
