# SPDX-License-Identifier: GPL-3.0-or-later
"""Final pictures: Cycles with our light against Cycles that follows every scattering itself.

    python -m tests.benchmarks.render [PART ...]

PART is clouds, trees, smoke, teapot, large, flicker, turning, mitsuba, forward, around, or the name
of a scene; default: all. Ours is what Bake makes with the quality Custom, whose defaults are the
lattice alone in all voxels, rendered with the settings of Use LB Light. Each Cycles setting is
rendered with several numbers of samples n; its error is fitted by e^2 = bias^2 + variance / n and
its cost by start + each n, which gives its time at any error.
Pictures are left in build/bench/render for `python -m tests.benchmarks.render_plots`.
"""

import argparse
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np
from mathutils import Vector

bpy.utils.expose_bundled_modules()

import lb_lighting  # noqa: E402
from lb_lighting import bake  # noqa: E402
from lb_lighting.cli import leave  # noqa: E402
from lb_lighting.output import render_settings  # noqa: E402
from tests.benchmarks import crowns, endtoend, pictures, shots  # noqa: E402
from tests.benchmarks.table import BUILD, publish  # noqa: E402
from tests.setup import peers  # noqa: E402

PICTURES = BUILD / "render"
TARGET = 0.06  # error of a picture that is good enough
VIEWS = 24
FULL = 1920 * 1080 / pictures.SIZE**2  # the pixels of a full picture, over those of ours
FLICKER = 4  # samples of ours where pictures move
FEW = 16  # of either half of the references of those
MANY = 65  # of a picture that tells what each costs: fewer are lost in what the start costs
LARGE, LARGE_HALF = 512, 128  # pixels along an edge; samples of either half of the reference
LOOSE = 0.1  # error of pixels
TREES = ("green tree, sun and sky", "white tree, sun", "white tree, white sky, baked")
STEP = 0.05  # rad from view to view
MITSUBA = 32  # samples of either of its pictures
OPINIONS = ("cloud, albedo 0.99, g 0", "cloud, albedo 0.99, g 0.85")
FORWARD = "cloud, albedo 0.99, g 0.85"
OTHERWISE = (
    {},
    {"gather": False},
    {"handover": 4.0},
    {"handover": 4.0, "gather": False},
    {"mode": "ADD"},
)
CAMERAS = {
    "on the sun's side": (-2.4, -0.9, 1.5),
    "in front": endtoend.CAMERA,
    "aside": (0.9, -2.8, 0.6),
    "against the sun": (2.4, 0.9, -1.2),
}
AROUND = 24  # samples of Cycles from each of them, by two seeds; means are known to some 2 %
DEVICE = "Cycles on the processor"


# --- One scene -----------------------------------------------------------------------------------


def rows_of(shot):
    """[row] for each picture of it; the pictures go to a file."""
    halves = reference(shot)
    with TemporaryDirectory() as name:
        folder = Path(name)
        found = [*by_cycles(shot, folder), *with_our_light(shot, folder)]
    images = np.array([image for _, image in found], np.float32)
    flips = flip(images, halves.mean(axis=0))
    rows = [
        row | figures(image, halves, shot.block) | {"FLIP": float(seen)}
        for (row, image), seen in zip(found, flips, strict=True)
    ]
    keep(shot.name, halves, images)
    stored = pictures.stored(shot.known_by, halves, shot.half, shot.bounces[0])
    return [{"scene": shot.name} | row | {"reference / stored": stored} for row in rows]


def reference(shot):
    """(2, SIZE, SIZE, 3): see `pictures.reference`."""
    with TemporaryDirectory() as folder:
        return pictures.reference(
            shot.known_by, lambda: shot.build(Path(folder)), shot.half, shot.bounces[0]
        )


