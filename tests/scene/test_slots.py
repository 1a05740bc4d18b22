# SPDX-License-Identifier: GPL-3.0-or-later
"""The material of an object that counts is the one that Cycles renders."""

import bpy
import numpy as np
import pytest

from lb_lighting.errors import SceneError
from lb_lighting.scene import smoke
from lb_lighting.scene.medium_choice import FROM_MATERIAL
from lb_lighting.scene.opening import open_sources
from lb_lighting.scene.reader import Reader
from lb_lighting.transport.medium import Domain
from tests import scenery
from tests.scene.trees import add_node, attribute, combine, connect, make_material, surface

DOMAIN = Domain.around((-1, -1, -1), (1, 1, 1), 20)


def read(ob, grid=""):
    """(source, notes)."""
    reader = Reader(bpy.context.evaluated_depsgraph_get(), FROM_MATERIAL, 30.0, grid)
    (source,) = open_sources([ob], reader)
    return source, reader.notes


def fog(density):
    return scenery.volume_material(density, color=(0, 0, 0))


def muted(material):
    material.node_tree.nodes["Principled Volume"].mute = True
    return material


def glow(strength=1.0):
    material = make_material("glow")
    tree = material.node_tree
    shader = add_node(tree, "ShaderNodeEmission", Color=(1, 0.5, 0.25))
    if strength:
        tree.links.new(attribute(tree, "density"), shader.inputs["Strength"])
    else:
        shader.inputs["Strength"].default_value = 0
    return connect(material, shader, "Volume")


def slots(*materials):
    def prepare(ob):
        for material in materials:
            ob.data.materials.append(material())

    return prepare


def active(ob):
    slots(lambda: fog(0.2), lambda: fog(0.4))(ob)
    ob.active_material_index = 1


def of_the_object(ob):
    slots(lambda: fog(0.2))(ob)
    ob.material_slots[0].link = "OBJECT"
    ob.material_slots[0].material = fog(0.4)


def by_nodes(ob):
    slots(lambda: fog(0.2))(ob)
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    setter = tree.nodes.new("GeometryNodeSetMaterial")
    setter.inputs["Material"].default_value = fog(0.4)
    tree.links.new(tree.nodes.new("NodeGroupInput").outputs[0], setter.inputs[0])
    tree.links.new(setter.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    ob.modifiers.new("nodes", "NODES").node_group = tree


@pytest.mark.parametrize(
    ("prepare", "extinction"),
    [
        (slots(lambda: fog(0.2), lambda: fog(0.4)), 0.2),
        (active, 0.2),
        (of_the_object, 0.4),
        (by_nodes, 0.4),
        (slots(lambda: surface("ShaderNodeBsdfDiffuse"), lambda: fog(0.4)), 0.4),
        (slots(lambda: muted(fog(0.2)), lambda: fog(0.4)), 0.4),
        (slots(lambda: glow(strength=0), lambda: fog(0.4)), 0.4),
        (slots(lambda: glow(strength=1), lambda: fog(0.4)), 0.0),
        (slots(lambda: fog(0.0), lambda: fog(0.4)), 0.0),
    ],
)
def test_volumes_have_the_first_material_that_cycles_renders(prepare, extinction, tmp_path, render):
    """Through a fog without light, the world has a brightness of e^-tau."""
    ob = scenery.add_fog(tmp_path, np.ones((40, 40, 40)), material=False)  # 10 m
    prepare(ob)
    scene = bpy.context.scene
    scene.camera.location = (4, 4, 20)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1
    scene.cycles.samples, scene.cycles.volume_biased = 1, True
    picture = render()
    source, notes = read(ob)
    optics = source.shares(DOMAIN)[0].optics
    assert np.add(optics.sigma_s, optics.sigma_a) == pytest.approx(extinction)
    assert notes == []
    if not source.glows:
        assert 10 * extinction == pytest.approx(-np.log(picture[0]), rel=0.03, abs=1e-3)
    else:  # each metre adds the colour
        assert picture - 1 == pytest.approx(10 * np.array((1, 0.5, 0.25)), rel=0.03)


@pytest.mark.parametrize("materials", [[], [None], [None, lambda: fog(0.4)]])
def test_an_empty_first_slot_is_no_material(materials, tmp_path):
    """Cycles renders it with a default material, so the second slot does not count."""
    ob = scenery.add_fog(tmp_path, material=False)
    for material in materials:
        ob.data.materials.append(material and material())
    source, notes = read(ob)
    assert source.material is None
    assert notes == ["'fog' has no volume material; the preset 'cloud' was used."]


def test_a_circle_of_links_is_refused(tmp_path):
    """Cycles renders nothing of it, and no preset replaces it."""
    ob = scenery.add_fog(tmp_path)
    tree = ob.active_material.node_tree
    first, second = (tree.nodes.new("ShaderNodeAddShader") for _ in range(2))
    tree.links.new(first.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], first.inputs[0])
    with pytest.raises(SceneError, match="The links of 'fog' form a loop at the node 'Add"):
        read(ob)


def test_smoke_has_the_first_material_with_a_volume():
    """An empty slot of a mesh has a plain surface."""
    ob = scenery.add_ball(material=surface("ShaderNodeBsdfDiffuse"))
    ob.data.materials.append(None)
    ob.data.materials.append(fog(2.0))
    materials = smoke.materials(ob, bpy.context.evaluated_depsgraph_get())
    assert materials == [ob.data.materials[0], ob.data.materials[2]]


