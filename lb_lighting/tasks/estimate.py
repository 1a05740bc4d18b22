# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding out what lighting a scene will take, before it is done."""

from dataclasses import dataclass, replace

from ..transport.device import troubles
from ..transport.medium import deepest
from ..transport.ordinates import source_iteration
from ..transport.planning.planner import Plan
from .light import Light

TRIED = 8  # steps of the paper's model, which takes a number of them that is known


@dataclass
class Expected:
    """What a bake will take, what it will be worth, and what the medium is like.

    shape          voxels
    voxel_size     m
    bytes          of memory
    device         its label
    seconds        about, of the solver
    plan           the `Plan`; None by the paper's model, which has no error to plan for
    voxel_depth    optical depth of the densest voxel's edge
    domain_depth   the largest optical depth of a line through the domain along an axis
    notes          sentences that the user should read
    """

    shape: tuple
    voxel_size: float
    bytes: int
    device: str
    seconds: float
    plan: Plan | None
    voxel_depth: float
    domain_depth: float
    notes: list

    @property
    def summary(self):
        """The most of it in one line."""
        error = f", {self.plan.error:.1%} off" if self.plan else ""
        return f"A bake takes about {duration(self.seconds)} on {self.device}{error}"

    @property
    def facts(self):
        """[line], for the panel."""
        shape = " x ".join(map(str, self.shape))
        return [
            f"{shape} voxels of {self.voxel_size:.3g} m, {self.bytes / 2**20:.0f} MiB",
            f"About {duration(self.seconds)} on {self.device}",
            f"Optical depth: {self.voxel_depth:.2g} a voxel, {self.domain_depth:.3g} across",
            *(self.plan.reasons if self.plan else []),
        ]


@dataclass
class Estimate:
    """Find out what a `Light` will take, by filling its voxels and by a plan."""

    light: Light

    def run(self, tell, _folder):
        """An `Expected`."""
        tell(stage="Filling voxels", fraction=0.0)
        problem = self.light.problem()
        tell(stage="Trying", fraction=0.5)
        medium = problem.medium
        depth = medium.depth(medium.sigma_t.max())
        found = self._paper(problem) if self.light.options.model == "paper" else self._plan(problem)
        return Expected(
            medium.shape,
            medium.voxel_size,
            *found,
            float(depth.max()),
            deepest(depth),
            [*self.light.reader.notes, *troubles],
        )

    def _plan(self, problem):
        options = self.light.options
        if options.is_planned:
            plan = self.light.plan(problem, options.quality)
        else:  # the target is of no importance: there is nothing to choose
            plan = self.light.plan(problem, "final", options.by_hand)
        seconds = plan.seconds
        if times := self.light.gathers(problem, plan.settings):
            device = options.device or None
            seconds += source_iteration.seconds(problem.medium, problem.lights, device, times)
        return plan.bytes, plan.device, seconds, plan

    def _paper(self, problem):
        settings = replace(self.light.options.settings(), steps=TRIED)
        report = self.light.solve(problem, settings).report
        steps = report.seconds["solve"] / report.steps * 2 * max(problem.medium.shape)
        seconds = sum(report.seconds.values()) - report.seconds["solve"] + steps
        return report.bytes, report.device, seconds, None


def duration(seconds):
    """A time as people say it."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min"
