# SPDX-License-Identifier: GPL-3.0-or-later
"""Final pictures by Cycles: their cost, their differences, and stored references.

Costs are wall time, and processor time (user and system, of this process and its children), which
hardly depends on other processes.
"""

import hashlib
import json
import resource
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import bpy
import numpy as np

from tests.benchmarks.table import BUILD
from tests.output.rendering import render, silent_stdout

REFERENCES = BUILD.parent / "references"
STORE = Path(__file__).parents[1] / "references" / "pictures.npz"
SIZE = 128  # pixels along an edge
BLOCK = 4  # edge, in pixels, of the blocks that coarse figures average
BOUNCES = ("max", "volume", "diffuse", "glossy", "transmission")
SEEDS = (1001, 1002)  # of the two halves of a reference; no other picture uses them


class Meter:
    """Seconds of a `with meter():`: `processor`, the sum over all cores, and `wall`."""

    def __init__(self):
        self.processor = self.wall = 0.0

    @contextmanager
    def __call__(self):
        processor, wall = _processor_time(), perf_counter()
        try:
            yield self
        finally:
            self.processor += _processor_time() - processor
            self.wall += perf_counter() - wall

    def add(self, other):
        self.processor += other.processor
        self.wall += other.wall


def _processor_time():
    everybody = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(sum(resource.getrusage(who)[:2]) for who in everybody)


def picture(samples, bounces=None, seed=0, denoise=False, meter=None, size=SIZE):
    """(size, size, 3) linear radiance of the scene by Cycles, row 0 at the bottom.

    bounces  of every kind, or None for those of the scene

    Nothing is clamped or omitted, and all pixels have the same number of samples.
    """
    scene = bpy.context.scene
    cycles = scene.cycles
    if bounces is not None:
        for kind in BOUNCES:
            setattr(cycles, f"{kind}_bounces", bounces)
    cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0
    cycles.seed = seed
    with TemporaryDirectory() as folder, silent_stdout(), (meter or Meter())():
        return render(scene, Path(folder) / "picture.exr", size, samples, denoise)


def reference(facts, build, samples, bounces, size=SIZE):
    """(2, size, size, 3): pictures of the scene that `build()` makes, with two seeds.

    facts  (name, everything else that the picture depends on); rendered once for the same facts
    """
    name = facts[0].replace(",", "").replace(" ", "-")
    path = REFERENCES / f"render-{name}-{digest(facts, samples, bounces, size)}.npz"
    if not path.exists():
        build()
        halves = [picture(samples, bounces, seed, size=size) for seed in SEEDS]
        REFERENCES.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, halves=np.array(halves, np.float32))
    with np.load(path) as file:
        return file["halves"].astype(float)


def digest(facts, samples, bounces, size=SIZE):
    """Hash of everything that a reference depends on."""
    return hashlib.sha256(repr((facts, samples, bounces, size, SEEDS)).encode()).hexdigest()[:8]


def stored(facts, halves, samples, bounces):
    """The mean of a reference relative to the one in tests/references; if new, it is stored."""
    name, key = facts[0], digest(facts, samples, bounces)
    known, about = {}, {}
    if STORE.exists():
        with np.load(STORE) as file:
            about = json.loads(str(file["about"]))
            known = {each: file[each] for each in about}
    if name not in known or about[name]["of"] != key:
        small = blocks(halves)
        known[name] = small.mean(axis=0).astype(np.float16)
        about[name] = {
            "of": key,
            "relative standard error of 4x4 means": noise(small),
            "made by": f"python -m tests.benchmarks.render '{name}'",
            "Cycles": f"{bounces} bounces, {samples} samples, seeds {SEEDS[0]} and {SEEDS[1]}",
        }
        np.savez_compressed(STORE, about=json.dumps(about), **known)
    return float(halves.mean() / known[name].astype(float).mean())


# --- Figures -------------------------------------------------------------------------------------


def error(found, halves):
    """Relative RMSE over pixels and bands, against the expectation of the two noisy `halves`.

    The noise of the halves is independent and cancels in the mean of products, as long as `found`
    has neither's seed. The result is at least the standard error of that mean.
    """
    return distance((found, found), halves)


def distance(found, halves):
    """The same for two `found` halves, whose noise cancels too."""
    products = ((found[0] - halves[0]) * (found[1] - halves[1])).mean(axis=-1)
    least = products.std() / np.sqrt(products.size)
    return float(np.sqrt(max(least, products.mean()) / np.mean(halves[0] * halves[1])))


def flicker(found, halves):
    """Relative RMSE of the change from frame to frame, compared with that of the reference.

    found (frames, ...), halves (frames, 2, ...)
    """
    steps, wanted = np.diff(found, axis=0), np.diff(halves, axis=0)
    square = np.mean((steps - wanted[:, 0]) * (steps - wanted[:, 1]))
    return float(np.sqrt(max(0.0, square) / np.mean(halves[:, 0] * halves[:, 1])))


def noise(halves):
    """The relative RMSE of the mean of both halves."""
    return float(
        np.sqrt(np.mean((halves[0] - halves[1]) ** 2) / 4 / np.mean(halves[0] * halves[1]))
    )


def brightness(found, halves):
    """The mean of `found` relative to the reference, in the band where this is farthest from 1."""
    ratios = found.mean(axis=(0, 1)) / halves.mean(axis=(0, 1, 2))
    return float(ratios[np.argmax(np.abs(ratios - 1))])


def blocks(pictures, edge=BLOCK):
    """Means over edge x edge pixels of (..., SIZE, SIZE, bands)."""
    *rest, rows, columns, bands = pictures.shape
    shape = (*rest, rows // edge, edge, columns // edge, edge, bands)
    return pictures.reshape(shape).mean(axis=(-4, -2))


# --- To look at ----------------------------------------------------------------------------------


def graded(picture, white):
    """Radiance as display values, 0 to 1; `white` is the radiance of white."""
    linear = np.clip(picture / white, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def difference(found, wanted, white, gain=4):
    """`gain` times the difference, around grey."""
    return np.clip(0.5 + gain / 2 * (found - wanted) / white, 0, 1)
