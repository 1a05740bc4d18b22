# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake and Clear are one undo step each."""

from pathlib import Path

import bpy
import pytest
from scenes import sun, volume_material, volume_object, write_ball


@pytest.fixture
def scene(lb, tmp_path):
    """A cloud and a leaf with a material, both selected; the first undo step."""
    write_ball(tmp_path / "ball.vdb", center=(0, 0, 0))
    volume_object(tmp_path / "ball.vdb", volume_material(density=5.0))
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4, size=1)
    bpy.context.object.data.materials.append(bpy.data.materials.new("Leaf"))
    bpy.data.objects["Cloud"].select_set(True)
    sun((0, 0, -1))
    settings = bpy.context.scene.lb_lighting
    settings.resolution, settings.folder = 20, str(tmp_path)
    bpy.ops.ed.undo_push(message="scene")
    return state()


def state():
    """All that a bake may change, as plain values: undo makes every datablock anew."""
    return {
        "objects": {ob.name: (ob.hide_render, ob.hide_viewport) for ob in bpy.data.objects},
        "links": {
            (material.name, link.from_node.name, link.to_node.name, link.to_socket.name)
            for material in bpy.data.materials
            for link in material.node_tree.links
        },
        "attributes": {mesh.name: mesh.attributes.keys() for mesh in bpy.data.meshes},
        "groups": bpy.data.node_groups.keys(),
        "marched": bpy.context.scene.cycles.volume_biased,
        "files": [volume.filepath for volume in bpy.data.volumes],
    }


def run(operator):
    """As the user would: with an undo step."""
    assert operator("EXEC_DEFAULT", True) == {"FINISHED"}
    return state()


def files(folder):
    return sorted(path.name for path in Path(folder).glob("*_lb_*.vdb"))


def test_bake(scene):
    lit = run(bpy.ops.lb_lighting.bake)
    assert lit != scene
    bpy.ops.ed.undo()
    assert state() == scene
    bpy.ops.ed.redo()
    assert state() == lit


def test_clear(scene, tmp_path):
    lit = run(bpy.ops.lb_lighting.bake)
    written = files(tmp_path)
    assert written
    assert run(bpy.ops.lb_lighting.clear) == scene
    assert files(tmp_path) == written
    bpy.ops.ed.undo()
    assert state() == lit


def test_light_that_is_deleted(scene):
    lit = run(bpy.ops.lb_lighting.bake)
    bpy.ops.object.select_all(action="DESELECT")
    bpy.data.objects["LB Cloud"].select_set(True)
    for _ in range(2):
        deleted = run(bpy.ops.object.delete)
        assert deleted["objects"]["Cloud"] == (False, False)
        bpy.ops.ed.undo()
        assert state() == lit
