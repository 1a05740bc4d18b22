# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding out what lighting a scene will take, before it is done."""

from dataclasses import dataclass, replace

from .light import Light

# Steps that an estimate tries, and the work of so many that dense media take until they settle: a
# white cube of depth 32 takes 124 in 128^3 voxels (docs/performance.md).
TRIED, USUAL = 8, 120


@dataclass
class Expected:
    """What a bake will take, and what the medium is like.

    shape          voxels
    voxel_size     m
    bytes          on the device
    device         its label
    seconds        about, of the solver
    voxel_depth    optical depth of the densest voxel's edge
    domain_depth   the largest optical depth of a line through the domain along an axis
    notes          sentences that the user should read
    """

    shape: tuple
    voxel_size: float
    bytes: int
    device: str
    seconds: float
    voxel_depth: float
    domain_depth: float
    notes: list

    @property
    def summary(self):
        """The most of it in one line."""
        return f"A bake takes about {duration(self.seconds)} on {self.device}"

    @property
    def facts(self):
        """[line], for the panel."""
        shape = " x ".join(map(str, self.shape))
        return [
            f"{shape} voxels of {self.voxel_size:.3g} m, {self.bytes / 2**20:.0f} MiB",
            f"About {duration(self.seconds)} on {self.device}",
            f"Optical depth: {self.voxel_depth:.2g} a voxel, {self.domain_depth:.3g} across",
        ]


@dataclass
class Estimate:
    """Find out what a `Light` will take, by filling its voxels and by its first steps."""

    light: Light

    def run(self, tell, _folder):
        """An `Expected`."""
        tell(stage="Filling voxels", fraction=0.0)
        options, problem = self.light.options, self.light.problem()
        tell(stage="Trying", fraction=0.5)
        settings = replace(options.settings(), most_steps=TRIED, steps=TRIED)
        report, medium = self.light.solve(problem, settings).report, problem.medium
        usual = 2 * max(medium.shape) if options.model == "paper" else USUAL
        steps = report.seconds["solve"] / report.steps * usual
        depth = medium.depth(medium.sigma_t.max())
        return Expected(
            medium.shape,
            medium.voxel_size,
            report.bytes,
            report.device,
            sum(report.seconds.values()) - report.seconds["solve"] + steps,
            float(depth.max()),
            float(max(depth.sum(axis=axis).max() for axis in range(3))),
            self.light.reader.notes,
        )


def duration(seconds):
    """A time as people say it."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min"
