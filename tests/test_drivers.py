# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenCL drivers that misbehave, and caches that are damaged: the light is solved all the same."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
import pytest

from lb_lighting import cli, job
from lb_lighting.errors import DeviceError
from lb_lighting.job import Job
from lb_lighting.transport import Medium, Settings, Sun, caches, device
from lb_lighting.ui import preferences, running
from tests import scenery
from tests.jobs import Die, Solve
from tests.tracing import OPENCL, name

MEDIUM = Medium(np.ones((4, 5, 6)), 0.5, 0.5, 0.1)
SUN = Sun((0.1, 0.2, -1), 2.0)
UNSCATTERED = Settings(scattering="single")  # by few programs, which are soon built
ENDS = {  # what a driver does as it is loaded: (its code, what is reported of it)
    "aborts": ("abort();", "ended the solver's process (signal 6)"),
    "crashes": ("*(volatile int *)0 = 0;", "ended the solver's process (signal 11)"),
    "exits": ("_exit(0);", "ended the solver's process (code 0)"),
    "sleeps": ("for (;;) pause();", "were not loaded within 2 s"),
}
compiles = pytest.mark.skipif(
    sys.platform != "linux" or not shutil.which("gcc"), reason="needs gcc, for a Linux driver"
)


@pytest.fixture(autouse=True)
def nothing_learned(tmp_path, monkeypatch):
    """Of drivers, in this session; logs of those that fail are kept in a folder of the test."""
    monkeypatch.setattr(job, "_learned", {})
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.fixture
def driver(tmp_path, monkeypatch):
    """Makes the machine's only OpenCL driver one that runs C code as it is loaded."""
    monkeypatch.setattr(job, "LONGEST_LOAD", 2.0)

    def make(code):
        source, library = tmp_path / "driver.c", tmp_path / "driver.so"
        source.write_text(
            "#include <stdio.h>\n#include <stdlib.h>\n#include <unistd.h>\n"
            "__attribute__((constructor)) static void load(void) {"
            f'fputs("the driver speaks\\n", stderr); {code} }}\n'
        )
        subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source], check=True)
        (tmp_path / "vendors").mkdir()
        (tmp_path / "vendors" / "bad.icd").write_text(f"{library}\n")
        monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path / "vendors"))

    return make


def workers(processes):
    """How many of the processes were the solver's."""
    return sum("lb_lighting.worker" in process.args for process in processes)


def solved(label=None, settings=UNSCATTERED):
    return Job(Solve(MEDIUM, [SUN], settings, label)).wait()


@compiles
@pytest.mark.parametrize("how", ENDS)
def test_a_driver_that_does_not_load_leaves_numpy(driver, processes, how):
    code, reason = ENDS[how]
    driver(code)
    found = solved()
    assert found.report.device == "NumPy (no OpenCL)"
    assert np.array_equal(found.direct, solved("NumPy").direct)
    why = job._learned[device.WITHOUT_OPENCL]
    assert why.startswith(f"The OpenCL drivers of this machine {reason}; update or remove them,")
    log = Path(why.rsplit(" ", 1)[1].removesuffix("."))
    assert "the driver speaks" in log.read_text()
    assert workers(processes) == 3
    assert solved().report.device == "NumPy (no OpenCL)"  # at once: the driver is not tried again
    assert workers(processes) == 4


@compiles
def test_numpy_by_name_loads_no_driver(driver, processes):
    driver("abort();")
    assert solved("numpy").report.device == "NumPy (no OpenCL)"
    assert workers(processes) == 1


@compiles
def test_a_device_by_name_is_not_replaced_where_drivers_do_not_load(driver):
    driver("abort();")
    sentence = (
        r"The OpenCL drivers of this machine ended the solver's process \(signal 6\); update .*"
        r"There is no device called 'Intel'; choose one of: NumPy \(no OpenCL\)\.$"
    )
    with pytest.raises(DeviceError, match=sentence):
        solved("Intel")


@compiles
def test_devices_are_listed_with_what_keeps_others_away(driver, capsys):
    driver("abort();")
    assert cli.main(["devices"], opens_file=False) == 0
    numpy, trouble = capsys.readouterr().out.splitlines()
    assert numpy.startswith("NumPy (no OpenCL): NumPy, ")
    assert trouble.startswith("The OpenCL drivers of this machine ended the solver's process")


