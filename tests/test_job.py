# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's process: the same light as here, its errors here, and no harm where it dies."""

import re
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest

from lb_lighting import exchange, job
from lb_lighting.errors import DeviceError, OutputError, SolverError
from lb_lighting.job import Job
from lb_lighting.transport import Medium, PointLight, Settings, Sky, Sun, solve
from tests.jobs import Chatter, Fail, Idle, ReadAndFail, Solve, Toil, refused

SUN = Sun((0.1, 0.2, -1), (3.0, 2.0, 1.0))
NO_OPENCL = "/nowhere"


@pytest.fixture(autouse=True)
def own_temporary_folder(tmp_path, monkeypatch):
    """Where logs of processes that fail are kept."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


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


def test_a_task_is_read_as_it_was_written(tmp_path, medium):
    lights = [SUN, Sky(0.5), PointLight((1, 2, 3), np.array((1.0, 2.0, 3.0)))]
    settings = Settings("paper", steps=5, keep_absorbed=True)
    exchange.save(tmp_path / "task", Solve(medium, lights, settings, "abc"))
    found = exchange.load(tmp_path / "task")
    for name in ("density", "sigma_s", "sigma_a", "g", "occlusion"):
        assert np.array_equal(getattr(found.medium, name), getattr(medium, name))
    assert (found.medium.voxel_size, found.medium.origin) == (0.5, (1, 2, 3))
    assert found.lights[:2] == lights[:2]
    assert (found.settings, found.device) == (settings, "abc")


def test_an_extensions_classes_are_read_under_their_plain_names(tmp_path, monkeypatch):
    """As an extension, the package is part of another; the worker knows it alone."""
    monkeypatch.setattr(Sun, "__module__", "bl_ext.user_default.lb_lighting." + Sun.__module__)
    monkeypatch.setitem(
        sys.modules, Sun.__module__, sys.modules["lb_lighting.transport.lights.distant"]
    )
    exchange.save(tmp_path / "sun", SUN)
    assert b"bl_ext" in (tmp_path / "sun").read_bytes()
    monkeypatch.undo()
    assert exchange.load(tmp_path / "sun") == SUN


def test_same_light_as_in_this_process(medium):
    reports = []
    task = Solve(medium, [SUN, Sky(0.1)], Settings("paper"), "NumPy")
    found = Job(task).wait(lambda *progress: reports.append(progress))
    expected = solve(medium, [SUN, Sky(0.1)], Settings("paper"), "NumPy")
    assert np.array_equal(found.fluence, expected.fluence)
    assert found.domain == expected.domain
    assert {stage for stage, _fraction in reports} - {"Starting"} == {"solve"}
    fractions = [fraction for _stage, fraction in reports]
    assert fractions == sorted(fractions)


def test_physical_light_crosses_too():
    sun = Sun((0, 0.6, -0.8), (1.0, 2.0), shadow_density=np.full((4, 5, 6), 0.5))
    medium = Medium(np.ones((4, 5, 6)), 0.5, 1.0, (0.1, 0.2), shift=[[0, 0], [0.5, 0]])
    settings = Settings(divide=2, tolerance=1e-3)
    found = Job(Solve(medium, [sun], settings)).wait()
    expected = solve(medium, [sun], settings)
    for name in ("fluence", "direct", "flux", "by_light"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    assert found.report.energy.keys() == expected.report.energy.keys()
    for where, power in expected.report.energy.items():
        np.testing.assert_array_equal(found.report.energy[where], power)


def test_starts_from_any_folder(tmp_path, monkeypatch, medium):
    (tmp_path / "lb_lighting.py").write_text("raise ImportError('not ours')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    task = Solve(medium, [SUN], Settings("paper", steps=1), "NumPy")
    assert Job(task).wait().report.steps == 1


def test_its_errors_are_raised_here():
    with pytest.raises(DeviceError, match=r"^The device is asleep; wake it\.$"):
        Job(Fail(refused())).wait()


def test_too_little_memory_is_one_sentence():
    with pytest.raises(DeviceError, match="not enough memory; close other programs or lower"):
        Job(Fail(MemoryError())).wait()


def test_a_full_disk_is_one_sentence():
    sentence = r"^The result does not fit into the temporary folder .* \(No space left\); free some"
    with pytest.raises(OutputError, match=sentence):
        Job(Fail(OSError(28, "No space left"))).wait()


def test_a_scene_that_cannot_be_written_down_is_one_sentence(processes, monkeypatch):
    def save(_path, _thing):
        raise OSError(28, "No space left")

    monkeypatch.setattr(exchange, "save", save)
    sentence = r"^The scene does not fit into the temporary folder .* \(No space left\); free some"
    with pytest.raises(OutputError, match=sentence):
        Job(Idle()).wait()
    assert processes[0].poll() is not None


def test_a_task_that_cannot_be_written_down_is_a_defect(processes):
    with pytest.raises(AttributeError, match="lambda"):
        Job(Fail(lambda: None)).wait()
    assert processes[0].poll() is not None


def test_cancel_before_the_task_is_written_down(processes, monkeypatch):
    """Nothing is left of a folder that is written to while it goes."""
    save = exchange.save

    def slow(path, thing):
        time.sleep(0.3)
        save(path, thing)

    monkeypatch.setattr(exchange, "save", slow)
    running = Job(Idle())
    folder = running.folder.name
    running.cancel()
    assert processes[0].poll() is not None
    assert not job.Path(folder).exists()


def test_a_killed_process_is_one_sentence(processes):
    running = Job(Idle())
    with pytest.raises(SolverError) as caught:
        running.wait(lambda *_progress: processes[0].kill())
    assert str(caught.value) == (
        "The solver's process was ended by signal 9; nothing was changed. "
        "Choose another device or a lower resolution."
    )


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs POSIX signals")
def test_a_process_that_hangs_is_ended(processes, monkeypatch):
    monkeypatch.setattr(job, "PATIENCE", 1.0)
    running = Job(Idle())
    with pytest.raises(SolverError, match=r"^The solver has not responded for 1 s and was ended; "):
        running.wait(lambda *_progress: processes[0].send_signal(signal.SIGSTOP))
    assert processes[0].poll() is not None


def test_a_process_that_works_in_silence_is_heard():
    """A busy machine may take longer than the patience for one piece of work."""
    running = Job(Toil())
    begun = running._heard
    running.wait()
    assert running._worked > 0
    assert running._heard > begun
    assert running.said == {}


def test_a_defect_in_it_is_one_sentence_with_its_last_words():
    with pytest.raises(SolverError, match=r"ended with code 1; .* Its last line: ValueError: no"):
        Job(Fail(ValueError("no"))).wait()


def test_a_defect_leaves_its_traceback_in_a_log():
    """Though OpenVDB may have the last word."""
    with pytest.raises(SolverError) as caught:
        Job(ReadAndFail()).wait()
    sentence = str(caught.value)
    assert "This is a bug in LB Lighting; please report it. Its output is in " in sentence
    last = r" Its last line: ZeroDivisionError: division by zero \(run, line \d+ of jobs\.py\)$"
    assert re.search(last, sentence)
    log = job.Path(re.search(r"is in (\S+\.log)\.", sentence)[1])
    written = log.read_text()
    assert "Traceback (most recent call last):" in written
    assert "ZeroDivisionError: division by zero" in written


def test_no_log_is_left_where_all_went_well(tmp_path):
    Job(Chatter()).wait()
    with pytest.raises(DeviceError):
        Job(Fail(refused())).wait()
    Job(Idle()).cancel()
    assert not list(tmp_path.glob("*.log"))


def test_nothing_set_for_another_python_matters(monkeypatch):
    for name, value in {
        "PYTHONHOME": "/nowhere",
        "PYTHONPATH": "/nowhere",
        "PYTHONPLATLIBDIR": "lib77",
        "PYTHONWARNINGS": "error",
        "PYTHONINSPECT": "1",
        "PYTHONIOENCODING": "utf-16",
        "PYTHONOPTIMIZE": "2",
    }.items():
        monkeypatch.setenv(name, value)
    assert Job(Chatter()).wait() == 42


def test_a_python_that_does_not_run_is_one_sentence(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    sentence = (
        r"does not start: /nowhere/python cannot be run \(No such file or directory\); reinstall"
    )
    with pytest.raises(SolverError, match=sentence):
        Job(Idle())
    assert not list(tmp_path.iterdir())


def test_a_temporary_folder_that_takes_nothing_is_one_sentence(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(
        OutputError, match=r"^A temporary folder cannot be created \(No such file or"
    ):
        Job(Idle())


def first_report(running):
    """Wait for the first message; what it first_report."""
    while not running.said:
        running.update(wait=0.1)
    return running.said


def test_cancel_is_prompt_and_leaves_nothing(processes, tmp_path):
    scrap, folder = tmp_path / "half.vdb", None
    running = Job(Idle((scrap,)))
    assert first_report(running) == {"stage": "idle", "fraction": 0.5}
    assert running.seconds_left > 0
    scrap.write_text("half")
    folder = running.folder.name
    start = time.monotonic()
    running.cancel()
    assert time.monotonic() - start < 1
    assert processes[0].poll() is not None
    assert not scrap.exists()
    assert not job.Path(folder).exists()


def test_it_ends_where_its_caller_stops_listening(processes):
    def interrupt(*_progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Job(Idle()).wait(interrupt)
    assert processes[0].poll() is not None


@pytest.mark.skipif(sys.platform == "win32", reason="kills as POSIX does")
def test_no_orphan_is_left_where_its_parent_is_killed(tmp_path):
    scrap = tmp_path / "half.vdb"
    code = f"""
