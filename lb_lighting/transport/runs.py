# SPDX-License-Identifier: GPL-3.0-or-later
"""Which bands are solved, for which lights, and which of them at once."""

import numpy as np

from .lights import multiple

_ALIKE = 1e-6  # relative: what is rounded otherwise is no other extinction


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
    """[(numbers of lights, {band: its multiples})]: runs after each other that may share rays.

    These are of the same lights and one extinction, and of bands that were not lit before, which
    would take memory of their own.
    """
    found, lit_before = [], set()
    for band, multiples, numbers in runs:
        last = next(iter(found[-1][1])) if found else band
        alike = np.isclose(sigma_t[band], sigma_t[last], rtol=_ALIKE, atol=0)
        if band in lit_before or not found or found[-1][0] != numbers or not alike:
            found.append((numbers, {}))
        found[-1][1][band] = multiples
        lit_before |= set(multiples)
    return found
