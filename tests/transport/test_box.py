# SPDX-License-Identifier: GPL-3.0-or-later
"""Empty space around matter: solved in the box of the matter, light is what it is without."""

from itertools import product

import numpy as np
import pytest

from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve
from lb_lighting.transport import box as crop
from lb_lighting.transport.box import Box
from lb_lighting.transport.lattice.layout import LENGTHS, MOVING
from lb_lighting.transport.lattice.streaming import stream_on
from lb_lighting.transport.uncollided.casting import cast
from tests.tracing import OPENCL, name

SHAPE, SIZE, H = (14, 11, 13), (4, 3, 5), 0.5
PLACES = {"odd": (5, 3, 3), "even": (4, 4, 6), "face": (0, 4, 5), "corner": (10, 0, 8)}
SUN = Sun((0.3, 0.2, -0.93), (2.0, 1.0))
OTHERS = [Sky(0.3), PointLight((1.0, 2.0, 3.0), (5.0, 2.0)), Sun((-0.9, 0.3, 0.2), 1.0)]
KINDS = ("patchy", "block", "opaque", "glowing")
NEAR = 1e-5  # of the largest

each_device = pytest.mark.parametrize(
    "found", [None, *OPENCL], ids=lambda found: name(found) if found else "NumPy"
)


def at(place, size=SIZE):
    return tuple(slice(a, a + n) for a, n in zip(place, size, strict=True))


def clump(place, kind):
    """Two bands; one of KINDS: with voids, with flat faces, with opaque voxels, with a glow that
    fills the domain."""
    rng = np.random.default_rng(7)
    density, occlusion = np.zeros((2, *SHAPE))
    density[at(place)] = 1 if kind == "block" else rng.random(SIZE) * (rng.random(SIZE) > 0.3)
    occlusion[at(place)] = rng.random(SIZE) * (rng.random(SIZE) > 0.6)
    extra = {
        "opaque": {"occlusion": occlusion, "occlusion_albedo": 0.6},
        "glowing": {"emission": rng.random(SHAPE) > 0.9},
    }.get(kind, {})
    return Medium(density, H, (2.0, 1.0), (0.1, 0.3), (0.5, -0.3), **extra)


def uncropped(run, monkeypatch):
    """What a run returns where the box is the domain."""
    with monkeypatch.context() as patch:
        patch.setattr(crop, "_MARGIN", max(SHAPE))
        return run()


def assert_close(got, expected):
    assert np.abs(got - expected).max() <= NEAR * np.abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("found", OPENCL, ids=name)
def test_light_is_that_of_the_whole_domain(found, place, kind, monkeypatch):
    lights = [SUN, *OTHERS] if (place, kind) == (PLACES["even"], "patchy") else [SUN]
    assert_cropped_is_whole(clump(place, kind), lights, found, monkeypatch)


@pytest.mark.parametrize("kind", KINDS[:3])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_the_twins_is_too(place, kind, monkeypatch):
    assert_cropped_is_whole(clump(place, kind), [SUN], "NumPy", monkeypatch)


def assert_cropped_is_whole(medium, lights, found, monkeypatch):
    def run():
        return solve(medium, lights, Settings(tolerance=1e-6, divide=1), found)

    assert not Box.around([medium.density]).is_whole
    field, whole = run(), uncropped(run, monkeypatch)
    for what in ("fluence", "flux", "direct", "direct_flux", "by_light"):
        assert_close(getattr(field, what), getattr(whole, what))
    for where, power in whole.report.energy.items():
        assert_close(field.report.energy[where], power)


def test_photons_hand_over_to_the_box(monkeypatch):
    medium = clump(PLACES["odd"], "patchy")

    def run():
        settings = Settings(handover=1.0, photons=20_000, tolerance=1e-6, divide=1)
        return solve(medium, [SUN], settings, OPENCL[0])

    field, whole = run(), uncropped(run, monkeypatch)
    assert_close(field.fluence, whole.fluence)
    assert_close(field.flux, whole.flux)


def test_a_suns_shadow_density_counts_as_matter(monkeypatch):
    medium, shadow = clump(PLACES["odd"], "patchy"), np.zeros(SHAPE)
    shadow[12, 9, 1] = 1.0

    def run():
        light = Sun((0, 0, -1), 1.0, shadow_density=shadow)
        return solve(medium, [light], Settings(tolerance=1e-6, divide=1), "NumPy")

    assert_close(run().fluence, uncropped(run, monkeypatch).fluence)


@each_device
@pytest.mark.parametrize("toward", [*product((-1, 1), (0.7,), (-0.2, 0.3)), (0, 0, -1)], ids=str)
def test_a_beam_is_that_of_the_whole_domain(toward, found):
    assert_cast_is_whole(Sun(toward, (2.0, 1.0)), found or "NumPy")


@pytest.mark.parametrize("found", OPENCL, ids=name)
def test_an_even_sky_is_too(found):
    assert_cast_is_whole(Sky(0.3), found)


def assert_cast_is_whole(light, found):
    """Behind the box, too; collisions are counted in the box alone."""
    medium = clump(PLACES["even"], "block")
    box = Box.around([medium.density])
    whole, part = (cast(medium, light, 0, 2.1, found, 3, box=b) for b in (None, box))
    for what in ("direct", "flux", "left"):
        assert_close(getattr(part, what), getattr(whole, what))
    for what in ("power", "position", "direction"):
        assert_close(getattr(part.collided, what), box.of(getattr(whole.collided, what)))
    assert part.entered == pytest.approx(whole.entered)


class _Bulb:
    """Stands for a lattice from which the same light leaves along one direction everywhere."""

    def __init__(self, shape, number):
        self.shape, self.number = shape, number

    def leaving(self):
        for n in range(len(MOVING)):
            yield np.full(self.shape, float(n == self.number))


@pytest.mark.parametrize("number", range(18))
def test_light_flies_on_as_far_as_the_domain_goes(number):
    """Voxel by voxel: lit is where, going back, the box is met."""
    c, length = MOVING[number], LENGTHS[number]
    for place in PLACES.values():
        upper = tuple(np.add(place, SIZE))
        box = Box(place, upper, SHAPE)
        fluence, flux = np.zeros(SHAPE), np.zeros((3, *SHAPE))
        left = stream_on(_Bulb(SIZE, number), box, 2.0, fluence, flux)
        inside = np.zeros(SHAPE, bool)
        inside[at(place)] = True
        expected, gone = np.zeros(SHAPE), np.zeros(6)
        for start in np.argwhere(inside):
            voxel = start + c
            if np.all((voxel >= 0) & (voxel < SHAPE)) and inside[tuple(voxel)]:
                continue  # it did not leave
            while np.all((voxel >= 0) & (voxel < SHAPE)):
                expected[tuple(voxel)] += 1
                voxel = voxel + c
            axis = np.flatnonzero((voxel < 0) | (voxel >= SHAPE))[0]
            gone[2 * axis + (c[axis] > 0)] += 1
        assert fluence == pytest.approx(2.0 * length * expected)
        assert flux == pytest.approx(2.0 * np.multiply.outer(c, expected))
        assert left == pytest.approx(gone)


def test_matter_at_all_faces_is_not_cropped():
    density = np.zeros(SHAPE)
    density[0, 0, 0] = 1
    assert not Box.around([density]).is_whole
    density[-1, -1, -1] = 1
    assert Box.around([density]).is_whole
    assert Box.around([np.zeros(SHAPE)]).is_whole
