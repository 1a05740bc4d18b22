# SPDX-License-Identifier: GPL-3.0-or-later
"""A tree whose leaves geometry nodes put on its twigs, lit as a plant."""

import bpy
import numpy as np
import pytest
from scenes import camera, new_object, render, sun

ORDERS = 6  # of branches
FORKS = 3  # branches of the next order at the end of each
TRUNK = 0.9  # m
LEAF = 0.12, 0.07  # m
LEAF_COLOR = (0.16, 0.34, 0.07)
SIZE = 200  # pixels


def grow(rng):
    """(branches, 2, 3) m: ends of the branches of all orders, and the order of each."""
    starts, directions, branches = np.zeros((1, 3)), np.array([[0, 0, 1.0]]), []
    for order in range(ORDERS):
        ends = starts + TRUNK * 0.72**order * directions
        branches.append(np.stack([starts, ends], axis=1))
        starts = np.repeat(ends, FORKS, axis=0)
        directions = np.repeat(directions, FORKS, axis=0) + rng.normal(0, 0.5, starts.shape)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return branches


def edges(name, branches):
    mesh = bpy.data.meshes.new(name)
    lines = np.arange(2 * len(branches)).reshape(-1, 2)
    mesh.from_pydata(branches.reshape(-1, 3).tolist(), lines.tolist(), [])
    return new_object(name, mesh)


