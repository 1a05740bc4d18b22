# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a bake, and the choices that its file passes on to later frames of a sequence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

from ..output.look import Look
from ..transport.field import Report
from ..transport.medium import Domain, Optics
from ..transport.planning.planner import Plan
from ..transport.solver import Settings

if TYPE_CHECKING:
    from ..arrays import Floats

# Keys of the file's metadata. What the file was made of, see `BakeTask.cache_keys`:
CACHE_KEY, LIGHTS, SOURCES = "essence", "essence_lights", "essence_sources"
# how it was made, see `SequenceChoices`:
SETTINGS, ITERATIONS, ALL_LIGHT, READERS = "settings", "gathered", "whole", "readers"
# and its `Look`.
LOOK = "look"


@dataclass(frozen=True)
class SequenceChoices:
    """What all frames of a sequence have in common, because they share materials; None for what the
    first frame has yet to choose.

    settings    `Settings` of the solver
    iterations  of the source iteration along ordinates; 0 for none
    all_light   whether surfaces show all light, uncollided light included
    readers     {name of a source: whether a modifier is to light it}
    """

    settings: Settings | None = None
    iterations: int | None = None
    all_light: bool | None = None
    readers: dict[str, bool] = field(default_factory=dict)

    @classmethod
    def read(cls, metadata: Mapping[str, Any]) -> SequenceChoices:
        """The choices of the frame whose file has this metadata."""
        values = json.loads(metadata.get(SETTINGS, "{}"))
        known = {f.name: values[f.name] for f in fields(Settings) if f.name in values}
        settings = Settings(**known) if known else None
        readers = json.loads(metadata.get(READERS, "{}"))
        return cls(settings, metadata.get(ITERATIONS), metadata.get(ALL_LIGHT), readers)


def text_of(settings: Settings) -> str:
    """`Settings` as text that `SequenceChoices.read` reads."""
    return json.dumps(asdict(settings), default=lambda number: number.item())


@dataclass
class BakeResult:
    """The result of a bake; the light itself is in files.

    domain      the `Domain` of the solve
    report      the solver's `Report`
    plan        the `Plan` of the solve, or None if there was none
    beams       the `Sun`, `PointLight` or `SpotLight` of each grid of uncollided light in the file
    optics      what the lit volume renders at density 1
    lobes       (bands,) mean cosine of the lobes about beams in light along ordinates, or None
    iterations  of the source iteration along ordinates; 0 for none
    ambient     {number of the source: what `Vertices.light` returns}
    readers     numbers of the sources that a modifier is to light
    notes       sentences for the user
    left_out    numbers of the sources that could not be lit
    """

    domain: Domain
    report: Report
    plan: Plan | None
    beams: list[Any]
    optics: Optics
    lobes: Floats | None
    iterations: int
    ambient: dict[int, Floats]
    readers: list[int]
    notes: list[str]
    left_out: list[int]

    @property
    def look(self) -> Look:
        """The `Look` of the lit volume."""
        optics = self.optics
        coefficients = optics.sigma_s, optics.sigma_a, optics.g
        return Look.of(*coefficients, self.beams, self.domain.voxel_size, self.lobes)
