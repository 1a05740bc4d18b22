# SPDX-License-Identifier: GPL-3.0-or-later
"""The task of a bake: fill the voxels of a scene, solve them, and write the file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from math import inf
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import exchange
from ..cache_key import cache_key
from ..output.ambient import Vertices, ambient_grids
from ..output.vdb import (
    EMISSION_GRID,
    leftovers,
    new_token,
    write_vdb,
)
from ..output.volume_light import volume_light
from ..transport.device import troubles
from ..transport.field import Field, Report
from ..transport.medium import Medium, paper_units
from ..transport.ordinates import source_iteration
from ..transport.planning.planner import BUDGETS, Plan, plan
from ..transport.solver import Settings, solve
from .problem import SPHERE, Problem, SceneTask
from .result import (
    ALL_LIGHT,
    CACHE_KEY,
    ITERATIONS,
    LIGHTS,
    LOOK,
    READERS,
    SETTINGS,
    SOURCES,
    BakeResult,
    SequenceChoices,
    text_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..arrays import Floats
    from . import Send

FIELD = "field"  # file of the `Field` in the task's folder
# The progress at which the plan begins, the solve begins, and the file is written;
PLAN, SOLVE, WRITE = 0.05, 0.1, 0.9
# and at which light along ordinates begins, if there is any.
ORDINATES = 0.4


@dataclass
class BakeTask(SceneTask):
    """Bake a scene: fill its voxels, solve, write the file.

    surfaces  {number of the source: `Vertices`} of surfaces that hold their light
    readers   numbers of the sources whose light a modifier reads from the file
    path      of the .vdb
    metadata  {name: value} for the file, besides options, report and coefficients
    choices   the `SequenceChoices`; `all_light` is always chosen
    token     of this bake, which sets its files apart from those of others
    """

    surfaces: dict[int, Vertices]
    readers: list[int]
    path: str
    metadata: dict[str, Any]
    choices: SequenceChoices
    token: str = field(default_factory=new_token)

    @property
    def all_light(self) -> bool:
        """Whether surfaces are to show all light, uncollided light included."""
        return bool(self.choices.all_light)

    @property
    def scraps(self) -> list[Path]:
        """The files to delete if the task does not end well."""
        return leftovers(self.path, self.token)

    def cache_keys(self) -> dict[str, str]:
        """{name: text} of what the result depends on, by what the user would change."""
        made = self.sources, self.box, self.surfaces, self.readers
        return {
            CACHE_KEY: self.options.cache_key,
            LIGHTS: cache_key(self.lights),
            SOURCES: cache_key(*made),
        }

    def run(self, send: Send, folder: Path) -> BakeResult:
        """A `BakeResult`; the `Field` goes to the file FIELD in `folder`."""
        send(stage="Filling voxels", fraction=0.0)
        cache_keys = self.cache_keys()
        problem = self.problem()
        settings, planned = self._settings(problem, send)
        solution = self._solve(problem, settings, send)
        send(stage="Writing", fraction=WRITE)
        exchange.save(folder / FIELD, solution)
        return self.keep(problem, solution, planned, {**cache_keys, SETTINGS: text_of(settings)})

    def _settings(self, problem: Problem, send: Send) -> tuple[Settings, Plan | None]:
        """(`Settings` for a `Problem`, the `Plan` that they come from or None)."""
        if self.choices.settings is not None:
            return self.choices.settings, None
        if not self.options.is_planned:
            return self.options.settings(), None
        send(stage="Planning", fraction=PLAN)
        planned = self.plan(problem, self.options.quality)
        if not (planned.meets_target and planned.keeps_to_budget):
            self.medium_choice.notes.append(planned.reasons[-1])
        return planned.settings, planned

    def plan(self, problem: Problem, quality: str, fixed: dict[str, Any] | None = None) -> Plan:
        """The `Plan` for a `Problem`; it does not choose the settings that are `fixed`."""
        device = self.options.device or None
        # Surfaces get the uncollided light of lamps from Cycles, unless the sky's is baked.
        scattered = bool(self.surfaces or self.readers) and not self.all_light
        return plan(problem.medium, problem.lights, quality, device, fixed, scattered=scattered)

    def solve(
        self,
        problem: Problem,
        settings: Settings,
        progress: Callable[[str, float], None] | None = None,
        residual: Callable[[float], None] | None = None,
    ) -> Field:
        """The `Field` of a `Problem`, by the model and on the device of the options."""
        is_paper = self.options.model == "paper"
        medium = paper_units(problem.medium) if is_paper else problem.medium
        device = self.options.device or None
        return solve(medium, problem.lights, settings, device, progress, residual=residual)

    def _solve(self, problem: Problem, settings: Settings, send: Send) -> Field:
        """The `Field` of a `Problem`, with light along ordinates, progress and notes."""
        stage, iterations = "Solving", self.iterations(problem, settings)
        end = ORDINATES if iterations else WRITE

        def residual(error: float) -> None:
            nonlocal stage
            is_known = error < 1  # not at the first checks
            stage = f"Solving (residual {error:.1%})" if is_known else "Solving"

        def progress(_stage: str, fraction: float) -> None:
            send(stage=stage, fraction=SOLVE + (end - SOLVE) * fraction)

        solution = self.solve(problem, settings, progress, residual)
        self._note_shortcomings(solution.report)
        if iterations:
            self._add_ordinates(problem, solution, iterations, send)
        return solution

    def _note_shortcomings(self, report: Report) -> None:
        notes = self.medium_choice.notes
        if not report.converged:
            notes.append(
                f"The light had not converged after {report.steps} steps and may be too dark; "
                "lower the resolution to converge sooner."
            )
        if not report.device.startswith("NumPy"):
            notes.extend(troubles)
        elif troubles:
            notes.append(" ".join([*troubles, "Solved with NumPy instead, which is slower."]))
        else:
            notes.append(
                "Solved with NumPy; an OpenCL driver for your processor or graphics card is faster."
            )

    def iterations(self, problem: Problem, settings: Settings) -> int:
        """How many source iterations along ordinates a `Problem` gets that `settings` solve."""
        if self.choices.iterations is not None:
            return self.choices.iterations
        is_enabled = self.options.gather and settings.model == "physical"
        has_volumes = any(source.is_volume for source in self.sources)
        is_multiple = settings.scattering == "multiple"
        if not (is_enabled and has_volumes and is_multiple):
            return 0
        if not source_iteration.is_worthwhile(problem.medium, problem.lights):
            return 0
        if self.options.quality == "preview":
            return 1
        budget = BUDGETS.get(self.options.quality, inf)
        if budget == inf:
            return source_iteration.ITERATIONS
        return self._iterations_in(budget, problem)

    def _iterations_in(self, budget: float, problem: Problem) -> int:
        """How many source iterations fit into a time of `budget` s; one at least."""
        device = self.options.device or None
        seconds = source_iteration.seconds(problem.medium, problem.lights, device, 1)
        iterations: int = min(max(int(budget / seconds), 1), source_iteration.ITERATIONS)
        if iterations < source_iteration.ITERATIONS:
            self.medium_choice.notes.append(
                f"Directional Scattering ran {iterations} of {source_iteration.ITERATIONS} passes, "
                f"to finish within about {budget:.0f} s; choose Final quality to run all of them."
            )
        return iterations

    def _add_ordinates(
        self, problem: Problem, solution: Field, iterations: int, send: Send
    ) -> None:
        """Add the scattered light along ordinates to the `Field` of a `Problem`."""

        def progress(share: float) -> None:
            send(stage="Directional scattering", fraction=ORDINATES + (WRITE - ORDINATES) * share)

        start, device = perf_counter(), self.options.device or None
        medium, lights = problem.medium, problem.lights
        solution.scattered = source_iteration.iterate(
            medium, lights, solution, device, iterations, progress
        )
        solution.report.seconds["gather"] = perf_counter() - start

    def keep(
        self,
        problem: Problem,
        solution: Field,
        planned: Plan | None = None,
        made_of: dict[str, str] | None = None,
    ) -> BakeResult:
        """Write the file for the `Field` of a `Problem`.

        made_of  {name: text} for the file's metadata
        """
        # The paper's opaque voxels are not dark; they only pass on less of their light.
        occlusion = None if self.options.model == "paper" else problem.medium.occlusion
        falling = solution.with_uncollided() if self.all_light else solution
        read = ambient_grids(falling, occlusion) if self.readers else None
        light, others, beams = volume_light(
            solution, problem.lights, self.options.mode, problem.medium.g
        )
        ambient = {
            number: vertices.light(falling, occlusion)
            for number, vertices in self.surfaces.items()
            if self._shows_light(number)
        }
        scattered = solution.scattered
        result = BakeResult(
            domain=solution.domain,
            report=solution.report,
            plan=planned,
            beams=beams,
            optics=problem.shown[1],
            lobes=None if scattered is None else scattered.g,
            iterations=0 if scattered is None else scattered.iterations,
            ambient=ambient,
            readers=[number for number in self.readers if self._shows_light(number)],
            notes=self.medium_choice.notes,
            left_out=[n for n, source in enumerate(self.sources) if source in self.left_out],
        )
        self._write(problem, result, light, others, read, made_of or {})
        return result

    def _shows_light(self, number: int) -> bool:
        """Whether the source of this number has a surface that shows its light."""
        source = self.sources[number]
        return source.shows_light and source not in self.left_out

    def _write(
        self,
        problem: Problem,
        result: BakeResult,
        light: Floats,
        others: dict[str, Floats],
        read: dict[str, Floats] | None,
        made_of: dict[str, str],
    ) -> None:
        """Write the .vdb of a `BakeResult`, with the grids that a modifier is to read, or None."""
        if problem.medium.emission is not None and self.options.mode == "REPLACE":
            others[EMISSION_GRID] = problem.medium.emission / SPHERE
        metadata = self._metadata(problem.medium, result.report) | made_of
        metadata |= {ITERATIONS: result.iterations, ALL_LIGHT: self.all_light}
        metadata |= {LOOK: result.look.text, READERS: json.dumps(self.choices.readers)}
        if result.plan is not None:
            metadata["expected_error"] = result.plan.error
        density = problem.shown[0]
        write_vdb(self.path, result.domain, density, light, metadata, others, read, self.token)

    def _metadata(self, medium: Medium, report: Report) -> dict[str, Any]:
        """What the file was made of and how."""
        reported = {name: value for name, value in asdict(report).items() if np.isscalar(value)}
        coefficients = {
            name: " ".join(f"{value:g}" for value in getattr(medium, name))
            for name in ("sigma_s", "sigma_a", "g")
        }
        totals = {"seconds": sum(report.seconds.values()), CACHE_KEY: self.options.cache_key}
        return {**asdict(self.options), **reported, **totals, **coefficients, **self.metadata}