def keep(name, wanted, images):
    """What is to be drawn later."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    arrays = {"reference": wanted, "images": images}
    np.savez_compressed(
        PICTURES / f"{name}.npz", **{k: np.asarray(v, np.float32) for k, v in arrays.items()}
    )


def by_cycles(shot, folder):
    """(row, picture) for each setting that follows the light itself."""
    shot.build(folder)
    pictures.picture(1, 0)  # what is loaded once for all
    for bounces in shot.bounces:
        for denoise in (False, True):
            light = f"{bounces} bounces" + ", denoised" * denoise
            for samples in shots.SAMPLES:
                meter = pictures.Meter()
                image = pictures.picture(samples, bounces, samples, denoise, meter)
                yield cost(light, samples, meter), image


def with_our_light(shot, folder):
    """(row, picture) for each number of samples; the first bake is not counted, as it compiles."""
    baked(shot, folder)
    baking, _ = baked(shot, folder)
    pictures.picture(1)
    for samples in shot.ours:
        meter = pictures.Meter()
        image = pictures.picture(samples, seed=samples, meter=meter)
        yield cost("ours", samples, meter) | {"bake, processor s": baking.processor}, image


def baked(shot, folder, **changes):
    """(`Meter`, `Outcome`) of lighting the scene, which then is ready to be rendered.

    changes  of the default options
    """
    objects = shot.build(folder)
    meter = pictures.Meter()
    with meter():
        chosen = {"quality": "CUSTOM"} | shot.options | changes
        options = bake.Options(folder=str(folder), **chosen)
        outcome = bake.bake(bpy.context, objects, options)
        render_settings.use_light(bpy.context.scene)
    return meter, outcome


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
        square = _nonnegative(1 / error**2, 1 / n / error**2)
        start, each = _nonnegative(1 / seconds, n / seconds)
        return cls(float(np.sqrt(square[0])), square[1], start, each)

    def samples(self, error):
        """As few as reach it: a whole number, or infinity."""
        left = error**2 - self.bias**2
        return max(1.0, np.ceil(self.variance / left)) if left > 0 else np.inf

    def seconds(self, error, views=1, size=1.0):
        """To reach it in so many views of one scene, which is set up once; size: of a picture,
        over that of ours."""
        return self.start + views * size * self.each * self.samples(error)


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
    """The row on a scene: processor time to the target, and how many times less ours is."""
    fits = {
        light: Fit.of([row for row in rows if row["light"] == light])
        for light in dict.fromkeys(row["light"] for row in rows)
    }
    ours, last = fits.pop("ours"), rows[-1]
    baking = last["bake, processor s"]
    plain = [fit for light, fit in fits.items() if "denoised" not in light]
    denoised = [fit for light, fit in fits.items() if "denoised" in light]

    def seconds(some, **facts):
        return min(fit.seconds(TARGET, **facts) for fit in some)

    def times(some, **facts):
        return seconds(some, **facts) / (baking + seconds([ours], **facts))

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


# --- Trees whose leaves are larger than pixels ---------------------------------------------------


def large():
    """[row]: processor time to an error of LOOSE, of the pixels of pictures of trees."""
    return [large_row(shot) for shot in shots.shots() if shot.name in TREES]


def large_row(shot):
    with TemporaryDirectory() as name:
        folder = Path(name)
        halves = pictures.reference(
            shot.known_by, lambda: shot.build(folder), LARGE_HALF, shot.bounces[0], LARGE
        )

        def rows(bounces=None):
            pictures.picture(1, bounces, size=LARGE)
            for samples in shots.SAMPLES:
                meter = pictures.Meter()
                image = pictures.picture(samples, bounces, samples, meter=meter, size=LARGE)
                yield figures(image, halves, 1) | cost("", samples, meter)

        shot.build(folder)
        cycles = Fit.of(list(rows(shot.bounces[1])))
        baked(shot, folder)
        baking = baked(shot, folder)[0].processor
        found = list(rows())
    ours = Fit.of(found)
    ratios = {
        views: cycles.seconds(LOOSE, views) / (baking + ours.seconds(LOOSE, views))
        for views in (1, VIEWS)
    }
    return {
        "scene": shot.name,
        "our error": found[-1]["error"],
        "our mean": found[-1]["mean"],
        "bake, s": baking,
        "a picture, s": ours.seconds(LOOSE),
        "samples": ours.samples(LOOSE),
        "Cycles, s": cycles.seconds(LOOSE),
        "its samples": cycles.samples(LOOSE),
        "ratio": ratios[1],
        f"{VIEWS} views": ratios[VIEWS],
    }


# --- Frames -------------------------------------------------------------------------------------


def flicker():
    """[row]: a fire, frame by frame, in as much time a frame."""
    frames = [shots.fire(frame) for frame in range(1, shots.FRAMES + 1)]
    halves = np.array([reference(replace(frame, half=FEW)) for frame in frames])
    with TemporaryDirectory() as name:
        folder = Path(name)
        ours, meter = [], pictures.Meter()
        baked(frames[0], folder)
        for number, frame in enumerate(frames):
            meter.add(baked(frame, folder)[0])
            ours.append(pictures.picture(FLICKER, seed=number, meter=meter))
        found = {("ours", FLICKER): (meter, ours)}
        samples = affordable(frames[0], folder, meter.processor / len(frames))
        for denoise in (False, True):
            meter, theirs = pictures.Meter(), []
            for number, frame in enumerate(frames):
                frame.build(folder)
                theirs.append(
                    pictures.picture(samples, frame.bounces[0], number, denoise, meter=meter)
                )
            found["Cycles" + ", denoised" * denoise, samples] = meter, theirs
    keep("flicker", halves[:, 0], [images for _, images in found.values()])
    return moving(found, halves)


def moving(found, halves):
    """[row] for {(light, samples): (`Meter`, pictures (frames, ...))} of frames that differ; halves
    (frames, 2, ...) of the reference."""
    return [
        {
            "light": light,
            "samples": samples,
            "processor s a frame": meter.processor / len(halves),
            "flicker": pictures.flicker(np.array(images), halves),
            "error": pictures.error(np.array(images), halves.swapaxes(0, 1)),
        }
        for (light, samples), (meter, images) in found.items()
    ]


def turning():
    """[row]: trees that the camera goes around, baked once, in as much time with the bake in it."""
    shown = [shot for shot in shots.shots() if shot.name in TREES]
    return [{"scene": shot.name} | row for shot in shown for row in turned(shot)]


def turned(shot):
    """[row] of one tree, seen from VIEWS sides, STEP apart; figures are of 4x4 means."""

    def seen(samples, bounces=None, seed=None, denoise=False, meter=None):
        images = []
        for number in range(VIEWS):
            crowns.look(crowns.CASES["tree"], "lit", number * STEP)
            own = number if seed is None else seed
            images.append(pictures.picture(samples, bounces, own, denoise, meter))
        return pictures.blocks(np.array(images))

    with TemporaryDirectory() as name:
        folder = Path(name)
        baked(shot, folder)
        meter, _ = baked(shot, folder)
        pictures.picture(1)
        found = {("ours", FEW): (meter, seen(FEW, meter=meter))}
        samples = affordable(shot, folder, meter.processor / VIEWS)
        for denoise in (False, True):
            own = pictures.Meter()
            images = seen(samples, shot.bounces[0], denoise=denoise, meter=own)
            found["Cycles" + ", denoised" * denoise, samples] = own, images
        halves = [seen(shot.half, shot.bounces[0], seed) for seed in pictures.SEEDS]
    return moving(found, np.stack(halves, axis=1))


def affordable(shot, folder, seconds):
    """The samples that Cycles has time for in `seconds` of processor time, at least one."""
    shot.build(folder)
    costs = []
    for samples in (1, MANY):
        meter = pictures.Meter()
        pictures.picture(samples, shot.bounces[0], meter=meter)
        costs.append(meter.processor)
    each = (costs[1] - costs[0]) / (MANY - 1)
    return max(1, round(1 + (seconds - costs[0]) / each))


# --- A second opinion ----------------------------------------------------------------------------


def opinions():
    """[row]: Mitsuba's pictures of the clouds against those of Cycles."""
    return [opinion(shot) for shot in shots.shots() if shot.name in OPINIONS]


