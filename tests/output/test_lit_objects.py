# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that show light on their surface, and their materials when the light is gone."""

import bpy
import pytest

from lb_lighting.ours import is_ours
from lb_lighting.output.attribute import AMBIENT_ATTRIBUTE
from lb_lighting.output.shading_surfaces import (
    light_surface,
    unlight_surface,
    unwire_unused,
    wire_ambient,
)
from lb_lighting.output.shading_volumes import remove_unused
from lb_lighting.output.surface_groups import (
    AMBIENT_GROUP,
)
from tests.output.graphs import ambient, ambients, dump, principled


def lit_object(scene, *materials):
    """A mesh object in `scene` as a bake leaves it."""
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata([(0, 0, 0)], [], [])
    for material in materials:
        mesh.materials.append(material)
    ob = bpy.data.objects.new("ob", mesh)
    scene.collection.objects.link(ob)
    mesh.attributes.new(AMBIENT_ATTRIBUTE, "FLOAT_COLOR", "POINT")
    light_surface(ob)
    return ob


def delete(ob):
    bpy.data.objects.remove(ob)


def take_out_of_the_scene(ob):
    bpy.context.scene.collection.objects.unlink(ob)


def remove_light(ob):
    ob.data.attributes.remove(ob.data.attributes[AMBIENT_ATTRIBUTE])


def swap_material(ob):
    ob.data.materials[0] = bpy.data.materials.new("other")


def override_material(ob):
    ob.material_slots[0].link = "OBJECT"
    ob.material_slots[0].material = bpy.data.materials.new("other")
    ob.data.materials[0] = None


CHANGES = [delete, take_out_of_the_scene, remove_light, swap_material, override_material]


@pytest.mark.parametrize("slots", [[], [None], [None, "user"]])
def test_objects_without_material_are_lit_and_given_back(slots):
    user = principled()
    ob = lit_object(bpy.context.scene, *(user if slot else None for slot in slots))
    assert ob.material_slots
    for slot in ob.material_slots:
        assert ambient(slot.material).node_tree.name == AMBIENT_GROUP
    assert not is_ours(ob.data)
    remove_light(ob)
    unlight_surface(ob)
    unwire_unused()
    remove_unused()
    assert [m and m.name for m in ob.data.materials] == slots
    assert list(ob.data.keys()) == []
    assert bpy.data.materials.keys() == ["user"]
    assert not bpy.data.node_groups


def test_user_material_in_our_slot_stays():
    ob = lit_object(bpy.context.scene)
    user = ob.material_slots[0].material = principled()
    unlight_surface(ob)
    assert list(ob.data.materials) == [user]


def test_user_material_of_the_object_in_our_slot_stays():
    ob = lit_object(bpy.context.scene)
    ob.material_slots[0].link = "OBJECT"
    user = ob.material_slots[0].material = principled()
    unlight_surface(ob)
    assert ob.material_slots[0].material == user
    assert list(ob.data.materials) == [None]


@pytest.mark.parametrize("change", CHANGES)
def test_materials_without_a_lit_mesh_are_unwired(change):
    user = principled()
    before = dump(user)
    ob = lit_object(bpy.context.scene, user)
    unwire_unused()
    assert ambient(user)
    change(ob)
    unwire_unused()
    assert dump(user) == before


def test_an_object_whose_light_was_removed_by_hand_gets_its_slots_back():
    ob = lit_object(bpy.context.scene)
    remove_light(ob)
    unwire_unused()
    remove_unused()
    assert not ob.data.materials
    assert not bpy.data.materials
    assert list(ob.data.keys()) == []


def test_materials_of_lit_meshes_in_other_scenes_stay_wired():
    user = principled()
    here = lit_object(bpy.context.scene, user)
    other = lit_object(bpy.data.scenes.new("other"), user)
    plain = lit_object(bpy.data.scenes["other"])
    remove_light(here)
    unlight_surface(here)
    unwire_unused()
    assert ambient(user)
    assert ambient(plain.material_slots[0].material)
    remove_light(other)
    unwire_unused()
    assert not ambients(user)


def test_a_duplicate_out_of_the_scene_does_not_take_the_material_of_the_mesh():
    ob = lit_object(bpy.context.scene)
    bpy.data.objects.new("duplicate", ob.data)
    unwire_unused()
    assert ambient(ob.material_slots[0].material)


def test_materials_of_a_library_are_left_alone(tmp_path):
    user = principled()
    wire_ambient(user)
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {user})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.materials = ["user"]
    unwire_unused()
    assert ambient(linked.materials[0])