def test_a_material_override_of_the_view_layer_gives_a_note(tmp_path):
    ob = scenery.add_fog(tmp_path)
    bpy.context.view_layer.material_override = bpy.data.materials.new("clay")
    source, (note,) = read(ob)
    assert source.material.optics.sigma_s == pytest.approx(3.6)
    assert note.startswith("The view layer 'ViewLayer' overrides all materials with 'clay'")


class TestGrids:
    def test_a_material_without_a_grid_gives_a_note(self, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob.active_material.node_tree.nodes["Principled Volume"].inputs[
            "Density Attribute"
        ].default_value = ""
        source, (note,) = read(ob)
        assert note.startswith("The material of 'fog' reads no grid, so Cycles does not")
        assert set(np.unique(source.shares(DOMAIN)[0].density)) == {0, 1}
        assert read(ob, grid="density")[1] == []

    def test_unsupported_emission_is_refused_if_it_is_all(self, tmp_path):
        """If the material also scatters, a note says that the emission is left out."""
        ob = scenery.add_fog(tmp_path, material=False)
        material = glow()
        ob.data.materials.append(material)
        tree = material.node_tree
        noise = tree.nodes.new("ShaderNodeTexNoise")
        tree.links.new(noise.outputs[1], tree.nodes["Emission"].inputs["Color"])
        with pytest.raises(SceneError, match="'glow' takes a value from the node 'Noise Texture'"):
            read(ob)
        both = combine(tree, tree.nodes["Emission"], add_node(tree, "ShaderNodeVolumeScatter"))
        connect(material, both, "Volume")
        notes = read(ob)[1]
        assert any(note.startswith("'fog' emits light, but that") for note in notes)

    def test_emission_by_a_missing_grid_is_refused_if_it_is_all(self, tmp_path):
        ob = scenery.add_fog(tmp_path, material=False)
        material = glow()
        ob.data.materials.append(material)
        material.node_tree.nodes["Attribute"].attribute_name = "fire"
        with pytest.raises(SceneError, match="'fog' has no grid 'fire'; choose one of: density"):
            read(ob)

    def test_density_is_clamped_before_it_is_averaged(self, tmp_path):
        """The mean of 0.25 and 1, clamped to 0.5, is 0.375."""
        values = np.full((16, 16, 16), 0.25)
        values[::2] = 1
        ob = scenery.add_fog(tmp_path, values, material=False)
        material = make_material()
        tree = material.node_tree
        clamped = tree.nodes.new("ShaderNodeMath")
        clamped.operation, clamped.use_clamp = "MULTIPLY", True
        clamped.inputs[1].default_value = 2
        tree.links.new(attribute(tree, "density"), clamped.inputs[0])
        scatter = add_node(tree, "ShaderNodeVolumeScatter", Density=clamped.outputs[0])
        ob.data.materials.append(connect(material, scatter, "Volume"))
        coarse = Domain.around((-1, -1, -1), (3, 3, 3), 8, padding=0)
        (share,) = read(ob)[0].shares(coarse)
        assert share.density[1:-1, 1:-1, 1:-1] == pytest.approx(0.375)
        assert share.optics.sigma_s == pytest.approx(2 * 0.8)

    def test_a_solid_with_a_density_from_a_grid_is_refused(self):
        """A mesh has no grid: a named Density Attribute then counts as 1, a linked one as 0."""
        ob = scenery.add_ball(material=fog(2.0))
        assert read(ob)[0].material.optics.sigma_a == pytest.approx(2)
        tree = ob.active_material.node_tree
        inputs = tree.nodes["Principled Volume"].inputs
        inputs["Density Attribute"].default_value = ""
        tree.links.new(attribute(tree, "smoke"), inputs["Density"])
        with pytest.raises(SceneError, match="'ball' follows the attribute 'smoke', which a mesh"):
            read(ob)

    def test_a_density_from_an_object_attribute(self, tmp_path):
        ob = scenery.add_fog(tmp_path)
        ob["thickness"] = 2.5
        tree = ob.active_material.node_tree
        density = tree.nodes["Principled Volume"].inputs["Density"]
        tree.links.new(attribute(tree, "thickness", kind="OBJECT"), density)
        optics = read(ob)[0].material.optics
        assert np.add(optics.sigma_s, optics.sigma_a) == pytest.approx(2.5)


class TestFaces:
    @pytest.mark.parametrize("materials", [[], [None], [None, None]])
    def test_faces_without_a_material_are_plain(self, materials):
        ob = scenery.add_leaves(material=False)
        for material in materials:
            ob.data.materials.append(material)
        optics = read(ob)[0].shares(DOMAIN)[0].optics
        assert optics.sigma_s == pytest.approx(0.8)

    def test_faces_with_an_empty_material_are_black(self):
        """As in Cycles."""
        material = make_material("empty")
        ob = scenery.add_leaves(material=False)
        ob.data.materials.append(material)
        optics = read(ob)[0].shares(DOMAIN)[0].optics
        assert (optics.sigma_s, optics.sigma_a) == (0, 1)
