# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of baked volumes, and the node groups."""

import bpy
import numpy as np

from lb_lighting.output.grid_groups import GRID_GROUP, grid_group
from lb_lighting.output.shading_surfaces import (
    unwire_ambient,
    wire_ambient,
)
from lb_lighting.output.shading_volumes import remove_unused, shade_volume
from lb_lighting.output.surface_groups import (
    AMBIENT_GROUP,
    ambient_group,
)
from lb_lighting.output.vdb import AXES
from lb_lighting.output.volume import remove_baked, show_volume
from lb_lighting.output.volume_groups import (
    BEAM_GROUP,
    VOLUME_GROUP,
    volume_group,
)
from tests.output.graphs import ambient, principled
from tests.scenery import source


def test_baked_volume_has_one_material_and_takes_it_along(tmp_path):
    ob = show_volume(bpy.context, [source("cloud")], tmp_path / "a.vdb")
    shade_volume(ob, "REPLACE", 2.0, 0.5)
    shade_volume(ob, "ADD", (1, 2, 3), (4, 5, 6), (0.5, 0, -0.5), strength=0.5)
    (material,) = ob.data.materials
    inputs = next(n for n in material.node_tree.nodes if n.type == "GROUP").inputs
    assert tuple(inputs["Sigma S"].default_value) == (1, 2, 3)
    assert tuple(inputs["Sigma A"].default_value) == (4, 5, 6)
    assert tuple(inputs["G"].default_value) == (0.5, 0, -0.5)
    assert inputs["Strength"].default_value == 0.5
    assert not inputs["Replace"].default_value
    assert sorted(bpy.data.node_groups.keys()) == [BEAM_GROUP, VOLUME_GROUP]
    remove_baked(ob)
    remove_unused()
    assert not bpy.data.materials
    assert not bpy.data.node_groups


def test_groups_explain_their_inputs(tmp_path):
    shade_volume(show_volume(bpy.context, [source("cloud")], tmp_path / "a.vdb"), "REPLACE", 1, 1)
    wire_ambient(principled())
    assert sorted(bpy.data.node_groups.keys()) == [AMBIENT_GROUP, BEAM_GROUP, VOLUME_GROUP]
    grid_group()
    for group in bpy.data.node_groups:
        assert all(item.description for item in group.interface.items_tree)


def test_groups_bound_their_inputs():
    """Every input without a value is linked, or a colour, a switch or an object."""
    made = {group.name: group.interface.items_tree for group in (volume_group(), ambient_group())}
    made[BEAM_GROUP] = bpy.data.node_groups[BEAM_GROUP].interface.items_tree
    made[GRID_GROUP] = grid_group().interface.items_tree
    limits = {}
    for group, items in made.items():
        for item in items:
            if item.in_out == "INPUT" and hasattr(item, "min_value"):
                values = np.atleast_1d(item.default_value)
                assert np.all((values >= item.min_value) & (values <= item.max_value))
                limits[group, item.name] = item.min_value, item.max_value
    assert limits[VOLUME_GROUP, "G"] == limits[BEAM_GROUP, "G"] == (-1, 1)
    assert limits[AMBIENT_GROUP, "Alpha"] == (0, 1)
    assert {low for name, (low, _) in limits.items() if name[1] not in ("G", *AXES)} == {0}
    hidden = {item.name for items in made.values() for item in items if item.hide_value}
    assert hidden == {"Direct", "Others", "Light"}


def test_a_group_of_the_user_with_our_name_is_not_taken_for_ours():
    mine = bpy.data.node_groups.new(AMBIENT_GROUP, "ShaderNodeTree")
    material = principled()
    wire_ambient(material)
    assert ambient(material).node_tree != mine
    unwire_ambient(material)
    remove_unused()
    assert list(bpy.data.node_groups) == [mine]
