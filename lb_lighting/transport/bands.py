# SPDX-License-Identifier: GPL-3.0-or-later
"""Which bands are solved, for which lights, and which of them share their rays.

A band whose light is a multiple of another band's is not solved. The multiples of a solved band
are {band: factor}; it is one of them itself.
"""

from collections.abc import Iterable, Sequence

from ..arrays import Floats
from .lights.base import Light, multiple, same
from .medium import Medium

type Multiples = dict[int, float]
type Problem = tuple[int, Multiples, list[int]]  # band to solve, its multiples, numbers of lights
type Group = tuple[list[int], dict[int, Multiples], bool]


def distinct(medium: Medium, lights: Sequence[Light]) -> list[tuple[int, Multiples]]:
    """[(band to solve, its multiples)]: bands that are multiples of each other are solved once."""
    bands: list[tuple[int, Multiples]] = []
    for band in range(medium.bands):
        for base, multiples in bands:
            factor = multiple(lights, medium, band, base)
            if factor is not None and medium.alike(band, base):
                multiples[band] = factor
                break
        else:
            bands.append((band, {band: 1.0}))
    return bands


def bands_to_solve(medium: Medium, lights: Sequence[Light], apart: bool) -> list[Problem]:
    """[(band to solve, its multiples, numbers of its lights)].

    apart  whether each light may be solved alone: in a grey medium it is then solved in one band,
           whatever its colour, instead of in all bands
    """
    numbers = list(range(len(lights)))
    if not apart:
        return [(band, multiples, numbers) for band, multiples in distinct(medium, lights)]
    problems: list[Problem] = []
    for number in numbers:
        for band, multiples in distinct(medium, [lights[number]]):
            for other, other_multiples, its_lights in problems:
                if (other, other_multiples) == (band, multiples):
                    its_lights.append(number)
                    break
            else:
                problems.append((band, multiples, [number]))
    return problems


def group_by_extinction(problems: Iterable[Problem], sigma_t: Floats) -> list[Group]:
    """[(numbers of lights, {band: its multiples}, whether the bands are lit for the first time)]:
    successive bands that may share rays.

    These have the same lights and the same extinction. A band that was lit before needs separate
    memory, so it is alone in its group.
    """
    groups: list[Group] = []
    lit: set[int] = set()
    for band, multiples, numbers in problems:
        is_new = band not in lit
        lit |= set(multiples)
        if groups and is_new:
            other_numbers, bands, are_new = groups[-1]
            has_same_lights = are_new and other_numbers == numbers
            if has_same_lights and same(sigma_t[band], sigma_t[next(iter(bands))]):
                bands[band] = multiples
                continue
        groups.append((numbers, {band: multiples}, is_new))
    return groups
