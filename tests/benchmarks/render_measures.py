# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors and costs of pictures of one scene, and the processor time that an error takes."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.benchmarks import pictures
from tests.benchmarks.table import BUILD
from tests.setup import peers

PICTURES = BUILD / "render"
TARGET = 0.06  # error of a picture that is good enough
VIEWS = 24
FULL = 1920 * 1080 / pictures.SIZE**2  # pixels of a full picture, relative to ours


def reference(shot):
    """(2, SIZE, SIZE, 3): see `pictures.reference`."""
    with TemporaryDirectory() as folder:
        return pictures.reference(
            shot.known_by, lambda: shot.build(Path(folder)), shot.half, shot.bounces[0]
        )


def keep(name, expected, images):
    """Write the pictures to a file, from which they are drawn later."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    arrays = {"reference": expected, "images": images}
    np.savez_compressed(
        PICTURES / f"{name}.npz", **{k: np.asarray(v, np.float32) for k, v in arrays.items()}
    )


def cost(light, samples, meter):
    seconds = {"processor s": meter.processor, "wall s": meter.wall}
    return {"light": light, "samples": samples} | seconds


def figures(image, halves, block):
    coarse = pictures.blocks(image), pictures.blocks(halves)
    pixels = pictures.error(image, halves)
    return {
        "error": pixels if block == 1 else pictures.error(*coarse),
        "of pixels": pixels,
        "of 4x4 means": pictures.error(*coarse),
        "mean": pictures.brightness(image, halves),
        "reference's noise": pictures.noise(halves),
    }


def flip(images, expected):
    """FLIP of each of `images`, which includes the noise of the reference."""
    white = float(np.percentile(expected, 99.5))
    return peers.run("flip", wanted=expected, found=images, white=white)["flip"]


@dataclass(frozen=True)
class Fit:
    """Error and processor time of a setting by its number of samples."""

    bias: float
    variance: float
    start: float
    each: float

    @classmethod
    def of(cls, rows):
        n, error, seconds = (
            np.array([row[name] for row in rows], float)
            for name in ("samples", "error", "processor s")
        )
        square = _nonnegative(1 / error**2, 1 / n / error**2)
        start, each = _nonnegative(1 / seconds, n / seconds)
        return cls(float(np.sqrt(square[0])), square[1], start, each)

    def samples(self, error):
        """The fewest that reach the error: a whole number, or infinity."""
        noise = error**2 - self.bias**2
        return max(1.0, np.ceil(self.variance / noise)) if noise > 0 else np.inf

    def seconds(self, error, views=1, size=1.0):
        """To reach the error in each of `views` of one scene, which is set up once.

        size  pixels of a picture, relative to ours
        """
        return self.start + views * size * self.each * self.samples(error)


def _nonnegative(first, second):
    """The two factors, both at least 0, with which the sum of the columns is closest to 1."""
    columns = np.stack([first, second], axis=1)
    one = np.ones(len(first))
    both = np.linalg.lstsq(columns, one, rcond=None)[0]
    if (both >= 0).all():
        return both
    alone = [max(0.0, float(column @ one / (column @ column))) for column in columns.T]
    errors = [np.linalg.norm(one - alone[i] * columns[:, i]) for i in (0, 1)]
    return (alone[0], 0.0) if errors[0] < errors[1] else (0.0, alone[1])


def summary(rows):
    """The row of a scene: processor time to the target error, and its ratios to ours."""
    fits = {
        light: Fit.of([row for row in rows if row["light"] == light])
        for light in dict.fromkeys(row["light"] for row in rows)
    }
    ours, last = fits.pop("ours"), rows[-1]
    baking = last["bake, processor s"]
    plain = [fit for light, fit in fits.items() if "denoised" not in light]
    denoised = [fit for light, fit in fits.items() if "denoised" in light]

    def seconds(settings, **facts):
        return min(fit.seconds(TARGET, **facts) for fit in settings)

    def times(settings, **facts):
        return seconds(settings, **facts) / (baking + seconds([ours], **facts))

    equal = min(fit.seconds(last["error"]) for fit in plain)
    row = {
        "our error": last["error"],
        "our mean": last["mean"],
        "bake, s": baking,
        "with picture, s": baking + seconds([ours]),
        "Cycles, s": seconds(plain),
        "denoised, s": seconds(denoised),
        "ratio": times(plain),
        "denoised": times(denoised),
        f"{VIEWS} views": times(plain, views=VIEWS),
        f"{VIEWS} views, denoised": times(denoised, views=VIEWS),
        "1920 x 1080": times(plain, size=FULL),
        "1920 x 1080, denoised": times(denoised, size=FULL),
        "at our error": equal / (baking + last["processor s"]),
    }
    return {"scene": last["scene"]} | {
        name: float(value) if 0 < value < np.inf else "not reached" for name, value in row.items()
    }