import time
from lb_lighting.job import Job
from tests.jobs import Idle
running = Job(Idle(({str(scrap)!r},)))
while not running.said:
    running.update(wait=0.1)
print(running._process.pid, flush=True)
time.sleep(60)
"""
    command = [sys.executable, "-c", code]
    environment = job._environment()
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as parent:
        worker = int(parent.stdout.readline())
        scrap.write_text("half")
        parent.kill()
    deadline = time.monotonic() + 10
    while is_running(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(worker)
    assert not scrap.exists()


def is_running(pid):
    """Whether there is such a process that is not just waiting to be buried."""
    try:
        state = job.Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return state.rsplit(")", 1)[1].split()[0] != "Z"


def test_without_opencl_numpy_solves(monkeypatch, medium):
    monkeypatch.setenv("OCL_ICD_VENDORS", NO_OPENCL)
    assert len(job.device_lines()) == 1
    found = Job(Solve(medium, [SUN], Settings("paper"))).wait()
    assert found.report.device == "NumPy (no OpenCL)"


def test_devices_are_listed_with_numpy_last():
    assert job.device_lines()[-1].startswith("NumPy (no OpenCL): NumPy, ")


def test_a_driver_may_print():
    running = Job(Chatter())
    assert running.wait() == 42
    assert running.said == {"stage": "talk", "fraction": 1.0}


def test_the_log_is_kept_if_it_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("LB_LIGHTING_LOG", "info")
    Job(Chatter()).wait()
    (log,) = tmp_path.glob("*.log")
    text = log.read_text()
    assert "INFO lb_lighting.worker: Chatter begins" in text
    assert "INFO lb_lighting.worker: Chatter ends after" in text
