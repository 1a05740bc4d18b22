# SPDX-License-Identifier: GPL-3.0-or-later
"""The p-values of a few classical tests: how likely chance alone is to be so far off.

A p-value of a true hypothesis is uniform in 0..1, so a test that demands p > q raises a false alarm
with probability q.
"""

from math import erfc, exp, expm1, lgamma, log, log1p, sqrt

import numpy as np


def sidak(p_values):
    """The p-value of the least of several independent p-values."""
    p_values = np.ravel(p_values)
    least = float(p_values.min())
    return 1.0 if least >= 1 else -expm1(len(p_values) * log1p(-least))


def normal(deviation):
    """Two-sided p-value of a deviation in standard errors."""
    return erfc(abs(deviation) / sqrt(2))


def uniform(sample):
    """(Kolmogorov-Smirnov's, chi-square's) p-values of a sample to be uniform in 0..1.

    The chi-square test has an odd number of bins, 5 to 101, with 20 values or more in each.
    """
    sample = np.sort(sample)
    n = len(sample)
    steps = np.arange(n + 1) / n
    distance = max((steps[1:] - sample).max(), (sample - steps[:-1]).max())
    bins = min(101, max(5, n // 20)) // 2 * 2 + 1
    counts = np.bincount(np.clip((sample * bins).astype(int), 0, bins - 1), minlength=bins)
    return _kolmogorov(distance, n), chi_square(counts, np.full(bins, n / bins))


def alike(first, second):
    """Kolmogorov-Smirnov's p-value of two samples to be of one law; infinite values are alike."""
    n, m = len(first), len(second)
    first, second = np.sort(first), np.sort(second)
    values = np.concatenate([first, second])
    distance = np.abs(
        np.searchsorted(first, values, "right") / n - np.searchsorted(second, values, "right") / m
    ).max()
    return _kolmogorov(distance, n * m / (n + m))


def chi_square(counts, expected, constraints=1):
    """p-value of counts against expected ones; there are that many less degrees of freedom."""
    counts, expected = np.asarray(counts, float), np.asarray(expected, float)
    half = float(((counts - expected) ** 2 / expected).sum()) / 2
    freedom = counts.size - constraints
    if half == 0:
        return 1.0
    # The incomplete gamma function Q(freedom / 2, half), by Q(a + 1) = Q(a) + half^a e^-half / a!.
    a, p = (0.5, erfc(sqrt(half))) if freedom % 2 else (1, exp(-half))
    while a < freedom / 2:
        p += exp(a * log(half) - half - lgamma(a + 1))
        a += 1
    return min(p, 1.0)


def _kolmogorov(distance, count):
    """p-value of the largest distance of two distribution functions (Stephens 1970)."""
    root = sqrt(count)
    x = (root + 0.12 + 0.11 / root) * distance
    if x < 0.2:  # p is 1 to 12 digits, where the series would cancel
        return 1.0
    return min(1.0, 2 * sum((-1) ** (k - 1) * exp(-2 * (k * x) ** 2) for k in range(1, 50)))
