# SPDX-License-Identifier: GPL-3.0-or-later
"""An equirectangular picture of the sky as lights: suns for its brightest cells, and a sky."""

from dataclasses import dataclass
from math import ceil

import numpy as np

from ...arrays import Floats, Integers
from .distant import Sky, Sun
from .sampling import SKY_CELLS, cells_of

_MOST_SUNS = 8  # each is a separate light, with a separate grid in volumes that show it
# The share of all light from which on a cell becomes a sun: about that of one of the directions
# that stand for the sky.
_SUN_SHARE = 1 / 40
# Pixels along an edge: pixels are divided below the first and merged above twice the second.
_FEWEST, _MOST = (256, 512), (512, 1024)


@dataclass(frozen=True, eq=False)
class CellSky:
    """A radiance that is constant in each cell of the sky: a function for `Sky`.

    cells  (2048,) or (2048, bands) W/(m^2 sr), of the cells of `sampling.cells_of`
    """

    cells: Floats

    def __call__(self, towards: Floats) -> Floats:
        """(...) or (..., bands) W/(m^2 sr) from the directions `towards`, (..., 3) unit vectors."""
        return self.cells[cells_of(np.asarray(towards, float))]


def panorama_lights(pixels: Floats, to_picture: Floats | None = None) -> list[Sun | Sky]:
    """[Sun, ..., Sky]: an equirectangular picture as lights of the same power.

    The brightest cells become suns, the remainder a sky.

    pixels      (height, width) or (height, width, bands) W/(m^2 sr), from the bottom up; columns
                go from -x by +y, +x and -y to -x again, as in Blender
    to_picture  (3, 3), the rotation or reflection of the world's directions to the picture's
    """
    pixels = np.asarray(pixels, float)
    bands = pixels.shape[2:]
    power, angle, towards = _by_pixel(pixels.reshape(*pixels.shape[:2], -1))
    towards = towards if to_picture is None else towards @ to_picture
    cell, count = cells_of(towards), SKY_CELLS[0] * SKY_CELLS[1]

    def by_cell(values: Floats) -> Floats:
        return np.stack([np.bincount(cell, v, count) for v in values.T], axis=1)

    angles = np.maximum(by_cell(angle[:, None]), np.finfo(float).tiny)
    radiance = by_cell(power) / angles
    suns = _suns((radiance * angles).sum(axis=1))
    level = radiance.copy()  # of the sky; suns carry the light above it
    level[suns] = np.minimum(radiance, np.median(radiance, axis=0))[suns]
    excess = np.maximum((power - level[cell] * angle[:, None]).sum(axis=1), 0)
    place, irradiance = by_cell(excess[:, None] * towards), (radiance - level) * angles
    lights: list[Sun | Sky] = [
        Sun(_away(place[n]), _as(bands, irradiance[n])) for n in suns if irradiance[n].any()
    ]
    # A `Sky` counts all cells alike, but pixels cover them unevenly: keep the total power.
    even = level.mean(axis=0) * 4 * np.pi
    level *= np.divide((level * angles).sum(axis=0), even, out=np.ones_like(even), where=even > 0)
    if np.allclose(level, level[0], rtol=1e-9, atol=0):
        return [*lights, Sky(_as(bands, level[0]))] if level.any() else lights
    return [*lights, Sky(CellSky(level if bands else level[:, 0]))]


def _suns(power: Floats) -> Integers:
    """The cells (n,) that become suns by their power (cells,), the brightest first."""
    brightest = np.argsort(-power, kind="stable")[:_MOST_SUNS]
    return brightest[power[brightest] > _SUN_SHARE * power.sum()]


def _away(place: Floats) -> tuple[float, ...]:
    return tuple(map(float, -place / np.linalg.norm(place)))


def _as(bands: tuple[int, ...], spectrum: Floats) -> tuple[float, ...] | float:
    return tuple(map(float, spectrum)) if bands else float(spectrum[0])


def _by_pixel(pixels: Floats) -> tuple[Floats, Floats, Floats]:
    """Power (n, bands) W/m^2, solid angle (n,) sr and unit direction (n, 3) of pixels."""
    for axis, fewest in enumerate(_FEWEST):
        pixels = pixels.repeat(ceil(fewest / pixels.shape[axis]), axis)
    height, width, _ = pixels.shape
    rows, columns = (
        np.arange(0, n, max(1, n // most)) for n, most in zip((height, width), _MOST, strict=True)
    )
    sines = np.sin(np.pi * (np.arange(height + 1) / height - 0.5))
    strips = np.diff(sines) * 2 * np.pi / width  # sr, of a pixel by its row
    power = np.add.reduceat(pixels * strips[:, None, None], rows, axis=0)
    power = np.add.reduceat(power, columns, axis=1)
    ends_of_rows, ends = np.append(rows, height), np.append(columns, width) / width
    angle = np.outer(np.diff(sines[ends_of_rows]), np.diff(ends) * 2 * np.pi)
    up = (sines[ends_of_rows[1:]] + sines[ends_of_rows[:-1]])[:, None] / 2
    turn = np.pi * (1 - ends[1:] - ends[:-1])
    flat = np.sqrt(1 - up**2)
    components = np.broadcast_arrays(flat * np.cos(turn), flat * np.sin(turn), up)
    towards = np.stack([component.ravel() for component in components], axis=1)
    return power.reshape(-1, power.shape[-1]), angle.ravel(), towards
