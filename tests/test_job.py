# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's process: the same light as here, its errors here, and no harm where it dies."""

import json
import subprocess
import sys

import numpy as np
import pytest

from lb_lighting import exchange, job
from lb_lighting.errors import DeviceError, LightError, SolverError
from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve

SUN = Sun((0.1, 0.2, -1), (3.0, 2.0, 1.0))
NO_OPENCL = "/nowhere"


@pytest.fixture
def medium():
    rng = np.random.default_rng(0)
    return Medium(
        rng.uniform(0, 0.5, (6, 7, 8)),
        0.5,
        (0.9, 0.8, 0.7),
        0.1,
        (0.3, 0.0, -0.3),
        (1, 2, 3),
        occlusion=rng.uniform(0, 1, (6, 7, 8)) > 0.9,
    )


@pytest.fixture
def large():
    """A medium that takes NumPy seconds."""
    return Medium(np.ones((64, 64, 64)), 1.0, 0.5, 0.1)


def test_problem_is_read_as_it_was_written(tmp_path, medium):
    path = tmp_path / "problem.npz"
    lights = [SUN, Sky(0.5), PointLight((1, 2, 3), np.array((1.0, 2.0, 3.0)))]
    exchange.save_problem(
        path, medium, lights, Settings("paper", steps=5, keep_absorbed=True), "abc"
    )
    found, found_lights, settings, device = exchange.load_problem(path)
    for name in ("density", "sigma_s", "sigma_a", "g", "occlusion"):
        assert np.array_equal(getattr(found, name), getattr(medium, name))
    assert found.emission is None
    assert (found.voxel_size, found.origin) == (0.5, (1, 2, 3))
    assert [type(light) for light in found_lights] == [Sun, Sky, PointLight]
    assert tuple(found_lights[0].direction) == SUN.direction
    assert tuple(found_lights[2].power) == (1, 2, 3)
    assert (settings, device) == (Settings("paper", steps=5, keep_absorbed=True), "abc")


def test_field_is_read_as_it_was_written(tmp_path, medium):
    path = tmp_path / "field.npz"
    field = solve(medium, [SUN], Settings("paper", steps=3), "NumPy")
    exchange.save_field(path, field)
    found = exchange.load_field(path)
    for name in ("fluence", "direct", "flux"):
        assert np.array_equal(getattr(found, name), getattr(field, name))
    assert found.variance is None
    assert (found.domain, found.report) == (field.domain, field.report)


def test_a_sky_with_a_function_stays_in_its_process(medium):
    with pytest.raises(LightError, match="can be solved in the same process only"):
        job.solve(medium, [Sky(lambda direction: 1.0)], Settings())


def test_same_light_as_in_this_process(medium):
    told = []
    found = job.solve(
        medium, [SUN, Sky(0.1)], Settings("paper"), "NumPy", lambda *progress: told.append(progress)
    )
    expected = solve(medium, [SUN, Sky(0.1)], Settings("paper"), "NumPy")
    assert np.array_equal(found.fluence, expected.fluence)
    assert found.domain == expected.domain
    assert {stage for stage, _fraction in told} == {"solve"}
    fractions = [fraction for _stage, fraction in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1


def test_physical_light_crosses_too():
    sun = Sun((0, 0.6, -0.8), (1.0, 2.0), shadow_density=np.full((4, 5, 6), 0.5))
    medium = Medium(np.ones((4, 5, 6)), 0.5, 1.0, (0.1, 0.2), shift=[[0, 0], [0.5, 0]])
    settings = Settings(divide=2, tolerance=1e-3)
    found = job.solve(medium, [sun], settings)
    expected = solve(medium, [sun], settings)
    for name in ("fluence", "direct", "flux", "by_light"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    assert found.report.energy.keys() == expected.report.energy.keys()
    for where, power in expected.report.energy.items():
        np.testing.assert_array_equal(found.report.energy[where], power)


def test_starts_from_any_folder(tmp_path, monkeypatch, medium):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert job.solve(medium, [SUN], Settings("paper", steps=1), "NumPy").report.steps == 1


@pytest.mark.parametrize(
    ("lights", "device", "error", "sentence"),
    [
        ([SUN], "abacus", DeviceError, "There is no device called 'abacus'; choose one of: "),
        ([PointLight((0, 0, 0), 1.0)], "NumPy", LightError, "replace the PointLight by a Sun"),
    ],
)
def test_its_errors_are_raised_here(medium, lights, device, error, sentence):
    with pytest.raises(error, match=sentence):
        job.solve(medium, lights, Settings("paper"), device)


def test_too_large_a_domain_is_refused_with_one_that_fits():
    with pytest.raises(DeviceError, match=r"the largest resolution that fits is (\d+)\.") as caught:
        job.require_memory((10**7, 10**7, 10**7), "NumPy")
    largest = int(str(caught.value).rstrip(".").rsplit(" ", 1)[1])
    # What fits is what is free at the time, and that differs a little from call to call.
    assert job.require_memory((int(0.8 * largest),) * 3, "NumPy") is None
    with pytest.raises(DeviceError):
        job.require_memory((int(1.25 * largest),) * 3, "NumPy")


def test_a_killed_process_is_one_sentence(processes, large):
    with pytest.raises(SolverError) as caught:
        job.solve(
            large, [Sky(1.0)], Settings("paper"), "NumPy", lambda *_progress: processes[0].kill()
        )
    assert str(caught.value) == (
        "The solver's process was ended by signal 9; nothing was changed. "
        "Choose another device or a lower resolution."
    )


def test_a_defect_in_it_is_one_sentence_with_its_last_words():
    with pytest.raises(SolverError, match=r"ended with code 1; .* Its last words: ValueError: "):
        job.require_memory(("wide", 1, 1), "NumPy")


def test_it_ends_where_its_caller_stops_listening(processes, large):

    def interrupt(*_progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        job.solve(large, [Sky(1.0)], Settings("paper"), "NumPy", interrupt)
    assert processes[0].poll() is not None


def test_without_opencl_numpy_solves(monkeypatch, medium):
    monkeypatch.setenv("OCL_ICD_VENDORS", NO_OPENCL)
    assert len(job.device_lines()) == 1
    assert job.solve(medium, [SUN], Settings("paper")).report.device == "NumPy (no OpenCL)"


def test_devices_are_listed_with_numpy_last():
    assert job.device_lines()[-1].startswith("NumPy (no OpenCL): NumPy, ")


def test_a_driver_may_print(tmp_path):
    code = """
import os, sys
from lb_lighting import worker
from lb_lighting.transport import device

def devices():
    print("chatter")
    os.write(1, b"chatter of a driver")
    return [device.numpy_device()]

device.devices = devices
sys.exit(worker.main(["devices"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=job._environment())
    (line,) = done.stdout.splitlines()
    assert list(json.loads(line)) == ["devices"]
    assert b"chatter of a driver" in done.stderr
