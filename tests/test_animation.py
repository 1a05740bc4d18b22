# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects, materials and lamps that change: what lights each baked frame, and what it shows."""

import bpy
import numpy as np
import pytest
from mathutils import Vector

from lb_lighting import bake
from lb_lighting.clearing import clear
from lb_lighting.options import Options
from lb_lighting.output.sources import hide_source
from lb_lighting.output.volume import baked_volumes
from lb_lighting.output.volume_groups import BEAM_GROUP, LAMP_GROUP
from lb_lighting.reading import read_scene
from lb_lighting.sequence import Sequence
from tests import scenery
from tests.output.rendering import dark_scene, render


def bake_frames(*objects, first=1, last=2, **changes):
    options = Options.of(bpy.context.scene, **changes)
    return bake.run(Sequence(bpy.context, objects, options, first, last), bpy.context)


def key(owner, path, **values):
    """Key the property `path` of `owner`: frame_1=value, ..., straight from one to the next."""
    for name, value in values.items():
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=int(name.removeprefix("frame_")))


def read_task(*objects, frame):
    return read_scene(bpy.context, objects, Options.of(bpy.context.scene), frame=frame)


def by_keys(ob):
    key(ob, "location", frame_1=(0, 0, 0), frame_3=(4, 0, 0))


def by_parent(ob):
    ob.parent = scenery.link("parent", None)
    ob.parent.hide_viewport = True
    by_keys(ob.parent)


def by_constraint(ob):
    constraint = ob.constraints.new("COPY_LOCATION")
    constraint.target = scenery.link("target", None)
    constraint.target.hide_viewport = True
    by_keys(constraint.target)


def by_driver(ob):
    ob.driver_add("location", 0).driver.expression = "2 * frame - 2"


@pytest.mark.parametrize("move", [by_keys, by_parent, by_constraint, by_driver])
def test_a_source_that_a_bake_hid_is_read_where_each_frame_has_it(scene, tmp_path, move):
    fog = scenery.add_fog(tmp_path)
    move(fog)
    hide_source(fog)
    scene.frame_set(1)
    for frame in (3, 1, 2):
        place = read_task(fog, frame=frame).sources[0].place
        assert place[0, 3] == pytest.approx(2 * frame - 2)
    assert fog.hide_viewport
    assert scene.frame_current == 1


def keyed_material(fog):
    socket = fog.active_material.node_tree.nodes["Principled Volume"].inputs["Density"]
    key(socket, "default_value", frame_1=1.0, frame_3=5.0)
    return fog, lambda task: np.max(task.sources[0].material.optics.sigma_s)


def keyed_lamp(fog):
    sun = bpy.data.objects["sun"]
    key(sun, "rotation_euler", frame_1=(0, 0, 0), frame_3=(1, 0, 0))
    key(sun.data, "energy", frame_1=1.0, frame_3=5.0)
    return sun, lambda task: task.lights[0].irradiance * task.lights[0].direction[1]


def keyed_modifier(fog):
    ball = scenery.add_ball(role="SOLID", material=fog.active_material)
    key(ball.modifiers.new("grow", "DISPLACE"), "strength", frame_1=0.0, frame_3=2.0)
    return ball, lambda task: np.max(task.sources[-1].bounds)


def keyed_domain(fog):
    box = scenery.add_ball("box")
    by_keys(box)
    bpy.context.scene.lb_lighting.domain = box
    return box, lambda task: task.box[0][0]


@pytest.mark.parametrize("make", [keyed_material, keyed_lamp, keyed_modifier, keyed_domain])
def test_whatever_is_hidden_changes_with_the_frame(scene, tmp_path, make):
    fog = scenery.add_fog(tmp_path)
    what, read = make(fog)
    sources = [fog, what] if make == keyed_modifier else [fog]
    shown = {frame: read(read_task(*sources, frame=frame)) for frame in (1, 3)}
    hide_source(what)
    what.hide_render = False
    hidden = {frame: read(read_task(*sources, frame=frame)) for frame in (3, 1)}
    assert hidden == pytest.approx(shown)
    assert abs(hidden[3] - hidden[1]) > 0.5