def opinion(shot):
    case, halves = shot.case, reference(shot)
    edge = endtoend.EDGE * endtoend.VOXEL / 2
    meter = pictures.Meter()
    with meter():
        found = peers.run(
            "mitsuba_cloud",
            density=case.density,
            lower=np.full(3, -edge),
            upper=np.full(3, edge),
            sigma_t=case.sigma_t,
            albedo=case.albedo,
            g=case.g,
            direction=np.array(case.suns[0][0]),
            irradiance=1.0,
            eye=np.array(endtoend.CAMERA),
            angle=np.degrees(2 * np.arctan(18 / 80)),  # of a film of 36 mm behind 80 mm
            pixels=pictures.SIZE,
            samples=MITSUBA,
            seeds=(1, 2),
        )["pictures"]
    theirs = np.repeat(found[..., None], 3, axis=-1).astype(float)
    single = pictures.error(theirs[0], halves)
    return {
        "scene": shot.name,
        "Mitsuba / Cycles": float(theirs.mean() / halves.mean()),
        "standard error": pictures.noise(theirs) / pictures.SIZE,
        "difference": pictures.distance(theirs, halves),
        "of 4x4 means": pictures.distance(pictures.blocks(theirs), pictures.blocks(halves)),
        "processor s of all": meter.processor,
        "s to 6 %": meter.processor / 2 * (single / TARGET) ** 2,
    }


