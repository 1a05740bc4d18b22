# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimating the cost of a bake before it is done."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..transport.device import troubles
from ..transport.medium import deepest
from ..transport.ordinates import source_iteration
from ..transport.planning.planner import Plan
from .bake import BakeTask
from .problem import Problem

if TYPE_CHECKING:
    from pathlib import Path

    from . import Send

TRIAL = 8  # steps of the paper model that are timed; the number that a bake takes is known


@dataclass
class Expected:
    """The expected cost and error of a bake, and what its medium is like.

    shape          voxels
    voxel_size     m
    bytes          of memory
    device         its label
    seconds        of the solver, approximately
    plan           the `Plan`, or None for the paper model, which has no error to plan for
    voxel_depth    optical depth of the densest voxel's edge
    domain_depth   the largest optical depth of a line through the domain along an axis
    notes          sentences for the user
    """

    shape: tuple[int, ...]
    voxel_size: float
    bytes: int
    device: str
    seconds: float
    plan: Plan | None
    voxel_depth: float
    domain_depth: float
    notes: list[str]

    @property
    def summary(self) -> str:
        """The main figures in one line."""
        error = f", with an error of {self.plan.error:.1%}" if self.plan else ""
        return f"A bake takes about {duration(self.seconds)} on {self.device}{error}"

    @property
    def report_lines(self) -> list[str]:
        """The figures, for the panel."""
        shape = " x ".join(map(str, self.shape))
        return [
            f"{shape} voxels of {self.voxel_size:.3g} m, {self.bytes / 2**20:.0f} MiB",
            f"About {duration(self.seconds)} on {self.device}",
            f"Optical depth: {self.voxel_depth:.2g} per voxel, {self.domain_depth:.3g} across",
            *(self.plan.reasons if self.plan else []),
        ]


@dataclass
class Estimate:
    """Estimate the cost of a bake: fill its voxels, and plan it."""

    bake: BakeTask

    def run(self, send: Send, _folder: Path) -> Expected:
        """An `Expected`."""
        send(stage="Filling voxels", fraction=0.0)
        problem = self.bake.problem()
        send(stage="Trying", fraction=0.5)
        medium = problem.medium
        depth = medium.depth(medium.sigma_t.max())
        is_paper = self.bake.options.model == "paper"
        costs = self._paper(problem) if is_paper else self._plan(problem)
        return Expected(
            medium.shape,
            medium.voxel_size,
            *costs,
            float(depth.max()),
            deepest(depth),
            [*self.bake.medium_choice.notes, *troubles],
        )

    def _plan(self, problem: Problem) -> tuple[int, str, float, Plan | None]:
        """(bytes, device, seconds, plan) of the physical model."""
        options = self.bake.options
        if options.is_planned:
            plan = self.bake.plan(problem, options.quality)
        else:  # all settings are fixed, so the target does not matter
            plan = self.bake.plan(problem, "final", options.by_hand)
        seconds = plan.seconds
        if iterations := self.bake.iterations(problem, plan.settings):
            device = options.device or None
            seconds += source_iteration.seconds(problem.medium, problem.lights, device, iterations)
        return plan.bytes, plan.device, seconds, plan

    def _paper(self, problem: Problem) -> tuple[int, str, float, Plan | None]:
        """(bytes, device, seconds, no plan) of the paper model, from a few steps."""
        settings = replace(self.bake.options.settings(), steps=TRIAL)
        report = self.bake.solve(problem, settings).report
        steps = report.seconds["solve"] / report.steps * 2 * max(problem.medium.shape)
        seconds = sum(report.seconds.values()) - report.seconds["solve"] + steps
        return report.bytes, report.device, seconds, None


def duration(seconds: float) -> str:
    """A time in s or min."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min"
