# SPDX-License-Identifier: GPL-3.0-or-later
"""Final pictures: Cycles with our light against Cycles that follows every scattering itself.

    python -m tests.benchmarks.render [PART ...]

PART is a group of scenes (clouds, ...) or the name of one, in quotes; default: all. Ours is what
`Bake` makes with its defaults, and the render settings that it offers. Each Cycles setting is
rendered with several numbers of samples n; its error is fitted by e^2 = bias^2 + variance / n and
its cost by start + each n, which gives its time at any error. Pictures are left in
build/bench/render for `python -m tests.benchmarks.render_plots`.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402
from lb_lighting import bake  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.output import shading  # noqa: E402
from tests.benchmarks import pictures  # noqa: E402
from tests.benchmarks.shots import shots  # noqa: E402
from tests.benchmarks.table import BUILD, publish  # noqa: E402
from tests.setup import peers  # noqa: E402

PICTURES = BUILD / "render"
TARGET = 0.06  # error of a picture that is good enough
VIEWS = 24
SAMPLES, OURS = (4, 16, 64), (1, 4, 16)
EQUAL = 16  # samples of ours that pictures are shown of


# --- One scene -----------------------------------------------------------------------------------


def rows_of(shot):
    """[row] for each picture of it; the pictures go to a file."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        halves = pictures.reference(
            (shot.name, *shot.facts), lambda: shot.build(folder), shot.half, shot.bounces[0]
        )
        found = [*by_cycles(shot, folder), *with_our_light(shot, folder)]
    images = np.array([image for _, image in found], np.float32)
    flips = flip(images, halves.mean(axis=0))
    rows = [
        row | figures(image, halves, shot.block) | {"FLIP": float(seen)}
        for (row, image), seen in zip(found, flips, strict=True)
    ]
    PICTURES.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(PICTURES / f"{shot.name}.npz", reference=halves, images=images)
    return [{"scene": shot.name} | row for row in rows]


def by_cycles(shot, folder):
    """(row, picture) for each setting that follows the light itself."""
    shot.build(folder)
    pictures.picture(1, 0)  # what is loaded once for all
    for bounces in shot.bounces:
        for denoise in (False, True):
            light = f"{bounces} bounces" + ", denoised" * denoise
            for samples in SAMPLES:
                meter = pictures.Meter()
                image = pictures.picture(samples, bounces, samples, denoise, meter)
                yield cost(light, samples, meter), image


def with_our_light(shot, folder):
    """(row, picture) for each number of samples; the first bake is not counted, as it compiles."""
    for _ in range(2):
        objects = shot.build(folder)
        meter = pictures.Meter()
        with meter():
            bake.bake(bpy.context, objects, bake.Options(folder=str(folder)))
            shading.use_light(bpy.context.scene)
    baking = meter
    pictures.picture(1)
    for samples in OURS:
        meter = pictures.Meter()
        image = pictures.picture(samples, seed=samples, meter=meter)
        yield cost("ours", samples, meter) | {"bake, processor s": baking.processor}, image


def cost(light, samples, meter):
    found = {"light": light, "samples": samples}
    return found | {"processor s": meter.processor, "wall s": meter.wall}


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


def flip(images, wanted):
    """FLIP of each of `images`; the noise of the reference is in it."""
    white = float(np.percentile(wanted, 99.5))
    return peers.run("flip", wanted=wanted, found=images, white=white)["flip"]


# --- What it comes to ----------------------------------------------------------------------------


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
        square = _nonnegative(np.ones_like(n) / error**2, 1 / n / error**2)
        start, each = _nonnegative(np.ones_like(n) / seconds, n / seconds)
        return cls(float(np.sqrt(square[0])), square[1], start, each)

    def samples(self, error):
        """As few as reach it: a whole number, or infinity."""
        left = error**2 - self.bias**2
        return max(1.0, np.ceil(self.variance / left)) if left > 0 else np.inf

    def seconds(self, error, views=1):
        """To reach it in so many views of one scene, which is set up once."""
        return self.start + views * self.each * self.samples(error)


def _nonnegative(first, second):
    """The two factors, none below 0, whose sum of columns is nearest to 1."""
    columns = np.stack([first, second], axis=1)
    one = np.ones(len(first))
    both = np.linalg.lstsq(columns, one, rcond=None)[0]
    if (both >= 0).all():
        return both
    alone = [max(0.0, float(column @ one / (column @ column))) for column in columns.T]
    left = [np.linalg.norm(one - alone[i] * columns[:, i]) for i in (0, 1)]
    return (alone[0], 0.0) if left[0] < left[1] else (0.0, alone[1])


def summary(rows):
    """The row on a scene: time to the target."""
    fits = {
        light: Fit.of([row for row in rows if row["light"] == light])
        for light in dict.fromkeys(row["light"] for row in rows)
    }
    ours, baking = fits.pop("ours"), rows[-1]["bake, processor s"]
    plain = [fit for light, fit in fits.items() if "denoised" not in light]
    denoised = [fit for light, fit in fits.items() if "denoised" in light]

    def fastest(some, views=1):
        return min(fit.seconds(TARGET, views) for fit in some)

    once, often = (baking + ours.seconds(TARGET, views) for views in (1, VIEWS))
    return {
        "scene": rows[0]["scene"],
        "ours: error": rows[-1]["error"],
        "mean": rows[-1]["mean"],
        "bake, s": baking,
        "bake and picture, s": once,
        "Cycles, s": fastest(plain),
        "denoised, s": fastest(denoised),
        "ratio": fastest(plain) / once,
        "ratio, denoised": fastest(denoised) / once,
        f"ratio, {VIEWS} views": fastest(plain, VIEWS) / often,
        f"denoised, {VIEWS} views": fastest(denoised, VIEWS) / often,
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", help="default: all")
    chosen = parser.parse_args().parts
    lb_lighting.register()
    groups = {}
    for shot in shots():
        if not chosen or {shot.name, shot.group} & set(chosen):
            print(shot.name, flush=True)
            groups.setdefault(shot.group, []).append(rows_of(shot))
    for group, scenes in groups.items():
        publish(
            f"render-{group}", "Cycles on the processor", [row for rows in scenes for row in rows]
        )
        publish(f"render-{group}-summary", "Cycles on the processor", list(map(summary, scenes)))


if __name__ == "__main__":
    main()
    leave(0)