# --- Light that goes on forwards -----------------------------------------------------------------


def forward():
    """[row]: the cloud that is too dark, baked otherwise: is it the light, or how it is shown?"""
    shot = next(shot for shot in shots.shots() if shot.name == FORWARD)
    halves, rows = reference(shot), []
    with TemporaryDirectory() as name:
        for changes in OTHERWISE:
            baking, outcome = baked(shot, Path(name), **changes)
            meter = pictures.Meter()
            image = pictures.picture(16 if "mode" in changes else 1, meter=meter)
            rows.append(
                {
                    "options": str(changes) if changes else "default",
                    "bake, processor s": baking.processor,
                    "picture, processor s": meter.processor,
                    "mean fluence, W/m^2": float(outcome.field.fluence.mean()),
                    **figures(image, halves, shot.block),
                }
            )
    return rows


def around():
    """[row]: the mean of the same cloud from other sides, over that of Cycles."""
    shot = next(shot for shot in shots.shots() if shot.name == FORWARD)

    def seen_from(place, *settings):
        camera = bpy.context.scene.camera
        camera.location = place
        camera.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
        return pictures.picture(*settings)

    rows = [{"camera": camera} for camera in CAMERAS]
    with TemporaryDirectory() as name:
        shot.build(Path(name))
        wanted = [
            np.array([seen_from(place, AROUND, shot.bounces[0], seed) for seed in pictures.SEEDS])
            for place in CAMERAS.values()
        ]
        for gather in (True, False):
            baked(shot, Path(name), gather=gather)
            told = "gathered" if gather else "not gathered"
            for row, place, image in zip(rows, CAMERAS.values(), wanted, strict=True):
                row[told] = float(seen_from(place, 1).mean() / image.mean())
    return rows


PARTS = {
    "large": large,
    "flicker": flicker,
    "turning": turning,
    "mitsuba": opinions,
    "forward": forward,
    "around": around,
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", help="default: all")
    chosen = set(parser.parse_args().parts)
    lb_lighting.register()
    wanted = [s for s in shots.shots() if not chosen or {s.name, s.group} & chosen]
    for group, some in groupby(wanted, key=lambda shot: shot.group):
        scenes = [rows_of(shot) for shot in some]
        publish(f"render-{group}", DEVICE, [row for rows in scenes for row in rows])
        publish(f"render-{group}-summary", DEVICE, list(map(summary, scenes)))
    for name, part in PARTS.items():
        if not chosen or name in chosen:
            publish(f"render-{name}", DEVICE, part())


if __name__ == "__main__":
    main()
    leave(0)
