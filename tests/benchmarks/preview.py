# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of a preview, and the share of its light that has scattered more than once.

Run it with `python -m tests.benchmarks.preview`; it also draws
docs/measurements/free-paths/preview.webp.
"""

from time import perf_counter

import numpy as np
from PIL import Image

from lb_lighting.transport import Medium, PerlinMedium, Sky, Sun, device
from lb_lighting.transport.preview.pictures import View, pictures
from lb_lighting.transport.preview.survey import advice, histogram_picture, statistics
from tests.benchmarks import table
from tests.benchmarks.plots import DOCS

LIGHTS = [Sun((-0.5, 0.6, -0.6), 3.0), Sky(0.15)]
AWAY = (0.5, 1.0, -0.4)  # direction of the camera
SMALL = (80, 60)
# Of the pictures that are compared, times their optical depth, as most rays pass a thin medium.
# Both pictures have the same paths, up to where one ends.
SAMPLES = 40
DEPTHS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
SECONDS = 8  # for which the picture of the documentation refines
BACKGROUND = 0.04  # of Blender's panels, linear


def ball(edge=64):
    """(edge,)^3 in [0, 1]: a cloud of noise, as a ball."""
    place = (np.indices((edge,) * 3) + 0.5) / edge - 0.5
    radius = np.linalg.norm(place, axis=0)
    noise = PerlinMedium(64, 1.0, 1.0, 0.0, seed=3, persistence=0.6).voxels(edge).density
    density = np.clip(2 * (1 - radius / 0.42 + 1.6 * (noise - 0.5)), 0, 1)
    return np.where(radius > 0.48, 0, density)


def cube(edge=64, margin=8):
    density = np.zeros((edge,) * 3)
    density[(slice(margin, edge - margin),) * 3] = 1
    return density


def media():
    """{name: medium}"""
    return {
        "cloud": Medium(ball(), 1 / 64, 39.9, 0.1, 0.6),
        "noise of 4096³": PerlinMedium(4096, 1.0, 30.0, 0.1, 0.3, cutoff=0.4, power=1.5, seed=2),
        "dense cube": Medium(cube(), 1 / 64, 190.0, 2.0),
    }


# --- How often light has scattered ---------------------------------------------------------------


def brightness(medium, light, samples, scatterings):
    """Mean of a picture's light."""
    view = View.onto(medium.domain, AWAY, size=SMALL)
    for picture in pictures(medium, [light], view, scatterings=scatterings):
        if picture.samples >= samples:
            return float(picture.pixels[..., :3].mean())


def shares(name, density, depths, albedo, g, light):
    """A row: the share of light that scattered more than once, by depth of the deepest column."""
    deepest = max(density.sum(axis=axis).max() for axis in range(3)) / len(density)
    row = {"medium": name, "albedo": albedo, "g": g, "light": type(light).__name__.lower()}
    for depth in depths:
        sigma = depth / deepest
        medium = Medium(density, 1 / len(density), albedo * sigma, (1 - albedo) * sigma, g)
        once, all_light = (
            brightness(medium, light, max(SAMPLES, SAMPLES / depth), most) for most in (1, None)
        )
        row[f"depth {depth:g}"] = 1 - once / all_light
    return row


def all_shares():
    filled = np.ones((16,) * 3)
    for name, density in (("cube", filled), ("cloud", ball())):
        for g in (0.0, 0.85):
            for light in LIGHTS:
                yield shares(name, density, DEPTHS, 1.0, g, light)
    for g in (0.0, 0.85):
        for light in LIGHTS:
            yield shares("cube", filled, (10.0,), 0.04, g, light)


# --- How long it takes ---------------------------------------------------------------------------


def refined(medium, **options):
    """({stage: seconds}, the last picture) of a medium."""
    view = View.onto(medium.domain, AWAY)
    start, seconds = perf_counter(), {}
    for picture in pictures(medium, LIGHTS, view, **options):
        now = perf_counter() - start
        seconds.setdefault("first picture, s", now)
        if picture.samples >= 1:
            after = seconds.setdefault("a sample in each pixel, s", now)
            if now > SECONDS and picture.samples > 1:
                break
    seconds["s a sample"] = (now - after) / (picture.samples - 1)
    return seconds, picture


def look(name, medium):
    """(row of figures, picture) of a medium."""
    seconds, picture = refined(medium)
    start = perf_counter()
    found = statistics(medium)
    row = {
        "medium": name,
        **seconds,
        "statistics, s": perf_counter() - start,
        "optical depth": max(found.depth_max),
        "free path, mm": 1000 * found.in_matter,
        **{f"{n}, accepted": s.acceptance for n, s in found.samplers.items()},
        **{f"{n}, million rays/s": s.rays_a_second / 1e6 for n, s in found.samplers.items()},
        "advice": advice(found, 64),
    }
    return row, draw(picture.pixels, histogram_picture(found, 320, 60))


def draw(picture, histogram):
    """An image of a picture above the histogram, as in the panel."""
    picture = picture.repeat(2, axis=0).repeat(2, axis=1)
    seen = picture[..., :3] + (1 - picture[..., 3:]) * BACKGROUND
    bars = histogram[..., :3] * histogram[..., 3:] + (1 - histogram[..., 3:]) * 0.22
    seen = np.clip(seen, 0, 1) ** (1 / 2.2)
    return Image.fromarray((255 * np.concatenate([bars, seen])[::-1]).astype(np.uint8))


def main():
    looks = [look(*item) for item in media().items()]
    sheet = Image.new("RGB", (sum(i.width for _, i in looks), looks[0][1].height))
    for number, (_, image) in enumerate(looks):
        sheet.paste(image, (number * image.width, 0))
    sheet.save(DOCS / "preview.webp", quality=75, method=6)
    found = device.choose()
    slow, _ = refined(media()["cloud"], device="NumPy", scatterings=4)
    rows = [row for row, _ in looks]
    rows.append({"medium": "cloud without OpenCL, 4 scatterings at most", **slow})
    table.publish("preview", found.label, rows)
    table.publish("preview-scatterings", found.label, list(all_shares()))


if __name__ == "__main__":
    main()
