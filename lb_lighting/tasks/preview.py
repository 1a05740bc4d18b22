# SPDX-License-Identifier: GPL-3.0-or-later
"""Previewing a scene's medium by free paths: pictures, statistics and advice."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import exchange
from ..transport.photons.perlin import PerlinMedium
from ..transport.preview.pictures import View, pictures
from ..transport.preview.survey import Statistics, advice, histogram_picture, statistics
from .bake import BakeTask

if TYPE_CHECKING:
    from ..arrays import Floats
    from ..transport.medium import Medium
    from . import Send

PICTURE, SURVEY = "picture", "survey"  # files in the task's folder
SAMPLES = 256.0  # per pixel, after which the picture is good enough
SURVEYED = 2.0  # samples per pixel, after which the survey is made
PLOT = 240, 120  # pixels of the histogram
CELLS = 4096  # of noise, along an edge
CUTOFF = 0.35  # of noise: lower values are void, which makes clouds


@dataclass
class Survey:
    """What free paths show of a medium.

    statistics  see transport/preview/survey.py
    advice      a sentence
    histogram   (height, width, 4), linear
    """

    statistics: Statistics
    advice: str
    histogram: Floats


@dataclass
class Preview:
    """Preview the medium of a `BakeTask` without a bake.

    view   `View`, or None for all of it from the front
    noise  whether fractal noise, too fine for any grid, replaces the medium's density
    """

    bake: BakeTask
    view: View | None
    noise: bool = False

    def run(self, send: Send, folder: Path) -> None:
        """Write ever better pictures to PICTURE, and once SURVEY; send a message for each."""
        send(stage="Filling voxels", fraction=0.0)
        options, problem = self.bake.options, self.bake.problem()
        device = options.device or None
        medium = _noise_like(problem.medium) if self.noise else problem.medium
        view = self.view or View.onto(problem.medium.domain, (0, 1, -0.3))
        is_surveyed = False
        for picture in pictures(medium, problem.lights, view, device):
            _replace(folder / PICTURE, picture.pixels)
            send(stage="Previewing", fraction=min(1.0, picture.samples / SAMPLES), picture=True)
            if picture.samples >= SURVEYED and not is_surveyed:
                is_surveyed = True
                _replace(folder / SURVEY, _survey(medium, device, options.resolution))
                send(survey=True)
            if picture.samples >= SAMPLES:
                return


def _survey(medium: Medium | PerlinMedium, device: str | None, resolution: int) -> Survey:
    figures = statistics(medium, device)
    return Survey(figures, advice(figures, resolution), histogram_picture(figures, *PLOT))


def _noise_like(medium: Medium) -> PerlinMedium:
    """A `PerlinMedium` in the cube around a medium, with its coefficients and mean density."""
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


def _replace(path: Path, thing: Any) -> None:
    """Save `thing` at `path`: a reader finds the old or the new file, never a part of one."""
    half = path.with_suffix(".half")
    exchange.save(half, thing)
    os.replace(half, path)
