# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources cross to the solver's process, which has no Blender."""

import json
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import openvdb
import pytest

import lb_lighting
from lb_lighting import exchange
from lb_lighting.scene.medium_choice import FROM_MATERIAL
from lb_lighting.scene.opening import open_sources
from lb_lighting.scene.reader import Reader
from lb_lighting.transport.medium import Domain
from tests import scenery

# Prints the densities and the notes of the sources in a file, and the modules that it loaded.
SOLVER = """
import json, sys
sys.modules["bpy"] = sys.modules["mathutils"] = None  # fails to import
from lb_lighting import exchange
from lb_lighting.transport.medium import Domain
domain = Domain.around((-1, -1, -1), (1, 1, 1), 20)
sources = exchange.load(sys.argv[1])
sums = [float(share.density.sum()) for s in sources for share in s.shares(domain)]
stopped = [float(s.occlusion(domain)[0].sum()) for s in sources if s.is_wall]
bounds = [[list(map(float, corner)) for corner in s.bounds] for s in sources]
sources[0].choice.notes.append("shared")
print(json.dumps([sums, stopped, bounds, sources[-1].choice.notes, list(sys.modules)]))
"""
READERS = ("opening", "reader", "read_meshes", "read_sources", "read_surfaces", "read_volumes")


@pytest.fixture
def crossed(tmp_path):
    """(the sources, what SOLVER prints about them)."""
    objects = [
        scenery.add_fog(tmp_path),
        scenery.add_leaves(),
        scenery.add_ball("body", role="SOLID", material=scenery.volume_material()),
        scenery.add_ball("rock", role="OCCLUDER", material=scenery.leaf_material()),
    ]
    reader = Reader(bpy.context.evaluated_depsgraph_get(), FROM_MATERIAL, 30.0, "")
    sources = open_sources(objects, reader)
    exchange.save(tmp_path / "sources", sources)
    folders = [Path(module.__file__).parents[1] for module in (lb_lighting, np)]
    folders.append(Path(openvdb.__file__).parent)
    folders += [folders[-1].parent]
    done = subprocess.run(
        [sys.executable, "-c", SOLVER, str(tmp_path / "sources")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, folders))},
        stdout=subprocess.PIPE,
        check=True,
    )
    return sources, json.loads(done.stdout)


def test_sources_give_the_same_in_a_process_without_blender(crossed):
    sources, (sums, stopped, bounds, notes, _modules) = crossed
    domain = Domain.around((-1, -1, -1), (1, 1, 1), 20)
    assert sums == [share.density.sum() for s in sources for share in s.shares(domain)]
    assert stopped == [s.occlusion(domain)[0].sum() for s in sources if s.is_wall]
    assert np.array_equal(bounds, [s.bounds for s in sources])
    assert notes == ["shared"]


def test_the_solver_loads_nothing_that_reads_blender(crossed):
    _sources, (*_values, modules) = crossed
    assert "lb_lighting.scene.surface_sources" in modules
    assert not {f"lb_lighting.scene.{name}" for name in READERS}.intersection(modules)
