# SPDX-License-Identifier: GPL-3.0-or-later
"""Every test starts from an empty Blender file where Blender is there at all."""

import subprocess

import pytest

try:
    import bpy
except ImportError:
    bpy = None
else:
    if hasattr(bpy.utils, "expose_bundled_modules"):
        bpy.utils.expose_bundled_modules()

EXIT_CODE = pytest.StashKey()


def pytest_sessionfinish(session, exitstatus):
    session.config.stash[EXIT_CODE] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """Everything is reported: end before the interpreter takes Blender down, see `cli.leave`."""
    if bpy is not None and EXIT_CODE in config.stash:
        from lb_lighting.cli import leave

        leave(config.stash[EXIT_CODE])


@pytest.fixture(scope="session", autouse=True)
def registered():
    """The extension as Blender has it when it is enabled."""
    if bpy is None:
        yield
        return
    import lb_lighting

    lb_lighting.register()
    yield
    lb_lighting.unregister()


@pytest.fixture(autouse=True)
def empty_file():
    """An empty file without a world; the names of a previous test are gone."""
    if bpy is not None:
        bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def processes(monkeypatch):
    """The solver's processes that were started."""
    from lb_lighting import job

    started = []

    class Recorded(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr(job.subprocess, "Popen", Recorded)
    return started


@pytest.fixture
def scene(tmp_path):
    """A sun, and settings that bake within a second, with the files in `tmp_path`."""
    from tests import scenery

    scenery.add_sun()
    settings = bpy.context.scene.lb_lighting
    settings.resolution, settings.device, settings.folder = 16, "NumPy", str(tmp_path)
    settings.quality = "CUSTOM"
    return bpy.context.scene
