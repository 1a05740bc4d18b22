# SPDX-License-Identifier: GPL-3.0-or-later
"""Lighting a scene: its voxels are filled, it is solved, and the file written."""

import json
from dataclasses import asdict, dataclass, field, fields
from math import inf
from time import perf_counter

import numpy as np

from .. import exchange
from ..cache_key import cache_key
from ..errors import LightingError, SceneError
from ..options import Options
from ..output.ambient import ambient_grids
from ..output.look import Look
from ..output.vdb import (
    EMISSION_GRID,
    leftovers,
    new_token,
    write_vdb,
)
from ..output.volume_light import volume_light
from ..scene.mixture import mixture, occluders, with_shadows
from ..transport.device import troubles
from ..transport.field import Report
from ..transport.lights.base import bands_of
from ..transport.medium import (
    Domain,
    Medium,
    Optics,
    paper_units,
)
from ..transport.ordinates import source_iteration
from ..transport.planning.planner import BUDGETS, Plan, plan
from ..transport.solver import Settings, require_memory, solve

COARSEST = 2  # voxels along its longest edge that a source should have
SMALLEST_VOXEL = 2e-5  # m: OpenVDB takes the transform of much smaller ones for singular
FIELD = "field"
# In the file's metadata: what it was made of, see `Light.cache_keys`; the settings that it was
# solved by; how often its light was gathered; whether surfaces show all light; which sources a
# modifier is to light; its `Look`.
CACHE_KEY, LIGHTS, SOURCES = "essence", "essence_lights", "essence_sources"
SETTINGS, GATHERED, WHOLE, READERS, LOOK = "settings", "gathered", "whole", "readers", "look"
_SPHERE = np.float32(4 * np.pi)  # sr
# Where on its way a bake is when the plan begins, the solve begins, and when it ends.
PLAN, SOLVE, WRITE = 0.05, 0.1, 0.9
GATHER = 0.4  # and where the solve ends, where light is gathered then


@dataclass(frozen=True)
class Decided:
    """What all frames of a sequence have in common, since they share materials; None where it is
    for this frame to decide.

    settings  `Settings` that it is solved by
    times     that light is gathered
    whole     whether surfaces show all light, unscattered light, too
    readers   {name of a source: whether a modifier is to light it}
    """

    settings: Settings | None = None
    times: int | None = None
    whole: bool | None = None
    readers: dict = field(default_factory=dict)

    @classmethod
    def read(cls, stamp):
        """What the frame with the metadata `stamp` had."""
        values = json.loads(stamp.get(SETTINGS, "{}"))
        known = {f.name: values[f.name] for f in fields(Settings) if f.name in values}
        settings = Settings(**known) if known else None
        readers = json.loads(stamp.get(READERS, "{}"))
        return cls(settings, stamp.get(GATHERED), stamp.get(WHOLE), readers)


@dataclass
class Problem:
    """A scene as the solver sees it.

    medium  in SI units
    shown   (density (nx, ny, nz), Optics) of what the lit volume renders: the volumes alone,
            where there are any, for surfaces show their light themselves
    lights  transport lights
    """

    medium: Medium
    shown: tuple
    lights: list


@dataclass
class Lit:
    """What lighting a scene came to.

    domain   the `Domain` of the solve
    report   the solver's
    plan     the `Plan` that it was solved by, or None where there was none
    beams    the `Sun`, `PointLight` or `SpotLight` of each grid of unscattered light in the file
    optics   what the lit volume renders at density 1
    lobes    (bands,) mean cosine of the lobes that light gathered has about beams; None where
             none was gathered
    times    that it was, or 0
    ambient  {number of the source: what `Vertices.light` returns}
    readers  [number of the source] of those that a modifier is to light
    notes    sentences that the user should read
    left_out numbers of the sources that could not be lit
    """

    domain: Domain
    report: Report
    plan: Plan | None
    beams: list
    optics: Optics
    lobes: np.ndarray | None
    times: int
    ambient: dict
    readers: list
    notes: list
    left_out: list

    @property
    def look(self):
        """The `Look` of the lit volume."""
        optics = self.optics
        coefficients = optics.sigma_s, optics.sigma_a, optics.g
        return Look.of(*coefficients, self.beams, self.domain.voxel_size, self.lobes)


