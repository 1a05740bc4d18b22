# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking at a scene's medium by free paths: pictures, and what the paths tell."""

import os
from dataclasses import dataclass

import numpy as np

from .. import exchange
from ..transport.photons.perlin import PerlinMedium
from ..transport.preview.pictures import View, pictures
from ..transport.preview.survey import advice, histogram_picture, statistics
from .light import Light

PICTURE, SURVEY = "picture", "survey"  # files in the task's folder
SAMPLES = 256.0  # of a pixel, after which a picture is good enough
SURVEYED = 2.0  # after which the picture lets the survey go first
PLOT = 240, 120  # pixels of the histogram
CELLS = 4096  # of noise, along an edge
CUTOFF = 0.35  # of noise: below it is void, which makes it clouds


@dataclass
class Survey:
    """What free paths tell.

    statistics  see transport/preview/survey.py
    advice      a sentence
    histogram   (height, width, 4), linear
    """

    statistics: object
    advice: str
    histogram: np.ndarray


@dataclass
class Preview:
    """Look at the medium of a `Light` without lighting it.

    view   `View`, or None for all of it from the front
    noise  whether noise, which no grid could hold, fills the domain in place of what is there
    """

    light: Light
    view: View | None
    noise: bool = False

    def run(self, tell, folder):
        """Write ever better pictures to PICTURE, and between them SURVEY; tell of each."""
        tell(stage="Filling voxels", fraction=0.0)
        options, problem = self.light.options, self.light.problem()
        device = options.device or None
        medium = _noise_like(problem.medium) if self.noise else problem.medium
        view = self.view or View.onto(problem.medium.domain, (0, 1, -0.3))
        surveyed = False
        for picture in pictures(medium, problem.lights, view, device):
            _replace(folder / PICTURE, picture.pixels)
            tell(stage="Previewing", fraction=min(1.0, picture.samples / SAMPLES), picture=True)
            if picture.samples >= SURVEYED and not surveyed:
                surveyed = True
                _replace(folder / SURVEY, _survey(medium, device, options.resolution))
                tell(survey=True)
            if picture.samples >= SAMPLES:
                return


def _survey(medium, device, resolution):
    found = statistics(medium, device)
    return Survey(found, advice(found, resolution), histogram_picture(found, *PLOT))


def _noise_like(medium):
    """A `PerlinMedium` in the cube about a medium, of its coefficients and about its density."""
    edge = medium.voxel_size * max(medium.shape)
    origin = np.add(medium.origin, np.multiply(medium.shape, medium.voxel_size) / 2) - edge / 2
    present = medium.density[medium.density > 0].mean()
    return PerlinMedium(
        CELLS,
        edge,
        medium.sigma_s * present,
        medium.sigma_a * present,
        medium.g,
        tuple(origin),
        CUTOFF,
    )


def _replace(path, thing):
    """Save `thing` at `path` so that a reader has the old or the new, never half of one."""
    half = path.with_suffix(".half")
    exchange.save(half, thing)
    os.replace(half, path)
