# SPDX-License-Identifier: GPL-3.0-or-later
"""Perceived differences between pictures: the mean of NVIDIA's FLIP.

    python flip.py PAIRS.npz RESULT.npz

PAIRS.npz: wanted (rows, columns, 3) and found (pictures, rows, columns, 3), linear radiance;
white, the radiance displayed as white
RESULT.npz: flip (pictures,), 0 for no difference to 1
"""

import sys

import flip_evaluator
import numpy as np


def seen(picture, white):
    """Display values in sRGB, from 0 to 1."""
    linear = np.clip(picture / white, 0, 1)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return curved.astype(np.float32)


def main(given, result):
    problem = np.load(given)
    wanted = seen(problem["wanted"], problem["white"])
    means = [
        flip_evaluator.evaluate(wanted, seen(found, problem["white"]), "LDR")[1]
        for found in problem["found"]
    ]
    np.savez(result, flip=means)


if __name__ == "__main__":
    main(*sys.argv[1:])