@compiles
def test_a_bake_tells_why_it_was_solved_with_numpy(driver, scene, tmp_path):
    driver("abort();")
    scene.lb_lighting.device = ""
    scenery.select(scenery.add_fog(tmp_path))
    assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
    note = next(line for line in running.last if line.startswith("The OpenCL drivers"))
    assert note.endswith(" Solved with NumPy instead, which is slower.")
    assert "ended the solver's process (signal 6); update or remove them" in note
    assert bpy.ops.lb_lighting.find_devices() == {"FINISHED"}
    assert len(preferences._found) == 1
    assert preferences._troubles[0].startswith("The OpenCL drivers of this machine ended")


@pytest.mark.parametrize("how", ["os.abort()", "os._exit(0)"])
def test_a_driver_that_dies_at_work_leaves_numpy(processes, how):
    assert Job(Die(how)).wait() == "NumPy (no OpenCL)"
    assert workers(processes) == (3 if OPENCL else 1)


def test_numpy_loads_no_opencl():
    code = """
import sys
import numpy as np
from lb_lighting.transport import *
from lb_lighting.transport.ordinates import source_iteration
medium = Medium(np.ones((4, 4, 4)), 0.5, 0.5, 0.1, 0.7)
lights = [Sun((0, 0.1, -1), 1.0), PointLight((1, 1, 5), 1.0)]
planned = plan(medium, lights, "preview", "NumPy")
field = solve(medium, lights, planned.settings, "NumPy")
source_iteration.iterate(medium, lights, field, "NumPy", 1)
trace(medium, lights, 1000, device="NumPy")
next(pictures(medium, lights, View.onto(medium.domain, (0, 1, 0)), "NumPy"))
statistics(medium, "NumPy")
assert "pyopencl" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], env=job._environment(), check=True)


@pytest.mark.parametrize("found", OPENCL, ids=name)
class TestCaches:
    def test_damaged_files_are_not_used(self, tmp_path, monkeypatch, found):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        expected = solved(found.label).direct
        files = [path for path in tmp_path.rglob("*") if path.is_file()]
        assert files
        for path in files:
            os.truncate(path, path.stat().st_size // 2)
        again = solved(found.label)
        assert np.array_equal(again.direct, expected)
        assert again.report.device == found.label

    @pytest.mark.parametrize("name", ["HOME", "POCL_CACHE_DIR"])
    def test_a_folder_that_cannot_be_made(self, tmp_path, monkeypatch, found, name):
        (tmp_path / "file").touch()
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
        monkeypatch.setenv(name, str(tmp_path / "file" / "folder"))
        assert solved(found.label).report.device == found.label


def test_a_full_disk_keeps_no_programs(tmp_path, monkeypatch):
    def refuse(*_arguments):
        raise OSError(28, "No space left")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(os, "replace", refuse)
    caches.keep("name", b"binary")
    assert caches.find("name") is None
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_a_user_without_a_home_keeps_no_programs(tmp_path, monkeypatch):
    """As containers have them: nothing is written to where the process happens to be."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    for variable in ("HOME", "XDG_CACHE_HOME", "POCL_CACHE_DIR"):
        monkeypatch.setenv(variable, "")  # so that what is set now is unset afterwards
        monkeypatch.delenv(variable)
    caches.keep("name", b"binary")
    assert caches.find("name") is None
    caches.prepare_drivers()
    assert Path(os.environ["POCL_CACHE_DIR"]).is_absolute()
    assert [path for path in tmp_path.iterdir() if "lb_lighting_" not in path.name] == []


@pytest.mark.parametrize("found", OPENCL, ids=name)
def test_a_kernel_that_is_wrong_is_told(tmp_path, monkeypatch, found):
    (tmp_path / "wrong.cl").write_text("kernel void wrong() { no; }")
    monkeypatch.setattr(device, "_SOURCES", tmp_path)
    with pytest.raises(DeviceError, match=r"cannot build wrong\.cl; update its driver"):
        device.program(found, "wrong.cl", ())


def test_the_best_device_that_opens_is_taken(monkeypatch):
    """A graphics card may be another program's own."""
    pytest.importorskip("pyopencl")
    taken = device.Device("Taken", "A platform", "GPU", 2**30, 2**30)
    monkeypatch.setattr(device, "_opencl", lambda: {taken: None})
    monkeypatch.setattr(device, "troubles", [])
    assert device.choose().kind == "NumPy"
    assert device.choose().kind == "NumPy"
    assert len(device.troubles) == 1
    assert device.troubles[0].startswith("The device Taken [A platform] does not open (")