def test_a_single_bake_again_lights_the_source_where_it_is_now(scene, tmp_path):
    fog = scenery.add_fog(tmp_path)
    by_keys(fog)
    scene.frame_set(1)
    scenery.bake_light(fog)
    scene.frame_set(3)
    outcome = scenery.bake_light(fog)
    assert np.mean([outcome.result.domain.origin, outcome.result.domain.upper], axis=0)[0] == (
        pytest.approx(4, abs=0.01)
    )


def test_a_single_bake_leaves_what_was_changed_without_a_key(scene, tmp_path):
    fog = scenery.add_fog(tmp_path)
    sun = bpy.data.objects["sun"]
    key(sun, "rotation_euler", frame_1=(0, 0, 0), frame_3=(1, 0, 0))
    scenery.bake_light(fog)
    sun.rotation_euler.x = 0.3
    scenery.bake_light(fog)
    assert sun.rotation_euler.x == pytest.approx(0.3)


def test_keys_that_show_a_source_beside_its_light_are_told(scene, tmp_path):
    fog = scenery.add_fog(tmp_path)
    key(fog, "hide_render", frame_1=False, frame_2=False)
    notes = bake_frames(fog, last=1).notes
    assert any(note.startswith("Keyframes show 'fog' again") for note in notes)


def test_a_moving_source_is_baked_and_shown_where_it_is(scene, tmp_path):
    fog = scenery.add_fog(tmp_path)
    by_keys(fog)
    scene.frame_set(1)
    scene.frame_start, scene.frame_end = 1, 2
    scenery.select(fog)
    assert bpy.ops.lb_lighting.bake_animation() == {"FINISHED"}
    (ob,) = baked_volumes(scene)
    for frame in (1, 2):
        scene.frame_set(frame)
        box = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).bound_box
        middle = np.mean([ob.matrix_world @ Vector(corner) for corner in box], axis=0)
        place = read_task(fog, frame=frame).sources[0].place[:3, 3]
        assert middle == pytest.approx(place, abs=0.01)


def tree():
    (ob,) = baked_volumes(bpy.context.scene)
    return ob.active_material.node_tree


def directions(frame):
    """[(3,)]: the directions of sunlight in the shader at a frame."""
    bpy.context.scene.frame_set(frame)
    nodes = [n for n in tree().nodes if n.type == "GROUP" and n.node_tree.name == BEAM_GROUP]
    return [[node.inputs[a].default_value[0] for a in "XYZ"] for node in nodes]


def turning_sun():
    sun = bpy.data.objects["sun"]
    key(sun, "rotation_euler", frame_1=(0, 0, 0), frame_3=(2, 0, 0))
    bpy.context.scene.frame_set(1)
    return sun


def ways(sun, frames):
    """{frame: (3,)}: the direction in which sunlight travels."""
    directions = {}
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        directions[frame] = -np.array(sun.matrix_world.col[2])[:3]
    return directions


def test_each_frame_has_its_own_direction_of_the_sun(scene, tmp_path):
    fog, sun = scenery.add_fog(tmp_path), turning_sun()
    outcome = bake_frames(fog)
    expected = ways(sun, (1, 2))
    for frame, shown in ((0, 1), (1, 1), (2, 2), (5, 2)):
        for direction in directions(frame):
            assert direction == pytest.approx(expected[shown], abs=1e-6)
    scene.frame_set(1, subframe=0.9)  # the file is that of frame 1
    assert tree().nodes["Group"].inputs["Strength"].default_value == 1
    assert not any("move" in note.lower() for note in outcome.notes)
    bake_frames(fog, last=3)  # kept frames have keyframes too
    expected = ways(sun, (1, 2, 3))
    for frame in (1, 2, 3):
        assert directions(frame)[0] == pytest.approx(expected[frame], abs=1e-6)