def leaf_material():
    """Reflects and transmits the same half each of what it does not absorb."""
    material = bpy.data.materials.new("Leaf")
    tree = material.node_tree
    tree.nodes.clear()
    output, mix, front, back = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("OutputMaterial", "MixShader", "BsdfDiffuse", "BsdfTranslucent")
    )
    for node, slot in ((front, 1), (back, 2)):
        node.inputs["Color"].default_value = (*LEAF_COLOR, 1)
        tree.links.new(node.outputs[0], mix.inputs[slot])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def geometry_nodes(ob, *kinds):
    """A modifier on `ob`: (group input, a node of each kind, group output), and the tree."""
    tree = bpy.data.node_groups.new(ob.name, "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    ob.modifiers.new("Shape", "NODES").node_group = tree
    return [tree.nodes.new(kind) for kind in ("NodeGroupInput", *kinds, "NodeGroupOutput")], tree


def thicken(ob):
    """A tube along every edge of `ob`."""
    (edges, curve, circle, tube, end), tree = geometry_nodes(
        ob, "GeometryNodeMeshToCurve", "GeometryNodeCurvePrimitiveCircle", "GeometryNodeCurveToMesh"
    )
    circle.inputs["Resolution"].default_value, circle.inputs["Radius"].default_value = 6, 0.015
    tree.links.new(edges.outputs[0], curve.inputs["Mesh"])
    tree.links.new(curve.outputs[0], tube.inputs["Curve"])
    tree.links.new(circle.outputs[0], tube.inputs["Profile Curve"])
    tree.links.new(tube.outputs[0], end.inputs[0])


def add_leaves(ob, material):
    """A leaf, turned at random, on every point of `ob`."""
    (points, leaf, turn, instance, realize, paint, end), tree = geometry_nodes(
        ob,
        "GeometryNodeMeshGrid",
        "FunctionNodeRandomValue",
        "GeometryNodeInstanceOnPoints",
        "GeometryNodeRealizeInstances",
        "GeometryNodeSetMaterial",
    )
    leaf.inputs["Size X"].default_value, leaf.inputs["Size Y"].default_value = LEAF
    leaf.inputs["Vertices X"].default_value = leaf.inputs["Vertices Y"].default_value = 2
    turn.data_type = "FLOAT_VECTOR"
    turn.inputs["Max"].default_value = (2 * np.pi,) * 3
    paint.inputs["Material"].default_value = material
    tree.links.new(points.outputs[0], instance.inputs["Points"])
    tree.links.new(leaf.outputs["Mesh"], instance.inputs["Instance"])
    tree.links.new(turn.outputs["Value"], instance.inputs["Rotation"])
    tree.links.new(instance.outputs[0], realize.inputs[0])
    tree.links.new(realize.outputs[0], paint.inputs["Geometry"])
    tree.links.new(paint.outputs[0], end.inputs[0])
    ob.data.materials.append(material)


@pytest.fixture
def tree(lb, tmp_path):
    """The leaves, selected, on a tree with bare wood, in a sun from the upper right alone."""
    branches = grow(np.random.default_rng(3))
    thicken(edges("Wood", np.concatenate(branches)))
    # Leaves sit on the whole length of the youngest twigs.
    share = np.linspace(0, 1, 8)[:, None]
    twigs = np.concatenate(branches[-2:])
    places = (1 - share) * twigs[:, None, 0] + share * twigs[:, None, 1]
    leaves = edges("Leaves", places.reshape(-1, 2, 3))
    add_leaves(leaves, leaf_material())
    leaves.select_set(True)
    sun((-1, 0.3, -0.8))
    camera(target=(0, 0, 1.8), width=3.5)
    scene = bpy.context.scene
    scene.render.film_transparent = True
    scene.cycles.diffuse_bounces = 0  # the lattice stands for all of them
    settings = scene.lb_lighting
    settings.medium, settings.resolution, settings.folder = "plant", 24, str(tmp_path)
    return leaves


def leaf_pixels(tmp_path):
    """(size, size) bool, where the picture shows nothing but leaves."""
    bpy.data.objects["Wood"].is_holdout = True
    alpha = render(tmp_path / "tree_mask.exr", "CYCLES", SIZE)[..., 3]
    bpy.data.objects["Wood"].is_holdout = False
    return alpha > 0.99


def green_share(pixels):
    red, green, blue = pixels.mean(axis=0)
    return green / (red + green + blue)


def render_with_bounces(tmp_path, bounces):
    """The picture of Cycles alone, by so many bounces."""
    cycles = bpy.context.scene.cycles
    for kind in ("max_bounces", "diffuse_bounces", "transmission_bounces"):
        setattr(cycles, kind, bounces)
    return render(tmp_path / "tree_bounces.exr", "CYCLES", SIZE)


@pytest.mark.parametrize("medium", ["plant", "MATERIAL"])
def test_leaves_are_brighter_and_their_shade_is_green(tree, tmp_path, medium):
    leaf = leaf_pixels(tmp_path)
    before = render(tmp_path / "tree_without.exr", "CYCLES", SIZE)[leaf, :3]
    many = render_with_bounces(tmp_path, 24)[leaf, :3]
    bpy.context.scene.cycles.diffuse_bounces = 0
    bpy.context.scene.lb_lighting.medium = medium
    assert bpy.ops.lb_lighting.bake() == {"FINISHED"}
    after = render(tmp_path / f"tree_{medium}.exr", "CYCLES", SIZE)[leaf, :3]

    # Modifiers make the leaves of single edges, and ours, the last of them, finds their light.
    shown = tree.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    attribute = shown.attributes["lb_ambient"]
    assert (attribute.domain, attribute.data_type) == ("POINT", "FLOAT_COLOR")
    assert "LB Ambient" in tree.data.materials["Leaf"].node_tree.nodes

    # Scattered light alone is added: lamps' own is Cycles'. By the leaves' own material it is as
    # much as Cycles finds by many bounces; the preset scatters more.
    assert many.mean() > 1.1 * before.mean()
    if medium == "MATERIAL":
        assert after.mean() == pytest.approx(many.mean(), rel=0.03)
    else:
        assert after.mean() > 1.1 * before.mean()
    dark = before.sum(axis=1) < 0.01
    assert dark.mean() > 0.05
    added = (after - before)[dark].sum(axis=1)
    assert np.median(added) > 0.002  # of leaves that throw back a tenth, in the shade of others
    # What reaches the shade came through leaves: it is greener than the white light of the sun,
    # in which a leaf has its own colour.
    assert green_share(after[dark]) > 1.02 * green_share(np.array([LEAF_COLOR]))
