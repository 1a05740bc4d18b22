# SPDX-License-Identifier: GPL-3.0-or-later
"""Which bands are solved, for which lights, and which of them at once."""

from .lights.base import multiple, same


def distinct(medium, lights):
    """[(band to solve, {band: its multiple})]: bands that are multiples are solved once."""
    runs = []
    for band in range(medium.bands):
        for base, multiples in runs:
            factor = multiple(lights, medium, band, base)
            if factor is not None and medium.alike(band, base):
                multiples[band] = factor
                break
        else:
            runs.append((band, {band: 1.0}))
    return runs


def runs_of(medium, lights, apart):
    """[(band to solve, {band: its multiple}, numbers of its lights)].

    apart  whether lights may be solved apart: in a grey medium each is then solved once, whatever
           its colour, and not once in each band
    """
    everything = list(range(len(lights)))
    if not apart:
        return [(band, multiples, everything) for band, multiples in distinct(medium, lights)]
    runs = []
    for number in everything:
        for band, multiples in distinct(medium, [lights[number]]):
            for alike, others, numbers in runs:
                if (alike, others) == (band, multiples):
                    numbers.append(number)
                    break
            else:
                runs.append((band, multiples, [number]))
    return runs


def together(runs, sigma_t):
    """[(numbers of lights, {band: its multiples}, whether nothing has lit the bands before)]: runs
    after each other that may share rays.

    These are of the same lights and one extinction. A band that was lit before takes memory of its
    own, and so is alone.
    """
    found, lit_before = [], set()
    for band, multiples, numbers in runs:
        is_new = band not in lit_before
        lit_before |= set(multiples)
        if found and is_new:
            others, bands, are_new = found[-1]
            if are_new and others == numbers and same(sigma_t[band], sigma_t[next(iter(bands))]):
                bands[band] = multiples
                continue
        found.append((numbers, {band: multiples}, is_new))
    return found
