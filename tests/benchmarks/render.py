# SPDX-License-Identifier: GPL-3.0-or-later
"""Final pictures: Cycles with baked light, compared with Cycles that traces every scattering.

    python -m tests.benchmarks.render [PART ...]

PART is clouds, trees, smoke, teapot, large, flicker, turning, mitsuba, forward, around, or the name
of a scene; default: all. Our pictures are bakes with the quality Custom, whose defaults solve all
voxels on the lattice alone, rendered with the settings of Use LB Light. Each Cycles setting is
rendered with several numbers of samples n. Its error is fitted by e^2 = bias^2 + variance / n and
its cost by start + each n, which gives its time at any error. Pictures are written to
build/bench/render for `python -m tests.benchmarks.render_plots`.
"""

import argparse
from dataclasses import replace
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
from lb_lighting.options import Options  # noqa: E402
from lb_lighting.output import render_settings  # noqa: E402
from tests.benchmarks import crowns, endtoend, pictures, shots  # noqa: E402
from tests.benchmarks.render_measures import (  # noqa: E402
    TARGET,
    VIEWS,
    Fit,
    cost,
    figures,
    flip,
    keep,
    reference,
    summary,
)
from tests.benchmarks.table import publish  # noqa: E402
from tests.setup import peers  # noqa: E402