@dataclass
class Light:
    """Light a scene: fill its voxels, solve, write the file.

    options   `Options`
    sources   see scene/sources.py
    reader    what they were read by, which knows the presets
    lights    [light], see transport/lights/lamps.py
    box       (lower, upper), each (3,) m, to light, or None for the bounds of the sources
    surfaces  {number of the source: `Vertices`} that are to show their light
    readers   [number of the source] of those whose light a modifier reads from the file
    path      of the .vdb
    facts     {name: value} that the file is to carry, besides options, report and coefficients
    decided   what another frame has `Decided`; whether surfaces show all light is so in any case
    left_out  [source] that turn out to be unreadable on the way
    is_frame  whether it is one of a sequence
    token     of this bake, which tells its file from those of others
    """

    options: Options
    sources: list
    reader: object
    lights: list
    box: tuple | None
    surfaces: dict
    readers: list
    path: str
    facts: dict
    decided: Decided
    left_out: list
    is_frame: bool
    token: str = field(default_factory=new_token)

    @property
    def whole(self):
        """Whether surfaces are to show all light, unscattered light, too."""
        return self.decided.whole

    @property
    def scraps(self):
        """The files that are there only in part, or in vain, where the task does not end well."""
        return leftovers(self.path, self.token)

    def cache_keys(self):
        """{name: text}: what the result depends on, by what the user would change."""
        made = self.sources, self.box, self.surfaces, self.readers
        return {
            CACHE_KEY: self.options.cache_key,
            LIGHTS: cache_key(self.lights),
            SOURCES: cache_key(*made),
        }

    def run(self, tell, folder):
        """A `Lit`; the `Field` goes to the file FIELD in `folder`."""
        tell(stage="Filling voxels", fraction=0.0)
        made_of = self.cache_keys()
        problem = self.problem()
        settings, planned = self._settings(problem, tell)
        field = self._solve(problem, settings, tell)
        tell(stage="Writing", fraction=WRITE)
        exchange.save(folder / FIELD, field)
        return self.keep(problem, field, planned, {**made_of, SETTINGS: _text_of(settings)})

    def _settings(self, problem, tell):
        """(`Settings`, the `Plan` that they are of or None)."""
        if self.decided.settings is not None:
            return self.decided.settings, None
        if not self.options.is_planned:
            return self.options.settings(), None
        tell(stage="Planning", fraction=PLAN)
        planned = self.plan(problem, self.options.quality)
        if not (planned.meets_target and planned.keeps_to_budget):
            self.reader.notes.append(planned.reasons[-1])
        return planned.settings, planned

    def plan(self, problem, quality, fixed=None):
        """The `Plan` for a `Problem`; fixed is what is not to be chosen."""
        device = self.options.device or None
        # Lamps' own light on surfaces is Cycles', but for a sky's that is baked.
        scattered = bool(self.surfaces or self.readers) and not self.whole
        return plan(problem.medium, problem.lights, quality, device, fixed, scattered=scattered)

    def keep(self, problem, field, planned=None, made_of=None):
        """Write the file of the `Field` that a `Problem` has: a `Lit`.

        made_of  {name: text} that the file is to carry, too
        """
        # The paper's opaque voxels are not dark, they only send on less of their light.
        occlusion = None if self.options.model == "paper" else problem.medium.occlusion
        falling = field.with_unscattered() if self.whole else field
        read = ambient_grids(falling, occlusion) if self.readers else None
        light, others, beams = volume_light(
            field, problem.lights, self.options.mode, problem.medium.g
        )
        ambient = {
            number: vertices.light(falling, occlusion)
            for number, vertices in self.surfaces.items()
            if self._shows_light(number)
        }
        optics = problem.shown[1]
        lit = Lit(
            field.domain,
            field.report,
            planned,
            beams,
            optics,
            None if field.scattered is None else field.scattered.g,
            _times(field),
            ambient,
            [number for number in self.readers if self._shows_light(number)],
            self.reader.notes,
            [number for number, source in enumerate(self.sources) if source in self.left_out],
        )
        self._write(problem, lit, light, others, read, made_of or {})
        return lit

    def _shows_light(self, number):
        """Whether the source of this number has a surface that shows its light."""
        source = self.sources[number]
        return source.shows_light and source not in self.left_out

    def problem(self):
        """The `Problem` that the scene poses."""
        domain = self._domain()
        shares = self._of_each(lambda source: source.shares(domain))
        occlusions = self._of_each(lambda source: source.occlusion(domain)).values()
        occlusions = [occlusion for occlusion in occlusions if occlusion is not None]
        everything = [share for own in shares.values() for share in own]
        emission = self._emission(domain)
        shines = emission is not None
        density, optics = self.reader.mixture(everything, shines)
        occlusion, albedo = occluders(occlusions) if occlusions else (None, np.zeros(1))
        bands = _bands(optics, self.lights, albedo, emission)
        volumes = [share for source, own in shares.items() for share in own if source.is_volume]
        medium = Medium(
            density,
            domain.voxel_size,
            *(np.broadcast_to(v, bands) for v in (optics.sigma_s, optics.sigma_a)),
            optics.g,
            domain.origin,
            emission=None if emission is None else _SPHERE * emission[:bands],
            occlusion=occlusion,
            occlusion_albedo=np.broadcast_to(albedo, (bands, *albedo.shape[1:])),
        )
        shown = density, optics
        if volumes and (shines or any(np.any(share.density) for share in volumes)):
            shown = mixture(volumes, shines)
        elif volumes or self.is_frame:  # there are none here, but other frames may have some
            shown = np.zeros_like(density), optics
        return Problem(medium, shown, with_shadows(self.lights, everything))

    def _emission(self, domain):
        """(3, nx, ny, nz) W/(m^3 sr) that the sources shine with by themselves, or None."""
        found = self._of_each(lambda source: source.emission(domain)).values()
        found = [emission for emission in found if emission is not None]
        if found and self.options.model == "paper":
            self.reader.notes.append("The paper's model leaves out the light of fire.")
            return None
        return np.sum(found, axis=0) if np.any(found) else None

    def _domain(self):
        bounds = {} if self.box else self._of_each(lambda source: source.bounds)
        corners = np.concatenate([self.box] if self.box else list(bounds.values()))
        padding, resolution = self.options.padding, self.options.resolution
        domain = Domain.around(corners.min(axis=0), corners.max(axis=0), resolution, padding)
        # A plan chooses what fits; unscattered light is the least of it.
        least = Settings(scattering="single")
        settings = least if self.options.is_planned else self.options.settings()
        require_memory(domain.shape, settings, self.options.device)
        if domain.voxel_size < SMALLEST_VOXEL:
            raise SceneError(
                f"Voxels of {domain.voxel_size:.1g} m are too small for a volume file; "
                "scale the scene up."
            )
        for source, (lower, upper) in bounds.items():
            wide = (upper - lower).max() / domain.voxel_size
            if wide < COARSEST and len(bounds) > 1:
                self.reader.notes.append(
                    f"'{source.name}' is only {wide:.1g} voxels large among the others; light it "
                    "by itself to see its shape."
                )
        return domain

    def _of_each(self, find):
        """{source: find(source)}, without those that cannot be read, which are noted.

        Raises the LightingError of the first where none is left.
        """
        found, failed = {}, []
        for source in self.sources:
            if source in self.left_out:
                continue
            try:
                found[source] = find(source)
            except LightingError as error:
                failed.append((source, error))
        if failed and not found:
            raise failed[0][1]
        for source, error in failed:
            self.left_out.append(source)
            self.reader.notes.append(f"'{source.name}' is left out. {error}")
        return found

    def solve(self, problem, settings, progress=None, residual=None):
        """The `Field` of a `Problem`, by the model and on the device that were chosen."""
        is_paper = self.options.model == "paper"
        medium = paper_units(problem.medium) if is_paper else problem.medium
        device, told = self.options.device or None, {"progress": progress, "residual": residual}
        return solve(medium, problem.lights, settings, device, **told)

    def gathers(self, problem, settings):
        """How many times a `Problem` that is solved by `Settings` has its light gathered."""
        if self.decided.times is not None:
            return self.decided.times
        wished = self.options.gather and settings.model == "physical"
        volumes = any(source.is_volume for source in self.sources)
        several = settings.scattering == "multiple"
        if not (wished and volumes and several):
            return 0
        if not source_iteration.is_worthwhile(problem.medium, problem.lights):
            return 0
        if self.options.quality == "preview":
            return 1
        budget = BUDGETS.get(self.options.quality, inf)
        return (
            source_iteration.ITERATIONS if budget == inf else self._gathers_within(budget, problem)
        )

    def _gathers_within(self, budget, problem):
        """How many times the light of a `Problem` is gathered within some seconds: once or more."""
        device = self.options.device or None
        once = source_iteration.seconds(problem.medium, problem.lights, device, 1)
        most = source_iteration.ITERATIONS
        times = min(max(int(budget / once), 1), most)
        if times < most:
            self.reader.notes.append(
                f"Directions are gathered {times} of {most} times, to end within "
                f"about {budget:.0f} s; choose Final to gather them all."
            )
        return times

    def _solve(self, problem, settings, tell):
        stage, times = "Solving", self.gathers(problem, settings)
        end = GATHER if times else WRITE

        def residual(error):
            nonlocal stage
            known = error < 1  # not at the first looks
            stage = f"Solving (residual {error:.1%})" if known else "Solving"

        def progress(_stage, fraction):
            tell(stage=stage, fraction=SOLVE + (end - SOLVE) * fraction)

        field = self.solve(problem, settings, progress, residual)
        if not field.report.converged:
            self.reader.notes.append(
                f"The light had not settled after {field.report.steps} steps and may be too dark; "
                "a lower resolution settles sooner."
            )
        if field.report.device.startswith("NumPy"):
            self.reader.notes.append(
                " ".join([*troubles, "Solved with NumPy instead, which is slower."])
                if troubles
                else "Solved with NumPy; an OpenCL driver for your processor or graphics card is "
                "faster."
            )
        else:
            self.reader.notes.extend(troubles)
        if times:
            self._gather(problem, field, times, tell)
        return field

    def _gather(self, problem, field, times, tell):
        """Add to a `Field` what its light is scattered to."""

        def progress(share):
            tell(stage="Gathering", fraction=GATHER + (WRITE - GATHER) * share)

        start, device = perf_counter(), self.options.device or None
        medium, lights = problem.medium, problem.lights
        field.scattered = source_iteration.iterate(medium, lights, field, device, times, progress)
        field.report.seconds["gather"] = perf_counter() - start

    def _write(self, problem, lit, light, others, read, made_of):
        """Write the .vdb of a `Lit`, with the grids that a modifier is to read, or None."""
        if problem.medium.emission is not None and self.options.mode == "REPLACE":
            others[EMISSION_GRID] = problem.medium.emission / _SPHERE
        stamp = self._stamp(problem.medium, lit.report) | made_of
        stamp |= {GATHERED: lit.times, WHOLE: self.whole, LOOK: lit.look.text}
        stamp[READERS] = json.dumps(self.decided.readers)
        if lit.plan is not None:
            stamp["expected_error"] = lit.plan.error
        density = problem.shown[0]
        write_vdb(self.path, lit.domain, density, light, stamp, others, read, self.token)

    def _stamp(self, medium, report):
        """What the file was made of and how, flat, for its metadata."""
        told = {name: value for name, value in asdict(report).items() if np.isscalar(value)}
        coefficients = {
            name: " ".join(f"{value:g}" for value in getattr(medium, name))
            for name in ("sigma_s", "sigma_a", "g")
        }
        spent = {"seconds": sum(report.seconds.values()), CACHE_KEY: self.options.cache_key}
        return {**asdict(self.options), **told, **spent, **coefficients, **self.facts}


def _text_of(settings):
    """`Settings` as `Decided.read` reads them."""
    return json.dumps(asdict(settings), default=lambda number: number.item())


def _times(field):
    """How often the light of a `Field` was gathered."""
    return 0 if field.scattered is None else field.scattered.iterations


def _bands(optics, lights, albedo, emission):
    """3 where a coefficient, a light, an occluder or the emission has a colour, else 1."""
    if emission is not None and np.ptp(emission, axis=0).any():
        return 3
    values = [optics.sigma_s, optics.sigma_a, optics.g]
    return max(len(albedo), *map(np.size, values), *map(bands_of, lights))
