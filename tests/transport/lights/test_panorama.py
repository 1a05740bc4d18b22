# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the sky as lights: the same power from the same directions."""

import pickle

import numpy as np
import pytest

from lb_lighting.transport import Medium, Sky, Sun
from lb_lighting.transport.lights.panorama import CellSky, panorama_lights
from lb_lighting.transport.lights.sampling import SKY_CELLS, cell_centers, cells_of
from lb_lighting.transport.uncollided.casting import cast

NORMALS = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (6, 3, 5)]


def landscape(height, sun=0.0):
    """(height, 2 height) W/(m^2 sr): ground, sky, a window of light, and a sun of 1.3 pixels."""
    row, column = np.mgrid[:height, : 2 * height] / height
    pixels = 1 + 0.5 * np.sin(np.pi * column) + 0.8 * row
    pixels[np.hypot(column - 0.6, row - 0.7) < 0.05] += 3
    place = int(0.8 * height), int(0.44 * height)
    if sun:
        pixels[place] = sun
        pixels[place[0] + 1, place[1]] = 0.3 * sun
    return pixels


def exact(pixels, pieces=4):
    """Directions (n, 3) and power (n,) W/m^2 of the pixels, each divided along its edges."""
    pixels = pixels.repeat(pieces, 0).repeat(pieces, 1)
    height, width = pixels.shape
    edges = np.sin(np.pi * (np.arange(height + 1) / height - 0.5))
    up = np.arcsin((edges[1:] + edges[:-1]) / 2)[:, None]
    turn = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width
    parts = np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up) + 0 * turn
    power = pixels * np.diff(edges)[:, None] * 2 * np.pi / width
    return np.stack(parts, axis=-1).reshape(-1, 3), power.ravel()


def irradiance(lights, normal):
    total = 0.0
    for light in lights:
        if isinstance(light, Sun):
            total += light.irradiance * max(0, -np.dot(light.direction, normal))
        else:
            rows, columns = SKY_CELLS  # and in each cell 4 x 4 points
            across = 1 - 2 * (np.arange(4 * rows) + 0.5) / (4 * rows)
            turn = 2 * np.pi * (np.arange(4 * columns) + 0.5) / (4 * columns)
            flat = np.sqrt(1 - across**2)[:, None]
            parts = across[:, None] + 0 * turn, flat * np.cos(turn), flat * np.sin(turn)
            towards = np.stack(parts, axis=-1)
            total += (light.radiance(towards) * np.maximum(towards @ normal, 0)).mean() * 4 * np.pi
    return total


@pytest.mark.parametrize("height", [32, 100, 512, 1100])
@pytest.mark.parametrize("sun", [0.0, 1e5])
def test_irradiance_is_that_of_the_picture(height, sun):
    """Up to .5 % (measured: .3 % if pixels are larger than cells, otherwise .07 %)."""
    pixels = landscape(height, sun)
    lights = panorama_lights(pixels)
    directions, power = exact(pixels, 8 if height < 50 else 2)
    assert any(isinstance(light, Sun) for light in lights) == (sun > 0)
    for normal in NORMALS:
        normal = np.divide(normal, np.linalg.norm(normal))
        expected = power @ np.maximum(directions @ normal, 0)
        assert irradiance(lights, normal) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("sun", [0.0, 1e5])
def test_no_power_is_lost_or_made(sun):
    pixels = landscape(300, sun)[..., None] * (1.0, 0.5, 2.0)
    *suns, sky = panorama_lights(pixels)
    found = np.sum([light.irradiance for light in suns], axis=0) if suns else 0
    found = found + sky.radiance.cells.mean(axis=0) * 4 * np.pi
    edges = np.sin(np.pi * (np.arange(301) / 300 - 0.5))
    expected = (pixels * np.diff(edges)[:, None, None]).sum(axis=(0, 1)) * 2 * np.pi / 600
    assert found == pytest.approx(expected, rel=1e-12)


def test_a_sun_is_where_it_is_in_the_picture():
    pixels = np.full((512, 1024), 0.01)
    pixels[320, 160] = 5e5
    (sun, _sky) = panorama_lights(pixels)
    up, turn = np.pi * (320.5 / 512 - 0.5), np.pi * (1 - 2 * 160.5 / 1024)
    towards = np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)
    assert np.negative(sun.direction) == pytest.approx(towards, abs=1e-3)
    turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # the picture's y is the world's -x
    (sun, _sky) = panorama_lights(pixels, turned)
    assert np.negative(sun.direction) == pytest.approx(turned.T @ towards, abs=1e-3)


def test_an_even_picture_is_an_even_sky():
    (sky,) = panorama_lights(np.full((20, 40), 0.7))
    assert sky.radiance == pytest.approx(0.7)
    (sky,) = panorama_lights(np.full((20, 40, 3), 0.7) * (1, 2, 0))
    assert sky.radiance == pytest.approx((0.7, 1.4, 0))


def test_a_dark_picture_is_no_light():
    assert panorama_lights(np.zeros((4, 8, 3))) == []


def test_many_bright_places_are_few_suns():
    pixels = np.random.default_rng(1).random((64, 128)) ** 400
    assert len(panorama_lights(pixels)) <= 9


def test_cells_are_numbered_as_they_are_drawn():
    centers = cell_centers()
    assert np.array_equal(cells_of(centers), np.arange(len(centers)))
    assert cells_of(np.array((1.0, 0, 0))) < SKY_CELLS[1]  # and at the poles there is one


def test_a_cell_sky_can_be_pickled():
    sky = Sky(CellSky(np.random.default_rng(2).random((2048, 3))))
    towards = np.array([(0, 0, 1.0), (0.6, 0.8, 0)])
    assert np.array_equal(pickle.loads(pickle.dumps(sky)).towards(towards), sky.towards(towards))


def test_its_light_in_a_void_is_that_of_the_picture():
    """Fluence and net flux of the solver's beams, in the number that it uses."""
    pixels = landscape(64, 1e4)
    medium = Medium(np.zeros((6, 6, 6)), 0.1, 1, 0)
    casts = [
        cast(medium, part, 0, 1.0, "NumPy", per_edge=4)
        for light in panorama_lights(pixels)
        for part in (light.parts() if isinstance(light, Sky) else [light])
    ]
    directions, power = exact(pixels)
    assert sum(c.direct.mean() for c in casts) == pytest.approx(power.sum(), rel=1e-2)
    flux = sum(c.flux.mean(axis=(1, 2, 3)) for c in casts)
    assert flux == pytest.approx(-power @ directions, abs=2e-2 * power.sum())