FLICKER = 4  # samples of our moving pictures
FEW = 16  # samples of each half of their references
MANY = 65  # samples from which the cost of one is measured: the start dominates the cost of fewer
LARGE, LARGE_HALF = 512, 128  # pixels along an edge; samples of each half of the reference
LOOSE = 0.1  # target error of pixels
TREES = ("green tree, sun and sky", "white tree, sun", "white tree, white sky, baked")
STEP = 0.05  # rad from view to view
MITSUBA = 32  # samples of each of its two pictures
OPINIONS = ("cloud, albedo 0.99, g 0", "cloud, albedo 0.99, g 0.85")
FORWARD = "cloud, albedo 0.99, g 0.85"
VARIANTS = (
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
AROUND = 24  # samples of Cycles per camera, with two seeds; means are accurate to about 2 %
DEVICE = "Cycles on the processor"


# --- One scene -----------------------------------------------------------------------------------


def rows_of(shot):
    """[row] for each picture of a shot; the pictures are written to a file."""
    halves = reference(shot)
    with TemporaryDirectory() as name:
        folder = Path(name)
        rendered = [*by_cycles(shot, folder), *with_our_light(shot, folder)]
    images = np.array([image for _, image in rendered], np.float32)
    flips = flip(images, halves.mean(axis=0))
    rows = [
        row | figures(image, halves, shot.block) | {"FLIP": float(score)}
        for (row, image), score in zip(rendered, flips, strict=True)
    ]
    keep(shot.name, halves, images)
    stored = pictures.stored(shot.known_by, halves, shot.half, shot.bounces[0])
    return [{"scene": shot.name} | row | {"reference / stored": stored} for row in rows]


def by_cycles(shot, folder):
    """(row, picture) for each setting with which Cycles traces the light."""
    shot.build(folder)
    pictures.picture(1, 0)  # loads everything, untimed
    for bounces in shot.bounces:
        for denoise in (False, True):
            light = f"{bounces} bounces" + ", denoised" * denoise
            for samples in shots.SAMPLES:
                meter = pictures.Meter()
                image = pictures.picture(samples, bounces, samples, denoise, meter)
                yield cost(light, samples, meter), image


def with_our_light(shot, folder):
    """(row, picture) for each number of samples; the first bake compiles and is not counted."""
    baked(shot, folder)
    baking, _ = baked(shot, folder)
    pictures.picture(1)
    for samples in shot.ours:
        meter = pictures.Meter()
        image = pictures.picture(samples, seed=samples, meter=meter)
        yield cost("ours", samples, meter) | {"bake, processor s": baking.processor}, image


def baked(shot, folder, **changes):
    """(`Meter`, `Outcome`) of a bake, after which the scene is ready to be rendered.

    changes  options that differ from the defaults
    """
    objects = shot.build(folder)
    meter = pictures.Meter()
    with meter():
        chosen = {"quality": "CUSTOM"} | shot.options | changes
        options = Options(folder=str(folder), **chosen)
        outcome = bake.bake(bpy.context, objects, options)
        render_settings.use_light(bpy.context.scene)
    return meter, outcome


# --- Trees whose leaves are larger than pixels ---------------------------------------------------


def large():
    """[row]: processor time to a pixel error of LOOSE in pictures of trees."""
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
        our_rows = list(rows())
    ours = Fit.of(our_rows)
    ratios = {
        views: cycles.seconds(LOOSE, views) / (baking + ours.seconds(LOOSE, views))
        for views in (1, VIEWS)
    }
    return {
        "scene": shot.name,
        "our error": our_rows[-1]["error"],
        "our mean": our_rows[-1]["mean"],
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
    """[row]: a fire, frame by frame, with equal time per frame."""
    frames = [shots.fire(frame) for frame in range(1, shots.FRAMES + 1)]
    halves = np.array([reference(replace(frame, half=FEW)) for frame in frames])
    with TemporaryDirectory() as name:
        folder = Path(name)
        ours, meter = [], pictures.Meter()
        baked(frames[0], folder)
        for number, frame in enumerate(frames):
            meter.add(baked(frame, folder)[0])
            ours.append(pictures.picture(FLICKER, seed=number, meter=meter))
        rendered = {("ours", FLICKER): (meter, ours)}
        samples = affordable(frames[0], folder, meter.processor / len(frames))
        for denoise in (False, True):
            meter, theirs = pictures.Meter(), []
            for number, frame in enumerate(frames):
                frame.build(folder)
                theirs.append(
                    pictures.picture(samples, frame.bounces[0], number, denoise, meter=meter)
                )
            rendered["Cycles" + ", denoised" * denoise, samples] = meter, theirs
    keep("flicker", halves[:, 0], [images for _, images in rendered.values()])
    return moving(rendered, halves)


def moving(rendered, halves):
    """[row] of moving pictures.

    rendered  {(light, samples): (`Meter`, pictures (frames, ...))}
    halves    (frames, 2, ...) of the reference
    """
    return [
        {
            "light": light,
            "samples": samples,
            "processor s a frame": meter.processor / len(halves),
            "flicker": pictures.flicker(np.array(images), halves),
            "error": pictures.error(np.array(images), halves.swapaxes(0, 1)),
        }
        for (light, samples), (meter, images) in rendered.items()
    ]


def turning():
    """[row]: trees baked once, with a camera that moves around them, in equal time."""
    shown = [shot for shot in shots.shots() if shot.name in TREES]
    return [{"scene": shot.name} | row for shot in shown for row in turned(shot)]


def turned(shot):
    """[row] of one tree from VIEWS sides, STEP apart; errors are those of 4x4 means."""

    def seen(samples, bounces=None, seed=None, denoise=False, meter=None):
        images = []
        for number in range(VIEWS):
            crowns.look(crowns.CASES["tree"], "lit", number * STEP)
            view_seed = number if seed is None else seed
            images.append(pictures.picture(samples, bounces, view_seed, denoise, meter))
        return pictures.blocks(np.array(images))

    with TemporaryDirectory() as name:
        folder = Path(name)
        baked(shot, folder)
        meter, _ = baked(shot, folder)
        pictures.picture(1)
        rendered = {("ours", FEW): (meter, seen(FEW, meter=meter))}
        samples = affordable(shot, folder, meter.processor / VIEWS)
        for denoise in (False, True):
            meter = pictures.Meter()
            images = seen(samples, shot.bounces[0], denoise=denoise, meter=meter)
            rendered["Cycles" + ", denoised" * denoise, samples] = meter, images
        halves = [seen(shot.half, shot.bounces[0], seed) for seed in pictures.SEEDS]
    return moving(rendered, np.stack(halves, axis=1))


def affordable(shot, folder, seconds):
    """The number of samples that Cycles renders in `seconds` of processor time, at least one."""
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
    """[row]: Mitsuba's pictures of the clouds, compared with those of Cycles."""
    return [opinion(shot) for shot in shots.shots() if shot.name in OPINIONS]


def opinion(shot):
    case, halves = shot.case, reference(shot)
    edge = endtoend.EDGE * endtoend.VOXEL / 2
    meter = pictures.Meter()
    with meter():
        by_mitsuba = peers.run(
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
    theirs = np.repeat(by_mitsuba[..., None], 3, axis=-1).astype(float)
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


# --- Forward scattering --------------------------------------------------------------------------


def forward():
    """[row]: the cloud that is too dark, with other options: is the light or its display wrong?"""
    shot = next(shot for shot in shots.shots() if shot.name == FORWARD)
    halves, rows = reference(shot), []
    with TemporaryDirectory() as name:
        for changes in VARIANTS:
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
    """[row]: the mean of the same cloud from other sides, relative to Cycles."""
    shot = next(shot for shot in shots.shots() if shot.name == FORWARD)

    def seen_from(place, *settings):
        camera = bpy.context.scene.camera
        camera.location = place
        camera.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
        return pictures.picture(*settings)

    rows = [{"camera": camera} for camera in CAMERAS]
    with TemporaryDirectory() as name:
        shot.build(Path(name))
        references = [
            np.array([seen_from(place, AROUND, shot.bounces[0], seed) for seed in pictures.SEEDS])
            for place in CAMERAS.values()
        ]
        for gather in (True, False):
            baked(shot, Path(name), gather=gather)
            column = "ordinates" if gather else "lattice alone"
            for row, place, image in zip(rows, CAMERAS.values(), references, strict=True):
                row[column] = float(seen_from(place, 1).mean() / image.mean())
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
    selected = [s for s in shots.shots() if not chosen or {s.name, s.group} & chosen]
    for group, group_shots in groupby(selected, key=lambda shot: shot.group):
        scenes = [rows_of(shot) for shot in group_shots]
        publish(f"render-{group}", DEVICE, [row for rows in scenes for row in rows])
        publish(f"render-{group}-summary", DEVICE, list(map(summary, scenes)))
    for name, part in PARTS.items():
        if not chosen or name in chosen:
            publish(f"render-{name}", DEVICE, part())


if __name__ == "__main__":
    main()
    leave(0)
