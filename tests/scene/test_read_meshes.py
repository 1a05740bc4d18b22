# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of every origin, as Blender evaluates them."""

import time
from math import pi

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from lb_lighting.errors import SceneError
from lb_lighting.scene import meshes, read_meshes
from tests.scene.shapes import (
    ROTATED_SCALED,
    add_cube,
    add_mesh,
    add_object,
    area_of,
    parts_of,
    triangles_of,
)


def geometry_nodes(ob, build):
    """Give `ob` a geometry nodes modifier; build(tree, geometry in) returns the geometry out."""
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(build(tree, start.outputs[0]), end.inputs[0])
    ob.modifiers.new("nodes", "NODES").node_group = tree


class TestWorldParts:
    def test_modifiers_and_world_space(self):
        cube = add_cube(matrix=Matrix.Translation((5, 0, 0)) @ Matrix.Scale(2, 4))
        cube.modifiers.new("array", "ARRAY").count = 3
        triangles = triangles_of(cube)
        assert len(triangles) == 36
        assert triangles.min(axis=(0, 1)) == pytest.approx([4, -1, -1])
        assert triangles.max(axis=(0, 1)) == pytest.approx([10, 1, 1])

    def test_only_the_chosen_objects(self):
        cube, _other = add_cube("a"), add_cube("b")
        assert {part.object for part in parts_of(cube)} == {cube}

    def test_a_mesh_and_its_instances_are_separate_parts(self):
        parent = add_cube("parent", Matrix.Scale(4, 4))
        parent.instance_type = "VERTS"
        child = add_object(parent.data, "child")
        child.parent = parent
        triangles = {part.instanced: len(part.faces.triangles) for part in parts_of(parent)}
        assert triangles == {False: 12, True: 96}

    def test_vertices_that_are_not_finite(self):
        mesh = add_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
        mesh.vertices[1].co.x = np.nan
        (part,) = parts_of(add_object(mesh, "broken"))
        with pytest.raises(
            SceneError, match=r"^'broken' has vertices whose position is not a number; repair"
        ):
            _ = part.faces.triangles

    def test_split_by_material_slot(self):
        mesh = add_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 5, 0)], [(0, 1, 2), (1, 3, 2)])
        materials = [bpy.data.materials.new(name) for name in "ab"]
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons[1].material_index = 1
        ob = add_object(mesh)
        first, second = parts_of(ob)
        assert [first.material, second.material] == materials
        assert [part.faces.area for part in (first, second)] == pytest.approx([0.5, 4.5])

    def test_material_of_the_object_overrides_that_of_the_mesh(self):
        cube = add_cube()
        cube.data.materials.append(bpy.data.materials.new("mesh's"))
        cube.material_slots[0].link = "OBJECT"
        cube.material_slots[0].material = mine = bpy.data.materials.new("object's")
        assert [part.material for part in parts_of(cube)] == [mine]

    def test_faces_of_a_missing_slot_take_the_last(self):
        mesh = add_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
        mesh.polygons[0].material_index = 7
        assert [part.material for part in parts_of(add_object(mesh))] == [None]

    def test_geometry_nodes_instances(self):
        cube = add_cube(matrix=ROTATED_SCALED)

        def on_points(tree, geometry):
            leaf = tree.nodes.new("GeometryNodeMeshGrid")
            instances = tree.nodes.new("GeometryNodeInstanceOnPoints")
            tree.links.new(geometry, instances.inputs["Points"])
            tree.links.new(leaf.outputs[0], instances.inputs["Instance"])
            return instances.outputs[0]

        geometry_nodes(cube, on_points)
        bpy.context.view_layer.update()
        triangles = triangles_of(cube)
        centers = [t.mean(axis=(0, 1)) for t in triangles.reshape(8, -1, 3, 3)]
        corners = [ROTATED_SCALED @ v.co for v in cube.data.vertices]
        assert np.sort(centers, axis=0) == pytest.approx(np.sort(corners, axis=0), abs=1e-5)

    def test_material_set_by_geometry_nodes(self):
        cube, material = add_cube(), bpy.data.materials.new("set")

        def with_material(tree, geometry):
            node = tree.nodes.new("GeometryNodeSetMaterial")
            node.inputs["Material"].default_value = material
            tree.links.new(geometry, node.inputs[0])
            return node.outputs[0]

        geometry_nodes(cube, with_material)
        assert [part.material for part in parts_of(cube)] == [material]

    def test_nested_collection_instances(self):
        cube, inner, outer = add_cube(), *(bpy.data.collections.new(n) for n in ("in", "out"))
        bpy.context.collection.objects.unlink(cube)
        inner.objects.link(cube)
        nested, top = (bpy.data.objects.new(n, None) for n in ("nested", "top"))
        for empty, collection in ((nested, inner), (top, outer)):
            empty.instance_type, empty.instance_collection = "COLLECTION", collection
        outer.objects.link(nested)
        nested.location = (0, 0, 3)
        bpy.context.collection.objects.link(top)
        top.scale = (2, 2, 2)
        (part,) = parts_of(top)
        assert part.object == top
        assert part.instanced
        assert part.faces.triangles.mean(axis=(0, 1)) == pytest.approx([0, 0, 6])
        assert area_of(part.faces.triangles) == pytest.approx(24)

    def test_particle_instances_without_their_emitter(self):
        cube = add_cube(matrix=Matrix.Translation((0, 0, -50)))
        emitter = add_object(add_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]), "emitter")
        settings = emitter.modifiers.new("p", "PARTICLE_SYSTEM").particle_system.settings
        settings.type, settings.count = "HAIR", 5
        settings.render_type, settings.instance_object = "OBJECT", cube
        emitter.show_instancer_for_viewport = emitter.show_instancer_for_render = False
        (part,) = parts_of(emitter)
        assert len(part.faces.triangles) == 5 * 12
        assert part.faces.triangles[..., 2].max() < 5

    def test_children_on_vertices(self):
        parent = add_object(add_mesh([(0, 0, 0), (4, 0, 0)], []), "parent")
        parent.instance_type = "VERTS"
        add_cube().parent = parent
        assert len(triangles_of(parent)) == 24

    def test_curve_with_its_material(self):
        curve = bpy.data.curves.new("curve", "CURVE")
        curve.dimensions, curve.bevel_depth = "3D", 0.1
        curve.splines.new("POLY").points.add(1)
        curve.splines[0].points[1].co = (1, 0, 0, 1)
        curve.materials.append(bpy.data.materials.new("bark"))
        (part,) = parts_of(add_object(curve))
        assert part.material == curve.materials[0]
        assert area_of(part.faces.triangles) == pytest.approx(2 * pi * 0.1, rel=0.05)

    def test_hundred_thousand_leaves_in_seconds(self):
        points = np.random.default_rng(0).uniform(-1, 1, (100_000, 3))
        ob = add_object(add_mesh(points, []))

        def leaves(tree, geometry):
            leaf = tree.nodes.new("GeometryNodeMeshGrid")
            leaf.inputs["Vertices X"].default_value = leaf.inputs["Vertices Y"].default_value = 2
            instances = tree.nodes.new("GeometryNodeInstanceOnPoints")
            tree.links.new(geometry, instances.inputs["Points"])
            tree.links.new(leaf.outputs[0], instances.inputs["Instance"])
            return instances.outputs[0]

        geometry_nodes(ob, leaves)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        start = time.perf_counter()
        (part,) = read_meshes.world_parts(depsgraph, [ob])
        assert len(part.faces.triangles) == 200_000
        assert time.perf_counter() - start < 10

    def test_object_without_faces(self):
        assert parts_of(add_object(add_mesh([(0, 0, 0), (1, 0, 0)], []))) == []
        with pytest.raises(SceneError, match="no faces"):
            meshes.world_bounds([])

    def test_bounds(self):
        lower, upper = meshes.world_bounds(
            [part.faces for part in parts_of(add_cube(matrix=Matrix.Scale(4, 4)))]
        )
        assert (*lower, *upper) == pytest.approx((-2, -2, -2, 2, 2, 2))