def test_clear_takes_the_keys_out(scene, tmp_path):
    fog = scenery.add_fog(tmp_path)
    turning_sun()
    before = scenery.snapshot()
    bake_frames(fog)
    assert len(bpy.data.actions) == 2
    clear(bpy.context)
    assert scenery.snapshot() == before


def test_a_bake_of_one_frame_has_no_keys(scene, tmp_path):
    fog, sun = scenery.add_fog(tmp_path), turning_sun()
    bake_frames(fog)
    scenery.bake_light(fog)
    assert len(bpy.data.actions) == 1
    assert directions(2)[0] == pytest.approx(ways(sun, (1,))[1], abs=1e-6)


def test_what_does_not_change_has_no_keys_and_those_of_the_user_stay(scene, tmp_path):
    fog = scenery.add_fog(tmp_path)
    bake_frames(fog)
    assert tree().animation_data is None
    strength = tree().nodes["Group"].inputs["Strength"]
    key(strength, "default_value", frame_1=1.0, frame_2=3.0)
    turning_sun()
    bake_frames(fog, last=3)
    for frame, value in ((1, 1.0), (2, 3.0)):
        scene.frame_set(frame)
        assert tree().nodes["Group"].inputs["Strength"].default_value == value
    (action,) = [a for a in bpy.data.actions if a == tree().animation_data.action]
    clear(bpy.context)
    assert action in list(bpy.data.actions)


def test_frames_with_other_lamps_show_each_their_own(scene, tmp_path):
    """First a sun, then only a lamp that moves and grows, whose light is in the same grid."""
    fog = scenery.add_fog(tmp_path)
    sun = bpy.data.objects["sun"]
    key(sun.data, "energy", frame_1=3.0, frame_2=0.0)
    data = bpy.data.lights.new("lamp", "POINT")
    lamp = scenery.link("lamp", data)
    key(data, "energy", frame_1=0.0, frame_2=50.0, frame_3=50.0)
    key(data, "shadow_soft_size", frame_1=0.1, frame_2=0.2, frame_3=0.3)
    key(lamp, "location", frame_1=(0, 0, 3), frame_2=(0, 0, 4), frame_3=(0, 5, 0))
    bake_frames(fog, last=3)
    nodes = tree().nodes
    shares = [node for node in nodes if node.type == "VECT_MATH"]
    lamps = [n for n in nodes if n.type == "GROUP" and n.node_tree.name == LAMP_GROUP]
    for frame, place in ((2, (0, 0, 4)), (3, (0, 5, 0))):
        scene.frame_set(frame)
        for node in lamps:
            assert tuple(node.inputs["Position"].default_value) == pytest.approx(place)
            assert node.inputs["Radius"].default_value == pytest.approx(frame / 10)
    for frame, of_lamp in ((1, False), (2, True), (3, True)):
        scene.frame_set(frame)
        for node in shares:
            feeds_lamp = any(link.to_node in lamps for link in node.outputs[0].links)
            assert node.inputs["Scale"].default_value == (feeds_lamp == of_lamp)


def test_pictures_of_frames_are_those_of_single_bakes(scene, tmp_path):
    """A sun that turns, and a material whose density increases."""
    fog = scenery.add_fog(tmp_path)
    turning_sun()
    socket = fog.active_material.node_tree.nodes["Principled Volume"].inputs["Density"]
    key(socket, "default_value", frame_1=1.0, frame_3=5.0)
    dark_scene((0, 0, 6), (0, 0, 0), width=2.4)

    def picture(frame):
        scene.frame_set(frame)
        return render(scene, tmp_path / f"{len(list(tmp_path.iterdir()))}.exr", 24, 16)

    bake_frames(fog, last=3)
    animated = {frame: picture(frame) for frame in (1, 3)}
    for frame in (1, 3):
        scene.frame_set(frame)
        scenery.bake_light(fog)
        alone = picture(frame)
        assert alone.max() > 0.01
        np.testing.assert_allclose(animated[frame], alone, atol=0.01 * alone.max())
