# SPDX-License-Identifier: GPL-3.0-or-later
"""A sequence of .vdb files, lit at more than one frame."""

import bpy
import numpy as np
from scenes import baked, center_of_mass, sun, volume_material, volume_object, write_ball

CENTERS = {1: (-0.3, 0, 0), 2: (0, 0.2, 0), 3: (0.3, 0, 0.1)}  # m, by frame


def test_each_frame_is_lit_with_its_own_density(lb, tmp_path):
    for frame, center in CENTERS.items():
        write_ball(tmp_path / f"ball_{frame:03}.vdb", center)
    ob = volume_object(tmp_path / "ball_001.vdb", volume_material(density=5.0))
    ob.data.is_sequence, ob.data.frame_duration = True, len(CENTERS)
    sun((0, 0, -1))
    scene = bpy.context.scene
    scene.lb_lighting.resolution, scene.lb_lighting.folder = 20, str(tmp_path)
    for frame in (1, 3):
        scene.frame_set(frame)
        assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
        density, _light, positions = baked("Cloud")
        voxel = positions[1, 0, 0, 0] - positions[0, 0, 0, 0]
        difference = center_of_mass(density, positions) - CENTERS[frame]
        assert np.abs(difference).max() < 0.1 * voxel
